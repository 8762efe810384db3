"""One fit: optimum, covariance, statistics, and whether it is determined at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from omm_core.part_pose.adjustment import Adjustment, adjust, refine
from omm_core.part_pose.observability import ambiguous, not_determined, too_few
from omm_core.part_pose.observation import SolveOptions
from omm_core.part_pose.problem import Problem
from omm_core.part_pose.statistics import Statistics, analyse, chi2_limit
from omm_core.part_pose.uncertainty import Propagation, propagate
from omm_core.words import Words, keyed

_AS_LIKELY = 13.8  # difference of cost: below it, a second pose has odds above 1 : 1000
_SAME_POSE_MM = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseFit:
    """A problem and its solution; ``missing`` says why there is none.

    ``minima`` are all poses that the least squares ended at, the best one first.
    """

    problem: Problem
    options: SolveOptions
    missing: tuple[Words, ...] = ()
    unseen: bool = False  # no pose from which the camera could have seen what it saw
    poor: tuple[Words, ...] = ()
    best: Adjustment | None = None
    minima: tuple[Adjustment, ...] = ()
    propagation: Propagation | None = None

    @property
    def determined(self) -> bool:
        """Whether there is a solution to believe."""
        return not self.missing

    @property
    def cost(self) -> float:
        """Weighted sum of squares; infinite without a solution."""
        return self.propagation.cost if self.propagation is not None else np.inf

    @property
    def degrees_of_freedom(self) -> int:
        """Coordinates measured minus unknowns."""
        return 2 * len(self.problem) - self.options.unknowns

    @cached_property
    def statistics(self) -> Statistics | None:
        """Tests and reliability; None without a solution. Most fits of a search never need them."""
        if self.propagation is None or self.best is None:
            return None
        by_local = self.best.d_theta_d_local(self.problem.X0_mm)
        return analyse(self.propagation, by_local, self.options)

    @property
    def passed(self) -> bool:
        """Whether the residuals are as small as the weights promise, all together and each."""
        all_together = chi2_limit(self.degrees_of_freedom, self.options.significance)
        if not self.determined or self.cost > all_together or self.statistics is None:
            return False
        largest = np.nanmax(np.nan_to_num(self.statistics.w_test), initial=0.0)
        return bool(largest <= self.statistics.w_limit)


def fit(
    problem: Problem, options: SolveOptions, near: Sequence[Adjustment] | None = None
) -> PoseFit:
    """Return the fit of a problem, from nothing or next to the poses given."""
    missing = too_few(problem, options)
    if missing:
        return PoseFit(problem=problem, options=options, missing=tuple(missing))
    if near is None:
        minima = adjust(problem, options)
    else:
        minima = sorted((refine(problem, options, pose) for pose in near), key=lambda m: m.cost)
    if not minima or not np.isfinite(minima[0].cost):
        words = keyed(
            "said.no_pose_found",
            "all: no pose of the part was found from which the camera could have seen what it saw:"
            " check the part file, the calibration and the spindle poses.",
        )
        return PoseFit(problem=problem, options=options, missing=(words,), unseen=True)
    best = minima[0]
    try:
        propagation = propagate(problem, best, options)
    except np.linalg.LinAlgError:
        words_missing, _ = not_determined(problem, best, None, options)
        return PoseFit(
            problem=problem,
            options=options,
            missing=tuple(words_missing),
            best=best,
            minima=tuple(minima),
        )
    best = propagation.adjustment
    words_missing, poor = not_determined(problem, best, propagation.covariance, options)
    words_missing += as_likely(minima, best, scale=1.0)
    if not best.converged:
        words_missing.append(
            keyed(
                "said.not_converged",
                "all: the least squares did not converge; take more images.",
            )
        )
    return PoseFit(
        problem=problem,
        options=options,
        missing=tuple(words_missing),
        poor=tuple(poor),
        best=best,
        minima=tuple(minima),
        propagation=propagation,
    )


def as_likely(minima: Sequence[Adjustment], best: Adjustment, scale: float) -> list[Words]:
    """Return words for a second pose that fits as well; ``scale``: cost of a degree of freedom."""
    for other in minima[1:]:
        if other.cost - minima[0].cost < _AS_LIKELY * scale and _apart(other, minima[0]):
            return [ambiguous(other, best)]
    return []


def _apart(other: Adjustment, best: Adjustment) -> bool:
    moved = np.abs(other.d0_mm - best.d0_mm).max() > _SAME_POSE_MM
    turned = np.abs(other.rotation - best.rotation).max() > 1e-4
    return bool(moved or turned)
