"""./omm handover: what it accepts, what it refuses, and that a refusal writes nothing."""

from pathlib import Path

import pytest

from omm_bringup.command_line import main

FLAT = ["--theta", "0", "-0", "-4.0e-3", "-8.12345e2", "-410.25", "1E2"]
TILTED = ["--theta", "2e-3", "-3e-3", "4e-3", "812.345", "-410.25", "155.02"]


def _handover(*arguments: str) -> int:
    try:
        return main(["handover", *arguments])
    except SystemExit as end:  # the command line's own refusal
        return int(end.code or 0)


def test_negative_numbers_and_exponents_are_numbers(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert _handover(*FLAT, "--control", "siemens", "--offset", "G599") == 0
    said = capsys.readouterr().out
    assert "$P_UIFR[99] = CTRANS(X,-812.345000,Y,-410.250000,Z,100.000000)" in said
    assert "assumed 0 to 1000 mm" in said


def test_a_tilt_that_linuxcnc_cannot_say_writes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "part.ngc"
    assert _handover(*TILTED, "--control", "linuxcnc", "--out", str(out)) == 1
    assert list(tmp_path.iterdir()) == []
    assert _handover(*TILTED, "--control", "linuxcnc", "--remaining", "5", "--out", str(out)) == 0
    assert "G10 L2 P1 " in out.read_text()


@pytest.mark.parametrize(
    "more",
    [
        ["--control", "siemens", "--offset", "G58"],
        ["--control", "mazak"],
        ["--control", "fanuc", "--remaining", "-1"],
        ["--control", "fanuc", "--part", "missing.yaml"],
        ["run.mcap", "--control", "fanuc"],
    ],
)
def test_bad_input_is_status_2_and_writes_nothing(more: list[str], tmp_path: Path) -> None:
    out = tmp_path / "part.ngc"
    assert _handover(*FLAT, *more, "--out", str(out)) == 2
    assert list(tmp_path.iterdir()) == []


def test_box_of_the_part_file_decides(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part = tmp_path / "part.yaml"
    part.write_text(
        "part: {name: p}\ntarget_family: aicon12\nbox_mm: [[0, 0, 0], [1500, 1000, 0]]\n"
        "targets: [{id: 1, xyz_mm: [0, 0, 0], dot_diameter_mm: 5}]\n"
    )
    more = ["--control", "linuxcnc", "--remaining", "5", "--part", str(part)]
    assert _handover(*TILTED, *more) == 0
    assert "G10 L2 P1 X812.340138 Y-410.253269 Z158.269991 R0.229355006" in capsys.readouterr().out
