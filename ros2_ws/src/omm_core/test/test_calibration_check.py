"""An old calibration on a new run: what holds passes, what changed is seen and named."""

import numpy as np
import pytest
from test_calibration_by_run import SENSOR, TRUTH, simulated

from omm_core.camera_calibration.check import check_calibration
from omm_core.camera_calibration.model import PARAMETERS
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration

SIGMA = np.array(
    [5e-4, 0.1, 0.1, 2e-11, 1e-17, 1e-9, 1e-9, 0.005, 0.005, 0.02, 4e-5, 4e-5, 4e-5]
)  # fmt: skip


def calibration(vector):
    return CameraCalibration(
        name="test",
        lens=SENSOR.lens(vector),
        taper_T_camera=RigidTransform.from_euler_xyz_rad(*vector[10:], vector[7:10]),
        parameters=PARAMETERS,
        covariance=np.diag(SIGMA**2),
    )


def check(seed, turns=(0.0, 90.0), **changes):
    seen, part, _ = simulated(seed, turns=turns, heights=(200, 400))
    camera = TRUTH + np.random.default_rng(5000 + seed).normal(0, 1, 13) * SIGMA
    for name, change in changes.items():
        camera[PARAMETERS.index(name)] += change
    return check_calibration(seen, part, calibration(camera))


def of(checked, name):
    return next(p for p in checked.parameters if p.name == name)


def test_a_calibration_that_holds_passes_with_evenly_spread_probabilities():
    checks = [check(seed) for seed in range(16)]
    assert all(c.holds for c in checks)
    # The mean of 16 evenly spread ones: 0.5 ± 0.07.
    assert 0.2 < np.mean([c.p_value for c in checks]) < 0.8


@pytest.mark.parametrize("name", ["focal_length_mm", "cl0_px", "alpha_rad", "x_mm", "k1_px2"])
def test_twice_what_is_told_as_detectable_is_seen_and_named(name):
    size = 2 * of(check(1), name).detectable
    for sign in (-1, 1):
        found = check(2, **{name: sign * size})
        assert not found.holds
        assert name in found.explained_by
        # The camera was given wrong by `size`, so it seems to have changed by `-size`.
        assert of(found, name).change == pytest.approx(-sign * size, rel=0.5)


def test_a_height_is_not_seen_and_a_place_across_only_with_a_turned_spindle():
    turned, straight = check(3), check(3, turns=(0.0,))
    assert not of(turned, "z_mm").seen
    assert of(turned, "x_mm").seen
    assert not of(straight, "x_mm").seen
    # What is not seen is told with what it would do.
    assert of(straight, "x_mm").moves_part_mm == pytest.approx(1.0, abs=1e-3)
    assert check(3, z_mm=5.0).holds


def test_another_camera_is_refused_in_words():
    found = check(4, focal_length_mm=3.0)
    assert not found.holds
    assert any("another camera" in words for words in found.findings)
    told = found.to_json_dict()
    assert told["holds"] is False
    assert {p["detectable"] for p in told["parameters"]} == {None}
