"""A calibration that is used outside its set's range is told so, with the result."""

import dataclasses

import numpy as np
import pytest
from core_cells import EXACT_MACHINE
from test_calibration_by_run import TRUTH, simulated
from test_calibration_check import calibration

from omm_core.imaging.calibration import Covered
from omm_core.part_pose import SolveOptions, solve
from omm_core.session.extrapolation import extrapolation_words


@pytest.fixture(scope="module")
def solved():
    seen, part, _ = simulated(11, turns=(0.0, 90.0), heights=(300,))
    options = SolveOptions(use_target_sigma=False, find_errors=False, **EXACT_MACHINE)
    return solve(seen, part, calibration(TRUTH), options), part


def words(solved, distance_mm, low_px=(100.0, 100.0), high_px=(2492.0, 1844.0)):
    solution, part = solved
    covered = Covered(distance_mm=distance_mm, low_px=low_px, high_px=high_px)
    camera = dataclasses.replace(calibration(TRUTH), covered=covered)
    return extrapolation_words(solution, part, camera)


def test_within_what_was_covered_nothing_is_said(solved):
    assert words(solved, (250.0, 310.0)) == ()
    solution, part = solved
    assert extrapolation_words(solution, part, calibration(TRUTH)) == ()


def test_targets_beyond_the_distances_of_the_set_are_told(solved):
    # The plate is 300 mm before the camera, every second target 20 mm nearer.
    (told,) = words(solved, (400.0, 600.0))
    assert told.startswith("the targets were 279 to 301 mm")
    assert "covers 400 to 600 mm" in told


def test_targets_nearer_to_the_edge_than_the_set_are_told(solved):
    (told,) = words(solved, (250.0, 310.0), low_px=(900.0, 700.0), high_px=(1600.0, 1200.0))
    assert "nearer to the image's edge" in told
    assert np.unique(solved[0].used).tolist() == [True]
