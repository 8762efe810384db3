"""./omm export: images and tables out of a recording."""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("run", metavar="RUN", type=Path, help="an MCAP file or a run's folder")
    parser.add_argument(
        "-o", "--output", metavar="FOLDER", type=Path, help="default: export, beside the recording"
    )
    parser.add_argument(
        "--plain", action="store_true", help="images exactly as recorded, nothing drawn in"
    )
    parser.add_argument(
        "--scale", type=float, default=1000.0, help="how many times residuals are enlarged"
    )


def run(arguments: argparse.Namespace) -> int:
    """Export; what is drawn is what was recorded, or else what solving finds."""
    from omm_recording.run_files import find_run
    from omm_runs.exporting import export

    folder = arguments.output or find_run(arguments.run).folder / "export"
    marks = None if arguments.plain else _marks(arguments.run)
    written = export(
        arguments.run,
        folder,
        marks,
        overlay=not arguments.plain,
        residual_scale=arguments.scale,
    )
    print(f"{len(written)} files in {folder}")
    return 0


def _marks(run: Path):  # type: ignore[no-untyped-def]
    """Return what to draw: nothing where the recording itself tells it."""
    from omm_core.errors import InputError, warn
    from omm_recording.reading import Recording
    from omm_runs.exporting import ESTIMATE, OBSERVATIONS, Mark

    with Recording(run) as recording:
        if any((t := recording.topics.get(n)) and t.messages for n in (ESTIMATE, OBSERVATIONS)):
            return None
    from omm_runs.solving import solve_run

    try:
        result = solve_run(run).result
    except InputError as error:
        warn(f"no targets are drawn: {error}")
        return {}
    marks: dict[int, list[Mark]] = {}
    for o in result.observations:
        residual = o.residual_px if all(v == v for v in o.residual_px) else None
        marks.setdefault(o.stamp_ns, []).append(
            Mark(target_id=o.target_id, center_px=o.center_px, residual_px=residual, used=o.used)
        )
    return marks
