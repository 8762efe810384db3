"""Controls that come late, go, hang and come back, under the node as a process, over DDS."""

import time

import peers
import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")
pytest.importorskip("omm_interfaces", reason="the workspace is not built (./omm setup)")
pytest.importorskip("asyncua", reason="asyncua is not installed")

import node_opcua
from diagnostic_msgs.msg import DiagnosticStatus
from node_bench import end
from omm_interfaces.msg import SpindleState

from omm_cnc_bridge.controls.linuxcnc.cell import is_installed
from omm_ros.conversions import stamp_ns

CONNECTION = "cnc_bridge: connection"
END_S = 2.0
PEERS = [
    pytest.param(
        "linuxcnc",
        marks=pytest.mark.skipif(
            not is_installed(), reason="LinuxCNC is not installed (apt-get install linuxcnc-uspace)"
        ),
    ),
    "opcua",
    pytest.param(
        "node-opcua",
        marks=pytest.mark.skipif(
            not node_opcua.is_installed(), reason="node-opcua is not installed (npm install -g)"
        ),
    ),
    "mtconnect",
]


@pytest.fixture(params=PEERS)
def peer(request, tmp_path):
    made = {
        "linuxcnc": lambda: peers.LinuxCnc(tmp_path / "linuxcnc"),
        "opcua": peers.OpcUa,
        "node-opcua": peers.NodeOpcUa,
        "mtconnect": peers.MtConnect,
    }[request.param]()
    yield made
    made.stop()


def is_told(bench) -> bool:
    """Whether diagnostics say that the control is not there."""
    status = bench.diagnostics.get(CONNECTION)
    return status is not None and status.level == DiagnosticStatus.ERROR and bool(status.message)


def poses_after(bench, when_ns: int) -> list[float]:
    """X (m) of the poses that claim to have been true after a moment."""
    return [p.pose.position.x for p in bench.poses if stamp_ns(p.header.stamp) > when_ns]


def has_poses(bench, when_ns: int, count: int = 30) -> bool:
    return len(poses_after(bench, when_ns)) >= count


def test_a_control_that_comes_late_goes_and_comes_back(peer, bench, start_node):
    process = start_node(**peer.parameters)
    assert bench.spin(20.0, lambda: is_told(bench))
    assert bench.poses == []
    peer.start()
    assert bench.spin(40.0, lambda: has_poses(bench, 0, 100))
    assert bench.states[-1].connection == SpindleState.CONNECTION_CONNECTED

    last_x = bench.poses[-1].pose.position.x
    peer.stop()
    # What was under way may still come; it was true before.
    gone_ns = time.time_ns() + 20_000_000
    assert bench.spin(10.0, lambda: is_told(bench))
    bench.spin(1.0)
    assert poses_after(bench, gone_ns) == []
    assert not bench.states[-1].in_position
    assert bench.states[-1].connection != SpindleState.CONNECTION_CONNECTED

    back_ns = time.time_ns()
    peer.start()
    assert bench.spin(40.0, lambda: has_poses(bench, back_ns))
    # It began at 0 anew: a pose of before under a fresh stamp would be further on.
    assert max(poses_after(bench, back_ns)[:5]) < max(0.9 * last_x, 0.05)
    assert poses_after(bench, gone_ns) == poses_after(bench, back_ns)
    assert end(process) < END_S


def test_a_control_that_hangs_gives_no_fresh_poses(peer, bench, start_node):
    peer.start()
    process = start_node(**peer.parameters)
    assert bench.spin(40.0, lambda: has_poses(bench, 0, 100))
    peer.hang()
    hung_ns = time.time_ns() + 20_000_000
    assert bench.spin(10.0, lambda: is_told(bench))
    bench.spin(1.0)
    assert poses_after(bench, hung_ns) == []
    assert not bench.states[-1].in_position
    assert end(process) < END_S


@pytest.mark.parametrize("control", ["opcua", "mtconnect"])
def test_ctrl_c_while_connecting_to_what_never_answers(control, bench, start_node):
    with peers.BlackHole() as port:
        scheme = {"opcua": "opc.tcp", "mtconnect": "http"}[control]
        url = {f"{control}_url": f"{scheme}://127.0.0.1:{port}"}
        process = start_node(control=control, machine_file=peers.X_Y_B, **url)
        assert bench.spin(20.0, lambda: is_told(bench))
        bench.spin(0.5)
        assert end(process) < END_S
    assert bench.poses == []


@pytest.mark.parametrize("control", ["linuxcnc", "opcua", "mtconnect"])
def test_ctrl_c_where_nothing_is(control, bench, start_node):
    urls = {"opcua_url": "opc.tcp://127.0.0.1:9", "mtconnect_url": "http://127.0.0.1:9"}
    process = start_node(control=control, machine_file=peers.X_Y_B, **urls)
    assert bench.spin(20.0, lambda: is_told(bench))
    assert end(process) < END_S
