"""Photographs of a survey: read as the sensor saw them, and everything found in them."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

from omm_core.errors import InputError
from omm_core.imaging.photographs import read_grey
from omm_core.survey.sighting import sighting_of_target
from omm_core.targets import DetectedTarget, TargetFamily, detect_targets
from omm_core.targets.detected import RefusedTarget
from omm_core.targets.plain import PlainDot, PlainOptions, find_plain_dots
from omm_runs.spreading import spread

Array = NDArray[np.float64]

_FEWEST_FOR_POLARITY = 3
_TILTED = 1.4  # longer axis of an ellipse over the diameter of the circle with its area
_FOCAL_LENGTH, _AS_35MM, _EXIF_WIDTH = 37386, 41989, 40962  # EXIF 2.3
_PLANE_RESOLUTION, _PLANE_UNIT = 41486, 41488
_CAMERA_TAGS = ((272, 50708), (42033,), (42036,))  # model (DNG's too), number of the body, lens
_DIAGONAL_35MM = 43.267
SAME_FOCAL = 1.02  # ratio of what EXIF tells of one setting: makers round it


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """What one photograph shows; ``problem`` says why nothing, where it cannot be used.

    Numbers that are read ``twice`` are not among the targets.
    """

    size_px: tuple[int, int]
    targets: tuple[DetectedTarget, ...] = ()
    twice: tuple[int, ...] = ()
    dots: tuple[PlainDot, ...] = ()
    problem: str | None = None

    def moved(self, shift_px: Array) -> Seen:
        """Return what would be seen if the picture had a margin; nothing else changes."""
        if not shift_px.any():
            return self
        targets = tuple(replace(t, center_px=t.center_px + shift_px) for t in self.targets)
        dots = tuple(replace(d, center_px=d.center_px + shift_px) for d in self.dots)
        return replace(self, targets=targets, dots=dots)


def look_at_all(photos: tuple[Path, ...], family: str) -> list[Seen]:
    """Return what each photograph shows, on all cores, with progress on the screen."""
    shown = sys.stderr.isatty()

    def tell(done: int, total: int) -> None:
        if shown:
            end = "\n" if done == total else ""
            print(f"\r  photograph {done} of {total}", end=end, file=sys.stderr, flush=True)

    return spread(_look, [(photo, family) for photo in photos], progress=tell)


def _look(job: tuple[Path, str]) -> Seen:
    import cv2

    cv2.setNumThreads(1)
    photo, family_name = job
    try:
        image = read_grey(photo)
    except InputError as error:
        # The survey names the photograph itself.
        words = str(error).removeprefix(f"{photo}: ").removesuffix(".").removesuffix("; skipped")
        return Seen(size_px=(0, 0), problem=words)
    size = (image.shape[1], image.shape[0])
    family = TargetFamily.by_name(family_name)
    detection = detect_targets(image, family)
    targets = detection.targets
    dark = sum(not t.bright for t in targets)
    bright = 2 * dark < len(targets) or len(targets) < _FEWEST_FOR_POLARITY
    contrast = [t.contrast_dn for t in targets]
    least = 0.12 * float(np.median(contrast)) if contrast else 15.0
    unit = 1.0 if image.dtype == np.uint8 else max(float(image.max()) / 255.0, 1.0)
    options = PlainOptions(bright=bright, min_contrast_dn=max(least / unit, 12.0))
    doubles = tuple(r for r in detection.refused if r.reason.key == "said.seen_twice")
    rings = np.vstack([rings_of(targets, family), _rings_about(doubles, family)])
    return Seen(
        size_px=size,
        targets=targets,
        twice=tuple(sorted({int(r.reason.args["target"]) for r in doubles})),
        dots=find_plain_dots(image, options, rings),
    )


def focal_length_px(photos: tuple[Path, ...], size_px: tuple[int, int]) -> float:
    """Return the focal length that the photographs' EXIF tells, in pixels.

    Raises
    ------
    InputError
        Where it tells none, or different ones.
    """
    told = {photo.name: _exif_focal_px(photo, size_px) for photo in photos}
    known = {name: f for name, f in told.items() if f is not None}
    if not known:
        raise InputError(
            "The photographs' EXIF gives no focal length: expected camera: {pixel_size_mm,"
            " focal_length_mm} in survey.yaml."
        )
    values = sorted(known.values())
    usual = values[len(values) // 2]
    if values[-1] > SAME_FOCAL * values[0]:
        others = [name for name, f in known.items() if abs(f / usual - 1.0) > SAME_FOCAL - 1.0]
        raise InputError(
            f"The photographs' EXIF gives focal lengths from {values[0]:.0f} to {values[-1]:.0f}"
            " pixels: one camera has one setting. Leave out (leave_out in"
            f" survey.yaml) those that differ: {', '.join((others or list(known))[:10])}."
        )
    return usual


def focal_told(photo: Path) -> float | None:
    """Return the focal length that a photograph's EXIF tells, mm (else that of a 35 mm camera)."""
    told = _exif(photo)
    return _positive(told.get(_FOCAL_LENGTH)) or _positive(told.get(_AS_35MM))


def taken_with(photo: Path) -> tuple[str, ...]:
    """Return model, number of the body and lens by the photograph's EXIF; empty where untold."""
    told = _exif(photo)
    words = ([str(told.get(tag, "")).strip(" \0") for tag in tags] for tags in _CAMERA_TAGS)
    return tuple(next(filter(None, found), "") for found in words)


def _exif(photo: Path) -> dict[int, Any]:
    try:
        with Image.open(photo) as opened:
            exif = opened.getexif()
            return {**exif, **exif.get_ifd(ExifTags.IFD.Exif)}
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return {}


def _exif_focal_px(photo: Path, size_px: tuple[int, int]) -> float | None:
    told = _exif(photo)
    focal, as_35mm = (_positive(told.get(tag)) for tag in (_FOCAL_LENGTH, _AS_35MM))
    resolution, unit = _positive(told.get(_PLANE_RESOLUTION)), told.get(_PLANE_UNIT, 2)
    width = _positive(told.get(_EXIF_WIDTH))
    unit_mm = {2: 25.4, 3: 10.0, 4: 1.0}.get(unit)
    if focal and resolution and unit_mm:
        scale = size_px[0] / width if width else 1.0  # where the picture was made smaller
        return focal * resolution / unit_mm * scale
    if as_35mm:
        return as_35mm * float(np.hypot(*size_px)) / _DIAGONAL_35MM
    return None


def _positive(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if np.isfinite(number) and number > 0.0 else None


def rings_of(targets: tuple[DetectedTarget, ...], family: TargetFamily) -> Array:
    """Return the outer edges of the rings as ellipses (N, 5): col, row, conic's xx, xy, yy."""
    rings = np.empty((len(targets), 5))
    for ring, target in zip(rings, targets, strict=True):
        spread = sighting_of_target(0, target).spread_px2
        assert spread is not None
        conic = np.linalg.inv(spread) / family.ring_outer_ratio**2
        ring[:] = [*target.center_px, conic[0, 0], conic[0, 1], conic[1, 1]]
    return rings


def _rings_about(refused: tuple[RefusedTarget, ...], family: TargetFamily) -> Array:
    """Return circles (N, 5) about targets of which only the mean diameter is known."""
    rings = np.empty((len(refused), 5))
    for ring, target in zip(rings, refused, strict=True):
        radius = _TILTED * family.ring_outer_ratio * target.diameter_px / 2.0
        ring[:] = [*target.center_px, radius**-2.0, 0.0, radius**-2.0]
    return rings
