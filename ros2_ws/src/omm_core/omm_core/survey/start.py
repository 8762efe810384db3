"""Where photographs and points lie, from nothing: best pair, then resection and intersection."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.errors import MeasurementError

Array = NDArray[np.float64]
Rays = dict[int, dict[int, Array]]  # photo -> point -> ideal (x/z, y/z)

FEWEST_COMMON = 8
FEWEST_TO_RESECT = 4
# With few points on a plane two poses look nearly alike: not before the lens is known.
_FEWEST_AT_FIRST = 7
_ENOUGH_PHOTOS = 4
_FLAT = 0.1
_PAIRS_TRIED = 60
_FIRST_ANGLE_RAD = 0.09
FEWEST_RAYS = 3
_MEETS_PX, _MOST_MEET = 40.0, 0.6  # rays to a point meet: how near, and how many of them
FITS_AT_FIRST_PX, _FITS_PX = 15.0, 5.0  # of a ray from where its point would be


def start_network(rays: Rays, pixel: float) -> tuple[dict[int, Array], dict[int, Array]]:
    """Return photos (6: rotation vector, place) and points (3,), in an arbitrary scale.

    Parameters
    ----------
    rays : mapping
        By photo and point: ideal normalised coordinates (2,).
    pixel : float
        Size of a pixel in them.

    Raises
    ------
    MeasurementError
        Where no two photographs have enough in common.
    """
    photos, points = _best_pair(rays, pixel)
    _extend(rays, photos, points, pixel, _FEWEST_AT_FIRST)
    if len(photos) < _ENOUGH_PHOTOS:
        _extend(rays, photos, points, pixel, FEWEST_TO_RESECT)
    return photos, points


def _extend(
    rays: Rays, photos: dict[int, Array], points: dict[int, Array], pixel: float, fewest: int
) -> None:
    """Locate whatever photographs and points can be located, in place."""
    while _resect_next(rays, photos, points, pixel, fewest):
        intersect_points(rays, photos, points, pixel, _FIRST_ANGLE_RAD)


def resect_photos(
    rays: Rays,
    photos: dict[int, Array],
    points: dict[int, Array],
    pixel: float,
    fits_px: float = _FITS_PX,
) -> None:
    """Locate the photographs that see enough of the points, in place; the lens is known."""
    while _resect_next(rays, photos, points, pixel, FEWEST_TO_RESECT, fits_px):
        pass


def _best_pair(rays: Rays, pixel: float) -> tuple[dict[int, Array], dict[int, Array]]:
    import cv2

    pairs = []
    for a, b in combinations(rays, 2):
        common = sorted(set(rays[a]) & set(rays[b]))
        if len(common) >= FEWEST_COMMON:
            pairs.append((len(common), a, b, common))
    pairs.sort(key=lambda pair: -pair[0])
    best: tuple[float, dict[int, Array], dict[int, Array]] | None = None
    for count, a, b, common in pairs[:_PAIRS_TRIED]:
        one, two = (np.array([rays[i][p] for p in common]) for i in (a, b))
        essential, mask = cv2.findEssentialMat(
            one, two, np.eye(3), method=cv2.RANSAC, prob=0.9999, threshold=5 * pixel
        )
        if essential is None or essential.shape != (3, 3):
            continue
        good, turn, shift, _ = cv2.recoverPose(essential, one, two, np.eye(3), mask=mask)
        if good < max(FEWEST_COMMON, 0.8 * count):
            continue
        place = (-turn.T @ shift).ravel()
        photos = {a: np.zeros(6), b: np.r_[Rotation.from_matrix(turn).as_rotvec(), place]}
        points: dict[int, Array] = {}
        intersect_points({a: rays[a], b: rays[b]}, photos, points, pixel, _FIRST_ANGLE_RAD)
        if len(points) < FEWEST_COMMON:
            continue
        to = np.array(list(points.values()))
        sine = np.linalg.norm(np.cross(_unit(to), _unit(to - place)), axis=1)
        score = len(points) * float(np.median(np.minimum(sine, 0.7)))
        if best is None or score > best[0]:
            best = (score, photos, points)
    if best is None:
        raise MeasurementError(
            f"Expected two photographs with {FEWEST_COMMON} coded targets in common, seen from"
            " different places; found none. Take photographs that overlap more; where the targets"
            " are there to be seen, check target_family."
        )
    return best[1], best[2]


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _resect_next(
    rays: Rays,
    photos: dict[int, Array],
    points: dict[int, Array],
    pixel: float,
    fewest: int,
    fits_px: float = FITS_AT_FIRST_PX,
) -> bool:
    """Locate the photograph that sees most of the known points; False when none is left."""
    import cv2

    left = [(len(set(rays[i]) & set(points)), i) for i in rays if i not in photos]
    for count, i in sorted(left, reverse=True):
        if count < fewest:
            return False
        common = sorted(set(rays[i]) & set(points))
        places = np.array([points[p] for p in common])
        seen = np.array([rays[i][p] for p in common])
        found, turn, shift, inliers = cv2.solvePnPRansac(
            places, seen, np.eye(3), None, reprojectionError=fits_px * pixel,
            iterationsCount=300, flags=cv2.SOLVEPNP_SQPNP,
        )  # fmt: skip
        if not found or inliers is None or len(inliers) < max(4, 0.6 * count):
            continue
        inside = inliers.ravel()
        turn, shift = _best_pose(places[inside], seen[inside], (turn, shift))
        off = cv2.projectPoints(places[inside], turn, shift, np.eye(3), None)[0][:, 0]
        # Four points are placed somehow whatever they are.
        if np.sqrt(np.mean((off - seen[inside]) ** 2)) > fits_px * pixel:
            continue
        rotation = Rotation.from_rotvec(turn.ravel())
        photos[i] = np.r_[turn.ravel(), -rotation.inv().apply(shift.ravel())]
        return True
    return False


def _best_pose(places: Array, seen: Array, first: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return turn and shift with the smallest error: on a plane, two poses look nearly alike."""
    import cv2

    tried = [first]
    for method in (cv2.SOLVEPNP_SQPNP, cv2.SOLVEPNP_IPPE):
        flat = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if method == cv2.SOLVEPNP_SQPNP or flat[2] < _FLAT * flat[1]:
            try:
                _, turns, shifts, _ = cv2.solvePnPGeneric(
                    places, seen, np.eye(3), None, flags=method
                )
            except cv2.error:
                # Places that all but coincide, as blunders make them: OpenCV refuses them.
                continue
            tried += list(zip(turns, shifts, strict=True))
    refined = []
    for turn, shift in tried:
        turn, shift = cv2.solvePnPRefineLM(places, seen, np.eye(3), None, turn, shift)
        error = cv2.projectPoints(places, turn, shift, np.eye(3), None)[0][:, 0] - seen
        refined.append((float(np.sum(error**2)), turn, shift))
    _, turn, shift = min(refined, key=lambda pose: pose[0])
    return turn, shift


def intersect_points(
    rays: Rays,
    photos: dict[int, Array],
    points: dict[int, Array],
    pixel: float,
    angle_rad: float,
) -> None:
    """Locate every point that two located photographs see at ``angle_rad``, in place."""
    for point in sorted({p for i in photos for p in rays[i]}):
        seen = [i for i in photos if point in rays[i]]
        if len(seen) < 2:
            continue
        turns = Rotation.from_rotvec([photos[i][:3] for i in seen])
        places = np.array([photos[i][3:] for i in seen])
        seen_at = np.array([rays[i][point] for i in seen])
        looks = _unit(turns.inv().apply(np.column_stack([seen_at, np.ones(len(seen_at))])))
        across = np.eye(3) - looks[:, :, None] * looks[:, None, :]
        if np.linalg.eigvalsh(across.sum(axis=0))[0] < 0.25 * angle_rad**2 * len(seen):
            continue
        place = _meeting(turns, places, across, seen_at, _MEETS_PX * pixel)
        if place is not None:
            points[point] = place
        else:
            points.pop(point, None)


def _meeting(
    turns: Rotation, places: Array, across: Array, seen_at: Array, near: float
) -> Array | None:
    """Return where most of the rays to a point meet, the worst left out; None where they do not."""
    kept = np.arange(len(places))
    fewest = min(len(places), max(FEWEST_RAYS, int(np.ceil(_MOST_MEET * len(places)))))
    while len(kept) >= fewest:
        normal = across[kept].sum(axis=0)
        place = np.linalg.solve(normal, np.einsum("nij,nj->i", across[kept], places[kept]))
        inside = turns.apply(place - places)[kept]
        errors = np.abs(inside[:, :2] / inside[:, 2:] - seen_at[kept]).max(axis=1)
        errors[inside[:, 2] <= 0] = np.inf
        if errors.max() < near:
            return np.asarray(place)
        kept = np.delete(kept, int(np.argmax(errors)))
    return None
