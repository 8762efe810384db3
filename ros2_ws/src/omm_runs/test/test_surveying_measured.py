"""An export of AICON's is adjusted to what AICON's own report says of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from omm_core.errors import InputError
from omm_core.files.aicon import load_aicon
from omm_core.survey.aicon import adjust_aicon
from omm_runs.surveying_measured import left_out_words, survey_measured

SET = Path(__file__).parents[4] / ".." / "shared" / "data" / "survey" / "aicon_network"
needs_set = pytest.mark.skipif(not SET.is_dir(), reason="the data beside the project is missing")


@needs_set
def test_sigma0_redundancy_and_standard_deviations_are_those_of_the_report():
    found = adjust_aicon(load_aicon(SET))
    assert found.solution.degrees_of_freedom == 18804
    assert found.sigma0_mm == pytest.approx(0.4056e-3, abs=0.0005e-3)
    lens = np.sqrt(np.diag(found.covariance_of("lens")))[[0, 1, 2, 3, 4, 6, 7]]
    reported = [2.513178e-4, 3.441658e-4, 3.262600e-4, 2.978787e-8, 7.655524e-11, 1.190972e-7]
    assert lens == pytest.approx([*reported, 1.043919e-7], rel=2e-3)
    first = np.sqrt(np.diag(found.covariance_of("photos")))[3:6]
    assert first == pytest.approx([0.0163, 0.0275, 0.0214], abs=0.0001)


@needs_set
def test_points_have_the_standard_deviations_of_the_report_and_the_bar_has_its_length():
    result = survey_measured(SET)
    rows = [line.split() for line in (SET / "example.obc").read_text().splitlines()]
    reported = {int(r[0]): (np.array(r[1:4], float), np.array(r[4:7], float)) for r in rows}
    assert len(result["points"]) == 150
    for point in result["points"]:
        place, sigma = reported[point["id"]]
        assert np.sqrt(np.diag(point["covariance_mm2"])) == pytest.approx(sigma, abs=0.00032)
        assert point["xyz_mm"] == pytest.approx(place, abs=0.006)
    (bar,) = result["scale_bars"]
    assert bar["measured_mm"] == pytest.approx(bar["length_mm"], abs=1e-5)


@needs_set
def test_blunders_moved_targets_and_swapped_numbers_are_left_out_named_and_harm_no_other():
    network = load_aicon(SET)
    clean = adjust_aicon(network)
    rng = np.random.default_rng(3)
    bad = rng.random(len(network.point)) < 0.05
    measured = network.measured_mm.copy()
    measured[bad] += rng.choice([-1, 1], (bad.sum(), 2)) * 10.0 ** rng.uniform(
        -2, 0, (bad.sum(), 1)
    )
    moved = (network.point == 25) & (network.image > 60)
    measured[moved] += [0.02, 0.01]
    point, early = network.point.copy(), network.image < 12
    point[early & (network.point == 36)], point[early & (network.point == 38)] = 38, 36
    swapped = point != network.point
    spoilt = replace(network, measured_mm=measured, point=point)
    found = adjust_aicon(spoilt)
    assert np.sum(~found.used != (bad | moved | swapped)) <= 3  # of 9972
    words = left_out_words(spoilt, found)
    assert any(w.startswith("Target 25: ") for w in words)
    sigma = np.sqrt(np.diag(clean.covariance_of("points"))).reshape(-1, 3)
    away = np.abs(found.solution.values["points"] - clean.solution.values["points"]) / sigma
    assert np.sqrt(np.mean(away**2)) < 0.3
    assert found.sigma0_mm == pytest.approx(clean.sigma0_mm, rel=0.02)


def test_a_file_that_is_cut_is_refused(tmp_path):
    for suffix, text in (
        (".phc", "1 6 7.1 3.5\n"), (".obc", "6 1 2 3\n"), (".eor", "1 1 1 2 3 0 0 0\n"),
        (".ior", "1 2 3\n"), (".scale", ""),
    ):  # fmt: skip
        (tmp_path / f"net{suffix}").write_text(text)
    with pytest.raises(InputError, match="columns"):
        load_aicon(tmp_path)
