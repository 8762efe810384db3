"""./omm info: what is in a recording."""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from omm_recording.inspecting import RunSummary, TopicSummary


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("run", metavar="RUN", type=Path, help="an MCAP file or a run's folder")
    parser.add_argument("--parameters", action="store_true", help="list the nodes' parameters too")
    parser.add_argument("--json", metavar="OUT", type=Path, help="write it all as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the summary."""
    from omm_recording.inspecting import inspect

    summary = inspect(arguments.run)
    if arguments.json is not None:
        _write_json(summary, arguments.json)
    print("\n".join(_lines(summary, arguments.parameters)))
    return 0


def _write_json(summary: "RunSummary", out: Path) -> None:
    from dataclasses import asdict

    from omm_core.files.output import write_whole

    write_whole(out, json.dumps(asdict(summary), indent=1, default=str) + "\n")


def _lines(summary: "RunSummary", with_parameters: bool) -> list[str]:
    from datetime import datetime, timezone

    start = datetime.fromtimestamp(summary.start_ns / 1e9, tz=timezone.utc).astimezone()
    who = summary.provenance
    lines = [
        f"files        {', '.join(map(str, summary.files))}",
        f"size         {summary.size_bytes / 1e6:.1f} MB in {summary.chunks} chunks, "
        f"compression {summary.compression}",
        f"when         {start.isoformat(timespec='seconds')}, {summary.duration_s:.1f} s",
        f"who          {who.get('user', '?')} on {who.get('host', '?')}, by {summary.writer}",
    ]
    versions = {k: v for k, v in who.items() if k not in ("user", "host")}
    if versions:
        lines.append("versions     " + ", ".join(f"{k} {v}" for k, v in versions.items()))
    if summary.ended_because:
        peak_mb = summary.queue_peak_bytes / 1e6
        lines.append(f"ended        {summary.ended_because}; at most {peak_mb:.0f} MB waited")
    if summary.repaired:
        lines.append(f"REPAIRED     from {summary.repaired.get('source', '?')}")
        lines += [f"             {p}" for p in summary.repaired.get("problems", "").splitlines()]
    lines += [f"contains     {name}  {digest}" for name, digest in summary.attached.items()]
    lines.append(f"seal         {_seal(summary.seal)}")
    lines += [
        "",
        _row("topic", "messages", "per s", "lost", "missing", "before first", "longest pause"),
    ]
    lines += [_topic(topic, summary.duration_s) for topic in summary.topics]
    if with_parameters:
        for node, values in summary.parameters.items():
            lines += ["", node] + [f"  {name} = {value}" for name, value in values.items()]
    return lines


def _seal(seal: dict[str, str]) -> str:
    if not seal:
        return "none"
    by = seal.get("public_key_ed25519")
    return f"{seal.get('sha256', '?')}, " + (f"signed by {by}" if by else "not signed")


def _row(*cells: str) -> str:
    name, *others = cells
    return f"{name:<26}" + "".join(f"{cell:>14}" for cell in others)


def _end_of(tally: "dict[str, object]") -> str:
    """Mark topics whose last messages may be missing; older files do not tell."""
    return "+?" if "missing_at_end" in tally and tally["missing_at_end"] is None else ""


def _topic(topic: "TopicSummary", duration_s: float) -> str:
    count = "?" if topic.messages is None else str(topic.messages)
    rate = f"{topic.messages / duration_s:.1f}" if topic.messages and duration_s > 0 else ""
    tally = topic.tally
    missing = tally.get("missing_from_publisher", "")
    pause = tally.get("longest_pause_s")
    return _row(
        topic.name,
        count,
        rate,
        str(tally.get("lost_by_recorder", "")),
        "?" if missing is None else f"{missing}{_end_of(tally)}",
        str(tally.get("published_before_first", "")),
        f"{pause:.3f} s" if pause else "",
    )
