"""A calibration's plan keeps its word: simulated, the set is as exact as predicted."""

import dataclasses

import numpy as np
import pytest
from planning_cells import kinematics
from test_calibration_by_run import NOMINAL, SENSOR, SIGMA_TARGET, TRUTH, simulated

from omm_core.camera_calibration.machine import calibrate_by_run
from omm_core.camera_calibration.model import PARAMETERS, project_with_derivatives
from omm_core.files.calibration_set import Touched
from omm_core.geometry import RigidTransform
from omm_core.imaging.calibration import CameraCalibration
from omm_core.imaging.circle import circle_points
from omm_core.machine.kinematics import Kinematics
from omm_core.machine.urdf import Joint
from omm_core.part_pose import Observation
from omm_core.planning.calibration_plan import (
    SIGMA_PX,
    CalibrationScene,
    plan_calibration,
    turning_axis,
)

PLATE = RigidTransform.from_euler_xyz_rad(0.0, 0.0, 0.0, (400.0, 250.0, 190.0))


def turning_kinematics() -> Kinematics:
    """Three linear axes and C about the spindle."""
    three = kinematics()
    links = (*three.robot.links, "head")
    joint = Joint(
        name="C", movable=True, rotary=True, parent="spindle", child="head",
        origin=np.eye(4), axis=np.array([0.0, 0.0, 1.0]), lower=-6.3, upper=6.3,
    )  # fmt: skip
    robot = dataclasses.replace(three.robot, links=links, joints=(*three.robot.joints, joint))
    return Kinematics(robot, spindle="head")


def scene(machine: Kinematics, touch_sigma_mm: float | None = 0.005) -> CalibrationScene:
    camera = CameraCalibration(
        name="test",
        lens=SENSOR.lens(TRUTH),
        taper_T_camera=RigidTransform.from_euler_xyz_rad(*TRUTH[10:], TRUTH[7:10]),
        covariance=np.zeros((0, 0)),
    )
    return CalibrationScene(
        plate=simulated(0)[1],
        machine_T_plate=PLATE,
        camera=camera,
        kinematics=machine,
        stop_sigma_mm=0.002,
        touch_sigma_mm=touch_sigma_mm,
    )


def test_the_predicted_sigma_is_that_of_the_set_as_it_is_taken():
    plan = plan_calibration(scene(turning_kinematics()), want_px=0.5)
    assert plan.reached
    rng = np.random.default_rng(4)
    true = NOMINAL + rng.normal(0, SIGMA_TARGET, NOMINAL.shape)
    seen = []
    for number, stop in enumerate(plan.stops):
        pose = stop.machine_T_spindle
        stood = pose.translation_mm + rng.normal(0, 0.002, 3)
        for target in stop.target_ids:
            circle = circle_points(true[target - 1][None], np.array([[0, 0, 1.0]]), np.array([6.0]))
            in_taper = (PLATE @ circle[0] - stood) @ pose.rotation
            pixel = project_with_derivatives(SENSOR, TRUTH, in_taper[None])[0][0]
            seen.append(
                Observation(
                    stamp_ns=number,
                    target_id=target,
                    center_px=pixel + rng.normal(0, SIGMA_PX, 2),
                    covariance_px2=SIGMA_PX**2 * np.eye(2),
                    machine_T_spindle=pose,
                )
            )
    height = float((PLATE @ true[plan.touch - 1])[2]) + rng.normal(0, 0.005)
    touched = Touched(target=plan.touch, z_mm=height, sigma_mm=0.005)
    result = calibrate_by_run(
        SENSOR, seen, scene(turning_kinematics()).plate, machine_sigma_mm=0.002, touched=touched
    )
    taken = np.sqrt(np.diag(result.covariance)) / max(result.sigma0, 1.0)
    assert taken == pytest.approx(plan.sigma, rel=0.05)
    assert np.abs((result.camera - TRUTH) / taken).max() < 4.5


def test_a_higher_wish_takes_more_images_and_the_highest_is_told_as_not_reached():
    modest = plan_calibration(scene(turning_kinematics()), want_px=0.5)
    better = plan_calibration(scene(turning_kinematics()), want_px=modest.projection_px[1] * 0.8)
    beyond = plan_calibration(scene(turning_kinematics()), want_px=1e-6)
    assert len(modest.stops) < len(better.stops)
    assert better.projection_px[1] <= modest.projection_px[1] * 0.8
    assert not beyond.reached


def test_a_spindle_that_cannot_turn_leaves_the_place_across_open_and_says_so():
    assert turning_axis(kinematics()) is None
    plan = plan_calibration(scene(kinematics(), touch_sigma_mm=None), want_px=0.5)
    assert plan.undetermined == ("x_mm", "y_mm", "z_mm")
    assert np.isnan(plan.sigma[[PARAMETERS.index(n) for n in plan.undetermined]]).all()
    assert any("turns the spindle" in words for words in plan.findings)
    assert any("touched height" in words for words in plan.findings)


def test_every_stop_is_within_the_limits_and_looks_at_the_plate():
    machine = turning_kinematics()
    for stop in plan_calibration(scene(machine), want_px=1e-6).stops:
        assert machine.out_of_limits(stop.axes) == ()
        assert len(stop.target_ids) >= 3
