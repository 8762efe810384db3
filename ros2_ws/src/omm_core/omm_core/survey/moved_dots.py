"""Plain dots that moved between photographs, and so come out as two.

A dot has no number: where it was moved, some photographs show one dot, others another one. Two dots
nearer to each other than their diameter cannot both be there. Farther apart, they are one if no
photograph shows both though many must, and nearly all of these show one of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from omm_core.survey.camera_model import evaluate_rays
from omm_core.survey.network import Network, NetworkState
from omm_core.survey.sighting import PLAIN, Sighting

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FAR = 10.0  # times the diameter: farther apart, what stands between may hide one of them
_BY_CHANCE = 1e-4  # that of two dots which stand still never both are seen
_SHOW_ONE = 0.75  # of the photographs that must show one of them
_FEWEST = 2  # that show the one, and the other
_MANY = 6  # rays, above which they do not meet by chance
_EDGE_PX = 20.0
_FLATTEST = 0.02  # of all rays are flatter than what counts as visible


def moved_dots(network: Network) -> list[tuple[int, int]]:
    """Return pairs of plain points that are one dot, which moved; the one seen more often first."""
    plain = [n for n in network.points if n < 0]
    diameter = network.diameters_mm.get(PLAIN)
    if diameter is None or len(plain) < 2:
        return []
    places = np.array([network.xyz_mm(n) for n in plain])
    near = cKDTree(places).query_pairs(_FAR * diameter)
    shown = _shown(network, plain)
    near = {(i, j) for i, j in near if not (shown[i] & shown[j]).any()}
    if not near:
        return []
    visible = _visible(network, plain, shown)
    share = (shown & visible).sum() / max(visible.sum(), 1)
    found: list[tuple[int, int]] = []
    for i, j in sorted(near, key=lambda pair: float(np.linalg.norm(np.subtract(*places[[*pair]])))):
        if {plain[i], plain[j]} & {n for pair in found for n in pair}:
            continue
        apart = float(np.linalg.norm(places[i] - places[j]))
        both = visible[i] & visible[j]
        of_both = [int((both & shown[k]).sum()) for k in (i, j)]
        alternate = (
            min(of_both) >= _FEWEST
            and sum(of_both) >= _SHOW_ONE * both.sum()
            and (1.0 - share**2) ** both.sum() < _BY_CHANCE
        )
        if apart < diameter or alternate:
            first, second = sorted((i, j), key=lambda k: -int(shown[k].sum()))
            found.append((plain[first], plain[second]))
    return found


def words_of_move(network: Network, pair: tuple[int, int]) -> str:
    """Return why a dot that stands in two places is left out, in words that follow its name."""
    by = float(np.linalg.norm(network.xyz_mm(pair[0]) - network.xyz_mm(pair[1])))
    rays = network.ray_counts()
    return (
        f"{rays[pair[1]]} photographs show it {by:.2f} mm from where the other {rays[pair[0]]} do:"
        " it moved"
    )


def name_of_dot(place_mm: Array, network: Network) -> str:
    """Return what a plain dot is called that has no number: where it is."""
    coded = [n for n in network.points if n > 0]
    away = [float(np.linalg.norm(network.xyz_mm(n) - place_mm)) for n in coded]
    nearest = int(np.argmin(away))
    return f"A plain dot, {away[nearest]:.0f} mm from target {coded[nearest]},"


def words_of_lost(
    lost: Iterable[int], state: NetworkState, sightings: Iterable[Sighting], network: Network
) -> list[str]:
    """Return what must be told of plain dots that many photographs show and none could keep."""
    rays = Counter(s.point for s in sightings)
    return [
        f"{name_of_dot(state.points[n], network)} is left out: its {rays[n]} rays contradict each"
        " other; it may have moved by a little."
        for n in lost
        if n < 0 and rays[n] >= _MANY
    ]


def _shown(network: Network, numbers: list[int]) -> Mask:
    """Return which photographs show each point, (N, K)."""
    rows = {number: row for row, number in enumerate(numbers)}
    shown = np.zeros((len(numbers), len(network.photos)), dtype=bool)
    for s in network.sightings:
        if s.point in rows:
            shown[rows[s.point], network.photos[s.photo]] = True
    return shown


def _visible(network: Network, numbers: list[int], shown: Mask) -> Mask:
    """Return in which photographs each point must be visible unless something hides it, (N, K)."""
    values = network.solution.values
    places = np.array([network.xyz_mm(n) for n in numbers])
    photo, row = (grid.ravel() for grid in np.mgrid[: shown.shape[1], : len(numbers)])
    point = np.array([network.points[n] for n in numbers])[row]
    camera = network.cameras.rows(network.photos)[photo]
    pixels, _ = evaluate_rays(values, photo, point, network.middle_px, camera)
    within = (pixels > _EDGE_PX) & (pixels < 2.0 * network.middle_px + 1.0 - _EDGE_PX)
    towards = values["photos"][:, None, 3:] - places
    axes = Rotation.from_rotvec(values["photos"][:, :3]).as_matrix()[:, 2]
    before = np.einsum("kni,ki->nk", towards, axes) < 0.0
    normals = np.array([getattr(network.circles.get(n), "normal", np.zeros(3)) for n in numbers])
    slope = np.einsum("kni,ni->nk", towards, normals) / np.linalg.norm(towards, axis=2).T
    seen = slope[shown & (slope > 0.0)]
    least = float(np.quantile(seen, _FLATTEST)) if len(seen) else 1.0
    return within.all(axis=1).reshape(shown.T.shape).T & before & (slope > least)
