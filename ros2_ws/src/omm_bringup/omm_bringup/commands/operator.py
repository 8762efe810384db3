"""`./omm operator`: serve the operator's page for the nodes that run."""

import argparse
import os
from pathlib import Path

from omm_core.errors import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `operator`."""
    parser.add_argument("--port", type=int, help="port of the page (default 8765)")
    parser.add_argument("--part", type=Path, help="part file with tolerances and jacks")
    parser.add_argument("--machine", type=Path, help="machine.yaml that says where up is")
    parser.add_argument(
        "--ros-args", nargs=argparse.REMAINDER, default=[], help="parameters: -p NAME:=VALUE …"
    )


def run(args: argparse.Namespace) -> int:
    """Run the node, with its parameters given as they are anywhere in ROS."""
    from omm_bringup.processes import NodeSpec, executable_of

    given = {"port": args.port, "part_file": args.part, "machine_file": args.machine}
    words = [f"{name}:={value}" for name, value in given.items() if value is not None]
    for path in (args.part, args.machine):
        if path is not None and not path.is_file():
            raise InputError(f"Expected a file at {path}.")
    spec = NodeSpec(package="omm_operator", executable="operator_node", name="operator")
    program = str(executable_of(spec))
    named = [word for pair in words for word in ("-p", pair)]
    os.execv(program, [program, "--ros-args", *named, *args.ros_args])
