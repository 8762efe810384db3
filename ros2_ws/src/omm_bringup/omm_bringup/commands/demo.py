"""`./omm demo`: measure a part in a simulated cell, from nothing to the result."""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from omm_core.errors import InputError, MeasurementError

if TYPE_CHECKING:
    from omm_interfaces.msg import PartEstimate
    from rich.console import Console

    from omm_bringup.processes import RunningNode
    from omm_core.session.result import MeasurementResult
    from omm_simulation.cell import Cell


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `demo`."""
    parser.add_argument(
        "--scenario", default="bench", help="bench, industrial, or a scenario folder (%(default)s)"
    )
    parser.add_argument("--seed", type=int, default=None, help="repeat a run (default: a new one)")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the result as JSON")
    parser.add_argument(
        "--folder", type=Path, help="where to leave the run (default: runs/DATE-SCENARIO-SEED)"
    )
    parser.add_argument("--camera", choices=("simulated", "gige"), default="simulated")
    parser.add_argument("--control", choices=("simulated", "linuxcnc"), default="simulated")
    parser.add_argument(
        "--screen", action="store_true", help="serve the operator's page, and stay until Ctrl-C"
    )
    parser.add_argument("--port", type=int, default=8765, help="of the page (%(default)s)")


def run(args: argparse.Namespace) -> int:
    """Run the cell; 0 where a result came out."""
    from omm_ros import transport
    from omm_ros.environment import check_environment

    check_environment(discovery=False)
    transport.prepare()
    from rich.console import Console

    from omm_bringup.cell import operators_page, simulated_cell
    from omm_bringup.isolation import own_domain
    from omm_bringup.processes import running
    from omm_core.files.output import write_whole
    from omm_report.run_picture import save_run_picture
    from omm_report.solution_text import solution_lines
    from omm_runs.solving import SolveRunOptions, solve_run
    from omm_simulation.cell import add_wishes, draw, write_estimator_files, write_truth
    from omm_simulation.scenario import load_scenario

    console = Console(stderr=True)
    seed = int(time.time()) % 100_000 if args.seed is None else args.seed
    cell = draw(load_scenario(args.scenario), seed)
    folder = _run_folder(args.folder, cell.scenario.name, seed)
    part_file, _ = write_estimator_files(cell, folder)
    if args.screen:
        add_wishes(part_file, cell)
    console.print(f"omm: scenario {cell.scenario.name}, seed {seed}, run folder {folder}")

    specs = simulated_cell(
        folder, scenario=args.scenario, seed=seed, camera=args.camera, control=args.control
    )
    if args.screen:
        specs = (*specs, operators_page(folder, port=args.port, stops=len(cell.stops)))
    with own_domain(), running(specs, folder / "log") as nodes:
        live = _measure(nodes, console)
        if args.screen:
            _stay(nodes, console, args.port, cell)
    # Written only now: nobody who measured could have looked.
    write_truth(cell, folder / "truth.json")

    solved = solve_run(folder / "run.mcap", SolveRunOptions())
    print("\n".join(solution_lines(solved)))
    # From the page, more may have been measured since.
    equal = args.screen or _tell_whether_equal(console, live, solved.result)
    picture = save_run_picture(solved, folder / "run.png")
    console.print(f"omm: recording {folder / 'run.mcap'}")
    console.print(f"omm: picture   {picture}")
    if args.json:
        content = {
            "result": solved.result.to_json_dict(),
            "truth": cell.theta_own(),
            "truth_absolute": cell.theta(),
            "seed": seed,
        }
        write_whole(args.json, json.dumps(content, indent=1) + "\n")
    return 0 if equal else 1


def _run_folder(chosen: Path | None, scenario: str, seed: int) -> Path:
    from omm_core.files.output import take_folder

    stamp = time.strftime("%Y%m%d-%H%M%S")
    folder = chosen or Path("runs") / f"{stamp}-{scenario}-{seed}"
    take_folder(folder)
    if (folder / "run.mcap").exists():
        raise InputError(f"Expected a folder without a recording, got {folder}: name another.")
    return folder.resolve()


def _measure(nodes: "Sequence[RunningNode]", console: "Console") -> "PartEstimate":
    """Play the operator; returns the last live estimate."""
    from omm_bringup.processes import check_alive
    from omm_operator.measuring import measure_alone

    try:
        return measure_alone(console, lambda: check_alive(nodes))
    except MeasurementError as error:
        logs = nodes[0].log_file.parent
        raise MeasurementError(f"{error} The nodes' logs lie in {logs}.") from error


def _stay(nodes: "Sequence[RunningNode]", console: "Console", port: int, cell: "Cell") -> None:
    """Let the page be used until Ctrl-C; turn the simulated jacks as it says."""
    import rclpy
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions

    from omm_bringup.processes import check_alive
    from omm_bringup.simulated_jacks import SimulatedJacks
    from omm_ros.interrupt import told_to_end

    console.print(f"omm: the operator's page is at http://127.0.0.1:{port}/ (Ctrl-C ends)")
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        with told_to_end() as ended:
            node = Node("simulated_jacks")
            hands = SimulatedJacks(node, cell.machine_T_part)
            while not ended.is_set():
                rclpy.spin_once(node, timeout_sec=0.2)
                check_alive(nodes)
            del hands
    finally:
        rclpy.try_shutdown()


def _tell_whether_equal(
    console: "Console", live: "PartEstimate", result: "MeasurementResult"
) -> bool:
    """Compare the live estimate with the one solved from the recording."""
    from omm_estimator.conversions import expanded_uncertainty_si, theta_si

    own, absolute = result.solution.own, result.solution.absolute
    solved = [theta_si(own), expanded_uncertainty_si(own), theta_si(absolute)]
    told = [live.theta, live.expanded_uncertainty, live.absolute_theta]
    equal = [[float(v) for v in of] for of in told] == [of.tolist() for of in solved]
    words = "equal to the live estimate, to the bit" if equal else "NOT equal to the live estimate"
    console.print(f"omm: solved again from the recording: {words}")
    return equal
