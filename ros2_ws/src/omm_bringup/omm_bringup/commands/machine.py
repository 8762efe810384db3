"""`./omm machine`: show and check the description of a machine."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from omm_core.errors import InputError
from omm_core.files.output import write_whole

if TYPE_CHECKING:
    from omm_core.machine.kinematics import Kinematics

RADIANS = math.radians(1.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `machine`."""
    actions = parser.add_subparsers(dest="action", required=True)
    show = actions.add_parser("show", help="check a machine's URDF and draw it")
    show.add_argument("machine", type=Path, help="URDF file")
    show.add_argument("--svg", type=Path, metavar="OUT", help="draw it to this file")
    show.add_argument(
        "--at", nargs="*", default=[], metavar="AXIS=VALUE",
        help="print the spindle's pose at axis positions, in mm and degrees",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Run the checks asked for; return 0, or 1 where one found something."""
    return _show(args)


def _show(args: argparse.Namespace) -> int:
    from omm_cnc_bridge.machine.check import check
    from omm_cnc_bridge.machine.drawing import draw
    from omm_core.machine.kinematics import Kinematics

    machine = Kinematics.load(args.machine)
    findings = check(machine)
    print(f"{machine.name}: {len(machine.axes)} axes, {'/'.join(a.name for a in machine.axes)}")
    for finding in findings:
        print(f"  {'ok ' if finding.good else '!! '} {finding.text}")
    if args.at:
        _print_pose(machine, _axes(args.at, machine))
    if args.svg:
        write_whole(args.svg, draw(machine))
        print(f"drawn to {args.svg}")
    return 0 if all(finding.good for finding in findings) else 1


def _print_pose(machine: "Kinematics", axes: dict[str, float]) -> None:
    for complaint in machine.out_of_limits(axes):
        print(f"  !!  {complaint}")
    pose = machine.machine_T_spindle({a.name: 0.0 for a in machine.axes} | axes)
    x, y, z = pose.translation_mm
    angles = (math.degrees(a) for a in pose.euler_xyz_rad())
    alpha, beta, gamma = angles
    print(f"spindle at {x:.4f}, {y:.4f}, {z:.4f} mm, turned {alpha:.5f}, {beta:.5f}, {gamma:.5f}°")


def _axes(words: list[str], machine: "Kinematics") -> dict[str, float]:
    """Return the positions given as AXIS=VALUE, degrees turned to rad where the axis turns."""
    rotary = {axis.name: axis.rotary for axis in machine.axes}
    axes = {}
    for word in words:
        name, _, value = word.partition("=")
        try:
            axes[name] = float(value) * (RADIANS if rotary[name] else 1.0)
        except (KeyError, ValueError):
            raise InputError(
                f"Expected AXIS=VALUE with an axis of {', '.join(rotary)}, got {word!r}."
            ) from None
    return axes
