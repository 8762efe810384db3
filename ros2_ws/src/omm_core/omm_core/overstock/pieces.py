"""Faces cut into triangles small enough to carry a colour at each corner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.overstock.face import Face

Array = NDArray[np.float64]


def cut_small(
    faces: tuple[Face, ...], *, pieces: float, most: int
) -> tuple[Array, NDArray[np.int64]]:
    """Return triangles (M, 3, 3), mm, and the face of each, from 0.

    The longest edges are halved until none is longer than the part's diagonal over ``pieces``, or
    until ``most`` triangles have been added; what the CAD holds itself is never thinned.
    """
    corners = np.concatenate([face.triangles for face in faces])
    number = np.repeat(np.arange(len(faces)), [len(face.triangles) for face in faces])
    size = float(np.linalg.norm(corners.max(axis=(0, 1)) - corners.min(axis=(0, 1)))) / pieces
    start = len(corners)
    while True:
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        longest = edges.max(axis=1)
        order = np.argsort(-longest, kind="stable")[: start + most - len(corners)]
        cut = order[longest[order] > size]
        if not len(cut):
            return corners, number
        rows, first = np.arange(len(cut)), edges[cut].argmax(axis=1)
        a, b, c = (corners[cut][rows, (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        kept = np.delete(corners, cut, axis=0)
        corners = np.concatenate([kept, *halves])
        number = np.concatenate([np.delete(number, cut), number[cut], number[cut]])
