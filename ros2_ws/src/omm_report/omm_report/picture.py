"""The picture of a run: every image with its targets, their numbers and enlarged residuals."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from omm_core.files.output import write_whole

_COLUMNS = 4
_TILE_PX = (640, 480)
_CAPTION_PX = 28
_LOUPE_PX = 280
_FOUND = (80, 220, 80)
_REFUSED = (60, 60, 255)
_RESIDUAL = (0, 200, 255)
_TEXT = (235, 235, 235)


@dataclass(frozen=True, kw_only=True)
class DrawnTarget:
    """One target to draw: centre and residual in pixels of the image."""

    target_id: int
    center_px: tuple[float, float]
    residual_px: tuple[float, float]
    used: bool


@dataclass(frozen=True, kw_only=True)
class DrawnImage:
    """One image to draw: (height, width) uint8 or uint16 pixels."""

    pixels: NDArray[np.generic]
    title: str
    used: bool
    targets: tuple[DrawnTarget, ...]


def draw_run(
    images: Sequence[DrawnImage],
    residual_scale: float,
    *,
    columns: int = _COLUMNS,
    text_scale: float = 0.5,
    caption: bool = True,
) -> NDArray[np.uint8]:
    """Draw all images of a run in a grid.

    Parameters
    ----------
    residual_scale : how many times a residual is enlarged against the full image
    columns : images side by side
    text_scale : size of the letters (0.5: for the screen)
    caption : whether a line below says how many times residuals are enlarged

    Returns
    -------
    (height, width, 3) uint8, blue-green-red
    """
    tiles = [_tile(image, residual_scale, text_scale) for image in images]
    columns = min(columns, len(tiles))
    blank = np.zeros_like(tiles[0])
    tiles += [blank] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    if not caption:
        return np.vstack(rows)
    line = np.zeros((_CAPTION_PX, rows[0].shape[1], 3), dtype=np.uint8)
    _write(line, f"residuals (yellow) enlarged {residual_scale:.0f} times", (8, 20))
    return np.vstack([*rows, line])


def save_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write the picture as PNG, whole or not at all."""
    _, data = cv2.imencode(".png", picture)
    write_whole(path, data.tobytes())


def _tile(image: DrawnImage, residual_scale: float, text_scale: float) -> NDArray[np.uint8]:
    gray = _to_8_bit(image.pixels)
    scale = min(_TILE_PX[0] / gray.shape[1], _TILE_PX[1] / gray.shape[0])
    small = cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    title_px = round(2 * _CAPTION_PX * text_scale)
    tile = np.zeros((_TILE_PX[1] + title_px, _TILE_PX[0], 3), dtype=np.uint8)
    tile[: small.shape[0], : small.shape[1]] = small[:, :, None]
    for target in image.targets:
        center = np.array(target.center_px)
        color = _FOUND if target.used else _REFUSED
        at = _point(center * scale)
        cv2.circle(tile, at, 14, color, 1, cv2.LINE_AA)
        _write(tile, str(target.target_id), (at[0] + 16, at[1] - 8), color, text_scale)
        tip = (center + np.array(target.residual_px) * residual_scale) * scale
        cv2.line(tile, at, _point(tip), _RESIDUAL, 1, cv2.LINE_AA)
    if image.targets:
        _loupe(tile, gray, image.targets[0], scale)
    color = _TEXT if image.used else _REFUSED
    _write(tile, image.title, (8, _TILE_PX[1] + round(40 * text_scale)), color, text_scale)
    return tile


def _loupe(
    tile: NDArray[np.uint8], gray: NDArray[np.uint8], target: DrawnTarget, scale: float
) -> None:
    """Draw the first target at full size, with its centre, in the farthest corner."""
    half = _LOUPE_PX // 2
    col, row = (round(c) for c in target.center_px)
    cut = gray[max(0, row - half) : row + half, max(0, col - half) : col + half]
    if cut.shape != (2 * half, 2 * half):
        return
    left = 0 if col * scale > _TILE_PX[0] / 2 else _TILE_PX[0] - _LOUPE_PX
    top = 0 if row * scale > _TILE_PX[1] / 2 else _TILE_PX[1] - _LOUPE_PX
    corner = tile[top : top + _LOUPE_PX, left : left + _LOUPE_PX]
    corner[:] = cut[:, :, None]
    offset = np.array(target.center_px) - (col - half, row - half)
    cv2.drawMarker(corner, _point(offset), _FOUND, cv2.MARKER_CROSS, 17, 1, cv2.LINE_AA)
    cv2.rectangle(corner, (0, 0), (_LOUPE_PX - 1, _LOUPE_PX - 1), _TEXT, 1)


def _to_8_bit(pixels: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Convert to 8 bits for the eye: stretched to the brightest, dark surroundings lifted."""
    values = pixels.astype(np.float32)
    top = max(1.0, float(np.percentile(values[::4, ::4], 99.9)))
    share = np.clip(values / top, 0.0, 1.0)
    return (255.0 * share**0.6).astype(np.uint8)


def _point(xy: NDArray[np.floating]) -> tuple[int, int]:
    return round(float(xy[0])), round(float(xy[1]))


def _write(
    canvas: NDArray[np.uint8],
    text: str,
    at: tuple[int, int],
    color: tuple[int, int, int] = _TEXT,
    scale: float = 0.5,
) -> None:
    thickness = max(1, round(1.5 * scale))
    cv2.putText(canvas, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, color, thickness, cv2.LINE_AA)
