"""Writes MCAP so that whatever happens, what has been written stays readable.

The `mcap` library's writer copies a message five times and cannot go on after a write that failed.
Here a chunk goes to the file in one call from where its messages lie; a chunk that does not fit
is taken back as a whole; and every block is linked into a checksum chain as it is written.

Large messages (images) are chunks of their own, small ones (poses) are gathered: so one image is
found without unpacking another, and all poses without unpacking any image.
"""

import hashlib
import io
import os
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
)

from omm_core.errors import InputError
from omm_recording.container import CHUNK, MAGIC, MESSAGE, PREFIX
from omm_recording.summary_section import Contents, ending, serialised

LARGE_BYTES = 256 << 10
CHUNK_BYTES = 1 << 20
COMPRESSIONS = ("none", "lz4", "zstd")
# Level 1 packs images of the paper's camera to 0.47 at 330 MB/s; the library's default, level 3,
# to 0.48 at 94 MB/s.
ZSTD_LEVEL = 1


@dataclass(frozen=True, kw_only=True)
class Link:
    """One block of the file in the checksum chain: SHA-256 of the link before it and its bytes."""

    offset: int
    length: int
    sha256: str


@dataclass
class _Chunk:
    """A chunk that is being gathered."""

    parts: list[bytes | bytearray | memoryview] = field(default_factory=list)
    size: int = 0
    first_ns: int = 0
    last_ns: int = 0
    index: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def add(self, data: bytes | memoryview) -> None:
        """Append bytes; small ones are gathered in one buffer."""
        self.size += len(data)
        if len(data) >= LARGE_BYTES:
            self.parts.append(data)
        else:
            if not self.parts or not isinstance(self.parts[-1], bytearray):
                self.parts.append(bytearray())
            self.parts[-1] += data  # type: ignore[operator]


class McapWriter:
    """Writes one MCAP file with profile ``ros2``. Not to be used by two threads at once.

    Parameters
    ----------
    file
        Open for writing, unbuffered and empty.
    compression
        ``none``, ``lz4`` or ``zstd``.
    library
        Who writes, for the header.
    """

    def __init__(self, file: io.FileIO, *, compression: str, library: str) -> None:
        if compression not in COMPRESSIONS:
            raise InputError(f"Expected one of {', '.join(COMPRESSIONS)}, got {compression!r}.")
        self._file = file
        self._compression = "" if compression == "none" else compression
        self._contents = Contents()
        self._chunk = _Chunk()
        self.offset = 0
        self.links: list[Link] = []
        self._schema_ids: dict[str, int] = {}
        self._append([MAGIC, serialised(Header("ros2", library))])

    @property
    def contents(self) -> Contents:
        """What has been written."""
        return self._contents

    @property
    def pending(self) -> bool:
        """Whether messages wait for their chunk to be written."""
        return self._chunk.size > 0

    def add_channel(
        self,
        topic: str,
        type_name: str,
        definition: str,
        metadata: dict[str, str],
        definition_encoding: str = "ros2msg",
    ) -> int:
        """Add a topic; returns its channel's number."""
        if type_name not in self._schema_ids:
            number = len(self._schema_ids) + 1
            schema = Schema(
                id=number, name=type_name, encoding=definition_encoding, data=definition.encode()
            )
            # Outside of chunks: a file that is cut short anywhere tells what its messages mean.
            self._append([serialised(schema)])
            self._contents.schemas[number] = schema
            self._schema_ids[type_name] = number
        identifier = len(self._contents.channels) + 1
        channel = Channel(
            id=identifier,
            topic=topic,
            message_encoding="cdr",
            metadata=metadata,
            schema_id=self._schema_ids[type_name],
        )
        self._append([serialised(channel)])
        self._contents.channels[identifier] = channel
        return identifier

    def add_message(
        self, channel: int, sequence: int, log_ns: int, publish_ns: int, data: bytes | memoryview
    ) -> None:
        """Add a message. `data` is written from where it lies, at the latest by `flush`."""
        large = len(data) >= LARGE_BYTES
        chunk = _Chunk() if large else self._chunk
        if not chunk.index:
            chunk.first_ns = chunk.last_ns = log_ns
        chunk.first_ns = min(chunk.first_ns, log_ns)
        chunk.last_ns = max(chunk.last_ns, log_ns)
        chunk.index.setdefault(channel, []).append((log_ns, chunk.size))
        chunk.add(
            PREFIX.pack(Opcode.MESSAGE, MESSAGE.size + len(data))
            + MESSAGE.pack(channel, sequence & 0xFFFFFFFF, log_ns, publish_ns)
        )
        chunk.add(data)
        if large:
            self._write_chunk(chunk)
        elif chunk.size >= CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write the messages that wait. Where that fails they keep waiting."""
        if self._chunk.size:
            self._write_chunk(self._chunk)
            self._chunk = _Chunk()

    def drop_pending(self) -> int:
        """Drop the messages that wait; return how many."""
        number = sum(map(len, self._chunk.index.values()))
        self._chunk = _Chunk()
        return number

    def add_attachment(self, name: str, media_type: str, time_ns: int, data: bytes) -> None:
        """Put a file into the recording."""
        attachment = Attachment(
            create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data
        )
        record = serialised(attachment)
        offset = self._append([record])
        self._contents.attachments.append(
            AttachmentIndex(
                offset=offset,
                length=len(record),
                log_time=time_ns,
                create_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Put a named table into the recording."""
        record = serialised(Metadata(name=name, metadata=values))
        offset = self._append([record])
        self._contents.metadata.append(MetadataIndex(offset=offset, length=len(record), name=name))

    def finish(self) -> None:
        """Write the index. The file is complete then; it is not closed."""
        self.flush()
        self._append([ending(self._contents, self.offset)])

    def _write_chunk(self, chunk: _Chunk) -> None:
        crc = 0
        for part in chunk.parts:
            crc = zlib.crc32(part, crc)
        parts = self._compressed(chunk.parts)
        size = sum(map(len, parts))
        name = self._compression.encode()
        head = CHUNK.pack(chunk.first_ns, chunk.last_ns, chunk.size, crc)
        head += struct.pack("<I", len(name)) + name + struct.pack("<Q", size)
        prefix = PREFIX.pack(Opcode.CHUNK, len(head) + size)
        length = len(prefix) + len(head) + size
        indexes = [_message_index(channel, entries) for channel, entries in chunk.index.items()]
        start = self._append([prefix + head, *parts, b"".join(indexes)])
        offsets = {}
        offset = start + length
        for channel, index in zip(chunk.index, indexes):
            offsets[channel] = offset
            offset += len(index)
        entry = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=start,
            compression=self._compression,
            compressed_size=size,
            message_end_time=chunk.last_ns,
            message_index_length=offset - start - length,
            message_index_offsets=offsets,
            message_start_time=chunk.first_ns,
            uncompressed_size=chunk.size,
        )
        self._contents.count_chunk(entry, {c: len(e) for c, e in chunk.index.items()})

    def _compressed(
        self, parts: Sequence[bytes | bytearray | memoryview]
    ) -> Sequence[bytes | bytearray | memoryview]:
        if self._compression == "zstd":
            import zstandard

            compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
            return [compressor.compress(b"".join(parts))]
        if self._compression == "lz4":
            import lz4.frame

            return [lz4.frame.compress(b"".join(parts))]
        return parts

    def _append(self, parts: Sequence[bytes | bytearray | memoryview]) -> int:
        """Write a block as a whole or not at all, and link it into the chain; returns its offset.

        Raises
        ------
        OSError
            If it cannot be written; the file then ends where it ended before.
        """
        start = self.offset
        try:
            written = _write_all(self._file.fileno(), parts)
        except OSError:
            os.ftruncate(self._file.fileno(), start)
            os.lseek(self._file.fileno(), start, os.SEEK_SET)
            raise
        digest = hashlib.sha256(bytes.fromhex(self.links[-1].sha256) if self.links else b"")
        for part in parts:
            digest.update(part)
        self.links.append(Link(offset=start, length=written, sha256=digest.hexdigest()))
        self.offset += written
        return start


def _write_all(descriptor: int, parts: Sequence[bytes | bytearray | memoryview]) -> int:
    """Write all parts one after the other; returns how many bytes that were."""
    waiting = [memoryview(part) for part in parts if len(part)]
    total = sum(len(part) for part in waiting)
    while waiting:
        written = os.writev(descriptor, waiting[:64])
        while waiting and written >= len(waiting[0]):
            written -= len(waiting.pop(0))
        if written:
            waiting[0] = waiting[0][written:]
    return total


def _message_index(channel: int, entries: list[tuple[int, int]]) -> bytes:
    """Return where the messages of one channel stand in the chunk, as MCAP writes it."""
    values = [value for entry in entries for value in entry]
    data = struct.pack(f"<{len(values)}Q", *values)
    head = PREFIX.pack(Opcode.MESSAGE_INDEX, 6 + len(data)) + struct.pack("<HI", channel, len(data))
    return head + data
