"""What people must be told of a network: what was left out, what is weak, what to do about it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.survey.misreading import misread_targets, misreading_words
from omm_core.survey.network import FEWEST_RAYS, Network

Array = NDArray[np.float64]

_NOISY = 5.0  # times the detector's figures: a real plate has 2.4
_WEAK_ANGLE = 0.35  # rad between the outermost rays of a point
_FOCAL_OFF = 0.1
_SHORT = 0.2  # of a unit vector in a plane, up to which its direction there tells nothing
_SAME_WAY = 0.97  # length of the mean of unit vectors


def name_of(number: int) -> str:
    """Return what a point is called: a coded target's number, or P and a number."""
    return str(number) if number > 0 else f"P{-number}"


def findings_of(
    network: Network, photo_name: Callable[[int], str], nominal_focal_px: Sequence[float]
) -> list[str]:
    """Return the findings of a network, the gravest first."""
    gone = [f"Target {n} is left out: {why}." for n, why in network.left_out_points.items()]
    return [
        *_noise(network),
        *network.words,
        *gone,
        *_bars(network),
        *_misread(network, photo_name),
        *_suspects(network, photo_name),
        *_few_rays(network),
        *_weak_angles(network),
        *_roll(network),
        *_lens(network),
        *_focal(network, nominal_focal_px),
        *_left_out_rays(network),
    ]


def _noise(network: Network) -> list[str]:
    if network.sigma0 < _NOISY:
        return []
    return [
        f"The rays fit {network.sigma0:.1f} times worse than the detector's figures say (good"
        f" photographs: 1 to 3), {network.rms_px:.3f} px rms: blurred photographs, a phone's"
        " corrections, a part or targets that moved, or a lens beyond the model. The standard"
        " deviations are grown by it, but what is no noise is not in them."
    ]


def _bars(network: Network) -> list[str]:
    if len(network.bars) != 1:  # whether several agree was judged before they took part
        return []
    return ["Only one scale bar: its length is not checked by anything."]


def _misread(network: Network, photo_name: Callable[[int], str]) -> list[str]:
    found = misread_targets(network)
    return misreading_words(found, {m.photo: photo_name(m.photo) for m in found})


def _suspects(network: Network, photo_name: Callable[[int], str]) -> list[str]:
    """Name targets and photographs of which a quarter or more of the rays were left out."""
    words = []
    for what, numbers, name in (
        ("Target", [s.point for s in network.sightings], name_of),
        ("Photograph", [s.photo for s in network.sightings], photo_name),
    ):
        every = np.array(numbers)
        for number in np.unique(every):
            out = int(np.sum(~network.used & (every == number)))
            of = int(np.sum(every == number))
            if out >= 2 and out >= 0.25 * of:
                words.append(
                    f"{what} {name(int(number))}: {out} of {of} rays do not fit and are left out;"
                    " it may be partly hidden, misread or moved."
                )
    return words


def _few_rays(network: Network) -> list[str]:
    few = [name_of(p) for p, rays in network.ray_counts().items() if rays < FEWEST_RAYS]
    few += map(name_of, network.few_rays)
    if not few:
        return []
    return [
        f"Not delivered, with fewer than {FEWEST_RAYS} rays: {_listed(few)}. Take photographs of"
        " them from other sides."
    ]


def widest_angles(network: Network) -> dict[int, float]:
    """Return the largest angle between two used rays of each point, rad."""
    places = network.solution.values["photos"][:, 3:]
    seen: dict[int, list[int]] = {}
    for s, used in zip(network.sightings, network.used, strict=True):
        if used:
            seen.setdefault(s.point, []).append(network.photos[s.photo])
    angles = {}
    for point, rows in seen.items():
        looks = places[rows] - network.xyz_mm(point)
        looks /= np.linalg.norm(looks, axis=1, keepdims=True)
        angles[point] = float(np.arccos(np.clip((looks @ looks.T).min(), -1.0, 1.0)))
    return angles


def _weak_angles(network: Network) -> list[str]:
    rays = network.ray_counts()
    weak = [
        name_of(p)
        for p, angle in widest_angles(network).items()
        if angle < _WEAK_ANGLE and rays[p] >= FEWEST_RAYS
    ]
    if not weak:
        return []
    return [
        f"Seen from nearly one side only (rays within {np.degrees(_WEAK_ANGLE):.0f} degrees), so"
        f" that their depth is weak: {_listed(weak)}. Take photographs of them from other sides."
    ]


def _roll(network: Network) -> list[str]:
    return [
        f"All photographs{of_camera(network, camera)} have nearly the same roll angle: the"
        " principal point is badly determined. Turn the camera by 90 degrees in a part of them."
        for camera in range(len(network.cameras))
        if one_roll_angle(network, camera)
    ]


def of_camera(network: Network, camera: int) -> str:
    """Return which camera is meant, where there are several."""
    return f" of {network.cameras.names[camera]}" if len(network.cameras) > 1 else ""


def one_roll_angle(network: Network, camera: int = 0) -> bool:
    """Tell whether a camera was hardly turned about its axis, against the points' main plane.

    That is so where the plane's normal points the same way in all pictures that see the plane from
    aside (upright all around), or where all pictures lie the same way along the plane (face on).
    """
    centred = network.solution.values["points"] - network.solution.values["points"].mean(axis=0)
    *along, normal = np.linalg.svd(centred, full_matrices=False)[2]
    own = network.cameras.rows(network.photos) == camera
    if np.sum(own) < 3:
        return False
    turns = Rotation.from_rotvec(network.solution.values["photos"][own, :3]).as_matrix()
    up = (turns @ normal)[:, :2]
    tilted = np.linalg.norm(up, axis=1) > _SHORT
    upright = tilted.sum() >= max(3.0, 0.5 * len(up)) and _one_direction(up[tilted])
    return upright or _one_direction(turns[:, 0] @ np.transpose(along))


def _one_direction(vectors: Array) -> bool:
    """Tell whether vectors (n, 2) point the same way; a short one tells no direction."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    if lengths.min() <= _SHORT:
        return False
    return bool(np.linalg.norm((vectors / lengths).mean(axis=0)) > _SAME_WAY)


def _lens(network: Network) -> list[str]:
    """Tell that the lens was taken as declared, where there are too few photographs for it."""
    counts = np.bincount(network.cameras.rows(network.photos), minlength=len(network.cameras))
    variance = np.diag(network.solution.covariance_of("lens"))[::10]
    return [
        f"{counts[camera]} photographs do not calibrate the lens{of_camera(network, camera)}: it"
        " counts as exactly as declared and free of distortion, and no covariance says what that"
        " costs. Take four photographs or more."
        for camera in range(len(counts))
        if counts[camera] and not variance[camera] > 0.0
    ]


def _focal(network: Network, nominal_px: Sequence[float]) -> list[str]:
    ratios = network.solution.values["lens"][:, 0] / np.array(nominal_px)
    return [
        f"The focal length{of_camera(network, camera)} comes out as {ratio:.2f} times what was"
        " declared: check the camera's focal length and pixel size."
        for camera, ratio in enumerate(ratios)
        if abs(ratio - 1.0) >= _FOCAL_OFF
    ]


def _left_out_rays(network: Network) -> list[str]:
    out = int(np.sum(~network.used))
    if not out:
        return []
    return [f"{out} of {len(network.used)} image points are left out as blunders."]


def _listed(names: list[str], most: int = 12) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def photo_reasons(count: int, network: Network, known: Mapping[int, str]) -> dict[int, str]:
    """Return why each photograph that is not part of the network is not, by number."""
    reasons = {**network.left_out_photos, **known}
    for number in range(count):
        if number not in network.photos:
            reasons.setdefault(
                number,
                "it shows too few targets of the rest of the network, or they do not lie as in"
                " the other photographs (another scene, numbers read wrong, another zoom)",
            )
    return reasons
