"""The launch files with the real `ros2 launch`; skipped where no ROS installation is sourced."""

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from whole_suite import ROOT

from omm_runs.solving import solve_run

pytestmark = pytest.mark.skipif(
    shutil.which("ros2") is None,
    reason="`ros2` is not on the PATH: it comes with a ROS installation",
)
WAIT_S = 120.0
NODES = ("recorder_node", "estimator_node", "camera_node", "cnc_bridge_node", "measure_node")


class Launched:
    """A `ros2 launch` in a session of its own, and what it has said so far."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.log = folder / "launch.log"
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(
                ["ros2", "launch", "omm_bringup", *words],
                stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                start_new_session=True, env={**os.environ, "ROS_LOG_DIR": str(folder / "log")},
                # A test runner in the background may have it ignored, which children inherit.
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
            )  # fmt: skip

    @property
    def said(self) -> str:
        return self.log.read_text(errors="replace")

    def until(self, words: str) -> None:
        deadline_s = time.monotonic() + WAIT_S
        while words not in self.said:
            assert self.process.poll() is None, self.said
            assert time.monotonic() < deadline_s, self.said
            time.sleep(0.1)

    def pid(self, node: str) -> int:
        """Process of a node, as launch told it."""
        (line,) = (s for s in self.said.splitlines() if f"[{node}-" in s and "with pid" in s)
        return int(line.rpartition("[")[2].rstrip("]"))

    def ended(self) -> int:
        return self.process.wait(WAIT_S)

    def close(self) -> None:
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


@pytest.fixture
def demo(tmp_path: Path) -> Iterator[Launched]:
    launched = Launched(tmp_path, "demo.launch.py", "seed:=7", f"folder:={tmp_path / 'run'}")
    yield launched
    launched.close()


def test_demo_measures_and_closes_the_recording_before_the_others_end(
    demo: Launched, tmp_path: Path
) -> None:
    assert demo.ended() == 0, demo.said
    assert "none lost" in demo.said
    assert "not known whether" not in demo.said
    assert (tmp_path / "run" / "run.mcap").is_file()


@pytest.mark.parametrize("signals", [1, 3])
def test_ended_by_ctrl_c_to_the_group_any_number_of_times_it_keeps_the_recording(
    demo: Launched, tmp_path: Path, signals: int
) -> None:
    demo.until("2 images")
    for _ in range(signals):
        os.killpg(demo.process.pid, signal.SIGINT)
        time.sleep(0.1)
    assert demo.ended() == 0, demo.said
    assert "Traceback" not in demo.said
    assert (tmp_path / "run" / "run.mcap").is_file()


def test_a_dead_node_is_told_and_ends_the_demo_with_status_1(
    demo: Launched, tmp_path: Path
) -> None:
    demo.until("2 images")
    os.kill(demo.pid("camera_node"), signal.SIGKILL)
    assert demo.ended() == 1, demo.said
    assert "camera has ended by itself (status -9)" in demo.said
    assert (tmp_path / "run" / "run.mcap").is_file()


def test_a_killed_launch_leaves_no_node_behind_and_the_recording_is_closed(
    demo: Launched, tmp_path: Path
) -> None:
    demo.until("2 images")
    pids = [demo.pid(node) for node in NODES]
    demo.process.kill()
    demo.ended()
    deadline_s = time.monotonic() + WAIT_S
    while left := [pid for pid in pids if Path(f"/proc/{pid}").exists()]:
        assert time.monotonic() < deadline_s, left
        time.sleep(0.1)
    assert (tmp_path / "run" / "run.mcap").is_file()


def test_a_stored_result_is_published_until_it_is_ended(tmp_path: Path) -> None:
    result = tmp_path / "result.json"
    result.write_text(json.dumps(solve_run(ROOT / "test" / "data" / "bench").result.to_json_dict()))
    launched = Launched(tmp_path, "result.launch.py", f"result_file:={result}")
    launched.until("Publishing the pose of bench")
    os.kill(launched.process.pid, signal.SIGINT)
    assert launched.ended() == 0, launched.said
    assert "Traceback" not in launched.said


def test_a_file_that_holds_no_result_ends_the_launch_with_status_1(tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text("{}")
    launched = Launched(tmp_path, "result.launch.py", f"result_file:={tmp_path / 'result.json'}")
    assert launched.ended() == 1, launched.said
    assert "stored_result has ended by itself (status 2)" in launched.said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("demo.launch.py", "sede:=7"), "Did you mean seed?"),
        (("demo.launch.py", "seed:=seven"), "seed: expected a whole number, got 'seven'"),
        (("demo.launch.py", "camera:=v4l2"), "camera: expected one of simulated, gige"),
        (("result.launch.py",), "result_file"),
        (("result.launch.py", "result_file:=no.json"), "'no.json'"),
        (("measure.launch.py",), "part_file"),
        (("measure.launch.py", "part_file:=no.yaml", "calibration_file:=no.yaml"), "'no.yaml'"),
    ],
)
def test_wrong_arguments_are_refused_in_words(
    tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    launched = Launched(tmp_path, *words)
    assert launched.ended() == 1
    assert said in launched.said


@pytest.mark.parametrize("file", ["demo.launch.py", "measure.launch.py", "result.launch.py"])
def test_every_argument_is_described(tmp_path: Path, file: str) -> None:
    launched = Launched(tmp_path, file, "--show-args")
    assert launched.ended() == 0
    lines = launched.said.splitlines()
    names = [i for i, line in enumerate(lines) if line.strip().endswith("':")]
    assert len(names) >= 4
    assert all(lines[i + 1].strip() for i in names)
