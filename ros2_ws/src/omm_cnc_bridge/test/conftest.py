"""Fixtures of the tests that hear the node over DDS."""

import os

import pytest


@pytest.fixture
def domain(monkeypatch) -> int:
    pytest.importorskip("rclpy", reason="ROS 2 is not there")
    pytest.importorskip("omm_interfaces", reason="the workspace is not built (./omm setup)")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    number = 110 + os.getpid() % 100
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    return number


@pytest.fixture
def bench(domain):
    from node_bench import Bench

    made = Bench(domain)
    yield made
    made.close()


@pytest.fixture
def start_node(domain):
    """Start the bridge with parameters; it is ended with the test."""
    from node_bench import start_bridge

    processes = []

    def start(**parameters):
        processes.append(start_bridge(**parameters))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.communicate()
