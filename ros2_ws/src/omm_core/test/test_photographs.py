"""Photographs are read whole and as stored, or refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from omm_core.errors import InputError
from omm_core.imaging.photographs import read_grey


def _jpeg() -> bytes:
    pixels = np.random.default_rng(3).integers(0, 255, (120, 160), dtype=np.uint8)
    return bytes(cv2.imencode(".jpg", cv2.GaussianBlur(pixels, (0, 0), 2.0))[1])


def test_bytes_behind_the_end_of_a_jpeg_change_nothing(tmp_path: Path) -> None:
    whole, longer = tmp_path / "a.jpg", tmp_path / "b.jpg"
    whole.write_bytes(_jpeg())
    longer.write_bytes(_jpeg() + b"video" * 4000)
    assert np.array_equal(read_grey(whole), read_grey(longer))


@pytest.mark.parametrize("share", [0.5, 0.8, 0.97])
@pytest.mark.parametrize("end", [b"", b"\xff\xd9"])
def test_a_jpeg_cut_short_is_refused_even_where_it_was_ended(
    tmp_path: Path, share: float, end: bytes
) -> None:
    data = _jpeg()
    path = tmp_path / "cut.jpg"
    path.write_bytes(data[: int(share * len(data))] + end)
    with pytest.raises(InputError, match="cut off"):
        read_grey(path)


def test_a_png_is_whole_up_to_its_end_chunk(tmp_path: Path) -> None:
    data = bytes(cv2.imencode(".png", np.eye(40, dtype=np.uint8))[1])
    path = tmp_path / "a.png"
    path.write_bytes(data + b"behind" * 2000)
    assert read_grey(path).shape == (40, 40)
    path.write_bytes(data[:-20])
    with pytest.raises(InputError, match="cut off"):
        read_grey(path)


def test_orientation_turns_nothing(tmp_path: Path) -> None:
    from PIL import Image

    exif = Image.Exif()
    exif[0x0112] = 6
    path = tmp_path / "turned.jpg"
    Image.fromarray(np.zeros((30, 50), dtype=np.uint8)).save(path, exif=exif)
    assert read_grey(path).shape == (30, 50)


def _drawn(colour: bool, **options: object) -> bytes:
    import io

    from PIL import Image

    pixels = np.random.default_rng(3).integers(0, 255, (121, 165, 3), dtype=np.uint8)
    image = Image.fromarray(cv2.GaussianBlur(pixels, (0, 0), 2.0))
    stream = io.BytesIO()
    (image if colour else image.convert("L")).save(stream, "JPEG", **options)
    return stream.getvalue()


RESTARTS = {"restart_marker_blocks": 5}


def _marked(data: bytes, markers: range) -> list[int]:
    return [i for i in range(len(data) - 1) if data[i] == 0xFF and data[i + 1] in markers]


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("more", [{}, {"progressive": True}, {"subsampling": "4:2:2"}])
def test_restart_markers_and_scans_of_a_whole_jpeg_do_no_harm(tmp_path, colour, more):
    path = tmp_path / "a.jpg"
    path.write_bytes(_drawn(colour, **RESTARTS, **more))
    assert read_grey(path).shape == (121, 165)


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("progressive", [False, True])
def test_a_jpeg_that_lacks_an_interval_is_refused(tmp_path, colour, progressive):
    """OpenCV reads each of them, and fills what is missing with grey."""
    data = _drawn(colour, progressive=progressive, **RESTARTS)
    marks = _marked(data, range(0xD0, 0xD8))
    middle = len(marks) // 2
    cut = data[: marks[middle]] + b"\xff\xd9"
    lost = data[: marks[middle]] + data[marks[middle + 1] :]
    hole = data[: marks[middle] + 2] + data[marks[middle + 1] :]
    path = tmp_path / "a.jpg"
    for damaged in (cut, lost, hole):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="cut off"):
            read_grey(path)


def test_a_progressive_jpeg_that_lacks_its_last_scans_is_refused(tmp_path):
    data = _drawn(True, progressive=True)
    path = tmp_path / "a.jpg"
    for scan in _marked(data, range(0xDA, 0xDB))[1:]:
        path.write_bytes(data[:scan] + b"\xff\xd9")
        with pytest.raises(InputError, match="never came to their last bit"):
            read_grey(path)
