"""Find plain dots: components above the light around them, outline, fit.

Components are taken at several levels above the local background, so that a dot beside a hot spot
stands alone at one of them. What has the area and the second moments of an ellipse is looked at
as the coded targets' dots are: `conic.outline`, then `plain.fitting`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.targets.conic.outline import dot_outline, within_any
from omm_core.targets.plain.fitting import PlainDot, fitted_dot

Array = NDArray[np.float64]

_SHRUNK = 8
_LEVELS = (0.06, 0.15, 0.35, 0.6)  # of the brightest dot's contrast
_BRIGHT_PART = 60  # of 255: light around, from which on half of it lies above a label's dark
_LABEL = 1.8  # dots wide, at least, is the dark that a dot on a bright part lies on
_MARGIN = 1.15  # around a ring


@dataclass(frozen=True, kw_only=True)
class PlainOptions:
    """What to look for.

    Attributes
    ----------
    bright : bright dots on dark, or dark ones on bright.
    min_diameter_px, max_diameter_px : of the ellipse's smaller and larger axis.
    min_contrast_dn : difference of dot and background, in grey values of 8 bit.
    most : dots in one image, at most (the ones with the strongest contrast).
    """

    bright: bool = True
    min_diameter_px: float = 3.6
    max_diameter_px: float = 160.0
    min_contrast_dn: float = 15.0
    most: int = 2000


def find_plain_dots(
    pixels: NDArray[Any], options: PlainOptions | None = None, rings: Array | None = None
) -> tuple[PlainDot, ...]:
    """Return the plain dots of an image, from top to bottom.

    Parameters
    ----------
    pixels : (H, W) uint8 or uint16
    options : PlainOptions, optional
    rings : (N, 5) array, optional
        Ellipses (col, row, conic's xx, xy, yy) within which nothing is plain: the outer edges of
        the coded targets' rings.

    Raises
    ------
    InputError
        If the image is of another kind.
    """
    if pixels.ndim != 2 or pixels.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"Expected a grey image (H, W) of uint8 or uint16, got {pixels.shape} {pixels.dtype}:"
            " convert colour images to grey first."
        )
    options = options or PlainOptions()
    kept = (pixels if pixels.flags.c_contiguous else pixels.copy()).view()
    kept.flags.writeable = False  # the form for which the kernels are compiled
    sign = 1 if options.bright else -1
    shapes = _outlines(kept, _candidates(kept, sign, options, rings), sign, options, rings)
    saturation = float(np.iinfo(pixels.dtype).max)
    dots = [fitted_dot(kept, shape, sign, saturation) for shape in shapes]
    return tuple(dot for dot in dots if dot is not None)


def _grey_and_around(image: NDArray[Any], sign: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the image in 8 bit, dots bright, and the light around each pixel."""
    grey = image
    if image.dtype != np.uint8:
        grey = cv2.convertScaleAbs(image, alpha=1.0 / max(float(image.max()) / 255.0, 1.0))
    if sign < 0:
        grey = 255 - grey
    height, width = grey.shape
    shrunk = (max(width // _SHRUNK, 1), max(height // _SHRUNK, 1))
    small = cv2.medianBlur(cv2.resize(grey, shrunk, interpolation=cv2.INTER_AREA), 15)
    around = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(grey), np.asarray(around)


def _candidates(
    image: NDArray[Any], sign: int, options: PlainOptions, rings: Array | None
) -> Array:
    """Return ellipses (N, 6) from the moments of components, polarity last."""
    grey, around = _grey_and_around(image, sign)
    lifted = np.asarray(cv2.subtract(grey, around))
    top = max(float(np.percentile(cv2.blur(lifted, (3, 3))[::2, ::2], 99.99)), 1.0)
    found: list[Array] = []
    for share in _LEVELS:
        level = max(share * top, 0.4 * options.min_contrast_dn)
        found += _components(lifted, level, options, rings)
    bright = cv2.threshold(around, _BRIGHT_PART, 255, cv2.THRESH_TOZERO)[1]
    if bright.any():  # a dot on a dark label need not be brighter than the part around the label
        half = cv2.subtract(grey, cv2.convertScaleAbs(around, alpha=0.5))
        half[bright == 0] = 0
        on_part = _components(half, 0.0, options, rings)
        found += [ellipse for ellipse in on_part if _is_on_a_label(half, ellipse)]
    if not found:
        return np.empty((0, 6))
    return np.column_stack([np.array(found), np.full(len(found), float(sign))])


def _is_on_a_label(lifted: NDArray[np.uint8], ellipse: Array) -> bool:
    """Tell whether dark lies all around, as wide as a label's: letters have holes, too."""
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    spread = np.linalg.inv(np.array([[ellipse[2], ellipse[3]], [ellipse[3], ellipse[4]]]))
    circle = _LABEL * np.stack([np.cos(turn), np.sin(turn)])
    cols, rows = np.rint(np.linalg.cholesky(spread) @ circle + ellipse[:2, None]).astype(int)
    height, width = lifted.shape
    if cols.min() < 0 or rows.min() < 0 or cols.max() >= width or rows.max() >= height:
        return False
    return not lifted[rows, cols].any()


def _components(
    lifted: NDArray[np.uint8], level: float, options: PlainOptions, rings: Array | None
) -> list[Array]:
    mask = cv2.threshold(lifted, level, 255, cv2.THRESH_BINARY)[1]
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
    left, top, width, height, area = boxes[1:].T.astype(float)
    longer, shorter = np.maximum(width, height), np.minimum(width, height)
    fits = (shorter >= 3) & (longer <= 1.3 * options.max_diameter_px + 4) & (area >= 9)
    fits &= (area > 0.35 * width * height) & (left > 2) & (top > 2)
    found = []
    for label in np.flatnonzero(fits) + 1:
        x, y, w, h = boxes[label, :4]
        if rings is not None and within_any(rings, len(rings), x + w / 2, y + h / 2, _MARGIN):
            continue
        crop = labels[y : y + h, x : x + w] == label
        ellipse = _ellipse(crop)
        if ellipse is not None:
            found.append(ellipse + np.array([x, y, 0.0, 0.0, 0.0]))
            if len(found) > 4 * options.most:
                break
    return found


def _ellipse(crop: NDArray[np.bool_]) -> Array | None:
    """Return the ellipse (5,) with a component's moments, or None where it is not an ellipse."""
    rows, cols = np.nonzero(crop)
    area = len(rows)
    centre = np.array([cols.mean(), rows.mean()])
    spread = 4.0 * np.cov(np.stack([cols, rows]), bias=True)
    larger = float(np.linalg.eigvalsh(spread)[1])
    det = float(np.linalg.det(spread))
    if det <= 1.0 or larger > 14.0 * det / larger:
        return None
    # An ellipse fills what its moments let expect; pixels' own size makes small ones differ.
    if abs(area / (np.pi * np.sqrt(det)) - 1.0) > 0.08 + 1.5 / np.sqrt(area):
        return None
    inverse = np.linalg.inv(spread)
    return np.array([*centre, inverse[0, 0], inverse[0, 1], inverse[1, 1]])


def _outlines(
    image: NDArray[Any],
    candidates: Array,
    sign: int,
    options: PlainOptions,
    rings: Array | None,
) -> list[Array]:
    """Return the outlines (9,) of what is a dot, each once, from top to bottom."""
    unit = 1.0 if image.dtype == np.uint8 else max(float(image.max()) / 255.0, 1.0)
    shapes: list[Array] = []
    for candidate in candidates:
        shape, ok = dot_outline(image, candidate)
        if not ok or sign * (shape[5] - shape[6]) < options.min_contrast_dn * unit:
            continue
        spread = np.linalg.inv(np.array([[shape[2], shape[3]], [shape[3], shape[4]]]))
        axes = 2.0 * np.sqrt(np.linalg.eigvalsh(spread))
        if axes[0] < options.min_diameter_px or axes[1] > options.max_diameter_px:
            continue
        if rings is not None and within_any(rings, len(rings), shape[0], shape[1], _MARGIN):
            continue
        shapes.append(shape)
    return _each_once(shapes)[: options.most]


def _each_once(shapes: Sequence[Array]) -> list[Array]:
    """Keep of outlines about one centre the one whose points lie closest to it."""
    kept: list[Array] = []
    grid: dict[tuple[int, int], list[Array]] = {}
    for shape in sorted(shapes, key=lambda s: float(s[7])):
        cell = (int(shape[0]) // 8, int(shape[1]) // 8)
        near = [
            s
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            for s in grid.get((cell[0] + i, cell[1] + j), [])
        ]
        if any(_inside(other, shape) for other in near):
            continue
        grid.setdefault(cell, []).append(shape)
        kept.append(shape)
    return sorted(kept, key=lambda s: (float(s[1]), float(s[0])))


def _inside(shape: Array, other: Array) -> bool:
    dx, dy = other[0] - shape[0], other[1] - shape[1]
    return bool(shape[2] * dx * dx + 2 * shape[3] * dx * dy + shape[4] * dy * dy < 1.0)
