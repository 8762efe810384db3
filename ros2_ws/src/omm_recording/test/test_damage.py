"""A changed bit gives the same content, or words that say what is wrong: never other content."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from omm_core.errors import InputError
from omm_recording.reading import Recording

MAGIC_BYTES = 8
FOOTER_BYTES = 29


def everything(path: Path) -> tuple[object, ...]:
    """What a solution depends on: all messages, and the files inside."""
    with Recording(path) as recording:
        messages = [(m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages()]
        return messages, recording.attachment("part.yaml")


def bits(start: int, end: int, count: int) -> list[int]:
    """Bits of the bytes from start to end, drawn without repeats."""
    random = np.random.default_rng(5)
    whole = 8 * (end - start)
    drawn = random.choice(whole, size=min(count, whole), replace=False)
    return [8 * start + int(bit) for bit in drawn]


def flipped(data: bytes, bit: int) -> bytes:
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << (bit % 8)
    return bytes(changed)


def summary_start(data: bytes) -> int:
    at = len(data) - MAGIC_BYTES - FOOTER_BYTES + 9
    return int(struct.unpack_from("<Q", data, at)[0])


def test_a_changed_bit_of_a_file_inside_is_told(record: Any, tmp_path: Path) -> None:
    path = record()
    data = path.read_bytes()
    with path.open("rb") as file:
        indexes = make_reader(file).get_summary().attachment_indexes
    index = next(index for index in indexes if index.name == "part.yaml")
    told = 0
    places = bits(index.offset, index.offset + index.length, 600)
    for bit in places:
        path.write_bytes(flipped(data, bit))
        with pytest.raises(InputError, match=r"damaged|differs"), Recording(path) as recording:
            recording.attachment("part.yaml")
        told += 1
    assert told == len(places)


def test_a_changed_bit_of_the_index_changes_nothing_unseen(
    record: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    path = record()
    data = path.read_bytes()
    sound = everything(path)
    capsys.readouterr()
    for bit in bits(summary_start(data), len(data), 400):
        path.write_bytes(flipped(data, bit))
        try:
            found = everything(path)
        except InputError:
            continue  # said what was wrong
        assert found == sound, f"bit {bit}"
        assert "omm: warning: " in capsys.readouterr().err, f"bit {bit}"


def test_a_sound_recording_is_read_without_a_warning(
    record: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    everything(record())
    assert capsys.readouterr().err == ""
