"""A simulated cell that measures a part: `ros2 launch omm_bringup demo.launch.py seed:=7`."""

import time
from pathlib import Path

from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from omm_bringup.cell import CAMERAS, CONTROLS, simulated_cell
from omm_simulation.cell import draw, write_estimator_files
from omm_simulation.scenario import load_scenario


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the nodes follow when these are known."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("scenario", default_value="bench"),
            DeclareLaunchArgument("seed", default_value="1"),
            DeclareLaunchArgument("camera", default_value="simulated", choices=list(CAMERAS)),
            DeclareLaunchArgument("control", default_value="simulated", choices=list(CONTROLS)),
            DeclareLaunchArgument("folder", default_value="", description="where to leave the run"),
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context):  # type: ignore[no-untyped-def]
    chosen = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("scenario", "seed", "camera", "control", "folder")
    }
    scenario, seed = chosen["scenario"], int(chosen["seed"])
    default = f"runs/{time.strftime('%Y%m%d-%H%M%S')}-{scenario}-{seed}"
    folder = Path(chosen["folder"] or default).resolve()
    write_estimator_files(draw(load_scenario(scenario), seed), folder)
    specs = simulated_cell(
        folder, scenario=scenario, seed=seed, camera=chosen["camera"], control=chosen["control"]
    )
    nodes = [
        Node(
            package=spec.package,
            executable=spec.executable,
            name=spec.name,
            parameters=[dict(spec.parameters)],
            output="screen",
        )
        for spec in specs
    ]
    # The operator presses cycle start when all are there, and ends when the part is measured.
    operator = Node(
        package="omm_operator",
        executable="measure_node",
        name="measure",
        output="screen",
    )
    ended = OnProcessExit(target_action=operator, on_exit=[EmitEvent(event=Shutdown())])
    return [*nodes, operator, RegisterEventHandler(ended)]
