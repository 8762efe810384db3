"""Do residuals have a pattern? Means over rings, planes and turns of the spindle, against chance.

In each group the mean of the standardised residuals, radial and tangential, is normal with
variance 1/n where the model holds (less, since the adjustment has taken some of it), so that the
sum of n times the squared means is at most chi-square with two degrees of freedom a group.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omm_core.adjustment import Block, Solution
from omm_core.camera_calibration.model import Sensor

Array = NDArray[np.float64]

_RINGS = 6
_LEAST = 4  # observations of a group
DOUBT = 1e-4


@dataclass(frozen=True, kw_only=True)
class Pattern:
    """The test of one way to group the residuals."""

    name: str
    groups: int
    radial_p: float
    tangential_p: float

    def to_json_dict(self) -> dict[str, Any]:
        """Return it as it stands under ``extra``."""
        return {
            "by": self.name, "groups": self.groups,
            "radial_p": self.radial_p, "tangential_p": self.tangential_p,
        }  # fmt: skip


def residual_patterns(
    sensor: Sensor, camera: Array, block: Block, solution: Solution, groupings: dict[str, Array]
) -> tuple[Pattern, ...]:
    """Return the tests by ring of the image and by further groupings.

    Parameters
    ----------
    block : Block
        The pixels (m, 2); what does not take part is left out.
    groupings : mapping
        By name: a number for the group of each observation, (m,).
    """
    used = np.ones(len(block.observed), dtype=bool) if block.used is None else block.used
    offset = block.observed - sensor.lens(camera).principal_point_px
    radius = np.linalg.norm(offset, axis=1)
    out = offset / np.maximum(radius, 1e-9)[:, None]
    around = np.stack([-out[:, 1], out[:, 0]], axis=1)
    scale = max(solution.sigma0, 1.0)
    standard = []
    for axis in (out, around):
        variance = np.einsum("mi,mij,mj->m", axis, block.covariance, axis)
        along = np.einsum("mi,mi->m", axis, solution.residuals["pixels"])
        standard.append((along / np.sqrt(variance) / scale)[used])
    edges = np.quantile(radius[used], np.linspace(0, 1, _RINGS + 1)[1:-1])
    all_groups = {"ring": np.searchsorted(edges, radius).astype(float), **groupings}
    found = []
    for name, group in all_groups.items():
        labels, index, counts = np.unique(group[used], return_inverse=True, return_counts=True)
        if len(labels) < 2 or counts.min() < _LEAST:
            continue
        radial, tangential = (_p_value(values, index, counts) for values in standard)
        found.append(
            Pattern(name=name, groups=len(labels), radial_p=radial, tangential_p=tangential)
        )
    return tuple(found)


def planes_of(heights: Array) -> Array:
    """Return a number for the plane of each height: planes are apart by 1/50 of the whole."""
    order = np.argsort(heights)
    gaps = np.diff(heights[order]) > np.ptp(heights) / 50
    plane = np.zeros(len(heights))
    plane[order[1:]] = np.cumsum(gaps)
    return plane


def _p_value(values: Array, index: NDArray[np.int64], counts: NDArray[np.int64]) -> float:
    from scipy.stats import chi2

    sums = np.bincount(index.ravel(), weights=values, minlength=len(counts))
    return float(chi2.sf(np.sum(sums**2 / counts), len(counts)))


def words_of_patterns(patterns: tuple[Pattern, ...]) -> tuple[str, ...]:
    """Return a finding for each pattern that is not chance."""
    told = []
    for pattern in patterns:
        for kind, p_value in (("radial", pattern.radial_p), ("tangential", pattern.tangential_p)):
            if p_value < DOUBT:
                told.append(
                    f"the {kind} residuals differ by {pattern.name} more than chance allows"
                    f" (p = {p_value:.1g}): the lens model, or the places, are not as assumed"
                )
    return tuple(told)
