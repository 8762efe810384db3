"""Measure with real devices: `ros2 launch … --show-args` lists the arguments.

ros2 launch omm_bringup measure.launch.py camera:=gige control:=linuxcnc \
    part_file:=part.yaml calibration_file:=camera.yaml machine_file:=mill.urdf
"""

from launch.actions import OpaqueFunction

from launch import LaunchDescription
from omm_bringup.launch_arguments import check_switch
from omm_bringup.launching import chosen, declared, missed, started
from omm_bringup.station import CAMERAS, CONTROLS, page, station

ARGUMENTS = {
    "camera": ("gige", f"{', '.join(CAMERAS)}, or a parameter file of your own"),
    "control": ("linuxcnc", f"{', '.join(CONTROLS)}, or a parameter file of your own"),
    "part_file": (None, "part.yaml: what is measured"),
    "calibration_file": (None, "camera.yaml: with which camera"),
    "machine_file": ("", "URDF of the machine, or a machine.yaml that names it"),
    "folder": ("", "where to record; empty: a new folder in runs/"),
    "record": ("true", "whether to record: true or false"),
    "page": ("", "port of the operator's page, or a parameter file for it; empty: no page"),
    "namespace": ("", "of this machine, where one computer serves several: /mill1"),
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the nodes follow when these are known."""
    return LaunchDescription([*declared(ARGUMENTS), OpaqueFunction(function=_nodes)])


def _nodes(context):  # type: ignore[no-untyped-def]
    given = chosen(context, ARGUMENTS)
    record = check_switch("record", given.pop("record"))
    where = given.pop("page")
    actions = []
    for spec in station(record=record, **given):
        node = started(spec)
        # A measurement without one of its stations is none: say so, and end the others.
        actions += [node, missed(node, spec.name)]
    if where:
        spec = page(where, machine_file=given["machine_file"], namespace=given["namespace"])
        # No measurement is lost with the page: it is started anew.
        actions.append(started(spec, respawn=True, respawn_delay=2.0))
    return actions
