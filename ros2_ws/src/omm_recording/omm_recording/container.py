"""The records of an MCAP file, one by one, where the `mcap` library wants the whole of it.

The library reads sound files. A file that was cut short by a power failure, one whose checksums
are in question and one that is searched without copying its images need the records themselves:
an opcode (1 byte), a length (8 bytes) and the content.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

LARGEST_RECORD = 1 << 30
LARGEST_CHUNK = 512 << 20
"""Uncompressed; an image of 150 MP with 16 bits has 300 MB."""
MAGIC = b"\x89MCAP0\r\n"
PREFIX = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")
# Times of the first and last message, uncompressed size, checksum.
CHUNK = struct.Struct("<QQQI")


class CutShort(Exception):
    """The file ends inside a record, or what follows is not a record."""

    def __init__(self, offset: int) -> None:
        super().__init__(f"cut short at byte {offset}")
        self.offset = offset


class Damaged(Exception):
    """The content of a record is not what was written."""


# What reading a damaged file ends in, by where the damage is: ours, the mcap library's, and those
# of what it uses.
UNREADABLE = (
    CutShort, Damaged, McapError, struct.error, ValueError, KeyError, IndexError, TypeError,
    OverflowError, MemoryError, OSError, EOFError,
)  # fmt: skip


class Record(NamedTuple):
    """Where one record lies: `start` is the offset of its content, `length` the content's size."""

    opcode: int
    start: int
    length: int

    @property
    def end(self) -> int:
        """Offset of the record after it."""
        return self.start + self.length


class ChunkHeader(NamedTuple):
    """What a chunk says of itself before its content."""

    first_ns: int
    last_ns: int
    uncompressed_size: int
    crc: int
    compression: str
    data_start: int
    data_size: int


def records(file: IO[bytes], start: int, end: int) -> Iterator[Record]:
    """Walk over the records between two offsets, without reading what is in them.

    Raises
    ------
    CutShort
        Where a record does not fit before `end`, or has an opcode that MCAP does not know.
    """
    offset = start
    while offset < end:
        file.seek(offset)
        prefix = file.read(PREFIX.size)
        if len(prefix) < PREFIX.size:
            raise CutShort(offset)
        opcode, length = PREFIX.unpack(prefix)
        # Opcodes from 0x80 are private ones of other programs, to be passed over (specification).
        known = Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= 0x80
        if not known or offset + PREFIX.size + length > end:
            raise CutShort(offset)
        record = Record(opcode, offset + PREFIX.size, length)
        yield record
        offset = record.end


def content(file: IO[bytes], record: Record) -> bytes:
    """Return the content of a record."""
    if record.length > LARGEST_RECORD:
        raise Damaged(
            f"the record at byte {record.start - PREFIX.size} is larger than any real one"
        )
    file.seek(record.start)
    data = file.read(record.length)
    if len(data) != record.length:
        raise CutShort(record.start - PREFIX.size)
    return data


def check_prefix(file: IO[bytes], record: Record) -> None:
    """Make sure that a record stands where an index says.

    Raises
    ------
    Damaged
        If not.
    """
    file.seek(record.start - PREFIX.size)
    if file.read(PREFIX.size) != PREFIX.pack(record.opcode, record.length):
        raise Damaged(f"there is no record at byte {record.start - PREFIX.size}, as the index says")


def stream(data: bytes | memoryview) -> ReadDataStream:
    """Return the bytes as the `mcap` library's record classes read them."""
    return ReadDataStream(BytesIO(data))


def chunk_header(file: IO[bytes], record: Record) -> ChunkHeader:
    """Read the head of a chunk, not its data."""
    file.seek(record.start)
    head = file.read(min(record.length, CHUNK.size + 4 + 64))
    try:
        first_ns, last_ns, size, crc = CHUNK.unpack_from(head)
        (name_length,) = struct.unpack_from("<I", head, CHUNK.size)
        name_end = CHUNK.size + 4 + name_length
        compression = head[CHUNK.size + 4 : name_end].decode()
        (data_size,) = struct.unpack_from("<Q", head, name_end)
    except (struct.error, UnicodeDecodeError) as error:
        raise Damaged(f"the chunk at byte {record.start} has no readable head") from error
    start = record.start + name_end + 8
    if start + data_size > record.end:
        raise Damaged(f"the chunk at byte {record.start} says that it is longer than it is")
    return ChunkHeader(first_ns, last_ns, size, crc, compression, start, data_size)


def chunk_data(file: IO[bytes], head: ChunkHeader) -> memoryview:
    """Return the records in a chunk, decompressed, with the checksum checked.

    Raises
    ------
    Damaged
        If it does not decompress, or the checksum differs.
    """
    if max(head.uncompressed_size, head.data_size) > LARGEST_CHUNK:
        raise Damaged(
            f"the chunk at byte {head.data_start} says that it holds {head.uncompressed_size} bytes"
        )
    file.seek(head.data_start)
    raw = file.read(head.data_size)
    data = decompress(raw, head.compression, head.uncompressed_size)
    if len(data) != head.uncompressed_size or (head.crc and zlib.crc32(data) != head.crc):
        raise Damaged(f"the chunk at byte {head.data_start} has another checksum than was written")
    return memoryview(data)


def decompress(raw: bytes, compression: str, size: int) -> bytes:
    """Undo a chunk's compression; `size` is what it must become, and no more is made."""
    try:
        if compression == "":
            return raw
        if compression == "zstd":
            return unzstd(raw, size)
        if compression == "lz4":
            import lz4.frame

            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(raw, max_length=size + 1))
    except Exception as error:  # zstd and lz4 have no common base of their errors
        raise Damaged(f"{compression} data do not decompress: {error}") from error
    raise Damaged(f"expected a chunk without compression, or lz4 or zstd, got {compression!r}")


def unzstd(raw: bytes | memoryview, size: int) -> bytes:
    """Undo zstd, to at most `size` + 1 bytes: what a frame says of its size is not believed."""
    import zstandard

    with zstandard.ZstdDecompressor().stream_reader(raw) as reader:
        return reader.read(size + 1)


def records_in_chunk(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the records in a chunk's data as (opcode, content), without copying.

    Raises
    ------
    CutShort
        Where a record does not fit; those before it have been given.
    """
    offset = 0
    while offset < len(data):
        if offset + PREFIX.size > len(data):
            raise CutShort(offset)
        opcode, length = PREFIX.unpack_from(data, offset)
        start = offset + PREFIX.size
        offset = start + length
        if offset > len(data):
            raise CutShort(start - PREFIX.size)
        yield opcode, data[start:offset]


def read_schema(data: bytes | memoryview) -> Schema:
    """Return a schema from a record's content."""
    return Schema.read(stream(data))


def read_channel(data: bytes | memoryview) -> Channel:
    """Return a channel from a record's content."""
    return Channel.read(stream(data))


_OTHERS = (
    (b"SQLite f", " It is of sqlite3: ros2 bag convert, or rosbags-convert --dst-storage mcap."),
    (b"#ROSBAG ", " It is a bag of ROS 1: rosbags-convert --dst-storage mcap makes one of ROS 2."),
    (b"\x1f\x8b", " It is compressed by gzip: gunzip it first."),
    (b"PK\x03\x04", " It is a zip file: unzip it first."),
)


def what_it_is(start: bytes) -> str:
    """Return what a file is by its first 8 bytes, and the way to a recording."""
    known = next((words for sign, words in _OTHERS if start.startswith(sign)), "")
    return known or (" It is a text file." if start.isascii() and start else "")
