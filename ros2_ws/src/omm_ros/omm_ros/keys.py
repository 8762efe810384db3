"""Keys for SROS 2: who has none cannot hear, speak to or pose as omm's nodes.

A keystore as `ros2 security` makes it: a certificate authority, and for each node an enclave with
its own key, its certificate and what it may do, signed (S/MIME) by the authority. DDS reads and
enforces it where its security plugins are installed; that is so with a ROS installation, not with
ROS 2 from wheels.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    pkcs7,
)
from cryptography.x509.oid import NameOID

from omm_core.errors import InputError

NODES = ("camera", "cnc_bridge", "estimator", "recorder", "operator", "replay")
PREFIX = "/omm/"
_YEARS = 10
_LARGEST_DOMAIN = 232


@dataclass(frozen=True, kw_only=True)
class _Authority:
    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    def sign(self, text: str) -> bytes:
        """Return a document with this authority's signature, S/MIME."""
        builder = pkcs7.PKCS7SignatureBuilder().set_data(text.encode())
        builder = builder.add_signer(self.certificate, self.key, hashes.SHA256())
        return builder.sign(
            Encoding.SMIME, [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
        )


def make_keystore(folder: Path, nodes: Sequence[str] = NODES) -> tuple[str, ...]:
    """Make a keystore in a new folder; return the names of the enclaves in it.

    Raises
    ------
    InputError
        Where something is in the folder, it cannot be written, or a name is no node's.
    """
    for name in nodes:
        if not (name.isascii() and name.isidentifier()):
            raise InputError(f"Expected names of nodes (letters, digits, _), got {name!r}.")
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        if any(folder.iterdir()):
            raise InputError(
                f"Expected a new or an empty folder, got {folder}. Existing keys are never changed."
            )
        folder.chmod(0o700)
        return _written(folder, nodes)
    except OSError as error:
        raise InputError(f"Cannot write keys to {folder}: {error.strerror}.") from error


def _written(folder: Path, nodes: Sequence[str]) -> tuple[str, ...]:
    now = datetime.now(timezone.utc).replace(microsecond=0)
    authority = _authority(now)
    certificate = _pem(authority.certificate)
    for name in ("ca", "identity_ca", "permissions_ca"):
        _write(folder / "public" / f"{name}.cert.pem", certificate)
    _write(folder / "private" / "ca.key.pem", _key_pem(authority.key))
    governance = authority.sign(_GOVERNANCE)
    _write(folder / "enclaves" / "governance.p7s", governance)
    for name in nodes:
        key, own = _identity(authority, PREFIX + name, now)
        permissions = _permissions(PREFIX + name, now)
        files = {
            "key.pem": _key_pem(key),
            "cert.pem": _pem(own),
            "identity_ca.cert.pem": certificate,
            "permissions_ca.cert.pem": certificate,
            "governance.p7s": governance,
            "permissions.xml": permissions.encode(),
            "permissions.p7s": authority.sign(permissions),
        }
        for file, content in files.items():
            _write(folder / "enclaves" / "omm" / name / file, content)
    return tuple(PREFIX + name for name in nodes)


def _write(path: Path, content: bytes) -> None:
    for folder in (path.parent.parent, path.parent):  # the mode is that of the last one only
        folder.mkdir(exist_ok=True, mode=0o700)
    # Private from its first byte on.
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _certificate(
    subject: str, key: ec.EllipticCurvePrivateKey, issuer: x509.Name, now: datetime, *, ca: bool
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(_name(subject))
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=365 * _YEARS))
        .add_extension(x509.BasicConstraints(ca=ca, path_length=1 if ca else None), critical=True)
    )


def _authority(now: datetime) -> _Authority:
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _certificate("ommCA", key, _name("ommCA"), now, ca=True)
    return _Authority(certificate=builder.sign(key, hashes.SHA256()), key=key)


def _identity(
    authority: _Authority, name: str, now: datetime
) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _certificate(name, key, authority.certificate.subject, now, ca=False)
    return key, builder.sign(authority.key, hashes.SHA256())


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(Encoding.PEM)


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _permissions(name: str, now: datetime) -> str:
    start, end = now - timedelta(days=1), now + timedelta(days=365 * _YEARS)
    return _PERMISSIONS.format(
        name=name,
        start=f"{start:%Y-%m-%dT%H:%M:%S}",
        end=f"{end:%Y-%m-%dT%H:%M:%S}",
        last=_LARGEST_DOMAIN,
    )


_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="\
http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_{kind}.xsd">
"""
# Whoever has a key may do all; who has none, nothing. Everything is encrypted.
_GOVERNANCE = (
    _HEAD.format(kind="governance")
    + f"""  <domain_access_rules>
    <domain_rule>
      <domains><id_range><min>0</min><max>{_LARGEST_DOMAIN}</max></id_range></domains>
      <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
      <enable_join_access_control>true</enable_join_access_control>
      <discovery_protection_kind>ENCRYPT</discovery_protection_kind>
      <liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
      <rtps_protection_kind>SIGN</rtps_protection_kind>
      <topic_access_rules>
        <topic_rule>
          <topic_expression>*</topic_expression>
          <enable_discovery_protection>true</enable_discovery_protection>
          <enable_liveliness_protection>true</enable_liveliness_protection>
          <enable_read_access_control>true</enable_read_access_control>
          <enable_write_access_control>true</enable_write_access_control>
          <metadata_protection_kind>ENCRYPT</metadata_protection_kind>
          <data_protection_kind>ENCRYPT</data_protection_kind>
        </topic_rule>
      </topic_access_rules>
    </domain_rule>
  </domain_access_rules>
</dds>
"""
)
_PERMISSIONS = (
    _HEAD.format(kind="permissions")
    + """  <permissions>
    <grant name="{name}">
      <subject_name>CN={name}</subject_name>
      <validity><not_before>{start}</not_before><not_after>{end}</not_after></validity>
      <allow_rule>
        <domains><id_range><min>0</min><max>{last}</max></id_range></domains>
        <publish><topics><topic>*</topic></topics></publish>
        <subscribe><topics><topic>*</topic></topics></subscribe>
      </allow_rule>
      <default>DENY</default>
    </grant>
  </permissions>
</dds>
"""
)
