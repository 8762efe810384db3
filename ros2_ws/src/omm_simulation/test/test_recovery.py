"""The estimator, given the messages of a simulated run and nothing else, finds its truth."""

import dataclasses

import numpy as np
import pytest

from omm_core.files.part import load_part
from omm_core.imaging.calibration import load_calibration
from omm_core.session.measurement import Measurement
from omm_simulation.cell import draw, write_estimator_files
from omm_simulation.machine_errors import MachineErrors
from omm_simulation.offline import ImageMessage, run
from omm_simulation.scenario import load_scenario


def measured(cell, tmp_path):
    part_file, calibration_file = write_estimator_files(cell, tmp_path)
    measurement = Measurement(load_part(part_file), load_calibration(calibration_file))
    for message in run(cell):
        if isinstance(message, ImageMessage):
            measurement.add_image(message.stamp_ns, message.image)
        else:
            measurement.add_pose(message.stamp_ns, message.machine_T_spindle)
    result = measurement.result()
    assert [image.reason for image in result.images if not image.used] == []
    return result.solution


@pytest.mark.parametrize(("name", "seed"), [("bench", 7), ("industrial", 3)])
def test_on_an_exact_machine_the_truth_is_found_to_micrometres(tmp_path, name, seed):
    scenario = load_scenario(name)
    exact = dataclasses.replace(
        scenario,
        errors=MachineErrors(),
        calibration=dataclasses.replace(
            scenario.calibration, parameters=(), covariance=np.zeros((0, 0))
        ),
    )
    cell = draw(exact, seed)
    solution = measured(cell, tmp_path)
    error = solution.theta - np.array(list(cell.theta().values()))
    sigma = np.sqrt(np.diag(solution.covariance))
    assert np.abs(error / sigma).max() < 4.0
    assert np.abs(error[3:6]).max() < 0.01


@pytest.mark.parametrize(("name", "seed"), [("ideal", 7), ("bench", 7), ("industrial", 3)])
def test_the_own_truth_is_found_within_twice_u(tmp_path, name, seed):
    cell = draw(load_scenario(name), seed)
    solution = measured(cell, tmp_path)
    truth = np.array(list(cell.theta_own().values()))
    assert np.all(np.abs(solution.theta - truth) < 2.0 * solution.expanded_uncertainty)
    assert solution.expanded_uncertainty[3:6].max() < (0.01 if name == "ideal" else 0.3)
