"""How we log in to an OPC UA server: encrypted where it offers that, and to the server we know.

A server's list of endpoints comes over a channel that nobody protects. So what is decided by it is
told, a password never goes over a plain channel, and a server whose certificate was seen before (or
is given) is not believed to have become a plain one, or another.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from asyncua import Client, ua
from asyncua.crypto import cert_gen, security_policies
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from omm_core.errors import InputError
from omm_core.files.json_input import read_json
from omm_core.files.output import write_whole
from omm_core.files.outside import read_bytes, read_text

_POLICIES = {
    policy.URI: policy
    for name in ("Basic256Sha256", "Aes256Sha256RsaPss", "Aes128Sha256RsaOaep")
    if (policy := getattr(security_policies, f"SecurityPolicy{name}", None)) is not None
}
"""Those that are thought to be safe, the most usual first."""
_VALID_DAYS = 3650
_ENCRYPTED = ua.MessageSecurityMode.SignAndEncrypt


@dataclass(frozen=True, kw_only=True)
class Security:
    """How we log in; see `Parameters` for each. All empty: as nobody, encrypted where offered."""

    user: str = ""
    password_file: str = ""
    certificate_file: str = ""
    private_key_file: str = ""
    server_certificate_file: str = ""
    allow_unencrypted: bool = False
    allow_password_unencrypted: bool = False
    folder: Path | None = None
    """For our own certificate and the servers we know; None: the user's data folder."""

    def password(self) -> str:
        """Return the password. Raises InputError where the file cannot be read."""
        return read_text(self.password_file, "password", 4096).strip() if self.password_file else ""

    def data_folder(self) -> Path:
        """Return the folder for our certificate and the servers we know."""
        home = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
        return self.folder or Path(home) / "omm" / "opcua"


async def log_in(client: Client, url: str, security: Security) -> tuple[str, ...]:
    """Connect, as safely as the server offers; return what people should know of it.

    Raises
    ------
    InputError
        Where the server is not the one that is known, or offers nothing that is allowed.
    """
    endpoints = await client.connect_and_get_server_endpoints()
    encrypted = _encrypted(endpoints)
    known = _known_certificate(url, security)
    if encrypted is None or security.allow_unencrypted:
        notes = _plain(url, endpoints, security, known, encrypted is not None)
        _give_user(client, security, allowed=security.allow_password_unencrypted)
    else:
        notes = _compared(url, encrypted, security, known)
        ours, key = _our_certificate(client, security)
        await client.set_security(
            _POLICIES[encrypted.SecurityPolicyUri],
            certificate=str(ours),
            private_key=str(key),
            server_certificate=bytes(encrypted.ServerCertificate),
            mode=_ENCRYPTED,
        )
        _give_user(client, security, allowed=True)
        notes = (*notes, f"OPC UA: encrypted; our certificate is {ours}, the server must trust it.")
    await client.connect()
    return notes


def _encrypted(
    endpoints: Sequence[ua.EndpointDescription],
) -> ua.EndpointDescription | None:
    """Return the endpoint that encrypts best, None where none does."""
    for uri in _POLICIES:
        for endpoint in endpoints:
            if (endpoint.SecurityMode, endpoint.SecurityPolicyUri) == (_ENCRYPTED, uri):
                return endpoint
    return None


def _plain(
    url: str,
    endpoints: Sequence[ua.EndpointDescription],
    security: Security,
    known: bytes | None,
    offers_more: bool,
) -> tuple[str, ...]:
    if known is not None and not security.allow_unencrypted:
        raise InputError(
            f"OPC UA: expected the encrypted endpoint that {url} had before, it offers none now. If"
            " that is meant, set opcua_allow_unencrypted; if not, somebody is in between."
        )
    if not any(e.SecurityMode == ua.MessageSecurityMode.None_ for e in endpoints):
        raise InputError(
            f"OPC UA: expected an endpoint of {url} that is encrypted by one of"
            f" {', '.join(p.__name__.removeprefix('SecurityPolicy') for p in _POLICIES.values())},"
            f" or a plain one; it offers {_offered(endpoints)}."
        )
    why = "as opcua_allow_unencrypted says" if offers_more else "the server offers nothing else"
    notes = [
        f"OPC UA: NOT ENCRYPTED, {why}: who is on the network can read and change what is said."
    ]
    if security.user and not security.allow_password_unencrypted:
        notes.append(
            f"OPC UA: logged in as nobody, not as {security.user}: a password is not sent over a"
            " plain channel unless opcua_allow_password_unencrypted says so."
        )
    return tuple(notes)


def _offered(endpoints: Sequence[ua.EndpointDescription]) -> str:
    names = {f"{e.SecurityMode.name} {e.SecurityPolicyUri.rpartition('#')[2]}" for e in endpoints}
    return ", ".join(sorted(names)) or "none"


def _give_user(client: Client, security: Security, *, allowed: bool) -> None:
    if security.user and allowed:
        client.set_user(security.user)
        client.set_password(security.password())


# --- certificates ------------------------------------------------------------------------------


def _fingerprint(certificate: bytes) -> str:
    return hashlib.sha256(certificate).hexdigest()


def _certificate_of(file: str) -> bytes:
    """Return a certificate (DER or PEM) as DER."""
    data = read_bytes(file, "certificate", 1 << 20)
    try:
        if b"-----BEGIN" in data:
            return x509.load_pem_x509_certificate(data).public_bytes(Encoding.DER)
        return x509.load_der_x509_certificate(data).public_bytes(Encoding.DER)
    except ValueError as error:
        raise InputError(f"Expected a certificate (DER or PEM) in {file}: {error}.") from None


def _known_servers(security: Security) -> dict[str, str]:
    path = security.data_folder() / "known_servers.json"
    return {k: str(v) for k, v in read_json(path, "list").items()} if path.exists() else {}


def _known_certificate(url: str, security: Security) -> bytes | None:
    """Return the fingerprint of the server that is expected at an address, if any is."""
    if security.server_certificate_file:
        return bytes.fromhex(_fingerprint(_certificate_of(security.server_certificate_file)))
    told = _known_servers(security).get(url)
    return bytes.fromhex(told) if told else None


def _compared(
    url: str, endpoint: ua.EndpointDescription, security: Security, known: bytes | None
) -> tuple[str, ...]:
    """Compare the certificate offered with the one expected; the first one seen is remembered."""
    told = _fingerprint(bytes(endpoint.ServerCertificate))
    if known is not None and known.hex() != told:
        where = security.server_certificate_file or security.data_folder() / "known_servers.json"
        raise InputError(
            f"OPC UA: {url} has another certificate (SHA-256 {told}) than is known (in {where})."
            " If the control got a new one, give it as opcua_server_certificate_file or remove the"
            " old one there; if not, somebody is in between."
        )
    if known is None:
        servers = _known_servers(security) | {url: told}
        security.data_folder().mkdir(parents=True, exist_ok=True, mode=0o700)
        write_whole(security.data_folder() / "known_servers.json", json.dumps(servers, indent=1))
        return (
            f"OPC UA: {url} is met for the first time; its certificate is remembered. Compare with"
            f" what the control shows: SHA-256 {told}",
        )
    return ()


def _our_certificate(client: Client, security: Security) -> tuple[Path, Path]:
    """Return our certificate and its key: those given, else our own, made once."""
    if security.certificate_file:
        return Path(security.certificate_file), Path(security.private_key_file)
    folder = security.data_folder()
    certificate, key = folder / "omm.der", folder / "omm.pem"
    if not (certificate.is_file() and key.is_file()):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        made = cert_gen.generate_private_key()
        names = [
            x509.UniformResourceIdentifier(client.application_uri),
            x509.DNSName(socket.gethostname()),
        ]
        own = cert_gen.generate_self_signed_app_certificate(
            made, "omm", {}, names, [ExtendedKeyUsageOID.CLIENT_AUTH], _VALID_DAYS
        )
        descriptor = os.open(key, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(cert_gen.dump_private_key_as_pem(made))
        write_whole(certificate, own.public_bytes(Encoding.DER))
    return certificate, key
