"""Whether a recording is as it was recorded; see `seal` for how that is known."""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex, ChunkIndex, MessageIndex, Metadata
from mcap.records import MetadataIndex as TableIndex

from omm_core.errors import InputError
from omm_recording import container
from omm_recording.container import MAGIC, PREFIX, UNREADABLE, CutShort, Record
from omm_recording.mcap_file import McapFile
from omm_recording.mcap_writer import Link
from omm_recording.seal import CHAIN, SEAL, parsed_chain, sealed, signature_holds
from omm_recording.summary_section import Contents, ending

_PIECE_BYTES = 8 << 20
_MAX_PROBLEMS = 20


@dataclass(kw_only=True)
class Verdict:
    """What was found."""

    sha256: str
    """The last link of the chain: what a report cites."""
    blocks: int
    size_bytes: int
    public_key: str | None
    signed: bool
    problems: list[str] = field(default_factory=list)

    @property
    def intact(self) -> bool:
        """Whether the file is as it was recorded."""
        return not self.problems

    def blame(self, problem: str) -> None:
        """Note a problem, up to a limit: a long list helps nobody."""
        if len(self.problems) < _MAX_PROBLEMS:
            self.problems.append(problem)


def verify(path: Path, trusted_key: str | None = None) -> Verdict:
    """Read all of a recording and compare it with its seal.

    Parameters
    ----------
    path
        An MCAP file that omm recorded.
    trusted_key
        Public key (64 hexadecimal digits) that must have signed it.

    Raises
    ------
    InputError
        If the file is not a recording, or has no seal.
    """
    with path.open("rb") as file:
        recording = McapFile(path, file, compare=False)
        seal = recording.metadata().get(SEAL)
        chain = [a.data for a in recording.attachments() if a.name == CHAIN]
        if seal is None or not chain or "sha256" not in seal:
            raise InputError(
                f"{path} has no seal: it was not recorded by omm, so whether it was changed cannot"
                f" be checked."
            )
        links = parsed_chain(chain[-1])
        verdict = Verdict(
            sha256=seal["sha256"],
            blocks=len(links),
            size_bytes=recording.size,
            public_key=seal.get("public_key_ed25519"),
            signed="signature" in seal,
        )
        _check_words(seal, links, verdict)
        _check_signature(seal, trusted_key, verdict)
        _check_chain(file, links, seal, verdict)
        _check_rest(file, links, recording.size, verdict)
    return verdict


def _check_words(seal: dict[str, str], links: list[Link], verdict: Verdict) -> None:
    """Check that the seal says what omm writes of these links, and nothing more."""
    expected = sealed(links, None) if links else {}
    for name in sorted({*seal, *expected} - {"public_key_ed25519", "signature", "sha256"}):
        if seal.get(name) != expected.get(name):
            verdict.blame(
                f"the seal says {name} {str(seal.get(name))[:99]!r}, it must be"
                f" {expected.get(name)!r}"
            )


def _check_signature(seal: dict[str, str], trusted_key: str | None, verdict: Verdict) -> None:
    if verdict.signed and not signature_holds(seal):
        verdict.blame("the signature is not that of the key and the checksum in the seal")
    if verdict.public_key is not None and not verdict.signed:
        verdict.blame(f"the seal names the key {verdict.public_key}, and nobody signed it")
    if trusted_key is not None and not (verdict.signed and verdict.public_key == trusted_key):
        by = f"by {verdict.public_key}" if verdict.signed else "by nobody"
        verdict.blame(f"expected it to be signed by {trusted_key}, it is signed {by}")


def _check_chain(
    file: IO[bytes], links: list[Link], seal: dict[str, str], verdict: Verdict
) -> None:
    offset = 0
    before = b""
    for number, link in enumerate(links):
        if link.offset != offset:
            verdict.blame(f"the chain has a hole at byte {offset}")
        if _link(file, link, before) != link.sha256:
            end = link.offset + link.length
            verdict.blame(f"block {number}, bytes {link.offset} to {end}, is not as recorded")
        before = bytes.fromhex(link.sha256)
        offset = link.offset + link.length
    if not links or links[-1].sha256 != seal["sha256"]:
        verdict.blame("the chain does not end in the seal's checksum")


def _link(file: IO[bytes], link: Link, before: bytes) -> str:
    digest = hashlib.sha256(before)
    file.seek(link.offset)
    left = link.length
    while left:
        piece = file.read(min(left, _PIECE_BYTES))
        if not piece:
            break
        digest.update(piece)
        left -= len(piece)
    return digest.hexdigest()


def _check_rest(file: IO[bytes], links: list[Link], size: int, verdict: Verdict) -> None:
    """Check that only the chain itself, the seal and the index of it all follow the chain."""
    chained = links[-1].offset + links[-1].length if links else 0
    try:
        contents, end, after = _contents(file, size, chained)
    except UNREADABLE as error:
        verdict.blame(f"the file's records are not readable: {error}")
        return
    if after != [Opcode.ATTACHMENT, Opcode.METADATA]:
        verdict.blame("something was added after the recording was sealed")
    file.seek(end)
    if file.read() != ending(contents, end):
        verdict.blame("the index is not that of the recording")


def _contents(file: IO[bytes], size: int, chained: int) -> tuple[Contents, int, list[int]]:
    """Return what the index must say; where it must begin; and the records after the chain."""
    contents = Contents()
    after: list[int] = []
    chunk: tuple[Record, list[tuple[int, int, int]]] | None = None
    for record in container.records(file, len(MAGIC), size - len(MAGIC)):
        start = record.start - PREFIX.size
        if record.opcode != Opcode.MESSAGE_INDEX and chunk is not None:
            _count(file, chunk[0], chunk[1], contents)
            chunk = None
        if record.opcode == Opcode.DATA_END:
            return contents, start, after
        if start >= chained:
            after.append(record.opcode)
        if record.opcode == Opcode.CHUNK:
            chunk = (record, [])
        elif record.opcode == Opcode.MESSAGE_INDEX and chunk is not None:
            index = MessageIndex.read(container.stream(container.content(file, record)))
            chunk[1].append((index.channel_id, start, len(index.records)))
        else:
            _note(file, record, contents)
    raise CutShort(size)


def _count(
    file: IO[bytes], record: Record, indexes: list[tuple[int, int, int]], contents: Contents
) -> None:
    head = container.chunk_header(file, record)
    entry = ChunkIndex(
        chunk_length=PREFIX.size + record.length,
        chunk_start_offset=record.start - PREFIX.size,
        compression=head.compression,
        compressed_size=head.data_size,
        message_end_time=head.last_ns,
        message_index_length=sum(PREFIX.size + 6 + 16 * number for _, _, number in indexes),
        message_index_offsets={channel: start for channel, start, _ in indexes},
        message_start_time=head.first_ns,
        uncompressed_size=head.uncompressed_size,
    )
    contents.count_chunk(entry, {channel: number for channel, _, number in indexes})


def _note(file: IO[bytes], record: Record, contents: Contents) -> None:
    start = record.start - PREFIX.size
    length = PREFIX.size + record.length
    if record.opcode == Opcode.SCHEMA:
        schema = container.read_schema(container.content(file, record))
        contents.schemas[schema.id] = schema
    elif record.opcode == Opcode.CHANNEL:
        channel = container.read_channel(container.content(file, record))
        contents.channels[channel.id] = channel
    elif record.opcode == Opcode.ATTACHMENT:
        a = Attachment.read(container.stream(container.content(file, record)))
        contents.attachments.append(
            AttachmentIndex(
                offset=start,
                length=length,
                log_time=a.log_time,
                create_time=a.create_time,
                data_size=len(a.data),
                name=a.name,
                media_type=a.media_type,
            )
        )
    elif record.opcode == Opcode.METADATA:
        table = Metadata.read(container.stream(container.content(file, record)))
        contents.metadata.append(TableIndex(offset=start, length=length, name=table.name))
