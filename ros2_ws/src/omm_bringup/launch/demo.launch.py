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
from omm_bringup.launch_arguments import check_choice, check_names
from omm_simulation.cell import draw, write_estimator_files
from omm_simulation.scenario import load_scenario

ARGUMENTS = {
    "scenario": ("bench", "bench, industrial, ideal, or a scenario's folder"),
    "seed": ("1", "equal seeds make equal cells"),
    "camera": ("simulated", f"one of {', '.join(CAMERAS)}"),
    "control": ("simulated", f"one of {', '.join(CONTROLS)}"),
    "folder": ("", "where to leave the run; empty: a new folder in runs/"),
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the nodes follow when these are known."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context):  # type: ignore[no-untyped-def]
    check_names(ARGUMENTS, context.launch_configurations)
    chosen = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    check_choice("camera", chosen["camera"], CAMERAS)
    check_choice("control", chosen["control"], CONTROLS)
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
    # A node that dies ends the demo: nobody waits for one that will not come.
    died = [
        RegisterEventHandler(
            OnProcessExit(
                target_action=node,
                on_exit=[EmitEvent(event=Shutdown(reason=f"{spec.name} has ended"))],
            )
        )
        for spec, node in zip(specs, nodes)
    ]
    return [*nodes, operator, RegisterEventHandler(ended), *died]
