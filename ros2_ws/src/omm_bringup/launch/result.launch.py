"""Publish a stored result: `ros2 launch omm_bringup result.launch.py result_file:=first.json`.

For programs that need the part's pose after the measurement. Who starts it vouches that the part
still lies as it was measured; where an estimator publishes a pose, too, it ends.
"""

from launch.actions import OpaqueFunction

from launch import LaunchDescription
from omm_bringup.launch_arguments import check_switch
from omm_bringup.launching import chosen, declared, missed, started
from omm_bringup.station import scene, stored_result

ARGUMENTS = {
    "result_file": (None, "result, as `./omm solve RUN --json FILE` writes it"),
    "publish_tf": ("true", "whether its frames go out on /tf: true or false"),
    "part_file": ("", "part.yaml, to show the part in RViz, Foxglove; empty: it is not shown"),
    "namespace": ("", "of the machine, where one computer serves several: /mill1"),
}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the nodes follow when these are known."""
    return LaunchDescription([*declared(ARGUMENTS), OpaqueFunction(function=_nodes)])


def _nodes(context):  # type: ignore[no-untyped-def]
    given = chosen(context, ARGUMENTS)
    publish_tf = check_switch("publish_tf", given["publish_tf"])
    namespace, part_file = given["namespace"], given["part_file"]
    specs = [stored_result(given["result_file"], publish_tf=publish_tf, namespace=namespace)]
    if part_file:
        specs.append(scene(part_file=part_file, namespace=namespace))
    actions = []
    for spec in specs:
        node = started(spec)
        actions += [node, missed(node, spec.name)]
    return actions
