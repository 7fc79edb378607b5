"""Certificates: who may talk to whom, under one authority that the operator keeps.

The authority signs one certificate for each daemon, good for all servers that the daemon acts as, and one for
each drone and each operator. Drones and operators hold only client certificates, so a stolen drone cannot pose as a
server. A daemon's is good at both ends, as daemons call their peers. Daemons' and operators' say so in their subject.
"""

from __future__ import annotations

import hashlib
import os
import re
import ssl
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from upwash.config import KeysConfig
from upwash.core.visitors import Role
from upwash.errors import CredentialsError, UsageError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes
    from cryptography.x509 import Certificate, ExtensionType

_AUTHORITY_LASTS = timedelta(days=3652)
_CERTIFICATE_LASTS = timedelta(days=730)
_CLOCKS_MAY_DIFFER = timedelta(days=1)  # a drone's clock may be behind the authority's
_LONGEST_NAME = 64  # of a certificate's common name
_REVOKED_FILE = "revoked.txt"
_REVOKED_HEAD = (
    b"# SHA-256 fingerprints of certificates that daemons refuse; `upwash keys --revoke` adds to them.\n"
)
_UNITS = {Role.OPERATOR: "operator", Role.SERVER: "server"}  # the organizational unit in the subject


@dataclass(frozen=True)
class Credentials:
    """The PEM texts with which one party shows who it is and checks who others are."""

    authority: bytes
    certificate: bytes
    key: bytes = field(repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """The names that the certificate is good for."""
        from cryptography import x509
        from cryptography.x509.oid import NameOID

        certificate = x509.load_pem_x509_certificate(self.certificate)
        try:
            names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except x509.ExtensionNotFound:
            common = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
            return tuple(str(name.value) for name in common)
        return tuple(names.get_values_for_type(x509.DNSName))

    def is_for(self, purpose: Literal["serving", "calling"]) -> bool:
        """Whether the certificate may be shown by the one who answers, or by the one who calls."""
        from cryptography import x509
        from cryptography.x509.oid import ExtendedKeyUsageOID

        certificate = x509.load_pem_x509_certificate(self.certificate)
        try:
            usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        except x509.ExtensionNotFound:
            return True
        needed = {"serving": ExtendedKeyUsageOID.SERVER_AUTH, "calling": ExtendedKeyUsageOID.CLIENT_AUTH}
        return needed[purpose] in usage

    @property
    def expiries(self) -> dict[str, datetime]:
        """Until when the certificate, by its first name, and its authority are valid."""
        from cryptography import x509

        return {
            holder: x509.load_pem_x509_certificate(pem).not_valid_after_utc
            for holder, pem in ((self.names[0], self.certificate), ("authority", self.authority))
        }


def fingerprint(certificate: bytes) -> str:
    """The SHA-256 fingerprint of a PEM certificate, in lower-case hexadecimal digits."""
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(certificate.decode())).hexdigest()


def role_of(subject: str) -> Role:
    """What a certificate is for, by its subject: parts such as "OU=operator", with commas between them."""
    parts = subject.split(",")
    return next((role for role, unit in _UNITS.items() if f"OU={unit}" in parts), Role.DRONE)


@dataclass(frozen=True)
class _Authority:
    certificate: Certificate
    key: EllipticCurvePrivateKey


def keys_in(folder: Path, name: str) -> KeysConfig:
    """Where `make_keys` put the files of the holder of that name."""
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
) -> list[Path]:
    """Makes a key and a certificate for each entry and returns the files written, the authority's if new.

    An entry of `servers` holds the names of all servers that one daemon acts as; its files are called after
    the first. The folder's authority signs, and is made if there is none. Raises UsageError, with nothing
    written, for a name that cannot be used or a file that is already there.
    """
    if not all(servers):
        raise UsageError("a server without a name: give each at least one")
    _refuse_names([name for names in (*servers, drones, operators) for name in names])
    holders = [*(names[0] for names in servers), *drones, *operators]
    for file in (folder / f"{name}{ending}" for name in holders for ending in (".key", ".pem")):
        if file.exists():
            raise _already_there(file)
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be made ({error.strerror}): name another folder") from None
    authority, files = _authority(folder)
    for names in servers:
        files += _issue(folder, authority, names, Role.SERVER)
    for role, names in ((Role.DRONE, drones), (Role.OPERATOR, operators)):
        for name in names:
            files += _issue(folder, authority, [name], role)
    return files


def revoke(folder: Path, names: Sequence[str]) -> Path:
    """Adds the certificates of these holders to the folder's list of revoked ones and returns its file.

    Raises UsageError, with nothing written, where a name has no certificate in the folder.
    """
    file = folder / _REVOKED_FILE
    known = read_revoked(file) if file.exists() else frozenset()
    lines = []
    for name in names:
        certificate = folder / f"{name}.pem"
        if not certificate.exists():
            raise UsageError(f"{certificate}: no such certificate: name one that was made in {folder}")
        pem = _read(certificate)
        _parsed_certificate(certificate, pem)
        revoked = fingerprint(pem)
        if revoked not in known:
            lines.append(f"{revoked}  {name}, revoked {datetime.now(UTC):%Y-%m-%d}\n")
    try:
        with file.open("a") as opened:
            opened.writelines(lines)
    except OSError as error:
        raise UsageError(f"{file}: cannot be written ({error.strerror}): name a writable folder") from None
    return file


def read_revoked(file: Path) -> frozenset[str]:
    """The fingerprints in a list of revoked certificates, one at the start of each line; raises CredentialsError."""
    revoked = set()
    for number, text in enumerate(_read(file).decode(errors="replace").splitlines(), start=1):
        first = text.partition(" ")[0].replace(":", "").lower()
        if not first or first.startswith("#"):
            continue
        if not re.fullmatch(r"[0-9a-f]{64}", first):
            raise CredentialsError(
                f"{file}: line {number} does not begin with a SHA-256 fingerprint: "
                "add to it with `upwash keys --revoke NAME` only"
            )
        revoked.add(first)
    return frozenset(revoked)


def read_credentials(authority: Path, certificate: Path, key: Path) -> Credentials:
    """The credentials in the three files, which belong together and are valid now; raises CredentialsError."""
    from cryptography.exceptions import InvalidSignature

    credentials = Credentials(_read(authority), _read(certificate), _read(key))
    issuer = _parsed_certificate(authority, credentials.authority)
    holder = _parsed_certificate(certificate, credentials.certificate)
    if _parsed_key(key, credentials.key).public_key() != holder.public_key():
        raise CredentialsError(f"{key}: not the key of {certificate}: give the two that were made together")
    try:
        holder.verify_directly_issued_by(issuer)
    except (InvalidSignature, ValueError, TypeError):
        raise CredentialsError(
            f"{certificate}: not issued by {authority}: give the authority that signed it, "
            "or a certificate made under this one"
        ) from None
    for file, each in ((authority, issuer), (certificate, holder)):
        _refuse_outdated(file, each)
    return credentials


def _refuse_names(names: list[str]) -> None:
    for index, name in enumerate(names):
        if not re.fullmatch(r"[A-Za-z0-9._-]+", name) or len(name) > _LONGEST_NAME:
            raise UsageError(
                f'"{name}" cannot be a name: use at most {_LONGEST_NAME} letters, digits, ".", "_" and "-"'
            )
        if name == "authority":
            raise UsageError('"authority" is the name of the authority itself: choose another')
        if name in names[:index]:
            raise UsageError(f'"{name}" is named twice: give each server, drone and operator its own name')


def _already_there(file: Path) -> UsageError:
    return UsageError(f"{file}: already there, and keys are never overwritten: move it away first")


def _authority(folder: Path) -> tuple[_Authority, list[Path]]:
    """The folder's authority, and the files written if it had none."""
    certificate, key = folder / "authority.pem", folder / "authority.key"
    if certificate.exists() and key.exists():
        return _kept_authority(certificate, key), []
    for there, missing in ((certificate, key), (key, certificate)):
        if there.exists():
            raise UsageError(f"{missing}: missing beside {there}: restore it, or move {there.name} away")
    return _new_authority(folder)


def _kept_authority(certificate: Path, key: Path) -> _Authority:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey

    issuer = _parsed_certificate(certificate, _read(certificate))
    private = _parsed_key(key, _read(key))
    if not isinstance(private, EllipticCurvePrivateKey) or private.public_key() != issuer.public_key():
        raise CredentialsError(
            f"{key}: not the elliptic-curve key of {certificate}: restore the two that were made together"
        )
    _refuse_outdated(certificate, issuer)
    return _Authority(issuer, private)


def _new_authority(folder: Path) -> tuple[_Authority, list[Path]]:
    from cryptography import x509

    key = _new_key()
    certificate = _signed(
        "upwash authority",
        key,
        [
            (x509.BasicConstraints(ca=True, path_length=0), True),
            (_key_usage(signs_certificates=True), True),
        ],
        issuer=None,
        lasts=_AUTHORITY_LASTS,
    )
    files = _write_pair(folder, "authority", certificate, key)
    revoked = folder / _REVOKED_FILE
    if not revoked.exists():
        _write_new(revoked, _REVOKED_HEAD, mode=0o644)
        files.append(revoked)
    return _Authority(certificate, key), files


def _issue(folder: Path, authority: _Authority, names: Sequence[str], role: Role) -> list[Path]:
    from cryptography import x509
    from cryptography.x509.oid import ExtendedKeyUsageOID

    key = _new_key()
    answering = [ExtendedKeyUsageOID.SERVER_AUTH] if role is Role.SERVER else []
    certificate = _signed(
        names[0],
        key,
        [
            (x509.BasicConstraints(ca=False, path_length=None), True),
            (_key_usage(signs_certificates=False), True),
            (x509.ExtendedKeyUsage([*answering, ExtendedKeyUsageOID.CLIENT_AUTH]), True),
            (x509.SubjectAlternativeName([x509.DNSName(name) for name in names]), False),
            (x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key()), False),
        ],
        issuer=authority,
        lasts=_CERTIFICATE_LASTS,
        unit=_UNITS.get(role, ""),
    )
    return _write_pair(folder, names[0], certificate, key)


def _signed(
    name: str,
    key: EllipticCurvePrivateKey,
    extensions: Sequence[tuple[ExtensionType, bool]],
    *,
    issuer: _Authority | None,
    lasts: timedelta,
    unit: str = "",
) -> Certificate:
    """A certificate with the extensions, each critical or not, signed by its own key without an issuer."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.x509.oid import NameOID

    units = [x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, unit)] if unit else []
    subject = x509.Name([*units, x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer.certificate.subject if issuer else subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCKS_MAY_DIFFER)
        .not_valid_after(now + lasts)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    for extension, is_critical in extensions:
        builder = builder.add_extension(extension, critical=is_critical)
    return builder.sign(issuer.key if issuer else key, hashes.SHA256())


def _new_key() -> EllipticCurvePrivateKey:
    from cryptography.hazmat.primitives.asymmetric import ec

    return ec.generate_private_key(ec.SECP256R1())


def _key_usage(*, signs_certificates: bool) -> ExtensionType:
    from cryptography import x509

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


def _write_pair(
    folder: Path, name: str, certificate: Certificate, key: EllipticCurvePrivateKey
) -> list[Path]:
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    certificate_file, key_file = folder / f"{name}.pem", folder / f"{name}.key"
    secret = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    _write_new(key_file, secret, mode=0o600)
    _write_new(certificate_file, certificate.public_bytes(Encoding.PEM), mode=0o644)
    return [certificate_file, key_file]


def _write_new(file: Path, content: bytes, *, mode: int) -> None:
    """Writes a file that was not there; nobody else could read it at any moment unless the mode says so."""
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        with os.fdopen(descriptor, "wb") as opened:
            opened.write(content)
    except FileExistsError:
        raise _already_there(file) from None
    except OSError as error:
        raise UsageError(f"{file}: cannot be written ({error.strerror}): name a writable folder") from None


def _parsed_certificate(file: Path, pem: bytes) -> Certificate:
    from cryptography import x509
    from cryptography.exceptions import UnsupportedAlgorithm

    try:
        certificate = x509.load_pem_x509_certificate(pem)
        certificate.public_key()  # which is looked at no earlier
    except (ValueError, UnsupportedAlgorithm):
        raise CredentialsError(
            f"{file}: not a PEM certificate with a key that is understood: give the .pem file"
        ) from None
    return certificate


def _parsed_key(file: Path, pem: bytes) -> PrivateKeyTypes:
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        return load_pem_private_key(pem, password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise CredentialsError(
            f"{file}: not a PEM private key without a password: give the .key file"
        ) from None


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except FileNotFoundError:
        raise CredentialsError(f"{file}: no such file: check the path, or make the keys first") from None
    except OSError as error:
        raise CredentialsError(
            f"{file}: cannot be read ({error.strerror}): run as the user that owns it"
        ) from None


def _refuse_outdated(file: Path, certificate: Certificate) -> None:
    now = datetime.now(UTC)
    if now > certificate.not_valid_after_utc:
        since = certificate.not_valid_after_utc.isoformat(" ", "minutes")
        raise CredentialsError(f"{file}: expired since {since}: make a new one")
    if now < certificate.not_valid_before_utc:
        start = certificate.not_valid_before_utc.isoformat(" ", "minutes")
        raise CredentialsError(f"{file}: not valid before {start}: set this computer's clock")
