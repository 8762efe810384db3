"""Lengths of scale bars as observations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import (
    Block,
)
from omm_core.survey.sighting import Bar

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def bar_block(bars: list[Bar], points: dict[int, int]) -> Block:
    """Return the block of bars whose ends stand in the rows ``points`` tells."""
    first, second = (np.array([points[b.ends[i]] for b in bars]) for i in (0, 1))
    return Block(
        name="bars", observed=np.array([[b.length_mm] for b in bars]),
        covariance=np.array([[[b.sigma_mm**2]] for b in bars]),
        index={"points": first, "points:2": second},
        evaluate=lambda v: _lengths(v["points"], first, second),
    )  # fmt: skip


def _lengths(points: Array, first: Index, second: Index) -> tuple[Array, dict[str, Array]]:
    between = points[first] - points[second]
    length = np.linalg.norm(between, axis=1, keepdims=True)
    direction = (between / length)[:, None, :]
    return length, {"points": direction, "points:2": -direction}
