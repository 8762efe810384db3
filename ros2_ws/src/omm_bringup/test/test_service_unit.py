"""The systemd unit of a station: sound, and patient enough that a recording is closed."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")

from omm_bringup.station import RECORDER_PATIENCE_S

UNIT = Path(__file__).parents[1] / "systemd" / "omm@.service"


def settings() -> dict[str, str]:
    lines = UNIT.read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if re.match(r"[A-Z]\w+=", line))


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not here")
def test_systemd_finds_nothing_wrong_with_the_unit(tmp_path: Path) -> None:
    instance = tmp_path / "omm@mill1.service"
    instance.write_text(UNIT.read_text())
    verified = subprocess.run(
        ["systemd-analyze", "verify", str(instance)], capture_output=True, text=True, check=False
    )
    assert (verified.returncode, verified.stdout, verified.stderr) == (0, "", "")


def test_nobody_is_killed_before_launch_has_given_the_recorder_its_time() -> None:
    unit = settings()
    assert int(unit["TimeoutStopSec"]) > sum(RECORDER_PATIENCE_S.values())
    assert unit["KillSignal"] == "SIGINT"
    # launch ends with status 0 after Ctrl-C at its own: a node that ended cleanly is one, too.
    assert unit["Restart"] == "always"


def test_the_station_is_started_in_the_instances_namespace() -> None:
    command = settings()["ExecStart"]
    assert "measure.launch.py namespace:=/%i" in command
    assert "--noninteractive" in command
