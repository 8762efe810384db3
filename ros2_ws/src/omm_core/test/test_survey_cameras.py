"""Photographs of several cameras in one bundle: each has its own lens and noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from omm_core.survey import Bar, Network, Sighting, solve_network
from omm_core.survey.camera_model import evaluate_rays
from omm_core.survey.cameras import Cameras
from omm_core.survey.words import findings_of
from omm_core.targets.plain import PlainDot

SIZE = (3000, 2000)
MIDDLE = (np.array(SIZE) - 1) / 2
LENSES = np.array([
    [3010.0, 4.0, -3.0, -0.05, 0.02, 0.0, 1e-4, -5e-5, 0.0, 0.0],
    [2100.0, -12.0, 7.0, -0.11, 0.06, 0.0, -2e-4, 1e-4, 0.0, 0.0],
])  # fmt: skip
SIGMA_PX = np.array([0.01, 0.03])  # the detector says 0.01 of both
CODED, PHOTOS = 20, 24


class Scene:
    """Twelve photographs by each of two cameras, by turns, of coded and plain targets."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.points = self.rng.uniform(-1, 1, (32, 3)) * [400.0, 300.0, 150.0]
        self.cameras = Cameras(
            focal_px=(3070.0, 2060.0), names=("tele", "wide"), of={i: i % 2 for i in range(PHOTOS)}
        )
        self.poses = np.array([self._pose(i) for i in range(PHOTOS)])
        photo, point = (grid.ravel() for grid in np.mgrid[:PHOTOS, : len(self.points)])
        values = {"lens": LENSES, "photos": self.poses, "points": self.points}
        at, _ = evaluate_rays(values, photo, point, MIDDLE, photo % 2)
        at += self.rng.normal(size=at.shape) * SIGMA_PX[photo % 2, None]
        self.sightings = [
            Sighting(photo=int(i), point=int(p) + 1, center_px=c, covariance_px2=1e-4 * np.eye(2))
            for i, p, c in zip(photo, point, at, strict=True)
            if p < CODED
        ]
        self.dots = {i: self._dots(i, at[(photo == i) & (point >= CODED)]) for i in range(PHOTOS)}

    def _pose(self, i: int) -> np.ndarray:
        around = 2 * np.pi * i / PHOTOS
        place = np.array([1500 * np.cos(around), 1500 * np.sin(around), 1200.0 + 100 * (i % 3)])
        z = -place / np.linalg.norm(place)
        x = np.cross(z, [0, 0, 1.0]) / np.linalg.norm(np.cross(z, [0, 0, 1.0]))
        roll = Rotation.from_rotvec([0, 0, np.pi / 2 * (i // 2 % 4)]).as_matrix()
        turn = roll @ np.array([x, np.cross(z, x), z])
        return np.r_[Rotation.from_matrix(turn).as_rotvec(), place]

    def _dots(self, photo: int, centres: np.ndarray) -> tuple[PlainDot, ...]:
        # So small that perspective does not shift their centres.
        away = np.linalg.norm(self.points[CODED:] - self.poses[photo, 3:], axis=1)
        return tuple(
            PlainDot(
                center_px=c, covariance_px2=1e-4 * np.eye(2), spread_px2=r**2 * np.eye(2),
                diameter_px=2 * r, contrast_dn=100.0, blur_px=0.7,
            )
            for c, r in zip(centres, 0.5 * LENSES[photo % 2, 0] / away, strict=True)
        )  # fmt: skip

    def solved(self) -> Network:
        bars = [
            Bar(
                ends=(a, a + 1),
                length_mm=float(np.linalg.norm(self.points[a - 1] - self.points[a])),
                sigma_mm=0.002,
            )
            for a in (1, 3)
        ]
        return solve_network(self.sightings, bars, self.cameras, SIZE, self.dots)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(4)


@pytest.fixture(scope="module")
def network(scene: Scene) -> Network:
    return scene.solved()


def test_each_camera_is_calibrated_within_its_sigma(network: Network) -> None:
    assert len(network.photos) == PHOTOS
    sigma = np.sqrt(np.diag(network.solution.covariance_of("lens"))).reshape(2, 10)
    free = sigma[0] > 0
    assert free.all()
    assert (free == (sigma[1] > 0)).all()
    off = (network.solution.values["lens"] - LENSES)[:, free] / sigma[:, free]
    assert np.abs(off).max() < 3.5
    assert 0.3 < np.mean(off**2) < 2.2


def test_sigma0_is_told_by_camera_and_kind(network: Network) -> None:
    told = network.sigma0_by
    assert set(told) == {
        f"{kind}, {name}" for kind in ("coded", "plain") for name in network.cameras.names
    }
    for kind in ("coded", "plain"):
        assert told[f"{kind}, tele"] == pytest.approx(1.0, rel=0.12)
        assert told[f"{kind}, wide"] == pytest.approx(3.0, rel=0.12)


def test_coordinates_of_both_kinds_err_as_much_as_their_covariance_says(
    scene: Scene, network: Network
) -> None:
    assert len(network.points) == len(scene.points)
    coded = np.array([network.xyz_mm(n) for n in range(1, CODED + 1)])
    true = scene.points[:CODED]
    turn, _ = Rotation.align_vectors(true - true.mean(0), coded - coded.mean(0))
    squares = []
    for number, row in network.points.items():
        at = turn.apply(network.xyz_mm(number) - coded.mean(0)) + true.mean(0)
        nearest = scene.points[int(np.argmin(np.linalg.norm(scene.points - at, axis=1)))]
        own = slice(3 * row, 3 * row + 3)
        covariance = network.solution.covariance_of("points")[own, own]
        error = turn.inv().apply(at - nearest)
        squares.append(error @ np.linalg.solve(covariance, error) / 3.0)
    assert 0.6 < np.mean(squares) < 1.5


def test_a_focal_length_told_wrong_is_named_by_camera(network: Network) -> None:
    words = findings_of(network, str, [3010.0, 2600.0])
    assert any(w.startswith("The focal length of wide comes out as 0.81 times") for w in words)
    assert not any("of tele comes out" in w for w in words)


def test_a_zoom_touched_in_one_camera_is_named_and_the_other_is_kept() -> None:
    scene = Scene(5)
    touched = {15, 17, 19, 21, 23}  # the last of "wide"

    def seen(photo: int, at: np.ndarray) -> np.ndarray:
        return MIDDLE + 1.002 * (at - MIDDLE) if photo in touched else at

    scene.sightings = [replace(s, center_px=seen(s.photo, s.center_px)) for s in scene.sightings]
    scene.dots = {
        photo: tuple(replace(d, center_px=seen(photo, d.center_px)) for d in dots)
        for photo, dots in scene.dots.items()
    }
    network = scene.solved()
    assert set(network.left_out_photos) == touched
    assert all("+0.2" in why for why in network.left_out_photos.values())
    assert len(network.photos) == PHOTOS - len(touched)
    assert len(network.points) == len(scene.points)
