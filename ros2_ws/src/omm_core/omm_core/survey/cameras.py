"""Which camera took each photograph: a body with a lens at one setting of zoom and focus."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """The cameras of a survey; each has a row in ``lenses`` (C, 10).

    Attributes
    ----------
    focal_px : tuple of float
        Nominal focal lengths.
    names : tuple of str
        What people call them.
    of : mapping
        Row by number of the photograph; 0 where it is not told.
    """

    focal_px: tuple[float, ...]
    names: tuple[str, ...] = ("",)
    of: dict[int, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.focal_px)

    def row(self, photo: int) -> int:
        """Return the row of a photograph's camera."""
        return self.of.get(photo, 0)

    def rows(self, photos: Iterable[int]) -> Index:
        """Return the rows of several photographs' cameras."""
        return np.array([self.row(n) for n in photos], dtype=np.intp)

    def lenses(self, factor: float = 1.0) -> Array:
        """Return lenses without distortion, their focal lengths times a factor."""
        lenses = np.zeros((len(self), 10))
        lenses[:, 0] = factor * np.array(self.focal_px)
        return lenses


def pixel_of(lenses: Array) -> float:
    """Return a pixel as an angle (rad): the largest of the cameras'."""
    return float(1.0 / lenses[:, 0].min())
