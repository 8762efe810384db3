"""What lies before the camera: the plate, the targets on it, and bright reflections between."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.files.part import Part
from omm_core.geometry import RigidTransform
from omm_core.targets.coded.families import TargetFamily
from omm_simulation.cell import Cell, random_stream
from omm_simulation.metal import Metal, machined_plate

Floats = NDArray[np.float64]

LABEL_MARGIN = 0.5
"""How far the label's black reaches beyond the ring, in dot radii."""
REFLECTION_GAP_MM = 1.5
"""Kept free between reflections and labels."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneTarget:
    """A target where it really is.

    Attributes
    ----------
    id, code : int
    part_T_target : RigidTransform
        Origin in the dot's centre, z out of the surface, x where the code starts.
    dot_radius_mm, label_radius_mm : float
    """

    id: int
    code: int
    part_T_target: RigidTransform
    dot_radius_mm: float
    label_radius_mm: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Reflection:
    """A bright ellipse on the plate, in the plate's coordinates."""

    centre_mm: Floats
    semi_axes_mm: tuple[float, float]
    angle_rad: float
    grey_dn: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """All that does not move with the spindle.

    Attributes
    ----------
    machine_T_plate : RigidTransform
        The plane through the middle of the targets, z out of the surface.
    """

    machine_T_part: RigidTransform
    machine_T_plate: RigidTransform
    family: TargetFamily
    targets: tuple[SceneTarget, ...]
    reflections: tuple[Reflection, ...]
    metal: Metal


def scene_of(cell: Cell) -> Scene:
    """Return the scene of a cell; equal cells have equal scenes."""
    rng = random_stream(cell.seed, "scene")
    imaging = cell.scenario.imaging
    family = TargetFamily.by_name(cell.true_part.target_family)
    towards_camera = (
        cell.machine_T_part.rotation.T
        @ RigidTransform.from_euler_xyz_rad(*cell.scenario.machine.spindle_euler_xyz_rad).rotation[
            :, 2
        ]
    )
    normals = _normals(cell.true_part, towards_camera)
    part_T_plate = RigidTransform(
        rotation=_axes(_plate_normal(cell.true_part, normals), 0.0),
        translation_mm=np.mean([t.xyz_mm for t in cell.true_part.targets], axis=0),
    )
    targets = tuple(
        SceneTarget(
            id=target.id,
            code=family.code_of(target.id),
            part_T_target=RigidTransform(
                rotation=_axes(normal, rng.uniform(0.0, 2 * np.pi)), translation_mm=target.xyz_mm
            ),
            dot_radius_mm=target.dot_diameter_mm / 2,
            label_radius_mm=target.dot_diameter_mm / 2 * (family.ring_outer_ratio + LABEL_MARGIN),
        )
        for target, normal in zip(cell.true_part.targets, normals)
    )
    return Scene(
        machine_T_part=cell.machine_T_part,
        machine_T_plate=cell.machine_T_part @ part_T_plate,
        family=family,
        targets=targets,
        reflections=_reflections(rng, targets, part_T_plate, imaging.reflections),
        metal=machined_plate(cell.seed, imaging.background_contrast),
    )


def _normals(part: Part, towards_camera: Floats) -> Floats:
    """Return the targets' normals, (N, 3) in the part frame.

    They point out of the surface, whatever the file says.
    """
    normals = [part.normal_of(target) for target in part.targets]
    told = [towards_camera if normal is None else normal for normal in normals]
    return np.array([normal if normal @ towards_camera > 0 else -normal for normal in told])


def _plate_normal(part: Part, normals: Floats) -> Floats:
    """Return the normal of the plane through the targets, where they span one."""
    mean = _unit(normals.mean(axis=0))
    spanned = part.plane_normal()
    if spanned is None:
        return mean
    return spanned if spanned @ mean > 0 else -spanned


def _axes(normal: Floats, angle_rad: float) -> Floats:
    """Return a right-handed frame with z along the normal, turned about it; shape (3, 3)."""
    along = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = _unit(np.cross(along, normal))
    y = np.cross(normal, x)
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.column_stack([cos * x + sin * y, cos * y - sin * x, normal])


def _unit(vector: Floats) -> Floats:
    return vector / np.linalg.norm(vector)


def _reflections(
    rng: np.random.Generator,
    targets: tuple[SceneTarget, ...],
    part_T_plate: RigidTransform,
    per_target: int,
) -> tuple[Reflection, ...]:
    """Return bright ellipses around each target, none of which touches a label."""
    plate_T_part = part_T_plate.inverse()
    labels = [
        ((plate_T_part @ t.part_T_target.translation_mm)[:2], t.label_radius_mm) for t in targets
    ]
    found = []
    for centre_mm, radius_mm in labels:
        kept = 0
        while kept < per_target:
            away_mm, direction = rng.uniform(radius_mm, 80.0 + radius_mm), rng.uniform(0, 2 * np.pi)
            at_mm = centre_mm + away_mm * np.array([np.cos(direction), np.sin(direction)])
            long_mm = rng.uniform(0.8, 3.5)
            ellipse = Reflection(
                centre_mm=at_mm,
                semi_axes_mm=(long_mm, long_mm * rng.uniform(0.4, 1.0)),
                angle_rad=rng.uniform(0.0, np.pi),
                grey_dn=rng.uniform(90.0, 320.0),
            )
            if all(
                np.linalg.norm(at_mm - other_mm) > other_radius_mm + long_mm + REFLECTION_GAP_MM
                for other_mm, other_radius_mm in labels
            ):
                found.append(ellipse)
                kept += 1
    return tuple(found)
