"""Private keys are found by their contents, whatever their files are called, and nothing else is taken for one."""

from __future__ import annotations

import gzip
import io
import json
import tarfile
import zipfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    pkcs12,
)

import upwash
from upwash.errors import UsageError
from upwash.packaging.contents import require_packable
from upwash.packaging.private_keys import private_key_in
from upwash.real.mavlink.signing import make_signing_key
from upwash.real.trust.authority import make_keys

_ENCRYPTED = BestAvailableEncryption(b"word")
_FORMS = [
    ("PKCS8", PrivateFormat.PKCS8),
    ("old", PrivateFormat.TraditionalOpenSSL),
    ("ssh", PrivateFormat.OpenSSH),
]


@cache
def _rsa() -> rsa.RSAPrivateKey:
    return rsa.generate_private_key(65537, 2048)


def keys() -> Iterator[tuple[str, bytes]]:
    """Each form of each key, by name."""
    elliptic, edwards = ec.generate_private_key(ec.SECP256R1()), ed25519.Ed25519PrivateKey.generate()
    for name, key in (("rsa", _rsa()), ("ec", elliptic), ("ed", edwards)):
        for form_name, form in _FORMS:
            for encoding_name, encoding in (("PEM", Encoding.PEM), ("DER", Encoding.DER)):
                for encryption in (NoEncryption(), _ENCRYPTED):
                    try:
                        content = key.private_bytes(encoding, form, encryption)
                    except (
                        ValueError,
                        UnsupportedAlgorithm,
                    ):  # the form has none of this key, or bcrypt is missing
                        continue
                    yield f"{name} {form_name} {encoding_name} {type(encryption).__name__}", content
        yield f"{name} PKCS12", pkcs12.serialize_key_and_certificates(b"me", key, None, None, _ENCRYPTED)
    pem = elliptic.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    yield "JSON", json.dumps({"private_key": pem.decode()}).encode()
    yield (
        "a program",
        b"KEY = (\n" + b"".join(b"    %r\n" % line.decode() for line in pem.splitlines(True)) + b")",
    )
    yield "behind a certificate", b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n" * 9 + pem
    yield "a file of Windows", pem.decode().replace("\n", "\r\n").encode("utf-16")
    yield "JWK", b'{"crv": "P-256", "d": "870MB6gfuTJ4HtUnUvYMyJpr5eUZNP4Bk43bVdj3eAE", "kty": "EC"}'
    yield "WireGuard", b"[Interface]\nPrivateKey = yAnz5TF+lXXJte14tji3zlMNq+hd2rYUIgJBgB3fBmk=\n"
    yield "PGP", b"-----BEGIN PGP PRIVATE KEY BLOCK-----\nVersion: 1\n\n" + b"lQOYBF" * 12
    yield "SSH2", b'---- BEGIN SSH2 ENCRYPTED PRIVATE KEY ----\nComment: "me"\n' + b"P2/56wAAAi" * 7


def _pem() -> bytes:
    return _rsa().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def zipped(name: str, content: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr(name, content)
    return file.getvalue()


def tarred(name: str, content: bytes, mode: str) -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode=mode) as packed:  # type: ignore[call-overload]
        entry = tarfile.TarInfo(name)
        entry.size = len(content)
        packed.addfile(entry, io.BytesIO(content))
    return file.getvalue()


def test_a_private_key_is_found_in_whatever_form(tmp_path: Path) -> None:
    file, found = tmp_path / "labels.txt", {}
    for name, content in keys():
        file.write_bytes(content)
        found[name] = private_key_in(file)
    assert len(found) > 20
    assert [name for name, kind in found.items() if "key" not in kind] == []


def test_a_private_key_is_found_in_archives(tmp_path: Path) -> None:
    file = tmp_path / "photos.bin"
    for content in (
        zipped("inner.zip", zipped("me.key", _pem())),
        zipped("inner.tgz", tarred("me.key", _pem(), "w:gz")),
        *(tarred("me.key", _pem(), mode) for mode in ("w", "w:bz2", "w:xz")),
        gzip.compress(_pem()),
    ):
        file.write_bytes(content)
        assert "a private key (PEM)" in private_key_in(file)
        file.write_bytes(content[: len(content) // 2])
        private_key_in(file)


def test_what_is_no_private_key_is_packed(tmp_path: Path) -> None:
    public = _rsa().public_key()
    (tmp_path / "a.pem").write_bytes(public.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    (tmp_path / "b.der").write_bytes(public.public_bytes(Encoding.DER, PublicFormat.PKCS1))
    (tmp_path / "c.py").write_text(
        'MARK = "-----BEGIN PRIVATE KEY-----"\nEND = "-----END PRIVATE KEY-----"\n'
    )
    (tmp_path / "d.sha256").write_text("0f" * 32 + "  model.onnx\n")
    (tmp_path / "e.zip").write_bytes(zipped("c.py", (tmp_path / "c.py").read_bytes()))
    (tmp_path / "empty").touch()
    require_packable(tmp_path)
    require_packable(Path(upwash.__file__).parent)


def test_keys_that_upwash_made_are_named_and_refused(tmp_path: Path) -> None:
    make_keys(tmp_path, servers=[["s1"]], drones=["drone"])
    make_signing_key(tmp_path / "signing.hex")
    with pytest.raises(UsageError) as refused:
        require_packable(tmp_path)
    assert all(
        f"{name} is a" in str(refused.value)
        for name in ("authority.key", "drone.key", "s1.key", "signing.hex")
    )
    assert ".pem is" not in str(refused.value)
