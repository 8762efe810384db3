"""A changed bit gives the same content, or words that say what is wrong: never other content."""

import dataclasses
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from omm_core.errors import InputError
from omm_recording.reading import Recording
from omm_recording.summary_section import Contents, ending

DATA_END = b"\x0f" + struct.pack("<Q", 4)

MAGIC_BYTES = 8
FOOTER_BYTES = 29
NOT_READ = ("omm_seal", "rosbag2")
"""The seal is compared by `verify`; the other is for rosbag2."""


def everything(path: Path) -> tuple[object, ...]:
    """What a solution depends on: all messages, and the files inside."""
    with Recording(path) as recording:
        messages = [(m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages()]
        tables = {name: t for name, t in recording.metadata().items() if name not in NOT_READ}
        # Without an index nobody has counted the messages; they are all there.
        topics = {n: dataclasses.replace(t, messages=None) for n, t in recording.topics.items()}
        return messages, recording.attachment("part.yaml"), tables, topics


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


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_a_changed_bit_anywhere_changes_nothing_unseen(
    record: Any, capsys: pytest.CaptureFixture[str], compression: str
) -> None:
    """In definitions, heads of chunks, poses, tables, chain, seal and statistics."""
    path = record(compression=compression)
    data = path.read_bytes()
    sound = everything(path)
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    image = max(chunks, key=lambda chunk: chunk.chunk_length)
    small = [c for c in chunks if c.chunk_length < image.chunk_length // 2]
    places = bits(0, small[0].chunk_start_offset, 300)
    for chunk in small[:2]:
        places += bits(chunk.chunk_start_offset, chunk.chunk_start_offset + 60, 100)
        places += bits(chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length, 60)
    places += bits(image.chunk_start_offset, image.chunk_start_offset + 60, 60)
    end_of_chunks = max(c.chunk_start_offset + c.chunk_length for c in chunks)
    places += bits(end_of_chunks, summary_start(data), 300)
    capsys.readouterr()
    for bit in places:
        path.write_bytes(flipped(data, bit))
        try:
            found = everything(path)
        except InputError:
            continue  # said what was wrong
        told = "omm: warning: " in capsys.readouterr().err
        assert told or found == sound, f"byte {bit // 8} of {len(data)}"


@pytest.mark.parametrize("kind", ["chunk", "attachment", "metadata", "channel"])
def test_an_index_that_leaves_something_out_is_told(record: Any, kind: str) -> None:
    """Made anew with sound checksums, as a program that drops things would."""
    path = record()
    data = path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    contents = Contents(
        schemas=dict(summary.schemas),
        channels=dict(summary.channels),
        chunks=list(summary.chunk_indexes),
        attachments=list(summary.attachment_indexes),
        metadata=list(summary.metadata_indexes),
        counts=dict(summary.statistics.channel_message_counts),
    )
    if kind == "channel":
        first = min(contents.channels)
        contents.channels[first] = dataclasses.replace(contents.channels[first], topic="/other")
    else:
        {
            "chunk": contents.chunks,
            "attachment": contents.attachments,
            "metadata": contents.metadata,
        }[kind].pop(0)
    end = data.index(DATA_END, summary_start(data) - 40)
    path.write_bytes(data[:end] + ending(contents, end))
    with pytest.raises(InputError, match="index"):
        everything(path)


def test_a_sound_recording_is_read_without_a_warning(
    record: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    everything(record())
    assert capsys.readouterr().err == ""
