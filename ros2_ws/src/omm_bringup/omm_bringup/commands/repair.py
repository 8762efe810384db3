"""./omm repair: make a recording that was cut short readable."""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "recording", metavar="FILE", type=Path, help="an MCAP file, or its folder; never changed"
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="OUT",
        type=Path,
        help="where the repaired one goes (run.mcap for run.mcap.unfinished, "
        "otherwise NAME.repaired.mcap beside it)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Repair and tell what was found."""
    from omm_core.errors import InputError
    from omm_recording.repairing import repair, repaired_name
    from omm_recording.run_files import to_repair

    source: Path = arguments.recording
    if source.is_dir():
        source = to_repair(source)
    if not source.is_file():
        raise InputError(f"Expected an MCAP file, got {source}, which does not exist.")
    target = arguments.output or repaired_name(source)
    recovered = repair(source, target)
    for problem in recovered.problems:
        print(f"omm: {problem}")
    print(f"omm: {recovered.messages} messages are in {target}; {source} is as it was.")
    return 0
