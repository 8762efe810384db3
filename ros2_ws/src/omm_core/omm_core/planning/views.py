"""Which targets a camera sees from where: whole, in focus, large enough, not too slanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omm_core.geometry import RigidTransform
from omm_core.planning.scene import Scene

Array = NDArray[np.float64]

SMALLEST_DOT_PX = 16.0
"""Diameter below which a dot's ring is hard to read."""
LARGEST_DOT_PX = 380.0
STEEPEST_RAD = np.deg2rad(75.0)
"""No ring can be read that is seen flatter, whatever camera.yaml allows."""
_EDGE_PX = 4.0
_QUIET = 1.06  # of the ring's diameter: what must be free about it


@dataclass(frozen=True, kw_only=True, eq=False)
class Views:
    """What is seen at each stop.

    Attributes
    ----------
    visible : (S, T) array of bool
    diameter_px : (S, T) array
        Of the dot's image: the smaller diameter.
    margin_mm : (S,) array
        How much farther than ``play_mm`` all targets in view may lie elsewhere: along the optical
        axis as far as the focus goes, across it until one leaves the image.
    """

    visible: NDArray[np.bool_]
    diameter_px: Array
    margin_mm: Array

    def only(self, stops: NDArray[np.int64]) -> Views:
        """Return those of some stops."""
        return Views(
            visible=self.visible[stops],
            diameter_px=self.diameter_px[stops],
            margin_mm=self.margin_mm[stops],
        )


def views(scene: Scene, machine_T_spindles: Sequence[RigidTransform]) -> Views:
    """Return what is seen from where the spindle is."""
    camera_T_spindle = scene.spindle_T_camera.inverse()
    cameras = [camera_T_spindle @ spindle.inverse() for spindle in machine_T_spindles]
    R = np.array([c.rotation for c in cameras]).reshape(-1, 3, 3)
    d = np.array([c.translation_mm for c in cameras]).reshape(-1, 3)
    centres = np.einsum("sij,tj->sti", R, scene.targets_in_machine()) + d[:, None]
    visible = _in_focus(scene, centres) & _facing(scene, R, centres)
    rings, dots = (
        np.asarray(scene.machine_T_part @ scene.circles(ratio, more_mm))
        for ratio, more_mm in ((_QUIET * scene.ring_ratio(), 2.0 * scene.play_mm), (1.0, 0.0))
    )
    to_border = _to_border(scene, _pixels(scene, R, d, rings))
    inside = to_border >= 0.0
    diameter = _smaller_diameter(_pixels(scene, R, d, dots))
    large = (diameter >= SMALLEST_DOT_PX) & (diameter <= LARGEST_DOT_PX)
    visible = visible & inside & large
    margin = np.minimum(to_border * centres[..., 2] / focal_px(scene), _focus_left(scene, centres))
    return Views(
        visible=visible,
        diameter_px=diameter,
        margin_mm=np.where(visible, margin, np.inf).min(axis=1, initial=np.inf),
    )


def focal_px(scene: Scene) -> float:
    """Return the focal length in pixels, the shorter of the two."""
    lens = scene.calibration.lens.numbers()
    return float(min(lens.fx, lens.fy))


def _focus_left(scene: Scene, centres: Array) -> Array:
    focus = scene.calibration.imaging.focus_mm
    if focus is None:
        return np.full(centres.shape[:2], np.inf)
    depth = centres[..., 2]
    return np.asarray(np.minimum(depth - focus[0], focus[1] - depth) - scene.play_mm)


def _in_focus(scene: Scene, centres: Array) -> NDArray[np.bool_]:
    focus = scene.calibration.imaging.focus_mm
    near, far = focus if focus is not None else (1.0, np.inf)
    depth = centres[..., 2]
    play = min(scene.play_mm, 0.25 * (far - near))
    return np.asarray((depth >= near + play) & (depth <= far - play))


def _facing(scene: Scene, R: Array, centres: Array) -> NDArray[np.bool_]:
    limit = scene.calibration.imaging.max_tilt_rad
    least = np.cos(min(STEEPEST_RAD, limit if limit is not None else np.inf))
    normals = np.einsum("sij,tj->sti", R, scene.normals_in_machine())
    distance = np.maximum(np.linalg.norm(centres, axis=2), 1e-9)
    towards = -np.einsum("sti,sti->st", normals, centres) / distance
    slant = np.where(scene.outward(), towards, np.abs(towards))
    return np.asarray(~(slant < least))  # an unknown normal (NaN) limits nothing


def _pixels(scene: Scene, R: Array, d: Array, circles: Array) -> Array:
    """Return the images of circles, (S, T, 8, 2); NaN where the lens does not see a point."""
    points = np.einsum("sij,tkj->stki", R, circles) + d[:, None, None]
    flat = scene.calibration.lens.project(points.reshape(-1, 3))
    return np.asarray(flat.reshape(*points.shape[:3], 2))


def _to_border(scene: Scene, pixels: Array) -> Array:
    """Return how far inside of the image circles lie, (S, T) px; negative where they are not."""
    size = np.array([scene.calibration.width_px, scene.calibration.height_px])
    inside = np.minimum(pixels, size - 1 - pixels).min(axis=(2, 3)) - _EDGE_PX
    return np.asarray(np.where(np.isnan(inside), -1.0, inside))


def _smaller_diameter(pixels: Array) -> Array:
    """Return the smaller diameter of ellipses through eight points around, (S, T)."""
    centred = pixels - pixels.mean(axis=2, keepdims=True)
    # Σ p pᵀ = 4 T Tᵀ with T the ellipse's half axes as columns.
    moment = np.einsum("stki,stkj->stij", centred, centred) / 4.0
    a, b, c = moment[..., 0, 0], moment[..., 0, 1], moment[..., 1, 1]
    smaller = (a + c) / 2.0 - np.sqrt(((a - c) / 2.0) ** 2 + b * b)
    return np.asarray(2.0 * np.sqrt(np.maximum(smaller, 0.0)))
