"""Random measuring cells: part, spindle poses and what the camera sees, with the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from core_cameras import PAPER_LENS
from numpy.typing import NDArray

from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform, spindle_T_taper
from omm_core.imaging.calibration import CameraCalibration
from omm_core.imaging.circle import CircleCentre, project_circles
from omm_core.part_pose.observation import Observation

Array = NDArray[np.float64]

PAPER_CALIBRATION = CameraCalibration(
    name="paper, table 1",
    lens=PAPER_LENS,
    taper_T_camera=RigidTransform.from_euler_xyz_rad(
        np.pi - 0.003, -0.009, 0.03, (-2.139, 0.301, -320.2)
    ),
    covariance=np.zeros((0, 0)),
)
BACKLASH_RAD = 6.15e-3
EXACT_MACHINE = {"stop_sigma_mm": 0.0, "geometry_sigma_mm": 0.0, "trust_detector": True}
"""Solve options under which the centres' own noise is the only one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """A part somewhere in a machine, and the noise-free observations of it."""

    part: Part
    calibration: CameraCalibration
    machine_T_part: RigidTransform
    gamma_s_rad: float
    observations: tuple[Observation, ...]

    @property
    def theta(self) -> Array:
        pose = self.machine_T_part
        return np.array([*pose.euler_xyz_rad(), *pose.translation_mm, self.gamma_s_rad])

    def noisy(self, random: np.random.Generator, sigma_px: float) -> tuple[Observation, ...]:
        return tuple(
            replace(
                o,
                center_px=o.center_px + random.normal(0, sigma_px, 2),
                covariance_px2=np.eye(2) * sigma_px**2,
            )
            for o in self.observations
        )


def observe(
    part: Part,
    calibration: CameraCalibration,
    machine_T_part: RigidTransform,
    gamma_s_rad: float,
    machine_T_spindles: list[RigidTransform],
    *,
    kind: CircleCentre = CircleCentre.OUTLINE,
    sigma_px: float = 0.05,
    margin_px: float = 20.0,
) -> tuple[Observation, ...]:
    """Return what the camera sees, without noise: every target wholly in the image."""
    observations = []
    holder = spindle_T_taper(gamma_s_rad) @ calibration.taper_T_camera
    size = np.array([calibration.width_px, calibration.height_px])
    for number, machine_T_spindle in enumerate(machine_T_spindles):
        camera_T_part = (machine_T_spindle @ holder).inverse() @ machine_T_part
        centres = camera_T_part @ np.array([t.xyz_mm for t in part.targets])
        normals = np.array([part.normal_of(t) for t in part.targets]) @ camera_T_part.rotation.T
        near = centres[:, 2] > 20.0
        for target, centre, normal in zip(
            np.array(part.targets, dtype=object)[near], centres[near], normals[near]
        ):
            (seen,) = project_circles(
                calibration.lens, [centre], [normal], [target.dot_diameter_mm], kind
            )
            radius = target.dot_diameter_mm / 2 / centre[2] * 2813.0 + margin_px
            if np.all(seen > radius) and np.all(seen < size - radius):
                observations.append(
                    Observation(
                        stamp_ns=(number + 1) * 1_000_000_000,
                        target_id=target.id,
                        center_px=seen,
                        covariance_px2=np.eye(2) * sigma_px**2,
                        machine_T_spindle=machine_T_spindle,
                    )
                )
    return tuple(observations)


def spindle_looking(
    random: np.random.Generator,
    at: Array,
    towards: Array,
    distance_mm: float,
    twist_rad: float,
    off_axis_mm: Array,
    calibration: CameraCalibration = PAPER_CALIBRATION,
    gamma_s_rad: float = 0.0,
) -> RigidTransform:
    """Return a spindle pose from which the camera looks along ``towards`` at a point."""
    z = towards / np.linalg.norm(towards)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(twist_rad), np.sin(twist_rad)
    rotation = np.column_stack([c * x + s * y, -s * x + c * y, z])
    position = at - distance_mm * z + rotation[:, :2] @ off_axis_mm
    machine_T_camera = RigidTransform(rotation=rotation, translation_mm=position)
    return machine_T_camera @ (spindle_T_taper(gamma_s_rad) @ calibration.taper_T_camera).inverse()


def bench_cell(random: np.random.Generator, *, images_per_target: int = 2) -> Cell:
    """Return the paper's bench: 4 targets, 1.5 x 1 m, 300 mm, a base of 120 mm, backlash."""
    corners = np.array([[0, 0, 3.75], [1500, 0, 11.9], [1500, 1000, 8.3], [0, 1000, -8.2]])
    part = Part(
        name="bench",
        target_family="metashape12",
        targets=tuple(
            Target(id=i, xyz_mm=x, dot_diameter_mm=8.0, normal=np.array([0.0, 0.0, 1.0]))
            for i, x in zip((42, 40, 8, 122), corners)
        ),
    )
    pose = RigidTransform.from_euler_xyz_rad(
        *random.normal(0, 2e-3, 3), translation_mm=random.uniform(-150, 150, 3)
    )
    gamma_s = float(random.uniform(-0.5, 0.5) * BACKLASH_RAD)
    spindles = [
        spindle_at_bench(pose @ target.xyz_mm + [side, 0, 0] + np.r_[random.normal(0, 5, 2), 0])
        for target in part.targets
        for side in np.linspace(-60, 60, images_per_target)
    ]
    return Cell(
        part=part,
        calibration=PAPER_CALIBRATION,
        machine_T_part=pose,
        gamma_s_rad=gamma_s,
        observations=observe(part, PAPER_CALIBRATION, pose, gamma_s, spindles),
    )


def spindle_at_bench(target_in_machine: Array, distance_mm: float = 300.0) -> RigidTransform:
    """Return the pose of a vertical spindle that does not turn, above a point."""
    offset = np.array([15.0, 35.0, distance_mm])  # the target is seen off the spindle's axis
    d_calib = np.array([0.0, 0.0, PAPER_CALIBRATION.taper_T_camera.translation_mm[2]])
    return RigidTransform(rotation=np.eye(3), translation_mm=target_in_machine + offset - d_calib)


def random_cell(
    random: np.random.Generator,
    calibration: CameraCalibration = PAPER_CALIBRATION,
    *,
    dot_diameter_mm: float = 8.0,
) -> Cell:
    """Return a cell with a head that turns, a part in any orientation within 20 m.

    Flat and solid parts, 4 to 8 targets; every target is seen from two places 40 mm or more
    apart, in images that are turned about the view and tilted, each with its own R_CNC.
    """
    while True:
        cell = _random_cell(random, calibration, dot_diameter_mm)
        seen = [o.target_id for o in cell.observations]
        if all(seen.count(target.id) >= 2 for target in cell.part.targets):
            return cell


def _random_cell(
    random: np.random.Generator, calibration: CameraCalibration, dot_diameter_mm: float
) -> Cell:
    flat = random.uniform() < 0.5
    size = np.exp(random.uniform(np.log(300), np.log(8000)))
    count = 4 if flat and random.uniform() < 0.7 else int(random.integers(4, 9))
    xyz = random.uniform(-0.5, 0.5, (count, 3)) * size * [1, 0.7, 0 if flat else 0.4]
    if flat:
        xyz[:4] = size / 2 * np.array([[-1, -0.7, 0], [1, -0.7, 0], [1, 0.7, 0], [-1, 0.7, 0]])
        xyz[:, 2] = random.normal(0, 3, count) if random.uniform() < 0.5 else 0.0
    tilted = random.normal(0, 0.1, (count, 3)) + np.array([0, 0, 1.0])
    normals = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
    part = Part(
        name="random",
        target_family="metashape12",
        targets=tuple(
            Target(id=i + 1, xyz_mm=x, dot_diameter_mm=dot_diameter_mm, normal=n)
            for i, (x, n) in enumerate(zip(xyz, normals))
        ),
    )
    quaternion = random.normal(size=4)
    pose = RigidTransform.from_quaternion_xyzw(quaternion, random.uniform(-20_000, 20_000, 3))
    gamma_s = float(random.uniform(-0.5, 0.5) * BACKLASH_RAD)
    if random.uniform() < 0.2:
        gamma_s = float(random.uniform(-np.pi, np.pi))
    spindles = []
    for target, normal in zip(part.targets, normals):
        for side in (-1.0, 1.0):
            view = -(pose.rotation @ (normal + random.normal(0, 0.15, 3)))
            spindles.append(
                spindle_looking(
                    random, pose @ target.xyz_mm, view, random.uniform(200, 600),
                    random.uniform(-np.pi, np.pi), side * random.uniform(20, 50, 2),
                    calibration, gamma_s,
                )
            )  # fmt: skip
    return Cell(
        part=part,
        calibration=calibration,
        machine_T_part=pose,
        gamma_s_rad=gamma_s,
        observations=observe(part, calibration, pose, gamma_s, spindles),
    )
