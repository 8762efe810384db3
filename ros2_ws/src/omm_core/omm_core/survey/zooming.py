"""Photographs that were taken with another focal length than most: zoom or focus was touched.

The network is adjusted with a focal length for each photograph (their logarithms over the common
one, with a weak prior), so that neither poses nor points are bent by those that differ. Two groups
are looked for: a run of photographs in the order of their files, between two moments at which the
lens was touched; or any that lie far from the rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.survey.network import Network

Array = NDArray[np.float64]

TOUCHED = "zoom or focus was touched"
_LEAST = 1e-4  # of the focal length
_TOLD = 3e-3  # sigma of a photograph's scale, above which it tells nothing
_UNCLEAR = 5.0  # of the median sigma
_FEWEST = 6
_TURNS = 5
_SIGMAS, _APART = 8.0, 4.0  # of the difference; by the scatter within the groups
_OF_ONE = 0.003  # one photograph alone may be off by a blunder that no test has found yet


def zoomed_photos(network: Network, count: int) -> dict[int, str]:
    """Return photographs that were taken with another focal length than most, and by how much.

    Parameters
    ----------
    network : Network
        Adjusted with ``zooms``.
    count : int
        Photographs in the series, numbered in the order of their files.
    """
    found: dict[int, str] = {}
    for camera in range(len(network.cameras)):
        found |= _zoomed_of_camera(network, count, camera)
    return found


def _zoomed_of_camera(network: Network, count: int, camera: int) -> dict[int, str]:
    every = np.array(list(network.photos))
    own = np.flatnonzero(network.cameras.rows(network.photos) == camera)
    every = every[own]
    covariance = network.solution.covariance_of("zooms")[np.ix_(own, own)]
    if not len(every):
        return {}
    told = 1.0 / np.sqrt(np.diag(np.linalg.inv(covariance)))  # if all else were known
    known = np.flatnonzero(told < _TOLD)
    if len(known) < _FEWEST:
        return {}
    # What all have in common is the lens's.
    mean = np.zeros(len(every))
    mean[known] = told[known] ** -2.0 / np.sum(told[known] ** -2.0)
    less_mean = (np.eye(len(every)) - mean)[known]
    scales = less_mean @ network.solution.values["zooms"][own, 0]
    covariance = less_mean @ covariance @ less_mean.T
    # What a photograph hardly tells of its scale says nothing of the others'.
    sigmas = np.sqrt(np.diag(covariance))
    clear = np.flatnonzero(sigmas < _UNCLEAR * np.median(sigmas))
    known = known[clear]
    if len(known) < _FEWEST:
        return {}
    found = _far_group(scales[clear], covariance[np.ix_(clear, clear)])
    if found is None:
        return {}
    fewer, apart = found
    why = f"it was taken with a focal length {apart:+.2%} different from most others' ({TOUCHED})"
    run = _whole_run(every[known], fewer, count)
    return {n: why for n in run if network.cameras.row(n) == camera}


def _whole_run(numbers: Array, fewer: NDArray[np.bool_], count: int) -> list[int]:
    """Return the numbers of those that differ; of a run, also what lies between."""
    rows = np.flatnonzero(fewer)
    if rows[-1] - rows[0] + 1 > len(rows):
        return [int(n) for n in numbers[rows]]
    first = 0 if rows[0] == 0 else int(numbers[rows[0]])
    last = count - 1 if rows[-1] == len(fewer) - 1 else int(numbers[rows[-1]])
    return list(range(first, last + 1))


def _far_group(scales: Array, covariance: Array) -> tuple[NDArray[np.bool_], float] | None:
    """Return which differ, the fewer ones, and by how much; None where there are no two groups."""
    best: tuple[float, NDArray[np.bool_], float] | None = None
    for group in _groups(scales):
        apart, test = _difference(scales, covariance, group)
        if best is None or test > best[0]:
            best = (test, group, apart)
    if best is None or best[0] < 1.0:
        return None
    _, group, _ = best
    for _ in range(_TURNS):  # each to the nearer of the two
        middles = np.median(scales[group]), np.median(scales[~group])
        nearer = np.abs(scales - middles[0]) < np.abs(scales - middles[1])
        if nearer.all() or not nearer.any():
            break
        group = nearer
    if 2 * group.sum() > len(group):
        group = ~group
    return group, _difference(scales, covariance, group)[0]


def _groups(scales: Array) -> list[NDArray[np.bool_]]:
    """Return the runs in the order of the files, and the two sides of the widest gap."""
    n, at = len(scales), np.arange(len(scales))
    groups = [(at >= first) & (at < last) for first in range(n) for last in range(first + 1, n + 1)]
    order = np.sort(scales)
    groups.append(scales > order[int(np.argmax(np.diff(order)))])
    # Of two halves the later is taken for the one that differs.
    kept = []
    for group in groups:
        if 2 * group.sum() > n or (2 * group.sum() == n and group[0]):
            group = ~group
        if group.any() and not group.all():
            kept.append(group)
    return kept


def _difference(scales: Array, covariance: Array, group: NDArray[np.bool_]) -> tuple[float, float]:
    """Return by how much a group differs, and that over the least that counts (1: it does)."""
    own = 1.0 / np.diag(covariance)
    weights = np.where(group, own / own[group].sum(), -own / own[~group].sum())
    apart = float(weights @ scales)
    sigma = float(np.sqrt(weights @ covariance @ weights))
    rest = np.where(group, scales - np.median(scales[group]), scales - np.median(scales[~group]))
    within = 1.4826 * float(np.median(np.abs(rest)))
    least = max(_LEAST, _SIGMAS * sigma, _APART * within, _OF_ONE * float(group.sum() == 1))
    return apart, abs(apart) / least
