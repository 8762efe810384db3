"""Takes a recording apart: images as PNG, with what was found drawn in, and tables as CSV."""

import csv
import io
import re
import stat
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from omm_core.errors import InputError
from omm_core.files.output import write_whole
from omm_recording.decoding import image_pixels, stamp_ns
from omm_recording.reading import Recording
from omm_recording.run_files import find_run

IMAGES = "/camera/image_raw"
POSES = "/cnc/spindle_pose"
OBSERVATIONS = "/omm/observations"
ESTIMATE = "/omm/estimate"

_USED = (80, 220, 80)
_UNUSED = (60, 60, 255)
_RESIDUAL = (0, 200, 255)
# PNG's quickest: higher levels save a few per cent of a noisy image and take ten times as long.
_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


@dataclass(frozen=True, kw_only=True)
class Mark:
    """One target to draw into an image."""

    target_id: int
    center_px: tuple[float, float]
    residual_px: tuple[float, float] | None
    used: bool


def export(
    run: Path,
    folder: Path,
    marks: dict[int, list[Mark]] | None = None,
    *,
    overlay: bool = True,
    residual_scale: float = 1000.0,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Write images and tables of a recording into a folder; returns what was written.

    Parameters
    ----------
    marks
        What to draw, by the images' stamps (ns); what was recorded where not given.
    overlay
        Whether to draw at all; without, the PNG holds exactly the recorded pixels.
    residual_scale
        How many times residuals are enlarged.
    progress
        Called with each file's name.
    """
    if folder.resolve() == find_run(run).folder.resolve():
        raise InputError(
            f"Expected another folder than the run's own, got {folder}: an export must not lie "
            "over the recording and its files."
        )
    _make_empty(folder, find_run(run).recordings[0].stat().st_mode)
    written: list[Path] = []

    def write(name: str, content: str | bytes) -> None:
        write_whole(folder / name, content)
        written.append(folder / name)
        progress(name)

    with Recording(run) as recording:
        if marks is None:
            marks = recorded_marks(recording)
        for attached in recording.attachments():
            write(_name_of(attached.name, written), attached.data)
        if POSES in recording.topics:
            write("poses.csv", _table(_POSE_COLUMNS, _pose_rows(recording)))
        if OBSERVATIONS in recording.topics:
            write("observations.csv", _table(_OBSERVATION_COLUMNS, _observation_rows(recording)))
        elif marks:
            write("observations.csv", _table(_MARK_COLUMNS, _mark_rows(marks)))
        for message in recording.messages([IMAGES]):
            image = recording.decode(message)
            stamp = stamp_ns(image)
            pixels = image_pixels(image)
            drawn = draw(pixels, marks.get(stamp, []), residual_scale) if overlay else pixels
            ok, data = cv2.imencode(".png", drawn, _PNG)
            if not ok:
                raise InputError(f"The image of {stamp} cannot be written as PNG.")
            write(f"{stamp}.png", data.tobytes())
    return written


def _make_empty(folder: Path, mode: int) -> None:
    """Make the folder, or take an empty one: nothing that is there is written over.

    Who may not read the recording (``mode``) may not enter the folder.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        own = stat.S_IMODE(folder.stat().st_mode)
        folder.chmod(own & (0o700 | 0o070 * bool(mode & 0o040) | 0o007 * bool(mode & 0o004)))
        there = next(folder.iterdir(), None)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot export to {folder}: {error}.") from error
    if there is not None:
        raise InputError(
            f"Expected a new or an empty folder, got {folder}, where {there.name} is already."
            " An export overwrites nothing: name another folder."
        )


def _name_of(attached: str, written: Sequence[Path]) -> str:
    """Return the name of a file from a recording: a plain one, and no other file's."""
    # What is in a file must not choose where it is written, nor hide it.
    plain = re.sub(r"[^\w .+()=,-]", "_", attached.replace("\\", "/").rpartition("/")[2])
    plain = plain.lstrip(".").strip()[:100] or "attached"
    name, number = plain, 1
    while name in {*(path.name for path in written), "poses.csv", "observations.csv"}:
        number += 1
        name = f"{number}_{plain}"
    return name


def recorded_marks(recording: Recording) -> dict[int, list[Mark]]:
    """Return what the live estimator found, with residuals as of its last estimate."""
    last = None
    if ESTIMATE in recording.topics:
        for message in recording.messages([ESTIMATE]):
            last = message
    if last is not None:
        return _marks_of_estimate(recording.decode(last))
    marks: dict[int, list[Mark]] = {}
    if OBSERVATIONS in recording.topics:
        for message in recording.messages([OBSERVATIONS]):
            found = recording.decode(message)
            marks[stamp_ns(found)] = [
                Mark(target_id=t.id, center_px=(t.col_px, t.row_px), residual_px=None, used=True)
                for t in found.targets
            ]
    return marks


def _marks_of_estimate(estimate: Any) -> dict[int, list[Mark]]:
    marks: dict[int, list[Mark]] = {}
    for o in estimate.observations:
        stamp = o.stamp.sec * 1_000_000_000 + o.stamp.nanosec
        residual = (float(o.residual_px[0]), float(o.residual_px[1]))
        marks.setdefault(stamp, []).append(
            Mark(
                target_id=o.target_id,
                center_px=(o.col_px, o.row_px),
                residual_px=residual if np.isfinite(residual).all() else None,
                used=bool(o.used),
            )
        )
    return marks


def draw(
    pixels: NDArray[np.generic], marks: Sequence[Mark], residual_scale: float
) -> NDArray[np.uint8]:
    """Draw targets, their numbers and enlarged residuals.

    Returns
    -------
    (height, width, 3) uint8, blue-green-red
    """
    gray = pixels if pixels.dtype == np.uint8 else (pixels >> 8).astype(np.uint8)  # type: ignore
    canvas: NDArray[np.uint8] = cv2.cvtColor(np.ascontiguousarray(gray), cv2.COLOR_GRAY2BGR)
    size = max(1, round(canvas.shape[1] / 1300))
    for mark in marks:
        color = _USED if mark.used else _UNUSED
        x, y = round(mark.center_px[0]), round(mark.center_px[1])
        cv2.drawMarker(canvas, (x, y), color, cv2.MARKER_CROSS, 30 * size, size)
        cv2.circle(canvas, (x, y), 60 * size, color, size, cv2.LINE_AA)
        if mark.residual_px is not None:
            dx, dy = (round(v * residual_scale) for v in mark.residual_px)
            cv2.arrowedLine(canvas, (x, y), (x + dx, y + dy), _RESIDUAL, size, cv2.LINE_AA)
        place = (x + 65 * size, y - 40 * size)
        cv2.putText(canvas, str(mark.target_id), place, cv2.FONT_HERSHEY_SIMPLEX, size, color, size)
    return canvas


def _table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return text.getvalue()


_POSE_COLUMNS = ("stamp_ns", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")


def _pose_rows(recording: Recording) -> Iterable[Sequence[object]]:
    for message in recording.messages([POSES]):
        pose = recording.decode(message)
        p, q = pose.pose.position, pose.pose.orientation
        yield (stamp_ns(pose), p.x * 1000.0, p.y * 1000.0, p.z * 1000.0, q.x, q.y, q.z, q.w)


_OBSERVATION_COLUMNS = (
    "stamp_ns",
    "target_id",
    "col_px",
    "row_px",
    "covariance_cc_px2",
    "covariance_cr_px2",
    "covariance_rr_px2",
    "diameter_px",
)


def _observation_rows(recording: Recording) -> Iterable[Sequence[object]]:
    for message in recording.messages([OBSERVATIONS]):
        found = recording.decode(message)
        for t in found.targets:
            c = [float(v) for v in t.covariance_px2]
            yield (stamp_ns(found), t.id, t.col_px, t.row_px, c[0], c[1], c[3], t.diameter_px)


_MARK_COLUMNS = (
    "stamp_ns",
    "target_id",
    "col_px",
    "row_px",
    "residual_col_px",
    "residual_row_px",
    "used",
)


def _mark_rows(marks: dict[int, list[Mark]]) -> Iterable[Sequence[object]]:
    for stamp, found in sorted(marks.items()):
        for m in found:
            residual = m.residual_px or ("", "")
            yield (stamp, m.target_id, *m.center_px, *residual, m.used)
