"""The keys of SROS 2, checked by openssl: what is signed verifies, and nobody else reads keys."""

import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from omm_core.errors import InputError
from omm_ros.keys import NODES, make_keystore


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys") / "store"
    assert make_keystore(folder) == tuple(f"/omm/{name}" for name in NODES)
    return folder


def openssl(*words: object) -> "subprocess.CompletedProcess[bytes]":
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl")
    return subprocess.run(["openssl", *map(str, words)], capture_output=True, check=False)


@pytest.mark.parametrize("node", NODES)
def test_openssl_trusts_certificates_and_documents_of_this_authority_only(
    store: Path, node: str, tmp_path: Path
) -> None:
    authority, enclave = store / "public" / "ca.cert.pem", store / "enclaves" / "omm" / node
    assert openssl("verify", "-CAfile", authority, enclave / "cert.pem").returncode == 0
    for name in ("governance", "permissions"):
        signed = enclave / f"{name}.p7s"
        done = openssl("smime", "-verify", "-text", "-in", signed, "-CAfile", authority)
        assert done.returncode == 0, done.stderr
        root = ET.fromstring(done.stdout.decode().strip())
        assert root.tag == "dds"
        changed = tmp_path / "changed.p7s"
        text = signed.read_bytes()
        changed.write_bytes(text.replace(b"DENY", b"ALLO").replace(b">false<", b">true<"))
        assert changed.read_bytes() != text
        done = openssl("smime", "-verify", "-text", "-in", changed, "-CAfile", authority)
        assert done.returncode != 0
    permissions = (enclave / "permissions.xml").read_text()
    subject = openssl("x509", "-in", enclave / "cert.pem", "-noout", "-subject").stdout.decode()
    name = subject.strip().replace(" ", "").partition("CN=")[2]
    assert f"<subject_name>CN={name}</subject_name>" in permissions


def test_the_certificate_of_a_node_belongs_to_its_key(store: Path) -> None:
    enclave = store / "enclaves" / "omm" / "camera"
    of_key = openssl("pkey", "-in", enclave / "key.pem", "-pubout").stdout
    of_certificate = openssl("x509", "-in", enclave / "cert.pem", "-noout", "-pubkey").stdout
    assert of_key == of_certificate != b""


def test_nobody_else_reads_the_keys_and_they_are_never_written_over(store: Path) -> None:
    for path in store.rglob("*"):
        assert path.stat().st_mode & 0o077 == 0, path
    with pytest.raises(InputError, match="empty folder"):
        make_keystore(store)
    for name in ("../x", "a b", "", "é"):
        with pytest.raises(InputError, match="names of nodes"):
            make_keystore(store.parent / "other", [name])
