"""The authority that an operator keeps: it signs the certificates of all parties, and revokes them.

It signs one certificate for each daemon, valid for all servers of the daemon, and one for each drone and each
operator. Drones and operators have only client certificates, so a stolen drone cannot pose as a server. A daemon's
certificate is for both ends, as daemons call their peers. The subject names the role of a daemon or an operator.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509 import Certificate
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from upwash.config.values import KeysConfig
from upwash.core.admission.clients import Role
from upwash.errors import CredentialsError, NotWritten, UsageError
from upwash.real.trust.credentials import (
    UNITS,
    fingerprint,
    parsed_certificates,
    parsed_key,
    read_revoked,
    refuse_outdated,
    role_of,
)
from upwash.real.trust.secrets import read_public, read_secret
from upwash.support.output_files import flush_to_disk, write_file

_AUTHORITY_LASTS = timedelta(days=3652)
_CERTIFICATE_LASTS = timedelta(days=730)
_CLOCKS_MAY_DIFFER = timedelta(days=1)  # a drone's clock may be behind the authority's
_LONGEST_NAME = 64  # of a certificate's common name
_REVOKED_FILE = "revoked.txt"
_REVOKED_HEAD = (
    b"# SHA-256 fingerprints of refused certificates; `upwash keys DIR --revoke NAME` adds to them.\n"
)


@dataclass(frozen=True)
class KeyPair:
    """A private key, and a certificate for it."""

    certificate: Certificate
    key: ec.EllipticCurvePrivateKey

    @property
    def certificate_pem(self) -> bytes:
        """The certificate as PEM."""
        return self.certificate.public_bytes(Encoding.PEM)

    @property
    def key_pem(self) -> bytes:
        """The private key as PEM, without a password."""
        return self.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def keys_in(folder: Path, name: str) -> KeysConfig:
    """The paths of the files that `make_keys` writes for the holder of that name."""
    folder = folder.absolute()
    return KeysConfig(
        authority=folder / "authority.pem", certificate=folder / f"{name}.pem", key=folder / f"{name}.key"
    )


def make_keys(
    folder: Path,
    *,
    servers: Sequence[Sequence[str]] = (),
    drones: Sequence[str] = (),
    operators: Sequence[str] = (),
    lasts: timedelta | None = None,
) -> list[Path]:
    """Makes a key and a certificate for each entry and returns the files written, the authority's if new.

    Certificates last two years by default, and no longer than their authority's. An entry of `servers` has the names
    of all servers of a daemon; its files are named after the first. The folder's authority signs, and is made if
    there is none. Raises UsageError, with nothing written, for an invalid name or a file that exists.
    """
    if not all(servers):
        raise UsageError("a server without a name: give each at least one")
    _refuse_names([name for names in (*servers, drones, operators) for name in names])
    holders = [
        *((Role.SERVER, names) for names in servers),
        *((Role.DRONE, [name]) for name in drones),
        *((Role.OPERATOR, [name]) for name in operators),
    ]
    for file in (folder / f"{names[0]}{ending}" for _, names in holders for ending in (".key", ".pem")):
        if file.exists():
            raise _already_there(file)
    signer, files = _signer(folder)
    for role, names in holders:
        issued = _issue(signer, names, role, lasts or _CERTIFICATE_LASTS)
        files[folder / f"{names[0]}.pem"] = issued.certificate_pem
        files[folder / f"{names[0]}.key"] = issued.key_pem
    _write_together(folder, files)
    return list(files)


def renew_authority(folder: Path) -> list[Path]:
    """Makes a new authority for the folder, which signs from now on, and returns the files written.

    authority.pem then has both certificates, so that its readers trust certificates of either; the former key is kept
    under another name. Raises UsageError if the folder has no authority.
    """
    certificate_file, key_file = folder / "authority.pem", folder / "authority.key"
    former, former_key = read_public(certificate_file), read_secret(key_file)
    signer = _signer_among(certificate_file, former, key_file, former_key)
    new, kept = _new_authority(), folder / f"authority-{fingerprint(signer.certificate_pem)[:8]}.key"
    new_certificate, new_key = folder / "authority.pem.new", folder / "authority.key.new"
    _write_together(
        folder, {new_certificate: new.certificate_pem + former, new_key: new.key_pem, kept: former_key}
    )
    new_certificate.replace(certificate_file)
    new_key.replace(key_file)  # until here the former authority signs
    return [certificate_file, key_file, kept]


def drop_former_authorities(folder: Path) -> Path:
    """Removes former authorities from authority.pem, and returns that file; only the present one stays trusted."""
    certificate_file, key_file = folder / "authority.pem", folder / "authority.key"
    signer = _signer_among(certificate_file, read_public(certificate_file), key_file, read_secret(key_file))
    write_file(certificate_file, signer.certificate_pem)
    return certificate_file


def revoke(folder: Path, names: Sequence[str]) -> Path:
    """Adds certificates to the folder's list of revoked ones and returns its file.

    A name is the holder of a certificate in the folder, or a SHA-256 fingerprint. Raises UsageError, with nothing
    written, for another name.
    """
    file = folder / _REVOKED_FILE
    known = read_revoked(file) if file.exists() else frozenset()
    before = (read_public(file) if file.exists() else _REVOKED_HEAD).rstrip(b"\n")
    lines = [*before.decode(errors="surrogateescape").splitlines(keepends=True), "\n"]
    for name in names:
        revoked, holder = _fingerprint_of(folder, name)
        if revoked not in known:
            lines.append(f"{revoked}  {holder}, revoked {datetime.now(UTC):%Y-%m-%d}\n")
    write_file(file, "".join(lines).encode(errors="surrogateescape"))
    return file


def _fingerprint_of(folder: Path, name: str) -> tuple[str, str]:
    """The fingerprint that a name or a fingerprint means, and its holder as far as the folder tells."""
    certificate = folder / f"{name}.pem"
    if certificate.exists():
        pem = read_public(certificate)
        parsed_certificates(certificate, pem)
        return fingerprint(pem), name
    if (digits := name.replace(":", "").lower()) and re.fullmatch(r"[0-9a-f]{64}", digits):
        holders = (made.holder for made in made_in(folder) if made.fingerprint == digits)
        return digits, next(holders, "of a holder whose certificate is not here")
    raise UsageError(
        f"{certificate}: no such certificate: give the name of a certificate in {folder}, or the 64 digits of a "
        "SHA-256 fingerprint: `upwash keys DIR` shows them"
    )


@dataclass(frozen=True, slots=True)
class CertificateFile:
    """A certificate in a folder: its holder, role, end of validity, fingerprint, and whether it is revoked."""

    holder: str
    role: str
    ends: datetime
    fingerprint: str
    is_revoked: bool


def made_in(folder: Path) -> list[CertificateFile]:
    """The certificates of a folder, in the order of the files; raises CredentialsError for a broken file."""
    list_file = folder / _REVOKED_FILE
    revoked = read_revoked(list_file) if list_file.exists() else frozenset()
    made = []
    for file in sorted(folder.glob("*.pem")):
        is_authority = file.name == "authority.pem"
        for certificate in parsed_certificates(file, read_public(file))[: None if is_authority else 1]:
            role = "authority" if is_authority else role_of(certificate.subject.rfc4514_string())
            digits = certificate.fingerprint(hashes.SHA256()).hex()
            ends = certificate.not_valid_after_utc
            made.append(CertificateFile(file.stem, role, ends, digits, digits in revoked))
    return made


def _refuse_names(names: list[str]) -> None:
    for index, name in enumerate(names):
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", name) or len(name) > _LONGEST_NAME:
            raise UsageError(
                f'"{name}" cannot be a name: use at most {_LONGEST_NAME} letters, digits, ".", "_" and "-", first '
                "a letter or a digit"
            )
        if name == "authority":
            raise UsageError('"authority" is the name of the authority itself: choose another')
        if name in names[:index]:
            raise UsageError(f'"{name}" is named twice: give each server, drone and operator its own name')


def _already_there(file: Path) -> UsageError:
    return UsageError(f"{file}: already there, and keys are never overwritten: move it away first")


def _signer(folder: Path) -> tuple[KeyPair, dict[Path, bytes]]:
    """The folder's authority; a new one, with its files to write, if the folder has none."""
    certificate, key, revoked = folder / "authority.pem", folder / "authority.key", folder / _REVOKED_FILE
    if certificate.exists() and key.exists():
        kept = _signer_among(certificate, read_public(certificate), key, read_secret(key))
        refuse_outdated(certificate, kept.certificate)
        return kept, {}
    for there, missing in ((certificate, key), (key, certificate)):
        if there.exists():
            raise UsageError(f"{missing}: missing beside {there}: restore it, or move {there.name} away")
    signer = _new_authority()
    files = {certificate: signer.certificate_pem, key: signer.key_pem}
    if not revoked.exists():
        files[revoked] = _REVOKED_HEAD
    return signer, files


def _signer_among(certificate: Path, pem: bytes, key: Path, key_pem: bytes) -> KeyPair:
    """The authority in a file to which this key belongs."""
    private = parsed_key(key, key_pem)
    for authority in parsed_certificates(certificate, pem):
        if isinstance(private, ec.EllipticCurvePrivateKey) and private.public_key() == authority.public_key():
            return KeyPair(authority, private)
    raise CredentialsError(
        f"{key}: not the elliptic-curve key of {certificate}: restore the two that were made together"
    )


def _new_authority() -> KeyPair:
    extensions = [
        (x509.BasicConstraints(ca=True, path_length=0), True),
        (_key_usage(signs_certificates=True), True),
    ]
    return new_key_pair("upwash authority", extensions, lasts=_AUTHORITY_LASTS)


def _issue(issuer: KeyPair, names: Sequence[str], role: Role, lasts: timedelta) -> KeyPair:
    serving = [ExtendedKeyUsageOID.SERVER_AUTH] if role is Role.SERVER else []
    extensions = [
        (x509.BasicConstraints(ca=False, path_length=None), True),
        (_key_usage(signs_certificates=False), True),
        (x509.ExtendedKeyUsage([*serving, ExtendedKeyUsageOID.CLIENT_AUTH]), True),
        (x509.SubjectAlternativeName([x509.DNSName(name) for name in names]), False),
        (x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer.key.public_key()), False),
    ]
    return new_key_pair(names[0], extensions, issuer=issuer, lasts=lasts, unit=UNITS.get(role, ""))


def new_key_pair(
    name: str,
    extensions: Sequence[tuple[x509.ExtensionType, bool]],
    *,
    issuer: KeyPair | None = None,
    lasts: timedelta = _AUTHORITY_LASTS,
    unit: str = "",
) -> KeyPair:
    """A new key and its certificate with these extensions, critical or not; without an issuer it is self-signed."""
    key = ec.generate_private_key(ec.SECP256R1())
    units = [x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, unit)] if unit else []
    subject = x509.Name([*units, x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    ends = min(now + lasts, issuer.certificate.not_valid_after_utc) if issuer else now + lasts
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer.certificate.subject if issuer else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCKS_MAY_DIFFER)
        .not_valid_after(ends)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    for extension, is_critical in extensions:
        builder = builder.add_extension(extension, critical=is_critical)
    return KeyPair(builder.sign(issuer.key if issuer else key, hashes.SHA256()), key)


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _write_together(folder: Path, files: Mapping[Path, bytes]) -> None:
    """Write new files, all or none of them; other users can never read a key."""
    is_new = not folder.exists()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be made ({error.strerror}): name another folder") from None
    with contextlib.ExitStack() as undoing:
        if is_new:
            undoing.callback(folder.rmdir)
        for file, content in files.items():
            mode = 0o600 if b"PRIVATE KEY" in content else 0o644
            try:
                descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
                undoing.callback(file.unlink)
                with os.fdopen(descriptor, "wb") as opened:
                    opened.write(content)
                    opened.flush()
                    flush_to_disk(opened.fileno())
            except FileExistsError:
                raise _already_there(file) from None
            except OSError as error:
                raise NotWritten(file, error, "none of the files were made") from None
        undoing.pop_all()
