"""What nearly all of its rays contradict: a photograph, or a point."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from omm_core.survey.network import (
    BAD_SHARE,
    CONTRADICTS,
    FEWEST_RAYS,
    NetworkState,
)

if TYPE_CHECKING:
    from omm_core.survey.fitting import Fitting

Array = NDArray[np.float64]
Values = dict[str, Array]
_FEWEST_GOOD = 3  # rays of a photograph, below which it is left out at once
_BENT = 0.1  # of the worst test: smaller ones may be due to the worst


class HopelessError(Exception):
    """Photographs and points of which nearly everything contradicts the others."""

    def __init__(self, fitting: Fitting, values: Values, t2: Array, limit: float) -> None:
        super().__init__()
        good = t2 <= limit
        self.fitting, self.values = fitting, values
        numbers = list(fitting.photos)
        fit, of = (np.bincount(fitting.photo, weights=w) for w in (good, np.ones(len(good))))
        bad = np.flatnonzero(fit < np.maximum(_FEWEST_GOOD, (1.0 - BAD_SHARE) * of))
        bad = bad[np.argsort(fit[bad] / of[bad])][: 1 + len(numbers) // 10]  # the worst first
        self.photos = {
            numbers[row]: f"{int(of[row] - fit[row])} of its {int(of[row])} rays contradict the"
            " others"
            for row in bad
        }
        # What only such a photograph spoils is judged again without it.
        self.points = {} if self.photos else _hopeless_points(fitting, t2, good)

    def __bool__(self) -> bool:
        return bool(self.photos or self.points)

    def rest_of(self, state: NetworkState) -> NetworkState:
        """Return the state without them, as far as the adjustment came."""
        values, fitting = self.values, self.fitting
        photos = {n: values["photos"][row] for n, row in fitting.photos.items()}
        points = {n: values["points"][row] for n, row in fitting.points.items()}
        return replace(
            state,
            lenses=values["lens"],
            photos={n: pose for n, pose in photos.items() if n not in self.photos},
            points={n: xyz for n, xyz in points.items() if n not in self.points},
        )


def _hopeless_points(fitting: Fitting, t2: Array, good: NDArray[np.bool_]) -> dict[int, str]:
    """Return the points with no ray to spare that contradict themselves, but for what they bend."""
    numbers = list(fitting.points)
    fit, of = (np.bincount(fitting.point, weights=w) for w in (good, np.ones(len(good))))
    worst = np.zeros(len(numbers))
    np.maximum.at(worst, fitting.point, t2)
    bad = np.flatnonzero((fit < of) & (fit < FEWEST_RAYS))
    return {numbers[row]: CONTRADICTS for row in bad if worst[row] >= _BENT * worst[bad].max()}
