"""Calibration in the machine: the truth is found, and what the set leaves open is told."""

import dataclasses

import numpy as np
import pytest

from omm_core.camera_calibration.machine import calibrate_by_run
from omm_core.camera_calibration.model import PARAMETERS, Sensor, project_with_derivatives
from omm_core.errors import InputError, MeasurementError
from omm_core.files.calibration_set import Touched
from omm_core.files.part import Part, Target
from omm_core.geometry import RigidTransform
from omm_core.imaging.circle import circle_points
from omm_core.part_pose import Observation

SENSOR = Sensor(name="test", width_px=2592, height_px=1944, pixel_size_mm=0.0022)
TRUTH = np.array(
    [6.189, -8.732, 27.52, 2.997e-8, -1.937e-15, -6.188e-8, 3.408e-7,
     -2.139, 0.301, -320.2, np.pi - 0.003, -0.009, 0.03]
)  # fmt: skip
NOMINAL = np.array(
    [[x, y, 20.0 * ((i + j) % 2)]
     for i, x in enumerate((-120, -40, 40, 120)) for j, y in enumerate((-75, 0, 75))]
)  # fmt: skip
MACHINE_T_PLATE = RigidTransform.from_euler_xyz_rad(0.004, -0.003, 0.4, (400.0, 250.0, 190.0))
SIGMA_PX, SIGMA_TARGET, SIGMA_STOP = 0.02, 0.03, 0.002
Z = PARAMETERS.index("z_mm")


def simulated(
    seed,
    turns=(0.0, 90.0, 180.0, 270.0),
    heights=(170, 300, 450),
    sides=(-1, 1),
    nominal=NOMINAL,
    place=None,
    tilt=0.0,
):
    """A run over a plate; returns observations, the nominal part, the true height of target 1."""
    rng = np.random.default_rng(seed)
    true = nominal + rng.normal(0, SIGMA_TARGET, nominal.shape)
    centre = MACHINE_T_PLATE @ np.zeros(3)
    stands = RigidTransform.from_euler_xyz_rad(
        *MACHINE_T_PLATE.euler_xyz_rad(), centre if place is None else place
    )
    seen = []
    for number, (turn, height, side) in enumerate(
        (t, h, s) for h in heights for t in turns for s in sides
    ):
        told = RigidTransform.from_euler_xyz_rad(
            0.0, 0.0, np.radians(turn), centre + [30 * side, -20 * side, height + 320]
        )
        if tilt:
            lean = RigidTransform.from_euler_xyz_rad(*rng.uniform(-tilt, tilt, 2), 0.0)
            nose = told.translation_mm - centre
            told = RigidTransform(
                rotation=lean.rotation @ told.rotation,
                translation_mm=centre + lean.rotation @ nose,
            )
        stood = told.translation_mm + rng.normal(0, SIGMA_STOP, 3)
        for target, point in enumerate(true, start=1):
            outline = circle_points(point[None], np.array([[0, 0, 1.0]]), np.array([6.0]))[0]
            in_taper = (stands @ outline - stood) @ told.rotation
            pixel = project_with_derivatives(SENSOR, TRUTH, in_taper[None])[0][0]
            if np.isfinite(pixel).all() and np.all((pixel > 30) & (pixel < [2560, 1910])):
                seen.append(
                    Observation(
                        stamp_ns=number,
                        target_id=target,
                        center_px=pixel + rng.normal(0, SIGMA_PX, 2),
                        covariance_px2=SIGMA_PX**2 * np.eye(2),
                        machine_T_spindle=told,
                    )
                )
    part = Part(
        name="plate",
        target_family="metashape12",
        targets=tuple(
            Target(
                id=i,
                xyz_mm=xyz,
                dot_diameter_mm=6.0,
                normal=np.array([0.0, 0.0, 1.0]),
                sigma_xyz_mm=np.full(3, SIGMA_TARGET),
            )
            for i, xyz in enumerate(nominal, start=1)
        ),
    )
    return seen, part, float((MACHINE_T_PLATE @ true[0])[2])


def calibrate(seed, *, touched=True, **choices):
    seen, part, height = simulated(seed, **choices)
    probed = height + np.random.default_rng(1000 + seed).normal(0, 0.005)
    touch = Touched(target=1, z_mm=probed, sigma_mm=0.005) if touched else None
    return calibrate_by_run(SENSOR, seen, part, machine_sigma_mm=SIGMA_STOP, touched=touch)


def test_squared_errors_over_the_covariance_are_as_promised():
    squares = []
    for seed in range(4):
        result = calibrate(seed)
        assert result.undetermined == ()
        error = result.camera - TRUTH
        covariance = result.covariance / max(result.sigma0, 1.0) ** 2
        squares.append(error @ np.linalg.solve(covariance, error))
    assert 3.0 < np.mean(squares) < 26.0  # 13 ± 2.5, more than 4 sigma either way
    assert result.sigma0 == pytest.approx(1.0, abs=0.2)


def test_without_a_touched_height_z_is_undetermined_and_the_rest_is_not():
    with_height, without = calibrate(7), calibrate(7, touched=False)
    assert without.undetermined == ("z_mm",)
    assert any("z_mm is undetermined" in words for words in without.findings)
    assert np.sqrt(without.covariance[Z, Z]) > 100
    others = np.arange(13) != Z
    sigma = np.sqrt(np.diag(with_height.covariance))[others]
    assert np.sqrt(np.diag(without.covariance))[others] == pytest.approx(sigma, rel=0.05)
    difference = (without.camera - with_height.camera)[others]
    assert np.abs(difference / sigma).max() < 0.5


def test_a_coarse_touch_gives_the_height_its_sigma_and_bends_nothing_else():
    seen, part, height = simulated(7)
    fine, coarse = (
        calibrate_by_run(
            SENSOR,
            seen,
            part,
            machine_sigma_mm=SIGMA_STOP,
            touched=Touched(target=1, z_mm=height + off, sigma_mm=sigma),
        )
        for off, sigma in ((0.0, 0.005), (4.0, 5.0))
    )
    assert coarse.undetermined == ()
    assert coarse.sigma0 == pytest.approx(fine.sigma0, abs=0.01)
    factor = max(coarse.sigma0, 1.0)
    assert np.sqrt(coarse.covariance[Z, Z]) == pytest.approx(5.0 * factor, rel=0.01)
    assert coarse.camera[Z] - fine.camera[Z] == pytest.approx(4.0, abs=0.1)
    others = np.arange(13) != Z
    sigma = np.sqrt(np.diag(fine.covariance))[others]
    assert np.sqrt(np.diag(coarse.covariance))[others] == pytest.approx(sigma, rel=0.02)
    assert np.abs((coarse.camera - fine.camera)[others] / sigma).max() < 0.1


def test_a_spindle_that_does_not_turn_leaves_the_place_across_open():
    result = calibrate(3, turns=(0.0,), touched=True)
    assert {"x_mm", "y_mm"} <= set(result.undetermined)
    assert "gamma_rad" not in result.undetermined
    f = result.camera[0] - TRUTH[0]
    assert abs(f) < 5 * np.sqrt(result.covariance[0, 0])


def test_a_spindle_that_tilts_gives_the_height_without_a_touch():
    result = calibrate(5, touched=False, tilt=0.2)
    assert result.undetermined == ()
    assert result.sigma0 == pytest.approx(1.0, abs=0.2)
    sigma = np.sqrt(np.diag(result.covariance))
    assert sigma[Z] < 0.5
    assert np.abs((result.camera - TRUTH) / sigma).max() < 4.5


def test_one_height_over_a_flat_plate_leaves_focal_length_and_height_open_together():
    with pytest.raises(MeasurementError, match=r"open: z_mm \(with focal_length_mm"):
        calibrate(4, heights=(300,), nominal=NOMINAL * [1, 1, 0])


def test_from_one_place_only_the_roll_is_open():
    # A turn of the camera about the spindle's axis is then one of the plate.
    with pytest.raises(MeasurementError, match=r"1 direction .*open: gamma_rad\."):
        calibrate(4, heights=(300,), sides=(0,))


def test_what_is_assumed_is_the_hint_where_there_is_one():
    seen, part, _ = simulated(7)
    hint = TRUTH.copy()
    hint[Z] = -315.0
    result = calibrate_by_run(SENSOR, seen, part, machine_sigma_mm=SIGMA_STOP, hint=hint)
    assert result.camera[Z] == -315.0
    assert np.sqrt(result.covariance[Z, Z]) == pytest.approx(10.0, rel=1e-3)


def displaced(seen, pixels, of):
    return [dataclasses.replace(o, center_px=o.center_px + pixels(o)) if of(o) else o for o in seen]


def test_a_plate_that_moved_is_refused_with_the_image_and_the_way():
    before, part, _ = simulated(2)
    after, _, _ = simulated(2, place=(400.03, 250.0, 190.0))
    seen = [o for o in before if o.stamp_ns < 15] + [o for o in after if o.stamp_ns >= 15]
    with pytest.raises(MeasurementError, match=r"moved between image 14 and image 15 .* 0\.03"):
        calibrate_by_run(SENSOR, seen, part, machine_sigma_mm=SIGMA_STOP)


def test_an_image_that_is_not_of_the_set_and_single_dots_are_left_out_and_named():
    seen, part, height = simulated(2)
    rng = np.random.default_rng(5)
    seen = displaced(seen, lambda o: rng.normal(0, 300, 2), lambda o: o.stamp_ns == 9)
    one = next(o.target_id for o in seen if o.stamp_ns == 20)
    seen = displaced(
        seen, lambda o: np.array([1.0, -0.5]), lambda o: (o.stamp_ns, o.target_id) == (20, one)
    )
    touch = Touched(target=1, z_mm=height, sigma_mm=0.005)
    result = calibrate_by_run(SENSOR, seen, part, machine_sigma_mm=SIGMA_STOP, touched=touch)
    left_out = [o for o in result.observations if o.reason]
    assert {o.image for o in left_out} == {"9", "20"}
    assert any("image 9 is not of the set" in words for words in result.findings)
    assert any(f"target {one} in image 20" in words for words in result.findings)
    error = result.camera - TRUTH
    assert np.abs(error / np.sqrt(np.diag(result.covariance))).max() < 4.5


def test_a_touched_target_that_is_not_seen_is_refused():
    seen, part, _ = simulated(1)
    with pytest.raises(InputError, match="touched target"):
        calibrate_by_run(
            SENSOR,
            seen,
            part,
            machine_sigma_mm=0.002,
            touched=Touched(target=77, z_mm=0.0, sigma_mm=0.005),
        )


def test_too_few_images_are_told():
    seen, part, _ = simulated(1)
    with pytest.raises(MeasurementError, match="at least 3 images"):
        calibrate_by_run(SENSOR, [o for o in seen if o.stamp_ns < 2], part, machine_sigma_mm=0.002)


@pytest.mark.parametrize("sigma_mm", [0.005, 5.0])
def test_a_touch_across_a_horizontal_spindle_does_not_give_z(sigma_mm):
    """Which goes with the plate's distance along the spindle's axis, and that was not touched."""
    seen, part, _ = simulated(3)
    lying = RigidTransform.from_euler_xyz_rad(np.pi / 2, 0.0, 0.0)
    turned = [dataclasses.replace(o, machine_T_spindle=lying @ o.machine_T_spindle) for o in seen]
    true = NOMINAL[0] + np.random.default_rng(3).normal(0, SIGMA_TARGET, NOMINAL.shape)[0]
    height = (lying @ (MACHINE_T_PLATE @ true))[2]
    touch = Touched(target=1, z_mm=float(height), sigma_mm=sigma_mm)
    result = calibrate_by_run(SENSOR, turned, part, machine_sigma_mm=SIGMA_STOP, touched=touch)
    assert result.undetermined == ("z_mm",)
    assert np.sqrt(result.covariance[Z, Z]) > 400.0
    assert result.sigma0 == pytest.approx(1.0, abs=0.2)
