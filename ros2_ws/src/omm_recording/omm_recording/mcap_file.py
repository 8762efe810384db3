"""One MCAP file: its index and its messages, also where the writer made no index."""

import itertools
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.summary import Summary

from omm_core.errors import InputError, warn
from omm_recording import container
from omm_recording.chained import Chain
from omm_recording.container import MAGIC, MESSAGE, PREFIX, UNREADABLE, Damaged, Record, what_it_is
from omm_recording.seal import CHAIN, parsed_chain
from omm_recording.summary_reading import Definitions, read_header, read_summary


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

    Parameters
    ----------
    path, file
        The file, and the same open.
    compare
        Whether to compare what is read with omm's checksum chain, where it has one.

    Raises
    ------
    InputError
        If it is not an MCAP file, or was cut short.
    """

    def __init__(self, path: Path, file: IO[bytes], *, compare: bool = True) -> None:
        self.path = path
        self._file = file
        self._check_ends()
        with self._damage_told():
            self.header = read_header(file)
        self.summary = summary = read_summary(path, file, self.size)
        self._chain: Chain | None = None
        self._blocks: list[Block] = []
        self.channels: dict[int, ChannelInfo] = {}
        self.counts: dict[int, int] | None = None
        with self._damage_told():
            self._chain = self._read_chain() if compare else None
            if summary is not None and _complete(summary):
                self._take_index(summary)
            else:
                self._scan()

    @contextmanager
    def _damage_told(self) -> Iterator[None]:
        try:
            yield
        except UNREADABLE as error:
            why = str(error) or type(error).__name__
            raise InputError(
                f"{self.path} is damaged: {why}. What is sound in it is brought into a new file by"
                f" ./omm repair {self.path}"
            ) from error

    def _read_chain(self) -> Chain | None:
        """Return the checksum chain of what omm recorded; None where there is none to believe."""
        bodies = [self._content(record) for record in self._standing(Opcode.ATTACHMENT)]
        # The name stands behind two times and its length; of others the content may be damaged.
        named = [body for body in bodies if body[20 : 20 + len(CHAIN)] == CHAIN.encode()]
        if not named:
            return None
        try:
            chain = Chain(self._file, parsed_chain(self._attached(named[-1]).data))
        except InputError as error:
            warn(f"{error} Nothing else in it is compared with its checksum.")
            return None
        if chain.begins_well():
            return chain
        warn(
            f"{self.path}: its beginning is not as omm sealed it (changed, or written anew by"
            f" {self.header.library or 'another program'}); its checksums are not compared"
        )
        return None

    def _check_ends(self) -> None:
        size = self._file.seek(0, 2)
        self._file.seek(0)
        start = self._file.read(len(MAGIC))
        if start != MAGIC[: len(start)] or not start:
            raise InputError(
                f"Expected an MCAP recording, but {self.path} is not one.{what_it_is(start)}"
            )
        self._file.seek(max(0, size - len(MAGIC)))
        if size <= len(MAGIC) or self._file.read() != MAGIC:
            raise InputError(
                f"{self.path} was cut short: its end is missing ({size} bytes are there). "
                f"What can be read of it is brought into a new file by ./omm repair {self.path}"
            )
        self.size = size

    def _take_index(self, summary: Summary) -> None:
        if self._chain is not None:
            self._compare_with_chain(self._chain, summary)
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

    def _compare_with_chain(self, chain: Chain, summary: Summary) -> None:
        """Make sure that the index names what was sealed: no more, no less, no other."""
        places = {
            Opcode.CHUNK: [chunk.chunk_start_offset for chunk in summary.chunk_indexes],
            Opcode.ATTACHMENT: [entry.offset for entry in summary.attachment_indexes],
            Opcode.METADATA: [entry.offset for entry in summary.metadata_indexes],
        }
        for opcode, offsets in places.items():
            chain.check_index(opcode, offsets)
        schemas = [container.read_schema(d) for d in self._sealed(chain, Opcode.SCHEMA)]
        channels = [container.read_channel(d) for d in self._sealed(chain, Opcode.CHANNEL)]
        if {s.id: s for s in schemas} != summary.schemas or {
            c.id: c for c in channels
        } != summary.channels:
            raise Damaged("the index describes other topics than were recorded")

    def _sealed(self, chain: Chain, opcode: int) -> Iterator[bytes]:
        """Yield the contents of the records of a kind, each as it was sealed."""
        for offset in chain.blocks(opcode):
            chain.check(offset)
            (record,) = itertools.islice(container.records(self._file, offset, self.size), 1)
            yield container.content(self._file, record)

    def _scan(self) -> None:
        """Make the index that the writer left out, from the heads of all records."""
        found = Definitions(self.path)
        for record in container.records(self._file, len(MAGIC), self.size - len(MAGIC)):
            if record.opcode == Opcode.DATA_END:
                break
            if record.opcode in _BLOCKS:
                self._check_sealed(record)
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                found.take(record.opcode, container.content(self._file, record))
            elif record.opcode == Opcode.CHUNK:
                head = container.chunk_header(self._file, record)
                self._blocks.append(Block(head.first_ns, head.last_ns, record, None))
                for opcode, data in container.records_in_chunk(
                    container.chunk_data(self._file, head)
                ):
                    found.take(opcode, data)
            elif record.opcode == Opcode.MESSAGE:
                self._file.seek(record.start)
                identifier, _, log_ns, _ = MESSAGE.unpack(self._file.read(MESSAGE.size))
                self._blocks.append(Block(log_ns, log_ns, record, frozenset([identifier])))
        self._take_channels(found.schemas, found.channels)

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
        """Yield the blocks that may hold messages of these topics."""
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
        """Yield a block's messages: channel, sequence, log and publish time (ns), data.

        Raises
        ------
        InputError
            If the block is not as it was written.
        """
        with self._damage_told():
            if block.record.opcode == Opcode.MESSAGE:
                data = memoryview(container.content(self._file, block.record))
                yield (*MESSAGE.unpack_from(data), data[MESSAGE.size :])
                return
            # Where the file system left a hole, the index points to zeros: they are no empty chunk.
            container.check_prefix(self._file, block.record)
            self._check_sealed(block.record)
            head = container.chunk_header(self._file, block.record)
            for opcode, data in container.records_in_chunk(container.chunk_data(self._file, head)):
                if opcode == Opcode.MESSAGE:
                    yield (*MESSAGE.unpack_from(data), data[MESSAGE.size :])

    def _check_sealed(self, record: Record) -> None:
        """Compare a block with its checksum; chain, seal and index come after what is chained."""
        chain, offset = self._chain, record.start - PREFIX.size
        if chain is not None and offset < chain.end:
            chain.check(offset)

    def attachments(self) -> Iterator[Attached]:
        """Return the files inside the recording.

        Raises
        ------
        InputError
            Where a file's checksum does not hold: it is not as it was written.
        """
        for record in self._standing(Opcode.ATTACHMENT):
            yield self._attached(self._content(record))

    def _attached(self, body: bytes) -> Attached:
        crc = int.from_bytes(body[-4:], "little")
        if crc and zlib.crc32(body[:-4]) != crc:
            raise InputError(
                f"{self.path} is damaged: a file inside it is not as it was recorded, its checksum"
                " does not hold. Name the file to use on the command line."
            )
        with self._damage_told():
            attachment = Attachment.read(container.stream(body))
        return Attached(
            attachment.name, attachment.media_type, attachment.log_time, attachment.data
        )

    def attachment_names(self) -> list[str]:
        """Return the names of the files inside, without reading them where there is an index."""
        if self.summary is not None:
            return [entry.name for entry in self.summary.attachment_indexes]
        return [attached.name for attached in self.attachments()]

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata records, by their names; the last of a name counts."""
        with self._damage_told():
            read = [
                Metadata.read(container.stream(self._content(record)))
                for record in self._standing(Opcode.METADATA)
            ]
        return {record.name: record.metadata for record in read}

    def _standing(self, opcode: Opcode) -> Iterator[Record]:
        """Yield where the records of a kind stand, by the index or by walking over all."""
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
        with self._damage_told():
            container.check_prefix(self._file, record)
            self._check_sealed(record)
            return container.content(self._file, record)


_BLOCKS = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA)
"""What the chain has a link for each."""


def _complete(summary: Summary) -> bool:
    """Return whether the summary suffices to find every message."""
    if summary.statistics is None:
        return False
    in_chunks = bool(summary.chunk_indexes) or summary.statistics.message_count == 0
    return in_chunks and len(summary.channels) == summary.statistics.channel_count
