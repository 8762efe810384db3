"""Makes a sound recording of what can be read of another; the original is never touched."""

import os
import re
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from omm_core.errors import InputError
from omm_recording import container
from omm_recording.container import MAGIC, MESSAGE, PREFIX, ChunkHeader, CutShort, Damaged, Record
from omm_recording.new_file import being_written
from omm_recording.rosbag2_format import parsed_qos
from omm_recording.run_files import UNFINISHED, open_recording
from omm_recording.seal import CHAIN, SEAL
from omm_recording.writing import (
    RecordingOptions,
    RecordingWriter,
    TopicToRecord,
)

REPAIRED = "omm_repaired"
# These describe the original file as a whole; the new one gets its own.
_OF_THE_FILE = frozenset({"rosbag2", SEAL, REPAIRED})
# A chunk's opcode, and a length below 4 GB.
_CHUNK_PATTERN = re.compile(rb"\x06.{4}\x00{4}", re.DOTALL)
_WINDOW_BYTES = 8 << 20


@dataclass
class Recovered:
    """What was found."""

    messages: int = 0
    problems: list[str] = field(default_factory=list)


@dataclass
class _Definitions:
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    written: dict[int, str] = field(default_factory=dict)


def repaired_name(source: Path) -> Path:
    """Return where the repaired recording goes, if not told otherwise."""
    if source.name.endswith(UNFINISHED):
        return source.with_name(source.name.removesuffix(UNFINISHED))
    return source.with_name(f"{source.stem}.repaired.mcap")


def repair(source: Path, target: Path) -> Recovered:
    """Write all that is sound in `source` into the new file `target`.

    Raises
    ------
    InputError
        If `source` is no MCAP file or is still being written, or `target` is there already.
    """
    with open_recording(source) as file:
        size = file.seek(0, 2)
        file.seek(0)
        if file.read(len(MAGIC)) != MAGIC:
            raise InputError(f"Expected an MCAP recording, but {source} does not begin like one.")
        if being_written(source):
            raise InputError(f"{source} is still being written; stop its recorder first.")
        writer = RecordingWriter(
            target,
            RecordingOptions(compression=_compression(file, size), distro="jazzy"),
            unfinished=target.with_name(target.name + ".repairing"),
        )
        return _copied(source, file, size, writer)


def _copied(source: Path, file: IO[bytes], size: int, writer: RecordingWriter) -> Recovered:
    recovered = Recovered()
    try:
        writer.keep_as_private_as(os.fstat(file.fileno()).st_mode)
        _copy(file, size, writer, recovered)
        values = {
            "source": source.name,
            "source_bytes": str(size),
            "repaired_ns": str(time.time_ns()),
            "messages": str(recovered.messages),
            "problems": "\n".join(recovered.problems),
        }
        writer.add_table(REPAIRED, values)
    except BaseException:
        writer.abandon()
        raise
    writer.close({})
    return recovered


def _copy(file: IO[bytes], size: int, writer: RecordingWriter, recovered: Recovered) -> None:
    definitions = _Definitions()
    for record in _sound_records(file, size, recovered):
        try:
            if record.opcode == Opcode.CHUNK:
                _copy_chunk(file, record, size, definitions, writer, recovered)
            elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                data = memoryview(container.content(file, record))
                _take(record.opcode, data, definitions, writer, recovered)
            elif record.opcode == Opcode.ATTACHMENT:
                _copy_attachment(container.content(file, record), writer)
            elif record.opcode == Opcode.METADATA:
                table = Metadata.read(container.stream(container.content(file, record)))
                if table.name not in _OF_THE_FILE and not table.name.startswith("omm_sha256"):
                    writer.add_table(table.name, table.metadata)
        except (Damaged, CutShort, McapError, struct.error, UnicodeDecodeError) as error:
            recovered.problems.append(f"left out: the record at byte {record.start}: {error}")


def _sound_records(file: IO[bytes], size: int, recovered: Recovered) -> Iterator[Record]:
    """Yield the data section's records; skip what is none, on to the next chunk."""
    offset = len(MAGIC)
    while offset < size:
        try:
            for record in container.records(file, offset, size):
                if record.opcode == Opcode.DATA_END:
                    return
                yield record
                offset = record.end
            recovered.problems.append("the end of the file is missing (its index is made anew)")
            return
        except CutShort as error:
            offset = error.offset
        found = _next_chunk(file, offset + 1, size)
        if found is None:
            tail = _cut_chunk(file, offset, size)
            if tail is not None:
                yield tail
            else:
                recovered.problems.append(
                    f"cut short: the last {size - offset} bytes are not a record"
                )
            return
        recovered.problems.append(f"bytes {offset} to {found} are damaged")
        offset = found


def _next_chunk(file: IO[bytes], start: int, size: int) -> int | None:
    """Search for a chunk whose checksum is right."""
    while start < size:
        file.seek(start)
        window = file.read(_WINDOW_BYTES + PREFIX.size)
        for match in _CHUNK_PATTERN.finditer(window):
            offset = start + match.start()
            (length,) = struct.unpack_from("<Q", match.group(), 1)
            record = Record(Opcode.CHUNK, offset + PREFIX.size, length)
            if record.end <= size and _is_sound_chunk(file, record):
                return offset
        start += _WINDOW_BYTES
    return None


def _is_sound_chunk(file: IO[bytes], record: Record) -> bool:
    try:
        head = container.chunk_header(file, record)
        if head.data_start + head.data_size != record.end or head.first_ns > head.last_ns:
            return False
        return bool(head.crc) and len(container.chunk_data(file, head)) > 0
    except (Damaged, struct.error, UnicodeDecodeError, MemoryError):
        return False


def _cut_chunk(file: IO[bytes], offset: int, size: int) -> Record | None:
    """Return the last record, if it is a chunk of which the beginning is there."""
    file.seek(offset)
    prefix = file.read(PREFIX.size)
    if len(prefix) < PREFIX.size or prefix[0] != Opcode.CHUNK:
        return None
    return Record(Opcode.CHUNK, offset + PREFIX.size, PREFIX.unpack(prefix)[1])


def _copy_chunk(
    file: IO[bytes],
    record: Record,
    size: int,
    definitions: _Definitions,
    writer: RecordingWriter,
    recovered: Recovered,
) -> None:
    head = container.chunk_header(file, record)
    before = recovered.messages
    whole = record.end <= size
    data = container.chunk_data(file, head) if whole else _begun_chunk(file, head)
    try:
        for opcode, content in container.records_in_chunk(data):
            _take(opcode, content, definitions, writer, recovered)
    except CutShort:
        if whole:
            raise
    if not whole:
        number = recovered.messages - before
        recovered.problems.append(f"cut short in its last chunk: {number} messages of it are there")


def _begun_chunk(file: IO[bytes], head: ChunkHeader) -> memoryview:
    """Return as much of a chunk as its beginning gives. What is there was written in order."""
    file.seek(head.data_start)
    raw = file.read()
    try:
        if head.compression == "zstd":
            import zstandard

            return memoryview(zstandard.ZstdDecompressor().decompressobj().decompress(raw))
        if head.compression == "lz4":
            import lz4.frame

            return memoryview(lz4.frame.LZ4FrameDecompressor().decompress(raw))
    except Exception as error:  # zstd and lz4 have no common base of their errors
        raise Damaged(f"the last chunk does not decompress: {error}") from error
    return memoryview(raw)


def _take(
    opcode: int,
    content: memoryview,
    definitions: _Definitions,
    writer: RecordingWriter,
    recovered: Recovered,
) -> None:
    if opcode == Opcode.SCHEMA:
        schema = container.read_schema(content)
        definitions.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = container.read_channel(content)
        definitions.channels[channel.id] = channel
    elif opcode == Opcode.MESSAGE:
        identifier, sequence, log_ns, publish_ns = MESSAGE.unpack_from(content)
        topic = _announced(identifier, definitions, writer)
        writer.write(topic, sequence, log_ns, publish_ns, content[MESSAGE.size :])
        recovered.messages += 1


def _announced(identifier: int, definitions: _Definitions, writer: RecordingWriter) -> str:
    """Return the topic of a channel, announced to the writer at its first message."""
    if identifier in definitions.written:
        return definitions.written[identifier]
    channel = definitions.channels.get(identifier)
    if channel is None:
        raise Damaged(f"channel {identifier} is not defined")
    if channel.message_encoding != "cdr":
        raise InputError(f"Expected a recording of ROS 2 (cdr), got {channel.message_encoding!r}.")
    schema = definitions.schemas.get(channel.schema_id)
    if channel.topic not in definitions.written.values():
        _announce(channel, schema, writer)
    definitions.written[identifier] = channel.topic
    return channel.topic


def _announce(channel: Channel, schema: Schema | None, writer: RecordingWriter) -> None:
    writer.add_topic(
        TopicToRecord(
            name=channel.topic,
            type_name=schema.name if schema else "",
            definition=schema.data.decode(errors="replace") if schema else "",
            definition_encoding=schema.encoding if schema else "",
            type_hash=channel.metadata.get("topic_type_hash", ""),
            qos=parsed_qos(channel.metadata.get("offered_qos_profiles", "")),
        )
    )


def _copy_attachment(data: bytes, writer: RecordingWriter) -> None:
    attachment = Attachment.read(container.stream(data))
    if attachment.name != CHAIN:
        writer.add_file(attachment.name, attachment.data, attachment.log_time)


def _compression(file: IO[bytes], size: int) -> str:
    """Return the first chunk's compression."""
    try:
        for record in container.records(file, len(MAGIC), size):
            if record.opcode == Opcode.CHUNK:
                return container.chunk_header(file, record).compression or "none"
    except (CutShort, Damaged):
        pass
    return "zstd"
