"""What is taken out of a recording is what was in it."""

import csv
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from omm_core.errors import InputError
from omm_recording.decoding import image_pixels, stamp_ns
from omm_recording.reading import Recording
from omm_recording.run_files import find_run
from omm_recording.writing import RecordingOptions, RecordingWriter
from omm_runs.exporting import Mark, draw, export


def test_plain_images_and_files_come_out_exactly(record: Any, tmp_path: Path) -> None:
    run = record()
    export(run, tmp_path / "out", overlay=False)
    with Recording(run) as recording:
        for message in recording.messages(["/camera/image_raw"]):
            image = recording.decode(message)
            path = tmp_path / "out" / f"{stamp_ns(image)}.png"
            assert np.array_equal(cv2.imread(str(path), -1), image_pixels(image))
    assert (tmp_path / "out" / "part.yaml").read_text() == "part: {name: plate}\n"


def test_poses_come_out_in_millimetres(record: Any, tmp_path: Path) -> None:
    export(record(), tmp_path / "out")
    with (tmp_path / "out" / "poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 200
    assert float(rows[150]["x_mm"]) == 150.0
    assert float(rows[150]["qw"]) == 1.0


def test_residuals_are_drawn_from_the_target_enlarged() -> None:
    mark = Mark(target_id=7, center_px=(100.0, 60.0), residual_px=(0.05, 0.0), used=True)
    picture = draw(np.zeros((120, 240), np.uint8), [mark], 1000.0).astype(int)
    # Smoothed edges: close to the arrow's colour is its colour.
    yellow = np.argwhere(np.abs(picture - (0, 200, 255)).max(axis=2) < 40)
    assert abs(yellow[:, 1].max() - 150) <= 1
    assert abs(yellow[:, 1].min() - 100) <= 1


def test_names_inside_do_not_lead_outside(tmp_path: Path, topics: Any) -> None:
    writer = RecordingWriter(tmp_path / "run" / "run.mcap", RecordingOptions())
    writer.add_topic(topics[0])
    writer.add_file("../../evil.yaml", b"x", 1)
    export(writer.close({}), tmp_path / "out")
    assert (tmp_path / "out" / "evil.yaml").read_bytes() == b"x"
    assert not (tmp_path / "evil.yaml").exists()


def test_an_export_writes_over_nothing(record: Any, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "part.yaml").write_text("mine")
    run = record()
    with pytest.raises(InputError, match="empty folder"):
        export(run, tmp_path / "out")
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["part.yaml"]
    assert (tmp_path / "out" / "part.yaml").read_text() == "mine"
    with pytest.raises(InputError, match="Cannot export"):
        export(run, tmp_path / "out" / "part.yaml")


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "a/..", ".bashrc", "a\0b", "poses.csv", "\x1b[2J", "a\\..\\b", "é" * 300],
)
def test_whatever_a_file_inside_is_called_it_comes_out_under_a_name_of_its_own(
    name: str, tmp_path: Path, topics: Any, messages: Any
) -> None:
    writer = RecordingWriter(tmp_path / "run" / "run.mcap", RecordingOptions())
    for topic in topics:
        writer.add_topic(topic)
    for text in (b"one", b"two"):
        writer.add_file(name, text, 1)
    writer.write("/cnc/spindle_pose", 1, 1, 1, messages.pose(1, 0.0))
    export(writer.close({}), tmp_path / "out")
    found = {p.name: p.read_bytes() for p in (tmp_path / "out").iterdir()}
    assert set(found) > {"poses.csv"}
    assert {b"one", b"two"} < set(found.values())
    assert len(found) == 4  # and the chain of hashes
    assert not any(n.startswith(".") or not n.isprintable() for n in found)


def test_who_may_not_read_a_recording_may_not_read_what_came_out(
    record: Any, tmp_path: Path
) -> None:
    run = record()
    find_run(run).recordings[0].chmod(0o600)
    export(run, tmp_path / "out")
    assert (tmp_path / "out").stat().st_mode & 0o077 == 0
