"""A side that few photographs show is not lost to a blunder."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from omm_core.survey import Bar, Network, Sighting, solve_network
from omm_core.survey.camera_model import evaluate_rays
from omm_core.targets.plain import PlainDot

LENS = np.array([3010.0, 4.0, -3.0, -0.05, 0.02, 0.0, 1e-4, -5e-5, 1e-4, 2e-5])
SIZE = (3000, 2000)
MIDDLE = (np.array(SIZE) - 1) / 2
SIGMA_PX = 0.01
SIDE = range(20, 36)  # four coded targets (20 to 23) and plain ones


def pose_of(place: np.ndarray, towards: np.ndarray, roll: float) -> np.ndarray:
    z = (towards - place) / np.linalg.norm(towards - place)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    turn = Rotation.from_rotvec([0, 0, roll]).as_matrix() @ np.array([x, np.cross(z, x), z])
    return np.r_[Rotation.from_matrix(turn).as_rotvec(), place]


class Scene:
    """Two photographs (0, 1) show a side alone, two from one place (2, 3) also the rest."""

    def __init__(self, rng: np.random.Generator) -> None:
        middle = rng.uniform(-1, 1, (20, 3)) * [400.0, 300.0, 150.0]
        side = np.array([700.0, 0, 0]) + rng.uniform(-1, 1, (16, 3)) * [5.0, 300.0, 150.0]
        self.points = np.vstack([middle, side])
        far = [pose_of(np.array([2100.0, y, 300.0]), side.mean(axis=0), 0.1) for y in (-400, 500)]
        near = [
            pose_of(np.array([2400.0, y, 700.0]), np.array([300.0, 0, 0]), roll)
            for y, roll in ((0.0, 0.0), (110.0, 1.5))
        ]
        around = 2 * np.pi * np.arange(12) / 12
        rest = [
            pose_of(
                np.array([1300 * np.cos(a), 1300 * np.sin(a), 1200.0]), np.zeros(3), i % 4 * 1.5
            )
            for i, a in enumerate(around)
        ]
        self.poses = np.array([*far, *near, *rest])
        self.sightings: list[Sighting] = []
        dots: dict[int, list[PlainDot]] = {}
        for photo in range(len(self.poses)):
            shown = SIDE if photo < 2 else range(36) if photo < 4 else range(20)
            for point in shown:
                self._show(rng, dots, photo, point)
        self.dots = {photo: tuple(found) for photo, found in dots.items()}

    def _show(
        self, rng: np.random.Generator, dots: dict[int, list[PlainDot]], photo: int, point: int
    ) -> None:
        values = {"lens": LENS[None], "photos": self.poses, "points": self.points}
        at = evaluate_rays(values, np.array([photo]), np.array([point]), MIDDLE)[0][0]
        at = at + rng.normal(0, SIGMA_PX, 2)
        noise = SIGMA_PX**2 * np.eye(2)
        if point < 24:
            self.sightings.append(
                Sighting(photo=photo, point=point + 1, center_px=at, covariance_px2=noise)
            )
            return
        away = np.linalg.norm(self.points[point] - self.poses[photo, 3:])
        radius = 4.0 * LENS[0] / away
        dots.setdefault(photo, []).append(
            PlainDot(
                center_px=at, covariance_px2=noise, spread_px2=radius**2 * np.eye(2),
                diameter_px=2 * radius, contrast_dn=100.0, blur_px=0.7,
            )
        )  # fmt: skip

    def solved(self, sightings: list[Sighting]) -> Network:
        bars = [
            Bar(
                ends=(a + 1, b + 1),
                length_mm=float(np.linalg.norm(self.points[a] - self.points[b])),
                sigma_mm=0.002,
            )
            for a, b in ((0, 1), (2, 3))
        ]
        return solve_network(sightings, bars, 3010.0, SIZE, self.dots)


def test_photographs_with_three_targets_are_placed_by_dots_that_only_two_others_show() -> None:
    scene = Scene(np.random.default_rng(3))
    spoilt = [
        replace(s, center_px=s.center_px + [50.0, -30.0]) if (s.photo, s.point) == (2, 24) else s
        for s in scene.sightings
    ]
    network = scene.solved(spoilt)
    assert set(network.photos) == set(range(16))
    assert sum(n < 0 for n in network.points) == 12
    assert {21, 22, 23, 24} <= set(network.points)
    used = {(s.photo, s.point) for s, u in zip(network.sightings, network.used, strict=True) if u}
    assert (2, 24) not in used
    assert {(0, 24), (1, 24), (3, 24)} <= used
