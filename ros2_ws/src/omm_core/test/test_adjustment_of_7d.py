"""The general adjustment and the fast 7D solver are the same on the 7D problem."""

import numpy as np
import pytest
from core_cells import EXACT_MACHINE
from test_calibration_by_run import SENSOR, TRUTH, simulated

from omm_core.adjustment import Block, Group, Problem, solve
from omm_core.camera_calibration.model import (
    project_with_derivatives,
    rotation_derivatives,
    skew,
)
from omm_core.geometry import RigidTransform, holder_rotation, rotation_from_euler_xyz_rad
from omm_core.imaging.calibration import CameraCalibration
from omm_core.imaging.circle import circle_points
from omm_core.part_pose import SolveOptions
from omm_core.part_pose import solve as solve_7d


def test_theta_and_covariance_are_those_of_the_7d_solver():
    seen, part, _ = simulated(11, turns=(0.0, 90.0), heights=(300,))
    seen = sorted(seen, key=lambda o: (o.stamp_ns, o.target_id))
    calibration = CameraCalibration(
        name="test",
        lens=SENSOR.lens(TRUTH),
        taper_T_camera=RigidTransform.from_euler_xyz_rad(*TRUTH[10:], TRUTH[7:10]),
        covariance=np.zeros((0, 0)),
    )
    options = SolveOptions(use_target_sigma=False, find_errors=False, **EXACT_MACHINE)
    fast = solve_7d(seen, part, calibration, options)

    targets = [part.target(o.target_id) for o in seen]
    outlines = circle_points(
        np.array([t.xyz_mm for t in targets]),
        np.array([t.normal for t in targets]),
        np.array([t.dot_diameter_mm for t in targets]),
    )
    spindle_R = np.array([o.machine_T_spindle.rotation for o in seen])
    spindle_d = np.array([o.machine_T_spindle.translation_mm for o in seen])

    def evaluate(values):
        theta = values["theta"][0]
        rotation, holder = rotation_from_euler_xyz_rad(*theta[:3]), holder_rotation(theta[6])
        from_spindle = outlines @ rotation.T + theta[3:6] - spindle_d[:, None]
        in_taper = from_spindle @ spindle_R @ holder
        centres, _, by_outline = project_with_derivatives(SENSOR, TRUTH, in_taper)
        by_machine = by_outline @ holder.T @ np.swapaxes(spindle_R, 1, 2)[:, None]
        turned = np.stack([outlines @ d.T for d in rotation_derivatives(theta[:3])], axis=-1)
        clamped = in_taper @ skew(np.array([0.0, 0.0, 1.0])).T
        by_theta = np.concatenate(
            [
                np.einsum("nkij,nkja->nia", by_machine, turned),
                by_machine.sum(axis=1),
                np.einsum("nkij,nkj->ni", by_outline, clamped)[:, :, None],
            ],
            axis=2,
        )
        return centres, {"theta": by_theta}

    block = Block(
        name="pixels",
        observed=np.array([o.center_px for o in seen]),
        covariance=np.array([o.covariance_px2 for o in seen]),
        index={"theta": np.zeros(len(seen), dtype=int)},
        evaluate=evaluate,
    )
    start = np.array([0.0, 0.0, 0.4, 400.0, 250.0, 190.0, 0.0])[None]
    general = solve(
        Problem(groups=(Group(name="theta", values=start),), blocks=(block,)), tolerance=1e-9
    )
    sigma = np.sqrt(np.diag(general.covariance))
    covariance = fast.covariance / fast.covariance_factor
    assert np.abs(general.values["theta"][0] - fast.theta).max() < 1e-9  # mm, rad
    scaled = (general.covariance - covariance) / np.outer(sigma, sigma)
    assert np.abs(scaled).max() < 1e-9
    assert general.sigma0 == pytest.approx(fast.sigma0, rel=1e-9)
