"""Parts of a survey keep their laws: datum, noise, circles."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from omm_core.adjustment import rigid_directions
from omm_core.errors import MeasurementError
from omm_core.survey.camera_model import evaluate_rays
from omm_core.survey.circles import circles_of, eccentricities
from omm_core.survey.datum import frame_of_nominal, frame_of_three, free_frame
from omm_core.survey.noise import RayNoise, estimated
from omm_core.survey.sighting import Sighting


def free_covariance(points, rng):
    """A covariance (3n, 3n) in the free datum."""
    root = rng.normal(size=(3 * len(points), 3 * len(points)))
    full = root @ root.T * 1e-4
    g = rigid_directions(points)
    keep = np.eye(len(g)) - g @ np.linalg.pinv(g)
    return keep @ full @ keep


def length_variance(points, covariance, a, b):
    direction = (points[a] - points[b]) / np.linalg.norm(points[a] - points[b])
    row = np.zeros(3 * len(points))
    row[3 * a : 3 * a + 3], row[3 * b : 3 * b + 3] = direction, -direction
    return row @ covariance @ row


def test_a_datum_changes_no_length_and_nothing_that_is_known_of_it():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(8, 3)) * 300.0
    covariance = free_covariance(points, rng)
    turned = Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix()
    nominal, _ = frame_of_nominal(points, [1, 3, 5, 6], points[[1, 3, 5, 6]] @ turned.T + 70.0)
    for frame in (free_frame(points), frame_of_three(points, (2, 4, 6)), nominal):
        moved, after = frame.moved(points), frame.covariance(points, covariance)
        for a, b in ((0, 1), (2, 7), (4, 6)):
            assert np.linalg.norm(moved[a] - moved[b]) == pytest.approx(
                np.linalg.norm(points[a] - points[b])
            )
            assert length_variance(moved, after, a, b) == pytest.approx(
                length_variance(points, covariance, a, b)
            )


def test_three_targets_lie_where_the_datum_puts_them_without_variance():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(6, 3)) * 300.0
    frame = frame_of_three(points, (3, 0, 5))
    moved = frame.moved(points)
    assert moved[3] == pytest.approx([0, 0, 0], abs=1e-9)
    assert moved[0][1:] == pytest.approx([0, 0], abs=1e-9)
    assert moved[0][0] > 0
    assert moved[5][2] == pytest.approx(0, abs=1e-9)
    assert moved[5][1] > 0
    variance = np.diag(frame.covariance(points, free_covariance(points, rng))).reshape(-1, 3)
    assert variance[3] == pytest.approx([0, 0, 0], abs=1e-12)
    assert variance[0][1:] == pytest.approx([0, 0], abs=1e-12)
    assert variance[5][2] == pytest.approx(0, abs=1e-12)
    assert (variance[1] > 0).all()


def test_three_targets_on_a_line_are_no_datum():
    points = np.array([[0.0, 0, 0], [100, 0, 0], [200, 0.1, 0]])
    with pytest.raises(MeasurementError, match="line"):
        frame_of_three(points, (0, 1, 2))


def test_variance_components_are_found_again():
    rng = np.random.default_rng(3)
    m = 4000
    sigma = rng.uniform(0.003, 0.02, m)
    detector = sigma[:, None, None] ** 2 * np.eye(2)
    kinds = np.where(np.arange(m) % 2 == 0, "coded", "plain")
    scale, floor = np.where(kinds == "coded", 1.5, 0.8), np.where(kinds == "coded", 0.0, 0.01)
    free = rng.uniform(0.3, 0.9, (m, 2))
    spread = np.sqrt(free * (scale**2 * sigma**2 + floor**2)[:, None])
    noise = estimated(rng.normal(size=(m, 2)) * spread, free, detector, kinds, RayNoise())
    assert noise.of["coded"].scale == pytest.approx(1.5, rel=0.06)
    assert noise.of["coded"].floor_px < 0.004
    assert noise.of["plain"].scale == pytest.approx(0.8, rel=0.1)
    assert noise.of["plain"].floor_px == pytest.approx(0.01, rel=0.06)


def test_normal_and_diameter_come_out_of_ellipses_and_tell_the_shift_of_the_centre():
    place, normal = np.array([10.0, -20.0, 5.0]), np.array([0.3, -0.2, 0.9])
    normal /= np.linalg.norm(normal)
    lens = np.array([3000.0, 4.0, -3.0, -0.05, 0.02, 0.0, 1e-4, -5e-5, 0.0, 0.0])
    photos = []
    for around in (0.0, 1.6, 3.1, 4.5):
        at = place + 900.0 * np.array([0.6 * np.cos(around), 0.6 * np.sin(around), 0.8])
        z = (place + [30.0, 10.0, 0.0] - at) / 900.0
        z /= np.linalg.norm(z)
        x = np.cross(z, [0, 0, 1.0]) / np.linalg.norm(np.cross(z, [0, 0, 1.0]))
        turn = Rotation.from_matrix([x, np.cross(z, x), z]).as_rotvec()
        photos.append(np.r_[turn, at])
    values = {"lens": lens[None], "photos": np.array(photos), "points": place[None]}
    photo, point = np.arange(4), np.zeros(4, dtype=int)
    outlines = outline_pixels(values, normal, 6.0)
    centres = outlines.mean(axis=1)  # of 720 points: second harmonics are left to the shift
    spreads = [2.0 * np.cov(o.T, bias=True) for o in outlines]
    sightings = tuple(
        Sighting(
            photo=i, point=1, center_px=centres[i], covariance_px2=np.eye(2), spread_px2=spreads[i]
        )
        for i in range(4)
    )
    slopes = evaluate_rays(values, photo, point, np.zeros(2))[1]["points"]
    used = np.ones(4, dtype=bool)
    circle = circles_of(values, sightings, photo, point, used, slopes, {})[0]
    lens = values["lens"][0]
    assert circle.normal == pytest.approx(normal, abs=0.01)
    assert circle.diameter_mm == pytest.approx(12.0, rel=2e-3)
    shift = eccentricities(values, lens, photo, point, circle.normal[None], np.array([12.0]))
    straight = eccentricities(values, lens, photo, point, normal[None], np.array([12.0]))
    assert np.abs(straight).max() > 0.02
    assert shift == pytest.approx(straight, abs=0.05 * np.abs(straight).max())


def outline_pixels(values, normal, radius):
    from omm_core.survey.camera_model import lens_pixels

    across = np.cross(normal, [1.0, 0, 0])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, 2 * np.pi, 721)[:-1, None]
    ring = values["points"][0] + radius * (
        np.cos(angle) * across + np.sin(angle) * np.cross(normal, across)
    )
    turns = Rotation.from_rotvec(values["photos"][:, :3]).as_matrix()
    return np.array(
        [
            lens_pixels(values["lens"][0], (ring - pose[3:]) @ turn.T)
            for turn, pose in zip(turns, values["photos"], strict=True)
        ]
    )
