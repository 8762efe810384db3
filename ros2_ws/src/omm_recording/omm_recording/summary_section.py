"""The end of an MCAP file: what stands in it, and where.

The writer makes it from what it wrote, `repair` from what it found, and `verify` once more to
compare it with what the file says; so it has one source.
"""

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from omm_recording.container import MAGIC


@dataclass
class Contents:
    """What has been written so far. It grows with every record."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    first_ns: int | None = None
    last_ns: int = 0

    def count_chunk(self, chunk: ChunkIndex, counts: dict[int, int]) -> None:
        """Take in a chunk with its number of messages by channel."""
        self.chunks.append(chunk)
        for channel, number in counts.items():
            self.counts[channel] = self.counts.get(channel, 0) + number
        first_ns = chunk.message_start_time
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = max(self.last_ns, chunk.message_end_time)

    def statistics(self) -> Statistics:
        """Return the statistics record."""
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=self.counts,
            chunk_count=len(self.chunks),
            message_count=sum(self.counts.values()),
            message_end_time=self.last_ns,
            message_start_time=self.first_ns or 0,
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )


def ending(contents: Contents, offset: int) -> bytes:
    """Return everything from the end of the data to the end of the file.

    Parameters
    ----------
    contents
        What stands before.
    offset
        Where in the file this will stand.
    """
    data_end = serialised(DataEnd(0))
    start = offset + len(data_end)
    groups: list[tuple[Opcode, Iterable[Any]]] = [
        (Opcode.SCHEMA, contents.schemas.values()),
        (Opcode.CHANNEL, contents.channels.values()),
        (Opcode.STATISTICS, [contents.statistics()]),
        (Opcode.CHUNK_INDEX, contents.chunks),
        (Opcode.ATTACHMENT_INDEX, contents.attachments),
        (Opcode.METADATA_INDEX, contents.metadata),
    ]
    summary = bytearray()
    offsets = bytearray()
    for opcode, group in groups:
        data = b"".join(serialised(record) for record in group)
        if data:
            offsets += serialised(SummaryOffset(opcode, start + len(summary), len(data)))
            summary += data
    offsets_start = start + len(summary)
    summary += offsets
    # The checksum covers the summary and the footer up to the checksum itself.
    footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start)
    crc = zlib.crc32(footer_head, zlib.crc32(summary))
    footer = serialised(Footer(start, offsets_start, crc))
    return b"".join((data_end, bytes(summary), footer, MAGIC))


def serialised(record: Any) -> bytes:
    """Return the bytes of one of the `mcap` library's records."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
