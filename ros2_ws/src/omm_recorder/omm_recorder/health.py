"""What the recorder says of its health."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from omm_core.words import Words, keyed, listed, sentences, verbatim
from omm_recorder.recording_state import RecordingState
from omm_ros.diagnostics import ERROR, OK, WARN, Health

_NEEDED = ("part.yaml", "camera.yaml")
_ALL = keyed("said.all_recorded", "all is recorded")


def recording_health(
    state: RecordingState,
    file: Path,
    *,
    unread: Sequence[str],
    attached: Sequence[str],
    unknown: Sequence[str],
    interrupted: Sequence[str] = (),
) -> Health:
    """Return whether all is recorded, and what is not.

    Parameters
    ----------
    state : RecordingState
        How the writing is doing.
    file : Path
        Where the recording will be.
    unread : sequence of str
        Why files could not be attached.
    attached : sequence of str
        Names of the files that are.
    unknown : sequence of str
        Topics whose type is not known here.
    interrupted : sequence of str
        Earlier recordings in the folder that nobody closed or repaired.
    """
    lost = state.lost + state.missing
    level = ERROR if not state.recording else WARN if lost or state.trouble else OK
    message = state.trouble or (_lost(lost) if lost else _ALL)
    if unread and level == OK:
        level, message = WARN, sentences(unread)
    missing = [name for name in _NEEDED if name not in attached]
    if missing and level == OK:
        level, message = WARN, _missing(listed(missing))
    if unknown and level == OK:
        level, message = WARN, _not_recorded(listed(unknown))
    if interrupted and level == OK:
        level, message = WARN, _interrupted(interrupted[0])
    values = {
        "file": str(file),
        "written [MB]": f"{state.bytes_written / 1e6:.1f}",
        "rate [MB/s]": f"{state.bytes_per_s / 1e6:.1f}",
        "waiting [MB]": f"{state.queue_bytes / 1e6:.1f}",
        "free [GB]": f"{state.free_bytes / 1e9:.1f}",
        "left [min]": f"{state.left_s / 60.0:.0f}",
        "received": state.received,
        "lost here": state.lost,
        "missing from publishers": state.missing,
        "files": ", ".join(attached) or "none yet",
        "interrupted": ", ".join(interrupted) or "none",
    }
    return Health(level=level, message=message, values=values)


def _missing(files: Words) -> Words:
    return keyed(
        "said.files_missing",
        "not in the recording, which cannot be solved without: {files}",
        files=files,
    )


def _not_recorded(names: Words) -> Words:
    return keyed("said.not_recorded", "not recorded: {names}", names=names)


def _interrupted(file: str) -> Words:
    return keyed(
        "said.interrupted",
        "all is recorded; an earlier recording was interrupted: ./omm repair {file}",
        file=verbatim(file),
    )


def _lost(count: int) -> Words:
    return keyed("said.messages_lost", "{n} messages lost", n=count)
