"""Parameters: declared once, checked at the start and at run time."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

from omm_core.errors import InputError
from omm_ros.parameters import declare, parameter, watch

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")


@dataclass(frozen=True, kw_only=True)
class Parameters:
    rate_hz: float = parameter(100.0, "Rate.", minimum=1.0, maximum=1000.0, read_only=False)
    driver: str = parameter("simulated", "Driver.", choices=("simulated", "gige"))
    topics: tuple[str, ...] = parameter(("/a",), "Topics.")


@pytest.fixture
def context() -> Iterator[rclpy.Context]:
    context = rclpy.Context()
    context.init()
    yield context
    context.try_shutdown()


def make(context: rclpy.Context, *overrides: Parameter) -> Node:
    return Node("subject", context=context, parameter_overrides=list(overrides))


def test_defaults_and_overrides_arrive_in_the_field_types(context: rclpy.Context) -> None:
    node = make(context, Parameter("rate_hz", value=50), Parameter("topics", value=["/b", "/c"]))
    parameters = declare(node, Parameters)
    assert parameters == Parameters(rate_hz=50.0, topics=("/b", "/c"))
    assert isinstance(parameters.rate_hz, float)
    node.destroy_node()


@pytest.mark.parametrize(
    "override",
    [
        Parameter("rate_hz", value=0.5),
        Parameter("rate_hz", value="fast"),
        Parameter("driver", value="usb"),
        Parameter("driver", value=7),
    ],
    ids=lambda p: f"{p.name}={p.value}",
)
def test_a_bad_value_is_told_with_what_is_expected(
    context: rclpy.Context, override: Parameter
) -> None:
    node = make(context, override)
    with pytest.raises(InputError, match=f"Parameter {override.name}: expected"):
        declare(node, Parameters)
    node.destroy_node()


def test_run_time_changes_reach_the_node_and_bad_ones_do_not(context: rclpy.Context) -> None:
    node = make(context)
    seen: list[Parameters] = []
    watch(node, declare(node, Parameters), seen.append)
    assert node.set_parameters([Parameter("rate_hz", value=20.0)])[0].successful
    assert not node.set_parameters([Parameter("rate_hz", value=5000.0)])[0].successful
    assert not node.set_parameters([Parameter("driver", value="gige")])[0].successful
    assert [p.rate_hz for p in seen] == [20.0]
    node.destroy_node()


@dataclass(frozen=True, kw_only=True)
class Files:
    part_file: str = parameter("", "Part.")
    key_file: str = parameter("", "Key.")


def test_a_file_is_told_by_its_absolute_path(
    context: rclpy.Context, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Whoever asks the node for it, the recorder for one, runs in another folder."""
    monkeypatch.chdir(tmp_path)
    node = make(context, Parameter("part_file", value="parts/../part.yaml"))
    assert declare(node, Files) == Files(part_file=str(tmp_path / "part.yaml"))
    assert node.get_parameter("part_file").value == str(tmp_path / "part.yaml")
    node.destroy_node()
