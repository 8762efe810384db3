"""What is damaged or forged in a recording is said, and never read as if it were sound."""

import struct
from pathlib import Path
from typing import Any

import pytest
from mcap.opcode import Opcode

from omm_core.errors import InputError
from omm_recording import container
from omm_recording.reading import Recording
from omm_recording.verifying import Verdict, _check_signature


def _flipped(path: Path, offset: int) -> None:
    data = bytearray(path.read_bytes())
    data[offset] ^= 1
    path.write_bytes(data)


def test_a_flipped_bit_in_an_attachment_is_refused(record: Any) -> None:
    path = record()
    with path.open("rb") as file:
        found = [
            r
            for r in container.records(file, 8, path.stat().st_size - 8)
            if r.opcode == Opcode.ATTACHMENT
        ]
    _flipped(path, found[0].end - 10)
    with Recording(path) as recording, pytest.raises(InputError, match="checksum"):
        recording.attachments()


def test_a_flipped_bit_in_the_index_changes_nothing_that_is_read(record: Any) -> None:
    path = record()
    sound = path.read_bytes()
    with Recording(path) as recording:
        expected = [(m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages()]
    (start,) = struct.unpack_from("<Q", sound, len(sound) - 8 - 20)
    for offset in range(start, len(sound) - 8, 29):
        path.write_bytes(sound)
        _flipped(path, offset)
        try:
            with Recording(path) as recording:
                got = [(m.topic, m.log_time_ns, bytes(m.data)) for m in recording.messages()]
        except InputError:
            continue  # it says that the file is damaged
        assert got == expected, offset


def test_the_name_of_a_key_without_its_signature_is_no_signature() -> None:
    key = "ab" * 32
    verdict = Verdict(sha256="", blocks=0, size_bytes=0, public_key=key, signed=False)
    _check_signature({"public_key_ed25519": key}, key, verdict)
    assert not verdict.intact
