"""Load, or compile once, all kernels of a measurement, so that no image waits for that.

Each function measures something small that needs no file. They may run side by side.

python -m omm_core.warm_up [detection] [estimation] [adjustment]
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.imaging.lens import PlumbBob
from omm_core.targets.coded.families import TargetFamily

_FAMILY = "metashape12"
_NORMAL = np.array([0.0, 0.0, 1.0])
_ABOVE_MM = 600.0


def warm_up_detection() -> None:
    """Find one target in a plain drawing, of 8 and of 16 bit."""
    from omm_core.targets import detect_targets
    from omm_core.targets.coded.uneven_outline import grey_unit, outline_uneven

    family = TargetFamily.by_name(_FAMILY)
    drawing = _drawing(family, 1)
    for image in (drawing, drawing.astype(np.uint16)):
        detect_targets(image, family)
        image.flags.writeable = False  # the form for which the kernels are compiled
        # Of evenly lit targets nobody asks for this outline.
        middle, round_px2 = image.shape[0] / 2.0, 1.0 / 20.0**2
        around = np.array([middle, middle, round_px2, 0.0, round_px2, 1.0])
        outline_uneven(image, around, grey_unit(image))


def warm_up_estimation() -> None:
    """Solve from eight images of four targets."""
    from omm_core.part_pose import Observation, solve

    lens = PlumbBob(
        width_px=2000, height_px=1500, fx_px=2500.0, fy_px=2500.0, cx_px=1000.0, cy_px=750.0
    )
    taper_T_camera = RigidTransform(rotation=np.eye(3), translation_mm=np.zeros(3))
    calibration = CameraCalibration(
        name="warm-up", lens=lens, taper_T_camera=taper_T_camera, covariance=np.zeros((0, 0))
    )
    corners = [(0.0, 0.0), (1000.0, 0.0), (1000.0, 700.0), (0.0, 700.0)]
    targets = tuple(
        Target(id=i, xyz_mm=np.array([*xy, 0.0]), dot_diameter_mm=10.0, normal=_NORMAL)
        for i, xy in enumerate(corners, start=1)
    )
    observations: list[Observation] = []
    for target in targets:
        for side_mm in (-60.0, 60.0):
            machine_T_spindle = RigidTransform(
                rotation=np.diag([1.0, -1.0, -1.0]),
                translation_mm=target.xyz_mm + [side_mm, 20.0, _ABOVE_MM],
            )
            in_camera = machine_T_spindle.inverse() @ target.xyz_mm
            observations.append(
                Observation(
                    stamp_ns=len(observations),
                    target_id=target.id,
                    center_px=lens.project(in_camera[None])[0],
                    covariance_px2=np.eye(2) * 1e-4,
                    machine_T_spindle=machine_T_spindle,
                )
            )
    solve(observations, Part(name="warm-up", target_family=_FAMILY, targets=targets), calibration)


def warm_up_adjustment() -> None:
    """Adjust and test two readings of one value."""
    from omm_core.adjustment import Block, Group, Problem, solve, test_observations

    reading = Block(
        name="readings",
        observed=np.array([[1.0], [1.1]]),
        covariance=np.full((2, 1, 1), 0.01),
        index={"value": np.zeros(2, dtype=int)},
        evaluate=lambda values: (values["value"][[0, 0]], {"value": np.ones((2, 1, 1))}),
    )
    problem = Problem(groups=(Group(name="value", values=np.zeros((1, 1))),), blocks=(reading,))
    test_observations(problem, solve(problem))


def _drawing(family: TargetFamily, target_id: int) -> NDArray[np.uint8]:
    """Return a plain drawing of one target, bright on black."""
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
    known = {
        "detection": warm_up_detection,
        "estimation": warm_up_estimation,
        "adjustment": warm_up_adjustment,
    }
    for name in sys.argv[1:] or known:
        known[name]()
