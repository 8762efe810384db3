"""One MCAP file: its index and its messages, also where the writer made no index."""

import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.summary import Summary

from omm_core.errors import InputError, warn
from omm_recording import container
from omm_recording.container import MAGIC, MESSAGE, PREFIX, CutShort, Damaged, Record

# Opcode, length, start of the summary, start of its offsets, checksum (MCAP specification).
FOOTER = struct.Struct("<BQQQI")


class Block(NamedTuple):
    """A stretch of the file that is read in one go: a chunk, or a message outside of chunks."""

    first_ns: int
    last_ns: int
    record: Record
    channels: frozenset[int] | None
    """Channels in it; None where the file does not tell."""


class Attached(NamedTuple):
    """A file inside the recording."""

    name: str
    media_type: str
    log_time_ns: int
    data: bytes


@dataclass(frozen=True, kw_only=True)
class ChannelInfo:
    """A channel with its schema."""

    name: str
    type_name: str
    encoding: str
    definition_encoding: str
    definition: str
    metadata: dict[str, str]


class McapFile:
    """An MCAP file, open for reading.

    Raises
    ------
    InputError
        If it is no MCAP file, or was cut short.
    """

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self.path = path
        self._file = file
        self._check_ends()
        try:
            file.seek(0)
            self._reader = SeekingReader(file)
            self.header = self._reader.get_header()
            summary = self._reader.get_summary() if self._summary_is_sound() else None
        except (McapError, ValueError, KeyError, OSError) as error:
            raise InputError(f"{path} is damaged: {error}. Try ./omm repair {path}") from error
        self.summary = summary
        self._blocks: list[Block] = []
        self.channels: dict[int, ChannelInfo] = {}
        self.counts: dict[int, int] | None = None
        if summary is not None and _complete(summary):
            self._take_index(summary)
        else:
            self._scan()

    def _check_ends(self) -> None:
        size = self._file.seek(0, 2)
        self._file.seek(0)
        start = self._file.read(len(MAGIC))
        if start != MAGIC[: len(start)] or not start:
            hint = " It is a text file." if start.isascii() and start else ""
            raise InputError(f"Expected an MCAP recording, {self.path} is not one.{hint}")
        self._file.seek(max(0, size - len(MAGIC)))
        if size <= len(MAGIC) or self._file.read() != MAGIC:
            raise InputError(
                f"{self.path} was cut short: its end is missing ({size} bytes are there). "
                f"What can be read of it is brought into a new file by ./omm repair {self.path}"
            )
        self.size = size

    def _summary_is_sound(self) -> bool:
        """Whether the footer's checksum holds. The index decides what is read: it is not believed.

        Where it does not hold the index is made anew from the records themselves. A writer that
        wrote no checksum (0) is taken at its word.
        """
        self._file.seek(max(0, self.size - len(MAGIC) - FOOTER.size))
        footer = self._file.read(FOOTER.size)
        start, crc = 0, -1
        if len(footer) == FOOTER.size:
            opcode, length, start, _, crc = FOOTER.unpack(footer)
            if (opcode, length) != (Opcode.FOOTER, FOOTER.size - PREFIX.size):
                crc = -1
        if crc == 0:
            return True
        end = self.size - len(MAGIC) - FOOTER.size
        if crc > 0 and len(MAGIC) <= (start or end) <= end:
            self._file.seek(start or end)
            covered = self._file.read(end - (start or end)) + footer[:-4]
            if zlib.crc32(covered) == crc:
                return True
        warn(f"{self.path}: the index is damaged (its checksum does not hold); all is read again")
        return False

    def _take_index(self, summary: Summary) -> None:
        self._take_channels(summary.schemas, summary.channels)
        for chunk in summary.chunk_indexes:
            prefix = container.PREFIX.size
            start, length = chunk.chunk_start_offset + prefix, chunk.chunk_length - prefix
            # Without message indexes the writer did not say which channels are in the chunk.
            channels = frozenset(chunk.message_index_offsets) or None
            record = Record(Opcode.CHUNK, start, length)
            self._blocks.append(
                Block(chunk.message_start_time, chunk.message_end_time, record, channels)
            )
        if summary.statistics is not None:
            self.counts = dict(summary.statistics.channel_message_counts)

    def _scan(self) -> None:
        """Make the index that the writer left out, from the heads of all records."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        try:
            for record in container.records(self._file, len(MAGIC), self.size - len(MAGIC)):
                if record.opcode == Opcode.SCHEMA:
                    schema = container.read_schema(container.content(self._file, record))
                    schemas[schema.id] = schema
                elif record.opcode == Opcode.CHANNEL:
                    channel = container.read_channel(container.content(self._file, record))
                    channels[channel.id] = channel
                elif record.opcode == Opcode.CHUNK:
                    head = container.chunk_header(self._file, record)
                    self._blocks.append(Block(head.first_ns, head.last_ns, record, None))
                    self._definitions_in_chunk(head, schemas, channels)
                elif record.opcode == Opcode.MESSAGE:
                    self._file.seek(record.start)
                    identifier, _, log_ns, _ = MESSAGE.unpack(self._file.read(MESSAGE.size))
                    self._blocks.append(Block(log_ns, log_ns, record, frozenset([identifier])))
                elif record.opcode == Opcode.DATA_END:
                    break
        except (CutShort, Damaged, McapError) as error:
            raise InputError(
                f"{self.path} is damaged: {error}. Try ./omm repair {self.path}"
            ) from error
        self._take_channels(schemas, channels)

    def _definitions_in_chunk(
        self, head: container.ChunkHeader, schemas: dict[int, Schema], channels: dict[int, Channel]
    ) -> None:
        for opcode, data in container.records_in_chunk(container.chunk_data(self._file, head)):
            if opcode == Opcode.SCHEMA:
                schema = container.read_schema(data)
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = container.read_channel(data)
                channels[channel.id] = channel

    def _take_channels(self, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
        for identifier, channel in channels.items():
            schema = schemas.get(channel.schema_id)
            self.channels[identifier] = ChannelInfo(
                name=channel.topic,
                type_name=schema.name if schema else "",
                encoding=channel.message_encoding,
                definition_encoding=schema.encoding if schema else "",
                definition=schema.data.decode(errors="replace") if schema else "",
                metadata=channel.metadata,
            )

    def blocks(self, topics: Collection[str] | None) -> Iterator[Block]:
        """The blocks that may hold messages of these topics."""
        if topics is None:
            yield from self._blocks
            return
        wanted = {
            identifier for identifier, channel in self.channels.items() if channel.name in topics
        }
        for block in self._blocks:
            if block.channels is None or block.channels & wanted:
                yield block

    def messages_in(self, block: Block) -> Iterator[tuple[int, int, int, int, memoryview]]:
        """The messages of a block: channel, sequence, log and publish time (ns), data.

        Raises
        ------
        InputError
            If the block is not as it was written.
        """
        try:
            if block.record.opcode == Opcode.MESSAGE:
                data = memoryview(container.content(self._file, block.record))
                yield (*MESSAGE.unpack_from(data), data[MESSAGE.size :])
                return
            # Where the file system left a hole, the index points to zeros: they are no empty chunk.
            container.check_prefix(self._file, block.record)
            head = container.chunk_header(self._file, block.record)
            for opcode, data in container.records_in_chunk(container.chunk_data(self._file, head)):
                if opcode == Opcode.MESSAGE:
                    yield (*MESSAGE.unpack_from(data), data[MESSAGE.size :])
        except (CutShort, Damaged, OSError) as error:
            raise InputError(
                f"{self.path} is damaged: {error}. What is sound in it is brought into "
                f"a new file by ./omm repair {self.path}"
            ) from error

    def attachments(self) -> Iterator[Attached]:
        """The files inside the recording.

        Raises
        ------
        InputError
            Where a file's checksum does not hold: it is not as it was written.
        """
        for record in self._standing(Opcode.ATTACHMENT):
            body = self._content(record)
            crc = int.from_bytes(body[-4:], "little")
            if crc and zlib.crc32(body[:-4]) != crc:
                raise InputError(
                    f"{self.path} is damaged: a file inside it (at byte {record.start}) is not as"
                    " it was recorded, its checksum does not hold. Name the file to use on the"
                    " command line."
                )
            attachment = Attachment.read(container.stream(body))
            yield Attached(
                attachment.name, attachment.media_type, attachment.log_time, attachment.data
            )

    def attachment_names(self) -> list[str]:
        """The names of the files inside, without reading them where there is an index."""
        if self.summary is not None:
            return [entry.name for entry in self.summary.attachment_indexes]
        return [attached.name for attached in self.attachments()]

    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata records, by their names; the last of a name counts."""
        read = (
            Metadata.read(container.stream(self._content(record)))
            for record in self._standing(Opcode.METADATA)
        )
        return {record.name: record.metadata for record in read}

    def _standing(self, opcode: Opcode) -> Iterator[Record]:
        """Where the records of a kind stand, by the index or by walking over all records."""
        summary = self.summary
        if summary is None or (summary.statistics is None):
            for record in container.records(self._file, len(MAGIC), self.size - len(MAGIC)):
                if record.opcode == Opcode.DATA_END:
                    return
                if record.opcode == opcode:
                    yield record
            return
        files = opcode == Opcode.ATTACHMENT
        for entry in summary.attachment_indexes if files else summary.metadata_indexes:
            prefix = PREFIX.size
            yield Record(opcode, entry.offset + prefix, entry.length - prefix)

    def _content(self, record: Record) -> bytes:
        try:
            container.check_prefix(self._file, record)
            return container.content(self._file, record)
        except (CutShort, Damaged) as error:
            raise InputError(
                f"{self.path} is damaged: {error}. Try ./omm repair {self.path}"
            ) from error


def _complete(summary: Summary) -> bool:
    """Whether the summary suffices to find every message."""
    if summary.statistics is None:
        return False
    in_chunks = bool(summary.chunk_indexes) or summary.statistics.message_count == 0
    return in_chunks and len(summary.channels) == summary.statistics.channel_count
