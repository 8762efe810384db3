"""survey.yaml: what could be meant otherwise is refused in words, bars are as long as they are."""

import pytest

from omm_core.errors import InputError
from omm_core.files.survey import load_survey

BAR = "ends: [1, 2], length_mm: 1000.0, sigma_mm: 0.004"


def loaded(folder, *lines):
    (folder / "A.JPG").touch()
    written = "\n".join(["photos: '*.JPG'", "target_family: aicon12", *lines])
    (folder / "survey.yaml").write_text(written + "\n")
    return load_survey(folder)


def test_a_warm_bar_is_longer_and_less_well_known(tmp_path):
    warm = "temperature_C: 24.5, temperature_sigma_K: 0.5, expansion_per_K: 11.5e-6"
    bar = loaded(tmp_path, f"scale_bars: [{{{BAR}, {warm}, calibrated_at_C: 20.5}}]").scale_bars[0]
    assert bar.length_mm == pytest.approx(1000.0 + 1000.0 * 11.5e-6 * 4.0, abs=1e-9)
    assert bar.sigma_mm == pytest.approx((0.004**2 + (1000.0 * 11.5e-6 * 0.5) ** 2) ** 0.5)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (f"scale_bars: [{{{BAR}, temperature_C: 24, expansion_per_K: 11.5}}]", "steel.s, 11.5e-6"),
        (
            "datum: {three_targets: [1, 2, 3], nominal: {1: [0, 0, 0]}}",
            "three_targets or nominal, got both",
        ),
        ("leave_out: 'a.jpg'", "Capitals count: there is A.JPG"),
    ],
)
def test_what_would_be_overlooked_in_silence_is_refused(tmp_path, lines, words):
    with pytest.raises(InputError, match=words):
        loaded(tmp_path, lines)


@pytest.mark.parametrize("told", ["expansion_per_K: 1.1e-5", "temperature_sigma_K: 1"])
def test_a_bar_without_a_temperature_is_told_so_and_taken_as_declared(tmp_path, capsys, told):
    survey = loaded(tmp_path, f"scale_bars: [{{{BAR}, {told}}}]")
    assert (survey.scale_bars[0].length_mm, survey.scale_bars[0].sigma_mm) == (1000.0, 0.004)
    assert f"{told.split(':')[0]} changes nothing without temperature_C" in capsys.readouterr().err
