"""Compile all kernels once, so that no measurement waits for the compiler (see ./omm).

python -m omm_bringup.warm_up rendering | measuring
"""

import sys

import numpy as np

from omm_core.geometry import RigidTransform


def rendering() -> None:
    """Everything that the simulated camera needs, at rest and in motion."""
    from omm_simulation.camera import SimulatedCamera
    from omm_simulation.cell import draw
    from omm_simulation.scenario import load_scenario

    cell = draw(load_scenario("bench"), 1)
    at = cell.stops[0].spindle_in_machine_mm
    camera = SimulatedCamera(cell)
    for moved_mm in (0.0, 0.5):
        poses = [
            RigidTransform(rotation=np.eye(3), translation_mm=at + [share * moved_mm, 0.0, 0.0])
            for share in (0.0, 1.0)
        ]
        camera.image(poses, frame=1)


def measuring() -> None:
    """Everything from an image to the estimate, on a plain drawing of four targets."""
    from omm_core.calibration import load_calibration
    from omm_core.estimation import Observation, solve
    from omm_core.part import load_part
    from omm_core.targets import TargetFamily, detect_targets
    from omm_simulation.scenario import load_scenario

    scenario = load_scenario("bench")
    part, calibration = load_part(scenario.part_file), load_calibration(scenario.calibration_file)
    family = TargetFamily.by_name(part.target_family)
    detect_targets(_drawing(family, part.targets[0].id), family)
    machine_T_taper = RigidTransform.identity()
    middle = np.array([calibration.width_px, calibration.height_px]) / 2.0
    observations = []
    for i, target in enumerate(part.targets):
        for side in (-60.0, 60.0):
            spindle_mm = target.xyz_mm + [side, 0.0, 620.0]
            camera = RigidTransform(rotation=np.eye(3), translation_mm=spindle_mm) @ machine_T_taper
            in_camera = (camera @ calibration.taper_T_camera).inverse() @ target.xyz_mm
            pixel = calibration.lens.project(in_camera[None])[0]
            observations.append(
                Observation(
                    stamp_ns=2 * i + int(side > 0),
                    target_id=target.id,
                    center_px=pixel if np.all(np.isfinite(pixel)) else middle,
                    covariance_px2=np.eye(2) * 1e-4,
                    machine_T_spindle=camera,
                )
            )
    solve(observations, part, calibration)


def _drawing(family: "TargetFamily", target_id: int) -> np.ndarray:  # type: ignore[name-defined, type-arg] # noqa: F821
    """A plain drawing of one target, bright on black."""
    size, radius = 240, 20.0
    rows, cols = np.mgrid[:size, :size] - size / 2.0
    rho = np.hypot(cols, rows) / radius
    sector = np.floor(np.mod(np.arctan2(rows, cols), 2 * np.pi) / (2 * np.pi) * family.bits)
    bits = np.array([int(b) for b in format(family.code_of(target_id), f"0{family.bits}b")])
    ring = (rho > family.ring_inner_ratio) & (rho < family.ring_outer_ratio)
    bright = (rho < 1.0) | (ring & (bits[sector.astype(int) % family.bits] == 1))
    image = np.where(bright, 180.0, 10.0)
    for axis in (0, 1):  # blurred as a lens would
        image = 0.5 * image + 0.25 * (np.roll(image, -1, axis) + np.roll(image, 1, axis))
    noise = np.random.default_rng(1).normal(0.0, 1.0, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


if __name__ == "__main__":
    {"rendering": rendering, "measuring": measuring}[sys.argv[1]]()
