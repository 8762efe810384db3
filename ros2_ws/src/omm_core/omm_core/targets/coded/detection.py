"""Detection of ring-coded targets in an image: search, outline, ring, centre, judgement.

`detect_targets` is all that other modules need. What looked like a target and was not accepted is
among `Detection.refused`, with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.targets.coded.centring import centre_all, centre_of_outline
from omm_core.targets.coded.families import TargetFamily, mirror_code
from omm_core.targets.coded.judging import RingReading, judge_candidates
from omm_core.targets.coded.search import find_dots, step_above
from omm_core.targets.detected import DetectedTarget, Detection, RefusedTarget
from omm_core.words import Words, keyed

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, kw_only=True)
class DetectionOptions:
    """What to look for and what to accept.

    Attributes
    ----------
    polarity : ``bright`` dots on dark, ``dark`` on bright, or ``both``.
    min_contrast_dn : smallest difference of dot and background, in grey values of 8 bit (16-bit
        images: in 1/256 of the image's brightest value).
    max_diameter_px : largest diameter of a dot.
    max_candidates : places looked at in one image, at most.
    centring : ``fit`` (the most accurate) or ``outline`` (the ellipse through the half levels:
        faster, a fifth to a half less accurate).
    saturation_dn : grey value from which on a pixel is saturated; None finds it in the image.
    expected_ids : numbers that the part carries. With them a mirrored image is noticed.
    """

    polarity: str = "both"
    min_contrast_dn: float = 6.0
    max_diameter_px: float = 400.0
    max_candidates: int = 2000
    centring: str = "fit"
    saturation_dn: float | None = None
    expected_ids: frozenset[int] | None = None


def detect_targets(
    image: Image, family: TargetFamily, options: DetectionOptions | None = None
) -> Detection:
    """Find, identify and centre all targets of a family.

    Parameters
    ----------
    image : (H, W) uint8 or uint16.

    Raises
    ------
    InputError
        If the image is of another kind, or an option does not exist.
    """
    options = options or DetectionOptions()
    _check(image, options)
    image = _for_kernels(image)
    found = _search(image, family, options)
    # Large ones first: the sectors of a ring look like small dots, and need no second look.
    candidates = found[np.argsort(found[:, 2] + found[:, 4])]
    readings, refused = judge_candidates(image, family, candidates)
    if options.centring == "fit" and readings:
        outcomes = centre_all(image, family, readings, _saturation(image, options, readings))
    else:
        outcomes = [centre_of_outline(reading) for reading in readings]
    targets = [outcome for outcome in outcomes if isinstance(outcome, DetectedTarget)]
    refused += [outcome for outcome in outcomes if isinstance(outcome, RefusedTarget)]
    targets, more = _refuse_doubles(targets)
    mirrored = _refuse_mirrored(targets, family, options)
    refused = _outside(refused, targets)
    if mirrored:
        return Detection(refused=(*refused, *more, *mirrored))
    targets.sort(key=lambda t: t.id)
    return Detection(targets=tuple(targets), refused=(*refused, *more))


def _check(image: Image, options: DetectionOptions) -> None:
    if (
        not isinstance(image, np.ndarray)
        or image.ndim != 2
        or image.dtype not in (np.uint8, np.uint16)
    ):
        shape = getattr(image, "shape", None)
        raise InputError(
            f"Expected a grey image (H, W) of uint8 or uint16, got {type(image).__name__} "
            f"{shape} {getattr(image, 'dtype', '')}: convert colour images to grey first."
        )
    if options.polarity not in ("both", "bright", "dark"):
        raise InputError(
            f"Expected the polarity 'both', 'bright' or 'dark', got {options.polarity!r}."
        )
    if options.centring not in ("fit", "outline"):
        raise InputError(f"Expected the centring 'fit' or 'outline', got {options.centring!r}.")


def _for_kernels(image: Image) -> Image:
    """Return the same image in the one form for which the kernels are compiled (`warm_up`).

    An array that may not be written to is another type to numba than one that may.
    """
    kept = image.view() if image.flags.c_contiguous else image.copy()
    kept.flags.writeable = False
    return kept


def _search(image: Image, family: TargetFamily, options: DetectionOptions) -> NDArray[np.float64]:
    """Return the candidates at full size: (N, 6) col, row, conic's xx, xy, yy, polarity."""
    height, width = image.shape
    if min(height, width) < 24:
        return np.empty((0, 6))
    half = cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    unit = 1.0 if image.dtype == np.uint8 else max(float(half.max()) / 255.0, 1.0)
    found = np.empty((options.max_candidates, 6))
    step = max(round(0.5 * options.min_contrast_dn * unit), 2)
    count = find_dots(
        half,
        step,
        step_above(half, step),
        max(int(0.6 * options.min_contrast_dn * unit), 3),
        int(0.5 * options.max_diameter_px),
        0.5 * (1.0 + family.ring_inner_ratio),
        family.read_ratio,
        found,
    )
    found = found[:count]
    if options.polarity != "both":
        found = found[found[:, 5] == (1 if options.polarity == "bright" else -1)]
    scale_x, scale_y = width / half.shape[1], height / half.shape[0]
    full = found.copy()
    full[:, 0] = (found[:, 0] + 0.5) * scale_x - 0.5
    full[:, 1] = (found[:, 1] + 0.5) * scale_y - 0.5
    full[:, 2:5] /= 4.0
    return full


def _saturation(image: Image, options: DetectionOptions, readings: list[RingReading]) -> float:
    """Return the grey value from which pixels are saturated."""
    if options.saturation_dn is not None:
        return options.saturation_dn
    if image.dtype == np.uint8:
        return 255.0
    # Sensors of 10 to 14 bit fill 16 differently: a value that stands for many pixels of a dot
    # and is the largest there is where they saturate.
    highest = 0.0
    often = False
    for reading in readings:
        col, row, r = int(reading.outline[0]), int(reading.outline[1]), int(reading.radius_px)
        dot = image[max(row - r, 0) : row + r + 1, max(col - r, 0) : col + r + 1]
        top = float(dot.max())
        if top > highest:
            highest = top
            often = int((dot == top).sum()) > max(8, dot.size // 20)
    return highest if often else 65535.0


def _outside(refused: list[RefusedTarget], targets: list[DetectedTarget]) -> list[RefusedTarget]:
    """Return what was refused and does not lie in a dot that was found."""
    if not refused or not targets:
        return refused
    places = np.array([r.center_px for r in refused])[:, None]
    dots = np.array([t.center_px for t in targets])
    apart = np.hypot(*np.moveaxis(places - dots, 2, 0))
    alone = (apart >= 0.5 * np.array([t.diameter_px for t in targets])).all(axis=1)
    return [r for r, keep in zip(refused, alone, strict=True) if keep]


def _refuse_doubles(
    targets: list[DetectedTarget],
) -> tuple[list[DetectedTarget], list[RefusedTarget]]:
    """Refuse numbers read twice: one is misread, or a reflection."""
    ids = [target.id for target in targets]
    kept = [target for target in targets if ids.count(target.id) == 1]
    refused = [
        _refuse(target, _seen_twice(target.id, ids.count(target.id)))
        for target in targets
        if ids.count(target.id) > 1
    ]
    return kept, refused


def _seen_twice(target_id: int, times: int) -> Words:
    return keyed(
        "said.seen_twice",
        "number {target} is seen {n} times in this image: remove the copy or the reflection",
        target=target_id,
        n=times,
    )


def _refuse_mirrored(
    targets: list[DetectedTarget], family: TargetFamily, options: DetectionOptions
) -> list[RefusedTarget]:
    """Refuse all where more expected numbers are read from the image turned over than as it is."""
    if options.expected_ids is None:
        return []
    direct = sum(target.id in options.expected_ids for target in targets)
    mirrored = sum(
        family.id_of(mirror_code(family.code_of(target.id), family.bits)) in options.expected_ids
        for target in targets
    )
    if mirrored <= direct:
        return []
    return [
        _refuse(
            target,
            keyed(
                "said.image_mirrored",
                "the image is mirrored: more of the part's numbers are read when it is turned over;"
                " switch off the camera's flip",
            ),
        )
        for target in targets
    ]


def _refuse(target: DetectedTarget, reason: Words) -> RefusedTarget:
    return RefusedTarget(center_px=target.center_px, diameter_px=target.diameter_px, reason=reason)
