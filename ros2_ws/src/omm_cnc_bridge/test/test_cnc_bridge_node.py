"""The node as a process over ROS, with the simulated control and a camera of the test's."""

import os
import signal

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")
pytest.importorskip("omm_interfaces", reason="the workspace is not built (./omm setup)")

from omm_cnc_bridge.parameters import Parameters
from omm_ros.conversions import stamp_ns


def test_program_is_measured_and_poses_flow(bench, start_node):
    process = start_node(control="simulated", seed=3, speed_factor=4.0)
    done = bench.spin(60.0, lambda: bench.states and bench.states[-1].program_state == 5)
    assert done, "the program did not finish"
    assert bench.triggered == 8
    rested = {s.measure_request for s in bench.states if s.measure_requested and s.in_position}
    assert rested == set(range(1, 9))
    assert bench.states[-1].measure_acknowledged == 8
    stamps = [stamp_ns(p.header.stamp) for p in bench.poses]
    assert stamps == sorted(set(stamps))
    span_s = (stamps[-1] - stamps[0]) / 1e9
    assert 50.0 < len(stamps) / span_s < 105.0  # what the topic promises; what was asked for
    true_stamps = [stamp_ns(p.header.stamp) for p in bench.truth]
    assert len(bench.truth) / ((true_stamps[-1] - true_stamps[0]) / 1e9) > 195.0
    assert {p.header.frame_id for p in bench.poses} == {"machine"}
    process.send_signal(signal.SIGINT)
    assert process.wait(10.0) == 0


def test_the_program_waits_until_the_camera_streams_and_says_for_what(bench, start_node):
    bench.camera_says = "no camera answers at 192.168.1.7"
    process = start_node(control="simulated", seed=3, speed_factor=4.0)
    assert bench.spin(30.0, lambda: bench.states and bench.states[-1].connection == 2)
    bench.spin(7.0)  # longer than a camera that says nothing of itself is waited for
    assert {s.program_state for s in bench.states} <= {0, 1}  # unknown, stopped
    assert bench.triggered == 0
    bench.camera_says = "streaming"
    assert bench.spin(30.0, lambda: bench.triggered > 0)
    process.send_signal(signal.SIGINT)
    _, text = process.communicate(timeout=10)
    assert "waits for the camera to stream; it says: no camera answers at 192.168.1.7" in text


def test_a_camera_that_says_nothing_of_itself_is_asked_all_the_same(bench, start_node):
    bench.camera_says = ""
    start_node(control="simulated", seed=3, speed_factor=4.0)
    assert bench.spin(40.0, lambda: bench.triggered > 0)


def test_an_image_that_came_too_late_and_is_taken_again_stands_in_the_log(bench, start_node):
    bench.camera_takes_s = 0.5
    limits = {"trigger_attempts": 2, "trigger_timeout_s": 0.1, "retry_s": 0.0}
    process = start_node(seed=3, speed_factor=4.0, **limits)
    assert bench.spin(40.0, lambda: bench.triggered > 1)
    process.send_signal(signal.SIGINT)
    _, text = process.communicate(timeout=10)
    assert "the camera did not answer in time (attempt 1 of 2)" in text


def test_a_camera_that_fails_is_told_and_the_program_is_not_answered(bench, start_node):
    bench.camera_works = False
    start_node(seed=3, speed_factor=4.0, trigger_attempts=2, retry_s=0.1)
    name = "cnc_bridge: images"

    def told() -> bool:
        status = bench.diagnostics.get(name)
        return status is not None and "out of light (attempt 2 of 2)" in status.message

    assert bench.spin(30.0, told)
    assert bench.states[-1].measure_acknowledged == 0


def test_a_real_control_is_only_read_and_says_so(bench, start_node, tmp_path):
    machine = os.path.join(os.path.dirname(__file__), "..", "machines", "three_axis_mill.urdf")
    process = start_node(
        control="mtconnect", machine_file=machine, mtconnect_url="http://127.0.0.1:9"
    )
    assert bench.spin(15.0, lambda: bench.states)
    assert bench.states[-1].connection in (0, 1)
    assert not bench.states[-1].in_position
    bench.spin(1.0)
    assert bench.poses == []
    process.send_signal(signal.SIGINT)
    _, text = process.communicate(timeout=10)
    assert "only reads this control" in text


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"control": "opcua"}, "machine_file"),
        ({"control": "fanuc"}, "one of simulated, linuxcnc, opcua, mtconnect"),
        ({"control": "mtconnect", "machine_file": "/nowhere.urdf"}, "/nowhere.urdf"),
        ({"tolerance_mm": -1.0}, "tolerance_mm"),
    ],
)
def test_parameters_that_cannot_be_used_end_the_node_with_2(start_node, parameters, complaint):
    process = start_node(**parameters)
    _, text = process.communicate(timeout=30)
    assert process.returncode == 2
    assert complaint in text


def test_documented_parameters_are_those_of_the_node():
    """docs/cnc_controls.md lists every parameter, and none that is not there."""
    import dataclasses
    import re
    from pathlib import Path

    text = (Path(__file__).parents[4] / "docs" / "cnc_controls.md").read_text(encoding="utf-8")
    table = text.split("## Parameters", 1)[1].split("\n## ", 1)[0]
    listed = re.findall(r"^\| `(\w+)` \| `?([^|`]*)`? \|", table, re.MULTILINE)
    expected = [(f.name, str(f.default)) for f in dataclasses.fields(Parameters)]
    assert [(n, d.strip()) for n, d in listed] == [(n, d or "(empty)") for n, d in expected]
