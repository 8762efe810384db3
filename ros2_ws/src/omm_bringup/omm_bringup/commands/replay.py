"""./omm replay: publish a recording to the live nodes."""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("run", metavar="RUN", type=Path, help="an MCAP file or a run's folder")
    parser.add_argument("--rate", type=float, default=1.0, help="times faster than recorded")
    parser.add_argument("--loop", action="store_true", help="start again at the end")
    parser.add_argument(
        "--start", metavar="S", type=float, default=0.0, help="seconds to leave out at the start"
    )
    parser.add_argument("--pause", action="store_true", help="start paused (space continues)")
    parser.add_argument(
        "--topics",
        nargs="+",
        default=[],
        metavar="TOPIC",
        help="what to publish (default: what cameras and controls published)",
    )
    parser.add_argument("--all", action="store_true", help="publish every recorded topic")
    parser.add_argument("--no-clock", action="store_true", help="do not publish /clock")
    parser.add_argument(
        "--wait",
        metavar="S",
        type=float,
        default=5.0,
        help="how long to wait for listeners before the start",
    )


def run(arguments: argparse.Namespace) -> int:
    """Replay from beginning to end."""
    from omm_ros import transport
    from omm_ros.environment import check_environment

    check_environment()
    transport.prepare()
    from rclpy.parameter import Parameter

    from omm_recorder.replay import replay

    values = {
        "run": str(arguments.run),
        "rate": arguments.rate,
        "loop": arguments.loop,
        "start_s": arguments.start,
        "pause": arguments.pause,
        "all_topics": arguments.all,
        "clock": not arguments.no_clock,
        "wait_s": arguments.wait,
    }
    if arguments.topics:
        values["topics"] = arguments.topics
    return replay([Parameter(name, value=value) for name, value in values.items()], [])
