"""What is in a recording, from its index alone: as quick for 50 GB as for one image."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omm_core.errors import InputError, warn
from omm_core.files.json_input import parse_json
from omm_recording.mcap_file import McapFile
from omm_recording.reading import Recording
from omm_recording.repairing import REPAIRED
from omm_recording.seal import CHAIN, SEAL
from omm_recording.writing import FILE_SUMS, PROVENANCE, REPORT

PARAMETERS = "omm_parameters "


@dataclass(frozen=True, kw_only=True)
class TopicSummary:
    """One topic."""

    name: str
    type_name: str
    messages: int | None
    tally: dict[str, Any]
    """What the recorder counted; empty where another program recorded."""


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    """What a recording says of itself."""

    files: tuple[Path, ...]
    size_bytes: int
    writer: str
    start_ns: int
    end_ns: int
    chunks: int
    compression: str
    topics: tuple[TopicSummary, ...]
    provenance: dict[str, str]
    ended_because: str
    queue_peak_bytes: int
    """What waited for the disk at most."""
    attached: dict[str, str]
    """SHA-256 of the files inside, by their names."""
    parameters: dict[str, dict[str, str]]
    seal: dict[str, str]
    repaired: dict[str, str]

    @property
    def duration_s(self) -> float:
        """From the first to the last message."""
        return (self.end_ns - self.start_ns) / 1e9


def inspect(run: Path) -> RunSummary:
    """Read a recording's index and its metadata.

    Raises
    ------
    InputError
        If it is not a recording, or was cut short.
    """
    with Recording(run) as recording:
        metadata = recording.metadata()
        report = metadata.get(REPORT, {})
        blocks = [block for file in recording.files for block in file.blocks(None)]
        return RunSummary(
            files=tuple(file.path for file in recording.files),
            size_bytes=sum(file.size for file in recording.files),
            writer=recording.files[0].header.library,
            start_ns=min((block.first_ns for block in blocks), default=0),
            end_ns=max((block.last_ns for block in blocks), default=0),
            chunks=len(blocks),
            compression=_compression(recording.files),
            topics=tuple(
                TopicSummary(
                    name=topic.name,
                    type_name=topic.type_name,
                    messages=topic.messages,
                    tally=_tally(report.get(topic.name, "{}")),
                )
                for topic in sorted(recording.topics.values(), key=lambda t: t.name)
            ),
            provenance=metadata.get(PROVENANCE, {}),
            ended_because=report.get("ended_because", ""),
            queue_peak_bytes=_whole(report.get("queue_peak_bytes", "0")),
            attached=_attached(recording, metadata),
            parameters={
                name.removeprefix(PARAMETERS): values
                for name, values in metadata.items()
                if name.startswith(PARAMETERS)
            },
            seal=metadata.get(SEAL, {}),
            repaired=metadata.get(REPAIRED, {}),
        )


def _tally(text: str) -> dict[str, Any]:
    """Read the recorder's counts of a topic; what is not a number is left out."""
    try:
        told = parse_json(text, "The recorder's count")
    except InputError as error:
        warn(str(error))
        return {}
    good = {k: v for k, v in told.items() if v is None or isinstance(v, int | float)}
    if len(good) < len(told):
        warn("The recorder's counts hold something that is not a number; it is left out.")
    return good


def _whole(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else 0


def _compression(files: tuple[McapFile, ...]) -> str:
    kinds = {
        chunk.compression or "none"
        for file in files
        if file.summary is not None
        for chunk in file.summary.chunk_indexes
    }
    return ", ".join(sorted(kinds)) or "none"


def _attached(recording: Recording, metadata: dict[str, dict[str, str]]) -> dict[str, str]:
    names = [name for file in recording.files for name in file.attachment_names()]
    sums = {
        name: value
        for table, values in metadata.items()
        if table.startswith(FILE_SUMS)
        for name, value in values.items()
    }
    return {name: sums.get(name, "") for name in names if name != CHAIN}
