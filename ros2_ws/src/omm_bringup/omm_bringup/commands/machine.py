"""`./omm machine`: show and check the description of a machine, write a program for it."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from omm_core.errors import InputError
from omm_core.files.output import write_whole

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from omm_core.machine.kinematics import Machine

    Array = NDArray[np.float64]

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
    program = actions.add_parser("program", help="write a measuring program in G-code")
    program.add_argument("machine", type=Path, help="URDF file")
    program.add_argument("--part", type=Path, required=True, help="part.yaml")
    program.add_argument("--calibration", type=Path, required=True, help="camera.yaml")
    program.add_argument(
        "--part-at", type=float, nargs=3, required=True, metavar=("X", "Y", "Z"),
        help="roughly where the part's origin lies in the machine, mm",
    )  # fmt: skip
    program.add_argument(
        "--part-turned", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("A", "B", "G"),
        help="and how it is turned about the machine's X, Y and Z, degrees",
    )  # fmt: skip
    program.add_argument(
        "--rotary", nargs="*", default=[], metavar="AXIS=DEGREES", help="rotary axes at the stops"
    )
    program.add_argument("--stereo-base", type=float, default=120.0, help="mm (%(default)s)")
    program.add_argument("--distance", type=float, default=300.0, help="mm (%(default)s)")
    program.add_argument("--feed", type=float, default=10000.0, help="mm/min (%(default)s)")
    program.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.ngc")


def run(args: argparse.Namespace) -> int:
    """0 = done; for `show`, 1 where a check found something."""
    return _show(args) if args.action == "show" else _program(args)


def _show(args: argparse.Namespace) -> int:
    from omm_cnc_bridge.machine.check import check
    from omm_cnc_bridge.machine.drawing import draw
    from omm_core.machine.kinematics import Machine

    machine = Machine.load(args.machine)
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


def _print_pose(machine: "Machine", axes: dict[str, float]) -> None:
    for complaint in machine.out_of_limits(axes):
        print(f"  !!  {complaint}")
    pose = machine.machine_T_spindle({a.name: 0.0 for a in machine.axes} | axes)
    x, y, z = pose.translation_mm
    angles = (math.degrees(a) for a in pose.euler_xyz_rad())
    alpha, beta, gamma = angles
    print(f"spindle at {x:.4f}, {y:.4f}, {z:.4f} mm, turned {alpha:.5f}, {beta:.5f}, {gamma:.5f}°")


def _axes(words: list[str], machine: "Machine") -> dict[str, float]:
    """Positions from AXIS=VALUE, degrees to rad where the axis turns."""
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


def _program(args: argparse.Namespace) -> int:
    from omm_cnc_bridge.gcode import ProgramOptions, measuring_program, stops_for
    from omm_core.files.part import load_part
    from omm_core.geometry import RigidTransform
    from omm_core.imaging.calibration import load_calibration
    from omm_core.machine.kinematics import Machine

    machine = Machine.load(args.machine)
    part = load_part(args.part)
    options = ProgramOptions(
        distance_mm=args.distance, stereo_base_mm=args.stereo_base, feed_mm_per_min=args.feed
    )
    rotary = _axes(args.rotary, machine)
    alpha, beta, gamma = (math.radians(angle) for angle in args.part_turned)
    machine_T_part = RigidTransform.from_euler_xyz_rad(alpha, beta, gamma, args.part_at)
    at_zero = machine.machine_T_spindle({a.name: 0.0 for a in machine.axes} | rotary)
    stops = stops_for(
        part, load_calibration(args.calibration), machine_T_part, at_zero.rotation, options
    )
    moves = [_linear_axes(machine, rotary, stop.spindle_in_machine_mm) for stop in stops]
    text = measuring_program(
        [type(s)(target_id=s.target_id, spindle_in_machine_mm=m) for s, m in zip(stops, moves)],
        at_zero.rotation,
        options,
        rotary_deg=[(name, math.degrees(value)) for name, value in rotary.items()],
        title=part.name,
    )
    write_whole(args.output, text)
    print(f"{len(stops)} images of {len(part.targets)} targets in {args.output}")
    return 0


def _linear_axes(machine: "Machine", rotary: dict[str, float], spindle_mm: "Array") -> "Array":
    """X, Y, Z of the axes that bring the spindle there; refused where the machine cannot."""
    import numpy as np

    whole = {axis.name: 0.0 for axis in machine.axes if axis.rotary} | rotary
    axes = machine.axes_at_tool_point(whole, spindle_mm, 0.0, turns_with_part=True)
    if complaints := machine.out_of_limits(axes):
        raise InputError(f"The part does not lie where the machine can reach: {complaints[0]}.")
    return np.array([axes[name] for name in ("X", "Y", "Z")])
