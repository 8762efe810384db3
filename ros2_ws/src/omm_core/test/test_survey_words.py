"""What is told of a network is true, and a good network is told nothing."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_survey_network import LENS, SIGMA_PX, SIZE, bars_of

from omm_core.errors import MeasurementError
from omm_core.survey import Sighting, solve_network
from omm_core.survey.camera_model import evaluate_rays
from omm_core.survey.words import findings_of


def told(
    seed: int, *, away_mm: tuple[float, float], quarters: int, noise_px: float = SIGMA_PX
) -> str:
    """Return the findings of 18 photographs from a ring (radius, height) about 20 targets.

    They are turned about the lens's axis by `quarters` different quarters of a turn; from near the
    ring's middle all are held the same way, from farther away upright.
    """
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (20, 3)) * [400.0, 300.0, 150.0]
    radius, height = away_mm
    photos = []
    for i in range(18):
        around = 2 * np.pi * i / 18
        place = np.array([radius * np.cos(around), radius * np.sin(around), height + 100 * (i % 3)])
        z = -place / np.linalg.norm(place)
        x = np.array([1.0, 0, 0]) if radius < 400 else np.cross(z, [0, 0, 1.0])
        x -= z * (x @ z)
        x /= np.linalg.norm(x)
        roll = Rotation.from_rotvec([0, 0, np.pi / 2 * (i % quarters)]).as_matrix()
        turn = Rotation.from_matrix(roll @ np.array([x, np.cross(z, x), z]))
        photos.append(np.r_[turn.as_rotvec(), place])
    photo, point = (grid.ravel() for grid in np.mgrid[:18, :20])
    values = {"lens": LENS[None], "photos": np.array(photos), "points": points}
    pixels = evaluate_rays(values, photo, point, (np.array(SIZE) - 1) / 2)[0]
    pixels += rng.normal(0, noise_px, pixels.shape)
    sightings = [
        Sighting(photo=int(i), point=int(p), center_px=c, covariance_px2=SIGMA_PX**2 * np.eye(2))
        for i, p, c in zip(photo, point, pixels, strict=True)
    ]
    network = solve_network(sightings, bars_of(points), 3060.0, SIZE)
    return " ".join(findings_of(network, lambda n: f"p{n}", [3060.0]))


ASIDE, FACE_ON = (1300.0, 1100.0), (150.0, 1800.0)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("away_mm", [ASIDE, FACE_ON])
def test_one_roll_angle_is_told_from_aside_and_face_on_and_only_then(seed, away_mm):
    assert "same roll angle" in told(seed, away_mm=away_mm, quarters=1)
    assert "same roll angle" not in told(seed, away_mm=away_mm, quarters=4)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_weak_angles_are_told_and_nothing_of_a_good_network(seed):
    assert "Seen from nearly one side only" in told(seed, away_mm=FACE_ON, quarters=4)
    assert told(seed, away_mm=ASIDE, quarters=4) == ""


def test_rays_that_fit_far_worse_than_expected_are_told_first():
    assert told(1, away_mm=ASIDE, quarters=4, noise_px=3 * SIGMA_PX) == ""
    words = told(1, away_mm=ASIDE, quarters=4, noise_px=20 * SIGMA_PX)
    times = re.match(r"The rays fit (\S+) times worse", words)
    assert times
    assert float(times[1]) == pytest.approx(20, rel=0.1)


def test_photographs_that_do_not_fit_together_give_no_coordinates():
    with pytest.raises(MeasurementError, match=r"not fit together.*1\.[3-6] px.*number once"):
        told(1, away_mm=ASIDE, quarters=4, noise_px=1.6)
