"""Certificates: what one party shows of itself, and what it believes of others."""

from __future__ import annotations

import contextlib
import hashlib
import re
import ssl
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from upwash.core.admission.clients import Role
from upwash.errors import CredentialsError
from upwash.real.trust.secrets import read_public, read_secret

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes
    from cryptography.x509 import Certificate

UNITS = {Role.OPERATOR: "operator", Role.SERVER: "server"}  # the organizational unit in the subject


@dataclass(frozen=True, slots=True)
class Lifetime:
    """From when until when the certificate of that holder is valid."""

    holder: str
    starts: datetime
    ends: datetime

    def problem_at(self, now: datetime, *, by: str = "this computer's clock") -> str:
        """Why it is not valid at the time that the clock says, with the dates; "" where it is."""
        if self.starts <= now <= self.ends:
            return ""
        what = "is not valid yet" if now < self.starts else "has expired"
        return (
            f"the certificate of {self.holder} {what}: it is valid from {at_second(self.starts)} to "
            f"{at_second(self.ends)}, and {by} says {at_second(now)}"
        )


@dataclass(frozen=True)
class Credentials:
    """The PEM texts with which one party shows who it is and checks who others are.

    `authority` may hold the certificates of several authorities: those of any of them are believed.
    """

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
    def lifetimes(self) -> tuple[Lifetime, ...]:
        """Of the certificate, by its first name, and of the authority that issued it."""
        from cryptography import x509

        certificate = x509.load_pem_x509_certificate(self.certificate)
        authorities = x509.load_pem_x509_certificates(self.authority)
        issuer = _issuer_among(authorities, certificate) or authorities[0]
        return tuple(
            Lifetime(holder, each.not_valid_before_utc, each.not_valid_after_utc)
            for holder, each in ((self.names[0], certificate), ("authority", issuer))
        )

    @property
    def expiries(self) -> dict[str, datetime]:
        """Until when the certificate, by its first name, and its authority are valid."""
        return {each.holder: each.ends for each in self.lifetimes}

    def problem_at(self, now: datetime, *, by: str = "this computer's clock") -> str:
        """Which of the certificates is not valid at the time of the clock, with its dates; "" where all are."""
        return next(filter(None, (each.problem_at(now, by=by) for each in self.lifetimes)), "")


def at_second(time: datetime) -> str:
    """As people write it, to the second, in UTC."""
    return time.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def fingerprint(certificate: bytes) -> str:
    """The SHA-256 fingerprint of a PEM certificate, in lower-case hexadecimal digits."""
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(certificate.decode())).hexdigest()


def role_of(subject: str) -> Role:
    """What a certificate is for, by its subject: parts such as "OU=operator", with commas between them."""
    parts = subject.split(",")
    return next((role for role, unit in UNITS.items() if f"OU={unit}" in parts), Role.DRONE)


def read_credentials(authority: Path, certificate: Path, key: Path, *, valid_now: bool = True) -> Credentials:
    """The credentials in the three files, which belong together; raises CredentialsError.

    The certificate is of one of the authorities in the first file. Both are valid by this computer's clock too,
    unless that is not to be believed yet.
    """
    credentials = Credentials(read_public(authority), read_public(certificate), read_secret(key))
    authorities = parsed_certificates(authority, credentials.authority)
    holder = parsed_certificate(certificate, credentials.certificate)
    if parsed_key(key, credentials.key).public_key() != holder.public_key():
        raise CredentialsError(f"{key}: not the key of {certificate}: give the two that were made together")
    issuer = _issuer_among(authorities, holder)
    if issuer is None:
        raise CredentialsError(
            f"{certificate}: not issued by {authority}: give the authority that signed it, "
            "or a certificate made under this one"
        )
    if valid_now:
        for file, each in ((authority, issuer), (certificate, holder)):
            refuse_outdated(file, each)
    return credentials


def read_revoked(file: Path) -> frozenset[str]:
    """The fingerprints in a list of revoked certificates, one at the start of each line; raises CredentialsError."""
    revoked = set()
    for number, text in enumerate(read_public(file).decode(errors="replace").splitlines(), start=1):
        first = text.partition(" ")[0].replace(":", "").lower()
        if not first or first.startswith("#"):
            continue
        if not re.fullmatch(r"[0-9a-f]{64}", first):
            raise CredentialsError(
                f"{file}: line {number} does not begin with a SHA-256 fingerprint: "
                "add to it with `upwash keys DIR --revoke NAME` only"
            )
        revoked.add(first)
    return frozenset(revoked)


def parsed_certificates(file: Path, pem: bytes) -> list[Certificate]:
    """The certificates of a PEM text, one or several, from that file; raises CredentialsError."""
    from cryptography import x509
    from cryptography.exceptions import UnsupportedAlgorithm

    try:
        certificates = x509.load_pem_x509_certificates(pem)
        for each in certificates:
            each.public_key()  # which is looked at no earlier
    except (ValueError, UnsupportedAlgorithm):
        raise CredentialsError(
            f"{file}: not a PEM certificate with a key that is understood: give the .pem file"
        ) from None
    return certificates


def parsed_certificate(file: Path, pem: bytes) -> Certificate:
    """The first of them, which is the holder's; raises CredentialsError."""
    return parsed_certificates(file, pem)[0]


def parsed_key(file: Path, pem: bytes) -> PrivateKeyTypes:
    """The private key of a PEM text from that file; raises CredentialsError."""
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        return load_pem_private_key(pem, password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise CredentialsError(
            f"{file}: not a PEM private key without a password: give the .key file"
        ) from None


def refuse_outdated(file: Path, certificate: Certificate) -> None:
    """Raises CredentialsError for a certificate that is not valid by this computer's clock."""
    now = datetime.now(UTC)
    clock = f"this computer's clock says {at_second(now)}"
    if now > certificate.not_valid_after_utc:
        since = certificate.not_valid_after_utc.isoformat(" ", "minutes")
        raise CredentialsError(f"{file}: expired since {since}, and {clock}: make a new one")
    if now < certificate.not_valid_before_utc:
        start = certificate.not_valid_before_utc.isoformat(" ", "minutes")
        raise CredentialsError(
            f"{file}: not valid before {start}, and {clock}: set this computer's clock, or let "
            "NTP, a battery-backed clock or chrony with gpsd keep it"
        )


def _issuer_among(authorities: Sequence[Certificate], holder: Certificate) -> Certificate | None:
    """The one that issued the holder's certificate; of several the one that is valid for longest."""
    from cryptography.exceptions import InvalidSignature

    found = []
    for each in authorities:
        with contextlib.suppress(InvalidSignature, ValueError, TypeError):
            holder.verify_directly_issued_by(each)
            found.append(each)
    return max(found, key=lambda each: each.not_valid_after_utc, default=None)
