"""Search for wrong observations: one at a time, left out, and everything tested again.

What can be wrong is a single centre (a reflection, an identifier misread), all that one image
shows (its spindle pose belongs to another image) and all that is seen of one target (it was
bumped). Each hypothesis is tried by solving without it. The smallest one that explains the
residuals wins: each observation left out must lower the cost by more than chance would.
Where two that exclude each other explain them as well, nobody can tell, and nothing is published.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from omm_core.part_pose.fit import PoseFit, fit
from omm_core.part_pose.naming import cannot_tell_which, describe
from omm_core.part_pose.observation import SolveOptions
from omm_core.part_pose.problem import Problem
from omm_core.part_pose.statistics import chi2_limit
from omm_core.words import Words

_TRIED = 12  # hypotheses of each kind, the most suspicious ones
_TELLS_APART = 10.0  # difference of score, odds of about 1 : 150
_MOST_LEFT_OUT = 1 / 3

Kind = Literal["observation", "image", "target"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """That some observations are wrong together."""

    kind: Kind
    members: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class SnoopingSearch:
    """What the search came to.

    Attributes
    ----------
    fit : PoseFit
        Of the observations that are left.
    dropped : (N,) bool array
        Which of the first problem's observations are left out.
    reasons : dict
        Index of observation to why.
    findings : tuple of str
        What was found wrong, for people.
    """

    fit: PoseFit
    dropped: NDArray[np.bool_]
    reasons: dict[int, Words]
    findings: tuple[Words, ...]


def search(problem: Problem, options: SolveOptions) -> SnoopingSearch:
    """Return the fit without the observations that are demonstrably wrong."""
    first = fit(problem, options)
    dropped = np.zeros(len(problem), dtype=bool)
    solvable = first.propagation is not None or first.unseen or lost(first)
    if not solvable or first.passed or not options.find_errors:
        return SnoopingSearch(fit=first, dropped=dropped, reasons={}, findings=())
    current, reasons, findings = first, {}, []
    astray = True  # the errors may have led the fit to a wrong place
    while not current.passed:
        tried, astray = _fits_without(problem, dropped, current, options, astray=astray)
        found = _most_likely(tried, current, options)
        if found is None:
            return SnoopingSearch(
                fit=first, dropped=np.zeros(len(problem), dtype=bool), reasons={}, findings=()
            )
        hypothesis, without, rival = found
        words = describe(problem, hypothesis.members, hypothesis.kind, without)
        if rival is not None:
            doubt = describe(problem, rival.members, rival.kind, without)
            contradiction = cannot_tell_which([words, doubt])
            return SnoopingSearch(
                fit=PoseFit(problem=problem, options=options, missing=(contradiction,)),
                dropped=np.zeros(len(problem), dtype=bool), reasons={}, findings=(),
            )  # fmt: skip
        findings.append(words)
        reasons.update({int(index): words for index in np.flatnonzero(hypothesis.members)})
        dropped = dropped | hypothesis.members
        current = without
    return SnoopingSearch(fit=current, dropped=dropped, reasons=reasons, findings=tuple(findings))


def lost(first: PoseFit) -> bool:
    """Return whether errors led the least squares to where nothing is determined."""
    return first.best is not None and not first.best.converged


def _most_likely(
    tried: list[tuple[Hypothesis, PoseFit]], current: PoseFit, options: SolveOptions
) -> tuple[Hypothesis, PoseFit, Hypothesis | None] | None:
    """Return the best hypothesis, the fit without it, and a rival that nobody can tell from it."""
    explaining = [
        (hypothesis, without)
        for hypothesis, without in tried
        if without.determined
        and without.degrees_of_freedom >= 1
        and (
            without.passed if current.propagation is None else _explains(current, without, options)
        )
    ]
    if not explaining:
        return None
    # While another error is still in, chance is as much larger as the residuals are.
    variance = max(1.0, min(rest.cost / rest.degrees_of_freedom for _, rest in explaining))
    chance = variance * chi2_limit(2, options.significance)
    scored = sorted(
        (
            (without.cost + chance * int(hypothesis.members.sum()), hypothesis, without)
            for hypothesis, without in explaining
        ),
        key=lambda item: item[0],
    )
    score, best, without = scored[0]
    rivals = (
        other
        for other_score, other, other_fit in scored[1:]
        if other_score < score + _TELLS_APART
        and other_fit.passed
        and without.passed
        and not np.any(other.members & best.members)
    )
    return best, without, next(rivals, None)


def _fits_without(
    problem: Problem,
    dropped: NDArray[np.bool_],
    current: PoseFit,
    options: SolveOptions,
    *,
    astray: bool,
) -> tuple[list[tuple[Hypothesis, PoseFit]], bool]:
    """Return each hypothesis with the fit without what it is about.

    That is searched for next to the current fit. Where no hypothesis makes that one sound, the
    errors may have led it to a wrong place, and all are fitted from nothing, too. Returned with
    them is whether one came to another place by that: if none did, there is no need to ask again
    when fewer errors are left.
    """
    most = max(1, int(len(problem) * _MOST_LEFT_OUT))
    hypotheses = [
        hypothesis
        for hypothesis in _hypotheses(problem, dropped, current)
        if (dropped | hypothesis.members).sum() <= most
    ]
    smaller = [problem.without(dropped | hypothesis.members) for hypothesis in hypotheses]
    here = None if current.best is None else [current.best]
    fits = [fit(rest, options, near=here) for rest in smaller]
    if astray and not any(near.passed for near in fits):
        anew = _fits_from_nothing(hypotheses, smaller, options)
        astray = any(_elsewhere(one, other) for one, other in zip(fits, anew))
        fits = [
            min(pair, key=lambda f: f.cost if f.determined else np.inf) for pair in zip(fits, anew)
        ]
    return list(zip(hypotheses, _smaller_explanations(hypotheses, smaller, fits, options))), astray


def _smaller_explanations(
    hypotheses: Sequence[Hypothesis],
    smaller: Sequence[Problem],
    fits: Sequence[PoseFit],
    options: SolveOptions,
) -> list[PoseFit]:
    """Return the fits, those of parts of a hypothesis that is sound tried next to its pose, too.

    Near the current fit, all of a target may have to go before the pose is found that shows that
    only one image of it is wrong.
    """
    better = list(fits)
    for index, found in enumerate(fits):
        if found.passed:
            continue
        members = hypotheses[index].members
        poses = [
            pose
            for other, sound in zip(hypotheses, fits)
            if sound.passed and np.all(other.members[members])
            for pose in sound.minima
        ]
        if poses:
            anew = fit(smaller[index], options, near=poses)
            better[index] = min(
                (found, anew), key=lambda f: f.cost if f.determined else np.inf
            )  # fmt: skip
    return better


def _elsewhere(near: PoseFit, anew: PoseFit) -> bool:
    """Return whether the fit from nothing is better than the one next to the current fit."""
    return anew.determined and not (near.determined and near.cost <= anew.cost * (1.0 + 1e-6))


def _fits_from_nothing(
    hypotheses: Sequence[Hypothesis], smaller: Sequence[Problem], options: SolveOptions
) -> list[PoseFit]:
    """Return the fit of each problem.

    A pose that fits what one hypothesis leaves fits what a larger one leaves, too: it is among
    those found for the larger one, unless that leaves too little, and need not be searched again.
    """
    done: dict[int, PoseFit] = {}
    searched: list[int] = []
    for index in sorted(range(len(hypotheses)), key=lambda i: -hypotheses[i].members.sum()):
        members = hypotheses[index].members
        larger = [i for i in searched if np.all(hypotheses[i].members[members])]
        poses = [pose for i in larger if done[i].propagation for pose in done[i].minima]
        done[index] = fit(smaller[index], options, near=poses or None)
        if not poses:
            searched.append(index)
    return [done[index] for index in range(len(hypotheses))]


def _explains(current: PoseFit, without: PoseFit, options: SolveOptions) -> bool:
    """Tell whether what is left out stands out from what is left (F test).

    Without this, centres that are all worse than they say would be left out one after another.
    """
    from scipy.special import fdtri

    left = without.degrees_of_freedom
    removed = current.degrees_of_freedom - left
    variance = max(without.cost / left, 1e-30)
    limit = float(fdtri(removed, left, 1.0 - 10.0 * options.significance))
    stands_out = (current.cost - without.cost) / removed > limit * variance
    return bool(stands_out and current.cost - without.cost > chi2_limit(removed, 1e-3))


def _hypotheses(problem: Problem, dropped: NDArray[np.bool_], current: PoseFit) -> list[Hypothesis]:
    """Return the most suspicious hypotheses of each kind, each set of observations once."""
    suspicion = np.zeros(len(problem))
    if current.propagation is not None:
        suspicion[~dropped] = np.sum(current.propagation.residuals**2, axis=1)
    kinds: list[tuple[Kind, NDArray[np.int64]]] = [
        ("observation", np.arange(len(problem))),
        ("image", problem.image_of),
        ("target", problem.target_of),
    ]
    found: list[Hypothesis] = []
    known: set[bytes] = set()
    for kind, group_of in kinds:
        sums = np.bincount(group_of[~dropped], weights=suspicion[~dropped])
        for group in np.argsort(-sums)[:_TRIED]:
            members = (group_of == group) & ~dropped
            if members.any() and members.tobytes() not in known:
                known.add(members.tobytes())
                found.append(Hypothesis(kind=kind, members=members))
    return found
