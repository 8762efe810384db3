"""A simulated cell that measures a part: `ros2 launch omm_bringup demo.launch.py seed:=7`."""

import signal
import time
from pathlib import Path

from launch.actions import EmitEvent, OpaqueFunction, SetEnvironmentVariable
from launch.events import Shutdown, matches_action
from launch.events.process import SignalProcess

from launch import LaunchDescription
from omm_bringup.cell import CAMERAS, CONTROLS, simulated_cell
from omm_bringup.launch_arguments import check_choice, check_whole_number
from omm_bringup.launching import chosen, declared, finished, missed, started
from omm_bringup.processes import NodeSpec
from omm_simulation.cell import draw, write_estimator_files
from omm_simulation.scenario import load_scenario

ARGUMENTS = {
    "scenario": ("bench", "bench, industrial, ideal, or a scenario's folder"),
    "seed": ("1", "equal seeds make equal cells"),
    "camera": ("simulated", f"one of {', '.join(CAMERAS)}"),
    "control": ("simulated", f"one of {', '.join(CONTROLS)}"),
    "folder": ("", "where to leave the run; empty: a new folder in runs/"),
}
# Presses cycle start when all are there, and ends when the part is measured.
OPERATOR = NodeSpec(package="omm_operator", executable="measure_node", name="measure")


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the nodes follow when these are known."""
    return LaunchDescription(
        [
            *declared(ARGUMENTS),
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context):  # type: ignore[no-untyped-def]
    given = chosen(context, ARGUMENTS)
    check_choice("camera", given["camera"], CAMERAS)
    check_choice("control", given["control"], CONTROLS)
    scenario, seed = given["scenario"], check_whole_number("seed", given["seed"])
    default = f"runs/{time.strftime('%Y%m%d-%H%M%S')}-{scenario}-{seed}"
    folder = Path(given["folder"] or default).resolve()
    write_estimator_files(draw(load_scenario(scenario), seed), folder)
    specs = simulated_cell(
        folder, scenario=scenario, seed=seed, camera=given["camera"], control=given["control"]
    )
    nodes = {spec.name: started(spec) for spec in specs}
    operator, recorder = started(OPERATOR), nodes["recorder"]
    # When the part is measured: the recorder first, which asks the others for the end.
    end = SignalProcess(signal_number=signal.SIGINT, process_matcher=matches_action(recorder))
    return [
        *nodes.values(),
        operator,
        finished(operator, OPERATOR.name, EmitEvent(event=end)),
        finished(recorder, "recorder", EmitEvent(event=Shutdown(reason="recorded"))),
        # A node that dies ends the demo: nobody waits for one that will not come.
        *(missed(node, name) for name, node in nodes.items() if node is not recorder),
    ]
