"""Measure with real devices: `ros2 launch … --show-args` lists the arguments.

ros2 launch omm_bringup measure.launch.py camera:=gige control:=linuxcnc \
    part_file:=part.yaml calibration_file:=camera.yaml machine_file:=mill.urdf
"""

from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription
from omm_bringup.launch_arguments import check_names
from omm_bringup.station import CAMERAS, CONTROLS, station

ARGUMENTS = {
    "camera": ("gige", f"{', '.join(CAMERAS)}, or a parameter file of your own"),
    "control": ("linuxcnc", f"{', '.join(CONTROLS)}, or a parameter file of your own"),
    "part_file": (None, "part.yaml: what is measured"),
    "calibration_file": (None, "camera.yaml: with which camera"),
    "machine_file": ("", "URDF of the machine, or a machine.yaml that names it"),
    "folder": ("", "where to record; empty: a new folder in runs/"),
    "record": ("true", "whether to record: true or false"),
    "namespace": ("", "of this machine, where one computer serves several: /mill1"),
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the nodes follow when these are known."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context):  # type: ignore[no-untyped-def]
    check_names(ARGUMENTS, context.launch_configurations)
    chosen = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    record = chosen.pop("record").lower() in ("true", "1", "yes")
    actions = []
    for spec in station(record=record, **chosen):
        files = [str(spec.parameter_file)] if spec.parameter_file else []
        node = Node(
            package=spec.package,
            executable=spec.executable,
            name=spec.name,
            namespace=spec.namespace or None,
            parameters=[*files, dict(spec.parameters)],
            output="screen",
        )
        # A measurement without one of its stations is none: say so, and end the others.
        ended = OnProcessExit(
            target_action=node, on_exit=[EmitEvent(event=Shutdown(reason=f"{spec.name} has ended"))]
        )
        actions += [node, RegisterEventHandler(ended)]
    return actions
