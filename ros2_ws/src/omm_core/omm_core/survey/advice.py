"""Where to take further photographs: from where the weak targets look."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from omm_core.survey.datum import Frame
from omm_core.survey.network import Network
from omm_core.survey.words import name_of, widest_angles

Array = NDArray[np.float64]

_RAYS_WANTED = 4
_ANGLE_WANTED = 0.5  # rad between the outermost rays
_ONE_SIDE = np.cos(np.radians(40.0))
_MOST = 6


def where_to_stand(network: Network, frame: Frame) -> list[str]:
    """Return what to add to a network, by the side on which its weak targets are."""
    rays, angles = network.ray_counts(), widest_angles(network)
    weak = [
        number
        for number in network.points
        if number in network.circles
        and (rays[number] < _RAYS_WANTED or angles.get(number, 0.0) < _ANGLE_WANTED)
    ]
    words = []
    for side in _sides(network, weak):
        normal = np.mean([network.circles[n].normal for n in side], axis=0)
        normal /= np.linalg.norm(normal)
        middle = np.mean([network.xyz_mm(n) for n in side], axis=0)
        place = frame.moved((middle + _distance(network) * normal)[None])[0]
        counts = [rays[n] for n in side]
        names = ", ".join(name_of(n) for n in side[:_MOST])
        more = f" and {len(side) - _MOST} more" if len(side) > _MOST else ""
        words.append(
            f"Weak: {names}{more} ({_range(counts)} rays). Take two photographs from"
            f" about ({place[0]:.0f}, {place[1]:.0f}, {place[2]:.0f}) mm and two from 30 degrees"
            " beside it, one of them turned by 90 degrees, with targets of other sides in view."
        )
    return words


def _range(counts: list[int]) -> str:
    fewest, most = min(counts), max(counts)
    return str(fewest) if fewest == most else f"{fewest} to {most}"


def _sides(network: Network, numbers: list[int]) -> list[list[int]]:
    """Return targets by the direction that they face, the largest group first."""
    left, groups = list(numbers), []
    while left:
        normals = np.array([network.circles[n].normal for n in left])
        near = normals @ normals.T > _ONE_SIDE
        group = near[int(np.argmax(near.sum(axis=1)))]
        groups.append([n for n, inside in zip(left, group, strict=True) if inside])
        left = [n for n, inside in zip(left, group, strict=True) if not inside]
    return groups


def _distance(network: Network) -> float:
    """Return how far photographs were taken from the middle of the points (median)."""
    values = network.solution.values
    middle = values["points"].mean(axis=0)
    return float(np.median(np.linalg.norm(values["photos"][:, 3:] - middle, axis=1)))
