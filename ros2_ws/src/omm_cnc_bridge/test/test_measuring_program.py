"""The program that `./omm plan` writes, run by LinuxCNC itself, answered by the node."""

import json
import subprocess
import sys

import peers
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")
pytest.importorskip("omm_interfaces", reason="the workspace is not built (./omm setup)")

from omm_cnc_bridge.controls.linuxcnc.cell import is_installed
from omm_core.files.part import load_part
from omm_core.session.pairing import PoseTrack
from omm_ros.conversions import stamp_ns, transform_from_pose
from omm_simulation.cell import draw, write_estimator_files
from omm_simulation.scenario import load_scenario

pytestmark = pytest.mark.skipif(
    not is_installed(), reason="LinuxCNC is not installed (apt-get install linuxcnc-uspace)"
)


@pytest.fixture
def linuxcnc(tmp_path):
    peer = peers.LinuxCnc(tmp_path / "linuxcnc")
    peer.cell.start()
    yield peer
    peer.stop()


def test_the_written_program_runs_and_rests_long_enough_around_each_image(
    linuxcnc, bench, start_node, tmp_path
):
    part, camera = write_estimator_files(draw(load_scenario("bench"), 1), tmp_path / "files")
    program = linuxcnc.cell.folder / "measure.ngc"
    planned = tmp_path / "plan.json"
    command = ["plan", "--machine", peers.THREE_AXES, "--part", part, "--calibration", camera]
    command += ["--part-at", 100, 100, 0, "--out", program, "--json", planned]
    done = subprocess.run(
        [sys.executable, "-m", "omm_bringup.command_line", *map(str, command)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    images = json.loads(planned.read_text())["program"]["images"]
    assert images >= 2 * len(load_part(part).targets)

    start_node(**linuxcnc.parameters, allow_commands=True, program_file=program)
    assert bench.spin(30.0, lambda: len(bench.poses) > 50)
    answer = bench.call("/cnc_bridge/start_program")
    assert answer.success, answer.message
    assert bench.spin(120.0, lambda: bench.states[-1].program_state == 5), bench.diagnostics
    assert bench.states[-1].measure_acknowledged == images
    assert len(bench.images_ns) == images

    track = PoseTrack()  # as the estimator judges: still from 0.1 s before until 0.1 s after
    for pose in bench.poses:
        track.add(stamp_ns(pose.header.stamp), transform_from_pose(pose.pose))
    assert [track.judge(image_ns).reason for image_ns in bench.images_ns] == [None] * images
