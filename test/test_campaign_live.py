"""A campaign over real processes in a simulated cell, then its budget, then a touch probe."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

POINTS = """name,part_x_mm,part_y_mm,part_z_mm
A,0,0,0
B,1500,0,0
C,1500,1000,0
D,0,1000,0
"""


def omm(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "omm_bringup.command_line", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=250, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two clampings measured live, and campaign.json."""
    folder = tmp_path_factory.mktemp("campaign")
    live = ("--clampings", "2", "--live", "--scenario", "ideal", "--folder", folder)
    done = omm("campaign", *live, "--json", folder / "campaign.json")
    assert "unclamp the camera" in done.stderr
    return folder


def test_the_part_is_where_it_was_and_the_holder_is_turned(campaign: Path) -> None:
    found = json.loads((campaign / "campaign.json").read_text())
    assert [run["clamping"] for run in found["runs"]] == [1, 2]
    thetas = np.array([list(run["theta"].values()) for run in found["runs"]])
    assert np.ptp(thetas[:, 3:6], axis=0).max() < 0.03
    assert np.ptp(thetas[:, 6]) > 2e-4
    truths = [json.loads((campaign / f"c0{k}/r01/truth.json").read_text()) for k in (1, 2)]
    turned = [truth["theta"]["gamma_s_rad"] for truth in truths]
    assert thetas[:, 6] == pytest.approx(turned, abs=2e-4)


def test_a_budget_takes_the_campaign_as_u_ip(campaign: Path) -> None:
    (campaign / "budget.yaml").write_text(
        "part: c01/r01/part.yaml\nu_ip: {campaign: campaign.yaml, run: c01/r01}\ntolerance_mm: 1\n"
    )
    omm("budget", campaign, "--json", campaign / "budget.json")
    found = json.loads((campaign / "budget.json").read_text())
    assert found["capability"]["verdict"] == "capable"
    assert all(0.0 < u < 0.05 for point in found["points"] for u in point["u_ip_mm"])


def test_a_touch_probe_finds_the_part_where_the_run_says(campaign: Path) -> None:
    (campaign / "points.csv").write_text(POINTS)
    out = ("--simulate", campaign / "probed.csv", "--json", campaign / "probe.json")
    omm("probe", campaign / "c01/r01", campaign / "points.csv", *out)
    found = json.loads((campaign / "probe.json").read_text())
    assert found["believed"]
    # What was touched can be judged again from the file.
    omm("probe", campaign / "c01/r01", campaign / "probed.csv", "--json", campaign / "again.json")
    assert json.loads((campaign / "again.json").read_text()) == found
