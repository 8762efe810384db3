"""What is taken out of a recording is what was in it."""

import csv
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from omm_recording.decoding import image_pixels, stamp_ns
from omm_recording.reading import Recording
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
    from omm_recording.writing import RecordingOptions, RecordingWriter

    writer = RecordingWriter(tmp_path / "run" / "run.mcap", RecordingOptions())
    writer.add_topic(topics[0])
    writer.add_file("../../evil.yaml", b"x", 1)
    export(writer.close({}), tmp_path / "out")
    assert (tmp_path / "out" / "evil.yaml").read_bytes() == b"x"
    assert not (tmp_path / "evil.yaml").exists()
