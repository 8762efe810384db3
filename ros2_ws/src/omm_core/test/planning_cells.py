"""A part, a camera and a machine to plan for, without files."""

from pathlib import Path

import numpy as np

from omm_core.files.machine import Machine
from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.imaging.lens import BrownPhotogrammetric
from omm_core.imaging.taking import Body, Imaging
from omm_core.machine.kinematics import Kinematics
from omm_core.machine.urdf import Joint, Robot
from omm_core.planning.scene import AssumedNoise, Scene

MACHINE = Machine(name="mill", urdf=Path("mill.urdf"))
REAL = AssumedNoise(
    image_sigma_px=0.005, stop_sigma_mm=0.003, geometry_sigma_mm=0.015, geometry_length_mm=700.0
)
EXACT = AssumedNoise(
    image_sigma_px=0.05, stop_sigma_mm=0.0, geometry_sigma_mm=0.0, geometry_length_mm=700.0
)
CORNERS = ((0.0, 0.0), (1500.0, 0.0), (1500.0, 1000.0), (0.0, 1000.0))


def kinematics(limits_mm=((-1000.0, 3000.0), (-1000.0, 2000.0), (-500.0, 1500.0))) -> Kinematics:
    """Three linear axes that carry a vertical spindle."""
    links = ("machine", "bridge", "saddle", "spindle")
    joints = tuple(
        Joint(
            name=name, movable=True, rotary=False, parent=links[i], child=links[i + 1],
            origin=np.eye(4), axis=np.eye(3)[i], lower=limits_mm[i][0], upper=limits_mm[i][1],
        )
        for i, name in enumerate("XYZ")
    )  # fmt: skip
    return Kinematics(Robot(name="mill", root="machine", links=links, joints=joints))


def camera(imaging: Imaging | None = None, body: Body | None = None) -> CameraCalibration:
    """The paper's camera."""
    return CameraCalibration(
        name="DMK 23GP031",
        lens=BrownPhotogrammetric(
            width_px=2592, height_px=1944, pixel_size_mm=0.0022, focal_length_mm=6.189,
            cl0_px=-8.732, rw0_px=27.52, k1_px2=2.997e-08, k2_px4=-1.937e-15,
            p1_px=-6.188e-08, p2_px=3.408e-07,
        ),
        taper_T_camera=RigidTransform.from_euler_xyz_rad(
            3.138592653589793, -0.009, 0.03, (-2.139, 0.301, -320.2)
        ),
        covariance=np.zeros((0, 0)),
        imaging=imaging or Imaging(),
        body=body,
    )  # fmt: skip


def part(places=CORNERS, sigma_mm=0.02, **more) -> Part:
    """A part with targets on its upper side."""
    heights = np.array([3.0, 11.0, 8.0, -8.0] * len(places))
    targets = tuple(
        Target(
            id=i + 1, xyz_mm=np.array([x, y, heights[i]]), dot_diameter_mm=8.0,
            normal=np.array([0.0, 0.0, 1.0]), sigma_xyz_mm=np.full(3, sigma_mm),
        )
        for i, (x, y) in enumerate(places)
    )  # fmt: skip
    return Part(name="bench", target_family="metashape12", targets=targets, **more)


def scene(noise=REAL, *, at=(100.0, 100.0, -100.0), turned=(0.0, 0.0, 0.0), **more) -> Scene:
    """A part on a machine, seen by the paper's camera."""
    given = {"part": part(), "calibration": camera(), "kinematics": kinematics()} | more
    return Scene(
        machine_T_part=RigidTransform.from_euler_xyz_rad(*turned, at), noise=noise, **given
    )
