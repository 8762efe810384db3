"""A seal holds as long as the file is as it was recorded, and not a bit longer."""

import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import DataEnd, Metadata

from omm_core.errors import InputError
from omm_recording.container import MAGIC
from omm_recording.mcap_file import McapFile
from omm_recording.seal import CHAIN, load_key, parsed_chain, public_key, public_text
from omm_recording.summary_section import ending, serialised
from omm_recording.verifying import _contents, verify


def test_a_recording_is_as_it_was_recorded(record: Any) -> None:
    verdict = verify(record())
    assert verdict.intact
    assert not verdict.signed


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_every_flipped_bit_is_found(record: Any, tmp_path: Path, compression: str) -> None:
    data = record(compression=compression).read_bytes()
    changed = tmp_path / "changed.mcap"
    random = np.random.default_rng(3)
    ends = [0, 8, 9, len(data) - 1, len(data) - 9, len(data) - 30]
    for offset in [*ends, *random.integers(0, len(data), 150)]:
        flipped = bytearray(data)
        flipped[offset] ^= 1 << int(random.integers(8))
        changed.write_bytes(flipped)
        with suppress(InputError):  # no recording any more: noticed as well
            assert not verify(changed).intact, offset


def test_the_changed_block_is_named(record: Any, samples: Any) -> None:
    path = record(compression="none")
    data = bytearray(path.read_bytes())
    at = data.index(samples[30].data)
    data[at + 40] ^= 1
    path.write_bytes(data)
    (problem,) = [p for p in verify(path).problems if p.startswith("block")]
    start, end = _range(problem)
    assert start <= at < end


def _range(problem: str) -> tuple[int, int]:
    words = problem.replace(",", "").split()
    return int(words[words.index("bytes") + 1]), int(words[words.index("to") + 1])


def test_a_chunk_left_out_of_the_index_is_noticed(record: Any) -> None:
    path = record()
    size = path.stat().st_size
    with path.open("r+b") as file:
        contents, end, _ = _contents(file, size, size)
        contents.chunks.pop(2)
        file.seek(end)
        file.write(ending(contents, end))
        file.truncate()
    with path.open("rb") as file:
        list(make_reader(file, validate_crcs=True).iter_messages())  # to others it looks sound
    assert verify(path).problems == ["the index is not that of the recording"]


def test_what_was_recorded_by_others_cannot_be_verified(bench: Path) -> None:
    with pytest.raises(InputError, match="has no seal"):
        verify(bench / "run.mcap")


@pytest.fixture(params=["pkcs8", "openssh"])
def key_file(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    pytest.importorskip("cryptography")
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    kinds = {
        "pkcs8": serialization.PrivateFormat.PKCS8,
        "openssh": serialization.PrivateFormat.OpenSSH,
    }
    path = tmp_path / "shop_key"
    path.write_bytes(
        Ed25519PrivateKey.generate().private_bytes(
            serialization.Encoding.PEM, kinds[request.param], serialization.NoEncryption()
        )
    )
    return path


def test_the_shops_signature_is_recognised(record: Any, key_file: Path) -> None:
    path = record(key_file=key_file)
    ours = public_text(load_key(key_file))
    assert verify(path, ours).intact
    assert verify(path).public_key == ours
    assert not verify(path, "00" * 32).intact
    assert not verify(record("unsigned"), ours).intact


def test_a_public_key_is_read_from_digits_and_files(key_file: Path, tmp_path: Path) -> None:
    from cryptography.hazmat.primitives import serialization

    key = load_key(key_file)
    digits = public_text(key)
    for encoding, kind in (
        (serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH),
        (serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo),
    ):
        file = tmp_path / "key.pub"
        file.write_bytes(key.public_key().public_bytes(encoding, kind))
        assert public_key(str(file)) == public_key(digits) == digits
    with pytest.raises(InputError, match="Expected a public key"):
        public_key("nobody")


def test_a_seal_of_the_content_with_another_signature_is_noticed(
    record: Any, key_file: Path
) -> None:
    path = record(key_file=key_file)
    data = path.read_bytes()
    with path.open("rb") as file:
        tables = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    signature = tables["omm_seal"]["signature"]
    forged = signature[:-1] + ("0" if signature[-1] != "0" else "1")
    path.write_bytes(data.replace(signature.encode(), forged.encode()))
    assert any("signature" in problem for problem in verify(path).problems)


def test_a_seal_that_names_a_key_without_its_signature_is_noticed(
    record: Any, key_file: Path
) -> None:
    path = record(key_file=key_file)
    ours = public_text(load_key(key_file))
    with path.open("rb") as file:
        index = next(i for i in make_reader(file).get_summary().metadata_indexes
                     if i.name == "omm_seal")  # fmt: skip
        tables = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    seal = {k: v for k, v in tables["omm_seal"].items() if k != "signature"}
    assert seal["public_key_ed25519"] == ours
    chained = parsed_chain(_chain_of(path))[-1]
    content = path.read_bytes()[: index.offset] + serialised(
        Metadata(name="omm_seal", metadata=seal)
    )
    with path.open("w+b") as file:
        file.write(content + serialised(DataEnd(0)) + MAGIC)
        size = file.tell()
        contents, end, _ = _contents(file, size, chained.offset + chained.length)
    path.write_bytes(content + ending(contents, end))
    problems = verify(path, ours).problems
    assert any("nobody signed it" in problem for problem in problems)
    assert any("expected it to be signed by" in problem for problem in problems)


def _chain_of(path: Path) -> bytes:
    with path.open("rb") as file:
        found = [a.data for a in McapFile(path, file).attachments() if a.name == CHAIN]
    return found[-1]


def test_a_key_of_another_kind_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("cryptography")
    path = tmp_path / "rsa"
    made = subprocess.run(
        ["openssl", "genpkey", "-algorithm", "RSA", "-out", str(path)],
        capture_output=True,
        check=False,
    )
    if made.returncode != 0:
        pytest.skip("needs openssl")
    with pytest.raises(InputError, match="Expected an Ed25519 key"):
        load_key(path)


@pytest.mark.parametrize("words", [b"SHA-256(previous", b"block)", b"algorithm"])
def test_the_words_of_the_seal_itself_are_compared(record: Any, words: bytes) -> None:
    path = record()
    data = path.read_bytes()
    at = data.rindex(words)
    path.write_bytes(
        data[:at] + words.replace(b"o", b"0").replace(b"6", b"5") + data[at + len(words) :]
    )
    verdict = verify(path)
    assert not verdict.intact
    assert any("the seal says" in problem for problem in verdict.problems)
