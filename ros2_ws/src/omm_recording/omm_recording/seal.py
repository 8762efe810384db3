"""The seal of a recording: a checksum chain over all of it, closed at its end, signed if wanted.

Every block (a chunk with its index, a definition, an attachment, a table) is linked when it is
written: ``link = SHA-256(link before, bytes of the block)``. At the end the list of links goes
into the recording as the attachment ``omm_chain.csv`` and the last link into the metadata record
``omm_seal``, with a signature (Ed25519) over it where a key is given. What comes after the seal is
the file's index, which `verify` makes anew and compares byte by byte.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omm_core.errors import InputError
from omm_core.files.outside import read_bytes
from omm_recording.mcap_writer import Link

CHAIN = "omm_chain.csv"
SEAL = "omm_seal"
_HEAD = "offset,length,sha256\n"


def chain_text(links: Sequence[Link]) -> bytes:
    """Return the links as a table."""
    lines = [f"{link.offset},{link.length},{link.sha256}\n" for link in links]
    return (_HEAD + "".join(lines)).encode()


def parsed_chain(data: bytes) -> list[Link]:
    """Read the table of links back.

    Raises
    ------
    InputError
        If it is not one.
    """
    try:
        text = data.decode("ascii")
        if not text.startswith(_HEAD):
            raise ValueError(f"its first line is not {_HEAD.strip()}")
        rows = (line.split(",") for line in text[len(_HEAD) :].splitlines())
        links = [Link(offset=int(o), length=int(n), sha256=s) for o, n, s in rows]
        for before, link in itertools.pairwise(links):
            if before.offset + before.length != link.offset:
                raise ValueError(f"it has a hole before byte {link.offset}")
        for link in links:
            if len(bytes.fromhex(link.sha256)) != 32 or link.offset < 0 or link.length < 1:
                raise ValueError(f"its link at byte {link.offset} is none")
    except ValueError as error:
        raise InputError(f"The recording's checksum chain is not readable: {error}") from error
    return links


def sealed(links: Sequence[Link], key_file: Path | None) -> dict[str, str]:
    """Return the content of the seal that closes these links."""
    seal = {
        "algorithm": "link = SHA-256(previous link, bytes of the block)",
        "blocks": str(len(links)),
        "bytes": str(links[-1].offset + links[-1].length),
        "sha256": links[-1].sha256,
    }
    if key_file is not None:
        key = load_key(key_file)
        seal["public_key_ed25519"] = public_text(key)
        seal["signature"] = key.sign(bytes.fromhex(links[-1].sha256)).hex()
    return seal


def load_key(path: Path) -> Any:
    """Return a private key, as ``ssh-keygen -t ed25519`` or ``openssl genpkey`` make one.

    Raises
    ------
    InputError
        If the file is none, or the library is missing.
    """
    try:
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    except ImportError as error:
        raise InputError("To sign recordings, install the Python package cryptography.") from error
    try:
        data = read_bytes(path, "private key", 1 << 20)
        ssh = b"OPENSSH PRIVATE KEY" in data
        load = serialization.load_ssh_private_key if ssh else serialization.load_pem_private_key
        key = load(data, password=None)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"Expected a private key without password in {path}: {error}") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"Expected an Ed25519 key in {path}, got {type(key).__name__}.")
    return key


def public_text(key: Any) -> str:
    """Return the public half of a key, as 64 hexadecimal digits."""
    return str(key.public_key().public_bytes_raw().hex())


def public_key(words: str) -> str:
    """Return a public key as 64 hexadecimal digits, from those or from a file (OpenSSH or PEM).

    Raises
    ------
    InputError
        If it is neither.
    """
    if len(words) == 64 and all(c in "0123456789abcdef" for c in words.lower()):
        return words.lower()
    try:
        from cryptography.hazmat.primitives import serialization

        data = read_bytes(words, "public key", 1 << 20)
        ssh = data.startswith(b"ssh-")
        load = serialization.load_ssh_public_key if ssh else serialization.load_pem_public_key
        return str(load(data).public_bytes_raw().hex())
    except (ImportError, OSError, ValueError, AttributeError) as error:
        raise InputError(
            f"Expected a public key (Ed25519) in 64 digits (0-f) or a file, got {words}: {error}"
        ) from error


def signature_holds(seal: dict[str, str]) -> bool:
    """Return whether the signature in a seal is that of the public key in it.

    Raises
    ------
    InputError
        If the library is missing.
    """
    try:
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    except ImportError as error:
        raise InputError("To check signatures, install the Python package cryptography.") from error
    try:
        key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(seal["public_key_ed25519"]))
        key.verify(bytes.fromhex(seal["signature"]), bytes.fromhex(seal["sha256"]))
    except (InvalidSignature, ValueError, KeyError):
        return False
    return True
