"""A live campaign tells the operator what to do, goes on after a break, and names its runs."""

import io

import pytest
from rich.console import Console

from omm_bringup import live_campaign
from omm_bringup.command_line import main
from omm_bringup.live_campaign import LiveCampaign, drive
from omm_core.budget.campaign_file import load_campaign_file
from omm_core.errors import InputError, MeasurementError

REAL = {"camera": "gige", "control": "linuxcnc", "part_file": "p", "calibration_file": "c"}


@pytest.fixture
def measured(monkeypatch):
    """The runs that were measured, without nodes."""
    runs = []

    def measure(campaign, folder, clamping, repeat, console):
        if len(runs) == getattr(measure, "breaks_after", -1):
            raise MeasurementError("broken off")
        runs.append((clamping, repeat))
        folder.mkdir(parents=True)
        (folder / "run.mcap").write_bytes(b"")

    monkeypatch.setattr(live_campaign, "_measure", measure)
    # The lock on the folder lasts as long as a process: one of these goes on after a break.
    make = {"parents": True, "exist_ok": True}
    monkeypatch.setattr(live_campaign, "take_folder", lambda folder: folder.mkdir(**make))
    return runs, measure


def quiet() -> Console:
    return Console(file=io.StringIO())


def test_each_clamping_is_asked_for_once_before_its_repeats(tmp_path, measured):
    asked = []
    campaign = LiveCampaign(folder=tmp_path / "c", clampings=3, repeats=2, station=REAL)
    path = drive(campaign, quiet(), asked.append)
    assert measured[0] == [(1, 1), (1, 2), (2, 1), (2, 2), (3, 1), (3, 2)]
    assert len(asked) == 3
    assert "unclamp" not in asked[0]
    assert all("unclamp" in words and "clamp it again" in words for words in asked[1:])
    runs = load_campaign_file(path).runs
    assert [(one.clamping, one.repeat) for one in runs] == measured[0]
    assert all((one.run / "run.mcap").exists() for one in runs)


def test_a_campaign_that_broke_off_goes_on_and_clamps_anew(tmp_path, measured):
    runs, measure = measured
    campaign = LiveCampaign(folder=tmp_path / "c", clampings=2, repeats=2, station=REAL)
    measure.breaks_after = 3
    with pytest.raises(MeasurementError):
        drive(campaign, quiet(), lambda words: None)
    assert len(load_campaign_file(campaign.folder).runs) == 3
    measure.breaks_after = -1
    asked = []
    drive(campaign, quiet(), asked.append)
    assert runs == [(1, 1), (1, 2), (2, 1), (2, 2)]
    assert len(asked) == 1
    assert "2 of 2" in asked[0]


def test_without_an_operator_nothing_is_started(tmp_path, measured, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    campaign = LiveCampaign(folder=tmp_path / "c", clampings=2, repeats=1, station=REAL)
    with pytest.raises(InputError, match="operator"):
        drive(campaign, quiet())
    assert measured[0] == []


def test_a_simulated_cell_needs_nobody(tmp_path, measured):
    campaign = LiveCampaign(folder=tmp_path / "c", clampings=2, repeats=1)
    drive(campaign, quiet())
    assert measured[0] == [(1, 1), (2, 1)]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--clampings", "2", "--camera", "gige"], "--live"),
        (["--clampings", "2", "--live", "--camera", "gige"], "--control"),
    ],
)
def test_options_that_belong_together_are_asked_for(arguments, told, capsys):
    assert main(["campaign", *arguments]) == 2
    assert told in capsys.readouterr().err
