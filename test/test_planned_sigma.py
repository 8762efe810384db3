"""What is predicted for the stops of recorded runs is what an independent program says is ideal."""

import json

import numpy as np
import pytest
from whole_suite import SHARED

from omm_core.geometry import RigidTransform
from omm_core.planning.prediction import designs, own_covariances
from omm_core.planning.scene import AssumedNoise, Scene
from omm_core.planning.views import views
from omm_core.planning.wish import PlanWish, Yardstick
from omm_runs.solving import solve_run
from omm_simulation.scenario import load_scenario

RUNS = {"shop": (0.003, 0.015, 700.0), "shoplarge": (0.004, 0.030, 2000.0)}


@pytest.mark.parametrize("name", RUNS)
def test_predicted_own_sigma_is_the_ideal_one_of_the_truth(name):
    run = SHARED / "machines" / name
    if not run.is_dir():
        pytest.skip(f"the recorded run {name} is not on this machine")
    from omm_cnc_bridge.controls.simulated.control import machine_of

    solved = solve_run(run)
    observations = solved.result.solution.observations
    spindles = list({o.stamp_ns: o.machine_T_spindle for o in observations}.values())
    theta = solved.result.solution.theta
    stop, geometry, length = RUNS[name]
    scene = Scene(
        part=solved.part,
        calibration=solved.calibration,
        kinematics=machine_of(load_scenario("bench")),
        machine_T_part=RigidTransform.from_euler_xyz_rad(*theta[:3], theta[3:6]),
        noise=AssumedNoise(
            stop_sigma_mm=stop, geometry_sigma_mm=geometry, geometry_length_mm=length
        ),
        gamma_s_rad=float(theta[6]),
        play_mm=0.0,
    )
    made = designs(scene, spindles, views(scene, spindles))
    covariance = own_covariances(made, scene.noise, np.arange(len(spindles))[None])[0]
    predicted = Yardstick.of(scene, PlanWish()).theta_covariance(covariance)
    ideal = json.loads((run / "truth.json").read_text())["ideal_own_sigma"]
    assert np.sqrt(np.diag(predicted)) == pytest.approx(ideal, rel=0.005)
