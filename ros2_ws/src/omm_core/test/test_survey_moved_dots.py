"""A plain dot that moved is one dot: it is named by where it was, and never delivered as two."""

import re

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from omm_core.survey import Bar, Network, Sighting, solve_network
from omm_core.survey.camera_model import evaluate_rays
from omm_core.targets.plain import PlainDot

Array = NDArray[np.float64]

LENS = np.array([3010.0, 4.0, -3.0, -0.05, 0.02, 0.0, 1e-4, -5e-5, 1e-4, 2e-5])
SIZE = (3000, 2000)
MIDDLE = (np.array(SIZE) - 1) / 2
SIGMA_PX = 0.01
PHOTOS, CODED, PLAIN = 16, 20, 10
RADIUS_MM = 4.0
LATE = range(10, PHOTOS)


def poses() -> Array:
    found = []
    for i in range(PHOTOS):
        a = 2 * np.pi * i / PHOTOS
        place = np.array([1300 * np.cos(a), 1300 * np.sin(a), 1500.0])
        z = -place / np.linalg.norm(place)
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        turn = Rotation.from_rotvec([0, 0, i % 4 * 1.5]).as_matrix() @ [x, np.cross(z, x), z]
        found.append(np.r_[Rotation.from_matrix(turn).as_rotvec(), place])
    return np.array(found)


class Plate:
    """Targets that lie on a plate, photographed from all around."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(5)
        places = self.rng.permutation(
            [[x, y, 0.0] for x in np.linspace(-400, 400, 6) for y in np.linspace(-300, 300, 5)]
        )
        self.coded = places[:CODED] + [0, 0, 1] * self.rng.uniform(0, 80, (CODED, 1))
        self.plain = places[CODED:]
        self.poses = poses()

    def _seen(self, photo: int, xyz: Array) -> tuple[Array, Array]:
        """Return where a place is seen, and the spread of a dot that lies there."""
        values = {"lens": LENS[None], "photos": self.poses, "points": xyz[None]}
        pixels, slopes = evaluate_rays(values, np.array([photo]), np.array([0]), MIDDLE)
        across = RADIUS_MM * slopes["points"][0][:, :2]
        return pixels[0] + self.rng.normal(0, SIGMA_PX, 2), across @ across.T

    def solved(self, dots: dict[int, list[Array]]) -> Network:
        """Return the network; ``dots`` are the places of the plain dots in each photograph."""
        noise = SIGMA_PX**2 * np.eye(2)
        sightings = [
            Sighting(
                photo=k, point=n + 1, center_px=self._seen(k, xyz)[0], covariance_px2=noise
            )
            for k in range(PHOTOS)
            for n, xyz in enumerate(self.coded)
        ]  # fmt: skip
        seen = {
            k: tuple(
                PlainDot(
                    center_px=at, covariance_px2=noise, spread_px2=spread,
                    diameter_px=2 * float(np.sqrt(np.linalg.eigvalsh(spread)[1])),
                    contrast_dn=100.0, blur_px=0.7,
                )
                for at, spread in (self._seen(k, xyz) for xyz in places)
            )
            for k, places in dots.items()
        }  # fmt: skip
        bars = [
            Bar(
                ends=(a + 1, b + 1),
                length_mm=float(np.linalg.norm(self.coded[a] - self.coded[b])),
                sigma_mm=0.002,
            )
            for a, b in ((0, 1), (2, 3))
        ]
        return solve_network(sightings, bars, 3010.0, SIZE, seen)


def plain_of(network: Network) -> int:
    return sum(n < 0 for n in network.points)


@pytest.mark.parametrize("by_mm", [1.0, 4.0, 12.0, 70.0])
def test_a_dot_that_moved_is_named_with_its_distance_and_left_out(by_mm: float) -> None:
    plate = Plate()
    dots = {k: list(plate.plain) for k in range(PHOTOS)}
    for k in LATE:
        dots[k][3] = plate.plain[3] + [by_mm, 0.0, 0.0]
    network = plate.solved(dots)
    assert plain_of(network) == PLAIN - 1
    (told,) = network.words
    found = re.search(
        r": 6 photographs show it (\S+) mm from where the other 10 do: it moved", told
    )
    assert found
    assert float(found[1]) == pytest.approx(by_mm, abs=0.02)
    away = np.linalg.norm(plate.coded - plate.plain[3], axis=1)
    assert f"{away.min():.0f} mm from target {np.argmin(away) + 1}" in told
    assert not network.left_out_points


def test_a_dot_that_moved_by_half_a_pixel_is_not_lost_in_silence() -> None:
    plate = Plate()
    dots = {k: list(plate.plain) for k in range(PHOTOS)}
    for k in LATE:
        dots[k][3] = plate.plain[3] + [0.3, 0.0, 0.0]
    network = plate.solved(dots)
    assert plain_of(network) == PLAIN - 1
    (told,) = network.words
    assert "moved" in told


def test_dots_that_stand_side_by_side_are_two_though_photographs_miss_them() -> None:
    plate = Plate()
    beside = plate.plain[3] + [9.0, 0.0, 0.0]
    dots = {}
    for k in range(PHOTOS):
        dots[k] = [xyz for i, xyz in enumerate(plate.plain) if i != 3]
        # A clamp hides the one from some sides, the other from others, both from a third.
        dots[k] += [plate.plain[3]] * (k < 10) + [beside] * (4 <= k < 13)
    network = plate.solved(dots)
    assert plain_of(network) == PLAIN + 1
    assert not network.words


def test_a_dot_that_was_taken_away_stays_where_photographs_show_it() -> None:
    plate = Plate()
    dots = {k: list(plate.plain[1:] if k in LATE else plate.plain) for k in range(PHOTOS)}
    network = plate.solved(dots)
    assert plain_of(network) == PLAIN
    assert not network.words
