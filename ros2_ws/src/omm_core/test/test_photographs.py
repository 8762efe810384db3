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
