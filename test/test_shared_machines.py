"""Runs on machines that are not exact, of an independent program: U is believable, and not wide."""

import json

import numpy as np
import pytest
from whole_suite import shared_data

from omm_core.part_pose import THETA_NAMES
from omm_runs.solving import SolvedRun, solve_run

RUNS = ("machines/shop", "machines/shoplarge")


@pytest.fixture(scope="module")
def solved() -> dict[str, tuple[SolvedRun, dict[str, dict[str, float]]]]:
    """Both runs with their truths; with nothing about the machine declared."""
    folders = {name: shared_data(name) for name in RUNS}
    return {
        name: (solve_run(folder), json.loads((folder / "truth.json").read_text()))
        for name, folder in folders.items()
    }


def test_the_errors_are_inside_u_in_own_coordinates(solved) -> None:
    ratios = np.concatenate(
        [
            np.abs(run.result.solution.theta - [truth["theta_own"][n] for n in THETA_NAMES])
            / run.result.solution.expanded_uncertainty
            for run, truth in solved.values()
        ]
    )
    assert np.count_nonzero(ratios <= 1.0) >= 12
    assert ratios.max() <= 1.5


def test_u_is_at_most_two_and_a_half_times_that_of_a_solver_that_knows_all_noise(solved) -> None:
    for run, truth in solved.values():
        ideal = 2.0 * np.array(truth["ideal_own_sigma"])
        assert np.all(run.result.solution.expanded_uncertainty <= 2.5 * ideal)


def test_nothing_is_refused_and_the_words_name_noise_and_source(solved) -> None:
    for run, _ in solved.values():
        assert all(image.used for image in run.result.images)
        assert run.result.findings == ()
        words = " ".join(run.result.solution.remarks)
        assert "stops" in words
        assert "targets' coordinates: measure more targets, or know them better" in words
        assert "in the machine's own coordinates" in words
