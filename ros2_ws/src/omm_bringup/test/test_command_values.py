"""Values on the command line that nothing can be done with are mistakes of usage, told in words."""

import argparse
import importlib
from pathlib import Path

import pytest

from omm_bringup.command_line import COMMANDS, main
from omm_bringup.values import _actions, guard

BAD = {
    "nan": ["export", "run", "--scale", "nan"],
    "infinity": ["replay", "run", "--rate", "inf"],
    "a negative seed": ["repeatability", "--seed", "-1"],
    "no clamping": ["repeatability", "--clampings", "0"],
    "a seed of 5000 digits": ["demo", "--seed", "9" * 5000],
    "a name with NUL": ["info", "a\0b"],
    "no name": ["info", ""],
    "a name that is too long": ["info", "a" * 5000],
    "a hundred thousand million numbers": [
        "targets", "--family", "aicon12", "--dot-mm", "5", "--ids", "1-99999999999",
    ],
    "numbers from high to low": [
        "targets", "--family", "aicon12", "--dot-mm", "5", "--ids", "9-1",
    ],
    "a dot without size": ["targets", "--family", "aicon12", "--dot-mm", "nan", "--ids", "1"],
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_what_cannot_be_used_is_told_with_status_2(
    kind: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    try:
        status = main(BAD[kind])
    except SystemExit as end:
        status = int(str(end.code))
    told = capsys.readouterr().err
    assert status == 2
    assert told.strip()
    assert "Traceback" not in told
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_takes_a_number_that_is_none(name: str) -> None:
    parser = argparse.ArgumentParser()
    importlib.import_module(f"omm_bringup.commands.{name}").add_arguments(parser)
    guard(parser)
    for action in _actions(parser):
        assert action.type not in (int, float, Path), f"{name}: {action.dest}"


def test_nothing_that_is_shown_steers_the_terminal(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["info", str(tmp_path / "\x1b[2J\x07\u202e\x9bname")]) == 2
    told = capsys.readouterr().err
    assert r"\x1b[2J\x07\u202e\x9bname" in told
    assert told.replace("\n", "").isprintable()


def test_a_folder_that_may_not_be_entered_is_no_traceback(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(_: argparse.Namespace) -> int:
        raise PermissionError(13, "Permission denied", str(tmp_path))

    monkeypatch.setattr("omm_bringup.commands.info.run", forbidden)
    assert main(["info", "x"]) == 2
    assert capsys.readouterr().err == f"omm: {tmp_path}: Permission denied.\n"
