"""Other machines hear nothing, also those that know the address; the parameter opens the network.

Two network namespaces with an address each are the two machines; each has its own /dev/shm.
"""

import os
import shutil
import subprocess
import sys
import textwrap
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import pytest

from omm_ros.transport import PROFILE_VARIABLES, network_is_asked_for

CONFIG = Path(__file__).parents[1] / "config"
SPEAK = """
import sys, time
from omm_ros import transport
transport.prepare(sys.argv[1:])
import rclpy
from std_msgs.msg import Header
rclpy.init()
node = rclpy.create_node("speaker")
publisher = node.create_publisher(Header, "/said", 10)
while True:
    publisher.publish(Header())
    time.sleep(0.02)
"""
LISTEN = """
import sys, time
import rclpy
from std_msgs.msg import Header
rclpy.init()
node = rclpy.create_node("listener")
heard = []
node.create_subscription(Header, "/said", heard.append, 10)
until = time.monotonic() + float(sys.argv[1])
while time.monotonic() < until and len(heard) < 20:
    rclpy.spin_once(node, timeout_sec=0.1)
print(len(heard))
"""


def in_namespace(pid: int, words: list[str], **environment: str) -> "subprocess.Popen[str]":
    # The shared memory of DDS would join the two: each gets a /dev/shm of its own.
    # Its root, too: a mount namespace alone leads out of a chroot.
    enter = ["nsenter", "-t", str(pid), "-n", "-m", "--root", "--wd=/"]
    # Other tests have prepared this process already; the two machines begin afresh.
    ours = (*PROFILE_VARIABLES, "OMM_NETWORK")
    fresh = {name: value for name, value in os.environ.items() if name not in ours}
    return subprocess.Popen(
        [*enter, *words],
        env={**fresh, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p), **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )


@pytest.fixture
def two_machines() -> Iterator[tuple[int, int]]:
    """Two processes that hold a network namespace each, joined by a cable."""
    if os.geteuid() != 0 or not all(shutil.which(w) for w in ("ip", "unshare", "nsenter")):
        pytest.skip("needs root, ip, unshare and nsenter to make two machines of one")
    hold = "mount -t tmpfs tmpfs /dev/shm && ip link set lo up && echo ready && exec sleep 300"
    holders = [
        subprocess.Popen(
            ["unshare", "-n", "-m", "sh", "-c", hold], stdout=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    try:
        if not all(h.stdout is not None and h.stdout.readline() == "ready\n" for h in holders):
            pytest.skip("no namespaces can be made here")
        a, b = (holder.pid for holder in holders)
        cable = f"ip link add omm{a} netns {a} type veth peer name omm{b} netns {b}"
        if subprocess.run(cable.split(), check=False, capture_output=True).returncode:
            pytest.skip("no virtual cable can be made here")
        for pid, address in ((a, "10.99.7.1"), (b, "10.99.7.2")):
            for words in (
                f"ip addr add {address}/24 dev omm{pid}",
                f"ip link set omm{pid} up",
                f"ip route add 224.0.0.0/4 dev omm{pid}",
            ):
                subprocess.run(["nsenter", "-t", str(pid), "-n", *words.split()], check=True)
        yield a, b
    finally:
        for holder in holders:
            holder.kill()
            holder.communicate()


def heard(speaker_at: int, listener_at: int, seconds: float, *words: str, address: str) -> int:
    speaker = in_namespace(
        speaker_at, [sys.executable, "-c", SPEAK, *words], ROS_DOMAIN_ID="97",
        ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET",
    )  # fmt: skip
    try:
        listener = in_namespace(
            listener_at, [sys.executable, "-c", LISTEN, str(seconds)],
            ROS_DOMAIN_ID="97", ROS_STATIC_PEERS=address,
        )  # fmt: skip
        told, _ = listener.communicate(timeout=120)
    finally:
        speaker.kill()
        speaker.communicate()
    return int(told)


def test_a_peer_on_another_machine_hears_nothing_unless_the_network_is_opened(
    two_machines: tuple[int, int],
) -> None:
    a, b = two_machines
    opened = ("--ros-args", "-p", "network:=true")
    assert heard(a, b, 60.0, *opened, address="10.99.7.1") == 20
    assert heard(a, b, 6.0, address="10.99.7.1") == 0
    assert heard(a, a, 60.0, address="") == 20  # who listens here hears


@pytest.mark.parametrize(
    ("words", "opened"),
    [
        ([], False),
        (["--ros-args", "-p", "network:=true"], True),
        (["--ros-args", "-p", "network:=false"], False),
        (["--ros-args", "--param", "camera:network:=True"], True),
        (["--ros-args", "-p", "my_network:=true"], False),
        (["--ros-args", "--params-file", "{file}"], True),
        (["--ros-args", "--params-file", "nowhere"], False),
    ],
)
def test_the_network_is_opened_by_the_parameter_alone(
    words: list[str], opened: bool, tmp_path: Path
) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(
        textwrap.dedent("""
        /**:
          ros__parameters: {network: true}
        """)
    )
    assert network_is_asked_for([w.format(file=file) for w in words]) is opened


def test_the_two_profiles_differ_by_the_limit_alone() -> None:
    limited, opened = (
        ET.parse(CONFIG / name).getroot() for name in ("fastdds.xml", "fastdds_network.xml")
    )
    found = [
        (parent, child)
        for parent in limited.iter()
        for child in parent
        if child.tag.endswith("interfaceWhiteList")
    ]
    (parent, limit) = found[0]
    assert [address.text for address in limit] == ["127.0.0.1"]
    parent.remove(limit)

    def plain(element: ET.Element) -> str:
        return "".join(ET.tostring(element, encoding="unicode").split())

    assert plain(limited) == plain(opened)
