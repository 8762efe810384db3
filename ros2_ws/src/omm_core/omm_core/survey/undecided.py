"""Points with a wrong ray among few: whether the others tell which one it is.

Of four rays, one of which is wrong, any three may meet about as well: then the test that rejects
one of them tells nothing, and the place depends on it. Each choice of so many rays that may be
wrong is a hypothesis; what it costs is the weighted square sum of the rays that are left, at the
place where these meet. Poses and lens are held, since many other points tell them.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from omm_core.survey.camera_model import evaluate_rays
from omm_core.survey.network import FEWEST_RAYS, Network, detector_covariances

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MOST_RAYS, _MOST_WRONG = 7, 2
_AS_LIKELY = 9.0  # difference of two costs: exp(9 / 2), 90 times, is told apart
_PASSES = 1e-3  # chance of a larger cost where the hypothesis is right
_ELSEWHERE = 1.0  # sigma of a coordinate: nearer than that, it does not matter which
_TURNS = 4


def undecided_points(network: Network) -> dict[int, str]:
    """Return points whose wrong rays the others do not tell, and why they are left out."""
    rays_of: dict[int, list[int]] = defaultdict(list)
    for i, sighting in enumerate(network.sightings):
        rays_of[sighting.point].append(i)
    covariance = network.noise.covariance(detector_covariances(network.sightings), network.kinds)
    weights = np.linalg.inv(covariance)
    found = {}
    for point, of_point in rays_of.items():
        rays = np.array(of_point)
        wrong = int(np.sum(~network.used[rays]))
        if (
            0 < wrong <= _MOST_WRONG
            and len(rays) - wrong >= FEWEST_RAYS
            and len(rays) <= _MOST_RAYS
            and _another_fits(network, point, rays, weights[rays])
        ):
            found[point] = (
                f"{wrong} of its {len(rays)} rays {'is' if wrong == 1 else 'are'} wrong, and the"
                " others do not tell which; take more photographs of it"
            )
    return found


def _another_fits(network: Network, point: int, rays: NDArray[np.intp], weights: Array) -> bool:
    """Tell whether leaving other rays out is about as likely, and puts the point elsewhere."""
    taken = network.used[rays]
    kept = np.array(list(combinations(range(len(rays)), int(taken.sum()))))
    takes = np.zeros((len(kept), len(rays)), dtype=bool)
    takes[np.arange(len(kept))[:, None], kept] = True
    places, costs = _meetings(network, point, rays, weights, takes)
    chosen = int(np.flatnonzero((takes == taken).all(axis=1))[0])
    rows = network.points[point] * 3 + np.arange(3)
    sigmas = np.sqrt(np.diag(network.solution.covariance_of("points"))[rows])
    elsewhere = (np.abs(places - places[chosen]) / sigmas).max(axis=1) > _ELSEWHERE
    limit = chi2.isf(_PASSES, 2 * taken.sum() - 3)
    return bool(np.any(elsewhere & (costs < limit) & (costs < costs[chosen] + _AS_LIKELY)))


def _meetings(
    network: Network, point: int, rays: NDArray[np.intp], weights: Array, takes: Mask
) -> tuple[Array, Array]:
    """Return where the rays of each hypothesis (H, n) meet, (H, 3), and the costs there."""
    h, n = takes.shape
    values = dict(network.solution.values)
    photo = np.array([network.photos[network.sightings[i].photo] for i in rays])
    camera = network.cameras.rows(network.sightings[i].photo for i in rays)
    at = np.repeat(np.arange(h), n)
    start = network.xyz_mm(point)

    def evaluated(places: Array) -> tuple[Array, Array]:
        pixels, slopes = evaluate_rays(
            values | {"points": places}, np.tile(photo, h), at, network.middle_px,
            np.tile(camera, h),
        )  # fmt: skip
        return pixels.reshape(h, n, 2), slopes["points"].reshape(h, n, 2, 3)

    places = np.tile(start, (h, 1))
    # What was observed, less the centres' shift: it comes with the residuals at the start.
    observed = network.solution.residuals["rays"][rays] + evaluated(places)[0]
    weighted = weights * takes[:, :, None, None]
    for _ in range(_TURNS):
        pixels, slopes = evaluated(places)
        turned = np.swapaxes(slopes, 2, 3) @ weighted
        normal = (turned @ slopes).sum(axis=1)
        right = (turned @ (observed - pixels)[..., None]).sum(axis=1)
        places = places + (np.linalg.pinv(normal, hermitian=True) @ right)[..., 0]
    off = observed - evaluated(places)[0]
    return places, np.einsum("hni,hnij,hnj->h", off, weighted, off)
