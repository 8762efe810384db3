"""What a plan is made for: part, camera, machine, where the part is, and how exact all is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Part
from omm_core.geometry import RigidTransform, spindle_T_taper
from omm_core.imaging.calibration import CameraCalibration
from omm_core.imaging.circle import CircleCentre, circle_points
from omm_core.machine.kinematics import Kinematics
from omm_core.targets.coded.families import TargetFamily

Array = NDArray[np.float64]

REFERENCE_DIAMETER_PX = 74.0
"""Of an 8 mm dot at 300 mm in the paper's camera, where the detector's noise is told."""


@dataclass(frozen=True, kw_only=True)
class AssumedNoise:
    """How exact image and machine are taken to be.

    Attributes
    ----------
    image_sigma_px : float
        Of a centre, each axis, for a dot of ``REFERENCE_DIAMETER_PX`` and larger. Smaller dots
        have a shorter edge: ``sqrt(74 / diameter)`` times as much.
    stop_sigma_mm, geometry_sigma_mm, geometry_length_mm : float
        As in machine.yaml.
    """

    image_sigma_px: float = 0.005
    stop_sigma_mm: float
    geometry_sigma_mm: float
    geometry_length_mm: float

    def without(self, source: str) -> AssumedNoise:
        """Return the same without one source: ``image``, ``stops`` or ``geometry``."""
        # An image without any noise would leave nothing to weigh by.
        left = {"image": self.image_sigma_px * 1e-3, "stops": 0.0, "geometry": 0.0}[source]
        name = {"image": "image_sigma_px", "stops": "stop_sigma_mm"}.get(
            source, "geometry_sigma_mm"
        )
        return replace(self, **{name: left})


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Everything that a plan depends on but the stops.

    Attributes
    ----------
    machine_T_part : RigidTransform
        About where the part is.
    gamma_s_rad : float
        How far the holder is turned in the spindle; 0 where nothing is known.
    play_mm : float
        How far a target may lie from where it is thought to be and still be seen whole.
    farthest_mm : float
        Largest distance from which a target is looked at, where camera.yaml tells no focus: light
        fades with it.
    """

    part: Part
    calibration: CameraCalibration
    kinematics: Kinematics
    machine_T_part: RigidTransform
    noise: AssumedNoise
    gamma_s_rad: float = 0.0
    play_mm: float = 10.0
    farthest_mm: float = 600.0

    @property
    def spindle_T_camera(self) -> RigidTransform:
        """Where the camera sits in the spindle."""
        held: RigidTransform = spindle_T_taper(self.gamma_s_rad) @ self.calibration.taper_T_camera
        return held

    def targets_in_machine(self) -> Array:
        """Return the targets' centres, (T, 3), mm."""
        xyz = np.array([target.xyz_mm for target in self.part.targets])
        return np.asarray(self.machine_T_part @ xyz)

    def normals_in_machine(self) -> Array:
        """Return unit normals, (T, 3); NaN where unknown."""
        told = [self.part.normal_of(target) for target in self.part.targets]
        normals = np.array([np.full(3, np.nan) if n is None else n for n in told])
        return np.asarray(normals @ self.machine_T_part.rotation.T)

    def outward(self) -> NDArray[np.bool_]:
        """Return which normals are known to point outwards, (T,)."""
        return np.array([target.normal is not None for target in self.part.targets])

    def circles(self, ratio: float, more_mm: float = 0.0) -> Array:
        """Return points of circles about the targets, part frame, (T, 8, 3).

        Their diameter is ``ratio`` dot diameters and ``more_mm``. The centre itself where the
        normal is unknown, as the solver does.
        """
        circles = []
        for target in self.part.targets:
            normal = self.part.normal_of(target)
            if normal is None:
                circles.append(np.tile(target.xyz_mm, (8, 1)))
            else:
                diameter = [ratio * target.dot_diameter_mm + more_mm]
                circles.append(circle_points(target.xyz_mm[None], normal[None], diameter)[0])
        return np.array(circles)

    def ring_ratio(self) -> float:
        """Return the outer diameter of the code's ring in dot diameters."""
        return TargetFamily.by_name(self.part.target_family).ring_outer_ratio

    def elsewhere(self, machine_T_part: RigidTransform) -> Scene:
        """Return the same with the part surely somewhere else."""
        return replace(self, machine_T_part=machine_T_part, play_mm=0.0)


CENTRE_KIND = int(CircleCentre.OUTLINE)
