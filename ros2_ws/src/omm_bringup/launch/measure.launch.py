"""Measure with real devices: `ros2 launch … --show-args` lists the arguments.

ros2 launch omm_bringup measure.launch.py camera:=gige control:=linuxcnc \
    part_file:=part.yaml calibration_file:=camera.yaml machine_file:=mill.urdf
"""

from launch.actions import OpaqueFunction

from launch import LaunchDescription
from omm_bringup.launch_arguments import check_switch
from omm_bringup.launching import chosen, declared, missed, started
from omm_bringup.station import CAMERAS, CONTROLS, overlay, page, scene, station

ARGUMENTS = {
    "camera": ("gige", f"{', '.join(CAMERAS)}, or a parameter file of your own"),
    "control": ("linuxcnc", f"{', '.join(CONTROLS)}, or a parameter file of your own"),
    "part_file": (None, "part.yaml: what is measured"),
    "calibration_file": (None, "camera.yaml: with which camera"),
    "machine_file": ("", "URDF of the machine, or a machine.yaml that names it"),
    "folder": ("", "where to record; empty: a new folder in runs/"),
    "record": ("true", "whether to record: true or false"),
    "page": ("", "port of the operator's page, or a parameter file for it; empty: no page"),
    "overlay": ("false", "whether to publish images with what was found in them: true or false"),
    "scene": ("false", "whether to publish part and machine for RViz, Foxglove: true or false"),
    "namespace": ("", "of this machine, where one computer serves several: /mill1"),
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the nodes follow when these are known."""
    return LaunchDescription([*declared(ARGUMENTS), OpaqueFunction(function=_nodes)])


def _nodes(context):  # type: ignore[no-untyped-def]
    given = chosen(context, ARGUMENTS)
    record = check_switch("record", given.pop("record"))
    viewers = _viewers(given)
    actions = []
    for spec in station(record=record, **given):
        node = started(spec)
        # A measurement without one of its stations is none: say so, and end the others.
        actions += [node, missed(node, spec.name)]
    # No measurement is lost with what only shows it: it is started anew.
    return actions + [started(spec, respawn=True, respawn_delay=2.0) for spec in viewers]


def _viewers(given):  # type: ignore[no-untyped-def]
    """Return the nodes that show the measurement; takes their arguments out."""
    where = given.pop("page")
    with_overlay, with_scene = (check_switch(n, given.pop(n)) for n in ("overlay", "scene"))
    namespace = given["namespace"]
    files = {n: given[n] for n in ("part_file", "calibration_file", "machine_file")}
    specs = []
    if where:
        specs.append(page(where, machine_file=files["machine_file"], namespace=namespace))
    if with_overlay:
        specs.append(overlay(namespace))
    if with_scene:
        specs.append(scene(**files, namespace=namespace))
    return specs
