"""Preparation goes on in sight: it beats, passes on what went wrong, and a signal ends it."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="ROS 2 is not there")

import rclpy
from rclpy.node import Node

from omm_ros.preparing import while_preparing

PROGRAM = """
import sys, time
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from omm_ros.node_main import run_node
from omm_ros.preparing import while_preparing

class Slow(LifecycleNode):
    "Prepares for ever."
    def __init__(self):
        super().__init__("slow")
    def on_configure(self, state):
        print("preparing", flush=True)
        while_preparing(self, "sleeping", lambda: time.sleep(600), lambda: None)
        return TransitionCallbackReturn.SUCCESS

sys.exit(run_node(Slow, [], parameters=object))
"""


@pytest.fixture
def node() -> Iterator[Node]:
    context = rclpy.Context()
    context.init()
    node = Node("preparing", context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


def test_it_beats_until_the_work_is_done(node: Node) -> None:
    beaten = threading.Event()
    while_preparing(node, "waiting", lambda: _wait_for(beaten), beaten.set)
    assert beaten.is_set()


def _wait_for(event: threading.Event) -> None:
    assert event.wait(30.0)


def test_what_goes_wrong_is_passed_on(node: Node) -> None:
    def fail() -> None:
        raise ValueError("no compiler")

    with pytest.raises(ValueError, match="no compiler"):
        while_preparing(node, "failing", fail, lambda: None)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_node_that_still_prepares(number: signal.Signals) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "preparing\n"
    time.sleep(0.3)
    process.send_signal(number)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 0, said
    assert "Traceback" not in said
