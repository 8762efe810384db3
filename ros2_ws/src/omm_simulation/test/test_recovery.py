"""The estimator, given the messages of a simulated run and nothing else, finds its truth."""

import numpy as np
import pytest

from omm_core.files.part import load_part
from omm_core.imaging.calibration import load_calibration
from omm_core.session.measurement import Measurement
from omm_simulation.cell import draw, write_estimator_files
from omm_simulation.offline import ImageMessage, run
from omm_simulation.scenario import load_scenario


@pytest.mark.parametrize(("name", "seed"), [("bench", 7), ("industrial", 3)])
def test_the_truth_is_found_within_four_standard_deviations(tmp_path, name, seed):
    cell = draw(load_scenario(name), seed)
    part_file, calibration_file = write_estimator_files(cell, tmp_path)
    measurement = Measurement(load_part(part_file), load_calibration(calibration_file))
    for message in run(cell):
        if isinstance(message, ImageMessage):
            measurement.add_image(message.stamp_ns, message.image)
        else:
            measurement.add_pose(message.stamp_ns, message.machine_T_spindle)
    result = measurement.result()
    assert [image.reason for image in result.images if not image.used] == []
    theta = np.array(result.solution.theta)
    sigma = np.sqrt(np.diag(result.solution.covariance))
    truth = np.array(list(cell.theta().values()))
    assert np.abs((theta - truth) / sigma).max() < 4.0
    assert sigma[3:6].max() < 0.002  # mm, so that the line above says something
