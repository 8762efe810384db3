"""./omm repeatability: short for a campaign, whose tables are the paper's in size."""

import json

import numpy as np
import pytest

from omm_bringup.command_line import main

COLUMNS = ("x_mm", "y_mm", "z_mm", "alpha_mm_per_m", "beta_mm_per_m", "gamma_mm_per_m")
PAPER = {
    "table_2": (0.136, 0.056, 0.026, 0.039, 0.056, 0.070),
    "table_3": (0.032, 0.030, 0.020, 0.028, 0.024, 0.010),
}


def tables(tmp_path, *arguments):
    out = tmp_path / "out.json"
    assert main(["repeatability", "--fast", "--json", str(out), *arguments]) == 0
    return json.loads(out.read_text())


def row(found, name):
    return np.array([found[name][column] for column in COLUMNS])


def test_7d_takes_the_backlash_out_of_x_and_y_and_beats_the_paper_with_image_noise_alone(tmp_path):
    found = tables(tmp_path, "--seed", "3", "--scenario", "ideal")
    six, seven = row(found, "table_2"), row(found, "table_3")
    assert np.all(six[:2] > 10 * seven[:2])
    assert np.all(seven < PAPER["table_3"])
    # 6D's x and y are the backlash times how far off the axis the targets are seen.
    assert np.all(np.abs(np.log(six[:2] / PAPER["table_2"][:2])) < np.log(2.0))


def test_on_a_machine_as_they_are_the_papers_tables_come_out_in_size(tmp_path, capsys):
    """Within a factor of 2 over many clampings; but for 6D's β (0.020 of 0.056) and 7D's γ."""
    found = tables(tmp_path, "--seed", "1", "--clampings", "60")
    six, seven = (np.exp(np.abs(np.log(row(found, n) / PAPER[n]))) for n in PAPER)
    assert np.all(six[[0, 1, 2, 3, 5]] < 2.0)
    assert np.all(seven[:5] < 2.0)
    assert six[4] < 4.0
    assert seven[5] < 4.0
    assert found["table_3"]["gamma_s_mm_per_m"] == pytest.approx(3.84, rel=0.2)
    printed = capsys.readouterr().out
    line = next(line for line in printed.splitlines() if line.startswith("6D / 7D"))
    factors = [float(word) for word in line.split()[3:9]]
    assert factors == pytest.approx(row(found, "table_2") / row(found, "table_3"), abs=0.06)
    assert factors[0] > 3.0
    assert factors[1] > 1.5


def test_it_is_the_campaign_of_the_same_clampings(tmp_path):
    short = tables(tmp_path, "--seed", "5", "--clampings", "3")
    out = tmp_path / "campaign.json"
    words = ["--clampings", "3", "--seed", "5", "--jobs", "1", "--json", str(out)]
    assert main(["campaign", *words]) == 0
    assert json.loads(out.read_text()) == short


@pytest.mark.parametrize("bad", [["--clampings", "1"], ["--noise-px", "0"]])
def test_what_makes_no_sense_is_refused(bad):
    assert main(["repeatability", "--fast", *bad]) == 2
