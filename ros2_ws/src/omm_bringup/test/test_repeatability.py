"""./omm repeatability: the table of 6D against 7D."""

import json

import numpy as np
import pytest

from omm_bringup.command_line import main


def table(capsys, tmp_path, *arguments):
    out = tmp_path / "out.json"
    assert main(["repeatability", "--fast", "--json", str(out), *arguments]) == 0
    return capsys.readouterr().out, json.loads(out.read_text())


def row(text, name):
    line = next(line for line in text.splitlines() if line.startswith(name))
    return [float(word) for word in line[len(name) :].split() if word != "–"]


def test_7d_takes_the_backlash_out_of_x_and_y_and_beats_the_paper_with_image_noise_alone(
    capsys, tmp_path
):
    text, _ = table(capsys, tmp_path, "--seed", "3", "--scenario", "ideal")
    six, seven, paper = row(text, "omm 6D"), row(text, "omm 7D"), row(text, "paper 7D")
    assert six[0] > 10 * seven[0]
    assert six[1] > 10 * seven[1]
    assert np.all(np.array(seven[:6]) < paper[:6])
    # 6D's x and y are the backlash times how far off the axis the targets are seen.
    assert 0.5 < six[0] / 0.136 < 2.0
    assert 0.5 < six[1] / 0.056 < 2.0


def test_on_a_machine_as_they_are_the_papers_table_3_comes_out_in_size(capsys, tmp_path):
    """Within a factor of 2 over many clampings; but for 6D's β (0.020 of 0.056) and 7D's γ."""
    text, _ = table(capsys, tmp_path, "--seed", "1", "--clampings", "60")
    factors = {
        name: np.exp(
            np.abs(np.log(np.array(row(text, f"omm {name}"))[:6] / row(text, f"paper {name}")[:6]))
        )
        for name in ("6D", "7D")
    }
    assert np.all(factors["6D"][[0, 1, 2, 3, 5]] < 2.0)
    assert np.all(factors["7D"][:5] < 2.0)
    assert factors["6D"][4] < 4.0
    assert factors["7D"][5] < 4.0
    assert row(text, "omm 7D")[6] == pytest.approx(3.84, rel=0.2)
    assert row(text, "6D / 7D")[0] > 3.0
    assert row(text, "6D / 7D")[1] > 1.5


def test_equal_seeds_give_equal_results(capsys, tmp_path):
    _, one = table(capsys, tmp_path, "--seed", "5", "--clampings", "3")
    _, other = table(capsys, tmp_path, "--seed", "5", "--clampings", "3")
    assert one == other


@pytest.mark.parametrize("bad", [["--clampings", "1"], ["--noise-px", "0"]])
def test_what_makes_no_sense_is_refused(bad):
    assert main(["repeatability", "--fast", *bad]) == 2
