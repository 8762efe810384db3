"""What launch files do with nodes: start them, see one die, end them so that a recording is closed.

Imports `launch`, which comes with a ROS installation: launch files use it, nothing else does.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, TimerAction
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from omm_bringup.launch_arguments import check_names
from omm_bringup.processes import NodeSpec
from omm_bringup.station import RECORDER_PATIENCE_S
from omm_core.errors import MeasurementError
from omm_ros.node_main import END_WITH_PARENT

Arguments = Mapping[str, tuple[str | None, str]]
"""Default (None: there is none) and description of each argument, by name."""


def declared(arguments: Arguments) -> list[Any]:
    """Return the actions that declare the arguments, for `--show-args`."""
    return [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in arguments.items()
    ]


def chosen(context: Any, arguments: Arguments) -> dict[str, str]:
    """Return what was given for each argument.

    Raises
    ------
    InputError
        One was given that is not declared: `ros2 launch` itself takes any.
    """
    check_names(arguments, context.launch_configurations)
    return {name: LaunchConfiguration(name).perform(context) for name in arguments}


def started(spec: NodeSpec, **more: Any) -> Any:
    """Return the action that starts a node; `more` as `launch_ros.actions.Node` takes it."""
    files = [str(spec.parameter_file)] if spec.parameter_file else []
    return Node(
        package=spec.package,
        executable=spec.executable,
        name=spec.name,
        namespace=spec.namespace or None,
        parameters=[*files, dict(spec.parameters)],
        output="screen",
        # Where launch itself is killed, no node stays behind and keeps the camera.
        additional_env={END_WITH_PARENT: "1"},
        **(_patience() if spec.ends_first else {}),
        **more,
    )


def _patience() -> dict[str, str]:
    return {name: str(seconds) for name, seconds in RECORDER_PATIENCE_S.items()}


def missed(node: Any, name: str) -> Any:
    """Return the handler that ends everything, with status 1, when a node ends by itself."""

    def told(event: Any, context: Any) -> Any:
        if context.is_shutdown:
            return None
        return _failing(f"{name} has ended by itself (status {event.returncode}).")

    return RegisterEventHandler(OnProcessExit(target_action=node, on_exit=told))


def _failing(why: str) -> Any:
    """Return an action that ends everything: launch's own status is 1 only after an exception."""

    def fail(context: Any) -> None:
        raise MeasurementError(why)

    # Not from within the event: launch would not hear the process's last words.
    return TimerAction(period=0.0, actions=[OpaqueFunction(function=fail)])


def finished(node: Any, name: str, then: Any) -> Any:
    """Return the handler that does `then` when a node ends well, and ends everything otherwise."""

    def told(event: Any, context: Any) -> Any:
        if context.is_shutdown:
            return None
        if event.returncode == 0:
            return then
        return _failing(f"{name} has failed (status {event.returncode}); it said why.")

    return RegisterEventHandler(OnProcessExit(target_action=node, on_exit=told))
