"""The index at the end of an MCAP file: read where its checksum holds and it is of bounded size."""

import struct
import zlib
from collections import Counter
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Header, Schema
from mcap.summary import Summary

from omm_core.errors import InputError, warn
from omm_recording import container
from omm_recording.container import MAGIC, PREFIX, UNREADABLE

# Opcode, length, start of the summary, start of its offsets, checksum (MCAP specification).
FOOTER = struct.Struct("<BQQQI")
# More than any recording of a measurement has; a day has 350,000 chunks.
MOST_DEFINITIONS = 10_000
MOST_CHUNKS = 400_000
_MOST = {
    Opcode.SCHEMA: MOST_DEFINITIONS,
    Opcode.CHANNEL: MOST_DEFINITIONS,
    Opcode.ATTACHMENT_INDEX: MOST_DEFINITIONS,
    Opcode.METADATA_INDEX: MOST_DEFINITIONS,
    Opcode.CHUNK_INDEX: MOST_CHUNKS,
}


def read_header(file: IO[bytes]) -> Header:
    """Return the first record, who wrote the file; fails with one of UNREADABLE."""
    file.seek(0)
    return SeekingReader(file).get_header()


def read_summary(path: Path, file: IO[bytes], size: int) -> Summary | None:
    """Return the index; None where there is none to believe, and all is to be read again.

    The index decides what is read. Where its checksum does not hold that is told; a writer that
    wrote no checksum (0) is taken at its word.

    Raises
    ------
    InputError
        Where it names more than any recording has.
    """
    start = _start_of_summary(file, size)
    if start is None:
        warn(f"{path}: the index is damaged (its checksum does not hold); all is read again")
        return None
    if start == 0:
        return None
    end = size - len(MAGIC) - FOOTER.size
    try:
        _check_numbers(path, file, start, end)
        file.seek(0)
        return SeekingReader(file).get_summary()
    except UNREADABLE as error:
        warn(f"{path}: the index is damaged ({error}); all is read again")
        return None


def _start_of_summary(file: IO[bytes], size: int) -> int | None:
    """Return where the index begins, 0 where there is none, None where its checksum is wrong."""
    end = size - len(MAGIC) - FOOTER.size
    file.seek(max(0, end))
    footer = file.read(FOOTER.size)
    if end < len(MAGIC) or len(footer) < FOOTER.size:
        return None
    opcode, length, start, _, crc = FOOTER.unpack(footer)
    if (opcode, length) != (Opcode.FOOTER, FOOTER.size - PREFIX.size):
        return None
    if start and not len(MAGIC) <= start <= end:
        return None
    if crc:
        file.seek(start or end)
        if zlib.crc32(file.read(end - (start or end)) + footer[:-4]) != crc:
            return None
    return int(start)


def _check_numbers(path: Path, file: IO[bytes], start: int, end: int) -> None:
    counts: Counter[int] = Counter()
    for record in container.records(file, start, end):
        counts[record.opcode] += 1
        check_number(path, record.opcode, counts[record.opcode])


def check_number(path: Path, opcode: int, number: int) -> None:
    """Raise InputError where a file has more of a kind of record than any recording has."""
    most = _MOST.get(Opcode(opcode)) if opcode in _MOST else None
    if most is not None and number > most:
        raise InputError(
            f"{path} names more than {most} {Opcode(opcode).name.lower()} records: that is not a"
            f" recording of a measurement."
        )


class Definitions:
    """Schemas and channels as they are found, of a bounded number."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._counts: Counter[int] = Counter()
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}

    def take(self, opcode: int, data: bytes | memoryview) -> None:
        """Take a record, of any kind."""
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
            return
        self._counts[opcode] += 1
        check_number(self._path, opcode, self._counts[opcode])
        if opcode == Opcode.SCHEMA:
            schema = container.read_schema(data)
            self.schemas[schema.id] = schema
        else:
            channel = container.read_channel(data)
            self.channels[channel.id] = channel
