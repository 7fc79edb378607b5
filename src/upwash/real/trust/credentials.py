"""Certificates: those that a party shows, and those of others that it trusts."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import re
import ssl
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from upwash.core.admission.clients import Client, DoorReason, Role
from upwash.errors import CredentialsError
from upwash.real.trust.secrets import load_secret, read_public, read_secret
from upwash.support.text import printable

if TYPE_CHECKING:  # cryptography takes 7 MB: a flight without certificates does not load it
    from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes
    from cryptography.x509 import Certificate

UNITS = {Role.OPERATOR: "operator", Role.SERVER: "server"}  # the organizational unit in the subject
_LONGEST_NAME = 255


@dataclass(frozen=True)
class Credentials:
    """A party's certificate and key, and the authority of all parties, as PEM texts.

    `authority` may have several certificates: each of these authorities is trusted.
    """

    authority: bytes
    certificate: bytes
    key: bytes = field(repr=False)

    @functools.cached_property
    def _certificate(self) -> Certificate:
        from cryptography import x509

        return x509.load_pem_x509_certificate(self.certificate)

    @property
    def names(self) -> tuple[str, ...]:
        """The names for which the certificate is valid."""
        from cryptography import x509

        try:
            names = self._certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except x509.ExtensionNotFound:
            return tuple(_common_names(self._certificate))
        return tuple(names.get_values_for_type(x509.DNSName))

    def is_for(self, purpose: Literal["serving", "calling"]) -> bool:
        """Whether the certificate may be used by a server ("serving"), or by a client ("calling")."""
        from cryptography import x509
        from cryptography.x509.oid import ExtendedKeyUsageOID

        try:
            usage = self._certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        except x509.ExtensionNotFound:
            return True
        wanted = ExtendedKeyUsageOID.SERVER_AUTH if purpose == "serving" else ExtendedKeyUsageOID.CLIENT_AUTH
        return wanted in usage

    @property
    def expiries(self) -> dict[str, datetime]:
        """The end of validity of the certificate, under its first name, and of its issuer, under "authority"."""
        return {holder: certificate.not_valid_after_utc for holder, certificate in self._chain()}

    def problem_at(self, now: datetime, *, by: str = "this computer's clock") -> str:
        """Which certificate is not valid at the time `now`, with its dates; "" if both are. `by` names the clock."""
        problems = (_problem(holder, known, now, by) for holder, known in self._chain())
        return next(filter(None, problems), "")

    def _chain(self) -> tuple[tuple[str, Certificate], ...]:
        from cryptography import x509

        authorities = x509.load_pem_x509_certificates(self.authority)
        issuer = _issuer_among(authorities, self._certificate) or authorities[0]
        return (self.names[0], self._certificate), ("authority", issuer)


def at_second(time: datetime) -> str:
    """The time as text, to the second, in UTC."""
    return time.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def fingerprint(certificate: bytes) -> str:
    """The SHA-256 fingerprint of a PEM certificate, in lower-case hexadecimal digits."""
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(certificate.decode())).hexdigest()


def role_of(subject: str) -> Role:
    """The role of a certificate's holder, from its subject: comma-separated parts such as "OU=operator"."""
    parts = subject.split(",")
    return next((role for role, unit in UNITS.items() if f"OU={unit}" in parts), Role.DRONE)


# --- files --------------------------------------------------------------------------------------------------


def read_credentials(authority: Path, certificate: Path, key: Path, *, valid_now: bool = True) -> Credentials:
    """The credentials in the three files; raises CredentialsError unless they belong together.

    An authority in the first file must have issued the certificate. With `valid_now` both must be valid by this
    computer's clock.
    """
    credentials = Credentials(read_public(authority), read_public(certificate), read_secret(key))
    authorities = parsed_certificates(authority, credentials.authority)
    holder = parsed_certificates(certificate, credentials.certificate)[0]
    if parsed_key(key, credentials.key).public_key() != holder.public_key():
        raise CredentialsError(f"{key}: not the key of {certificate}: give the two that were made together")
    issuer = _issuer_among(authorities, holder)
    if issuer is None:
        raise CredentialsError(
            f"{certificate}: not issued by {authority}: give the authority that signed it, "
            "or a certificate made under this authority"
        )
    if valid_now:
        refuse_outdated(authority, issuer)
        refuse_outdated(certificate, holder)
    return credentials


def read_revoked(file: Path) -> frozenset[str]:
    """The fingerprints in a file of revoked certificates, one at the start of each line; raises CredentialsError."""
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
    """The certificates of a PEM text from that file, the holder's first; raises CredentialsError."""
    from cryptography import x509
    from cryptography.exceptions import UnsupportedAlgorithm

    try:
        certificates = x509.load_pem_x509_certificates(pem)
        for certificate in certificates:
            certificate.public_key()  # which is looked at no earlier
    except (ValueError, UnsupportedAlgorithm):
        raise CredentialsError(
            f"{file}: not a PEM certificate with a key that is understood: give the .pem file"
        ) from None
    return certificates


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
    """Raises CredentialsError if the certificate is not valid by this computer's clock."""
    now = datetime.now(UTC)
    if problem := _problem(file.stem, certificate, now, "this computer's clock"):
        remedy = "make a new one"
        if now < certificate.not_valid_before_utc:
            remedy = (
                "set this computer's clock, or let NTP, a battery-backed clock or chrony with gpsd keep it"
            )
        raise CredentialsError(f"{file}: {problem}: {remedy}")


def _problem(holder: str, certificate: Certificate, now: datetime, by: str) -> str:
    starts, ends = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if starts <= now <= ends:
        return ""
    what = "is not valid yet" if now < starts else "has expired"
    return (
        f"the certificate of {holder} {what}: it is valid from {at_second(starts)} to "
        f"{at_second(ends)}, and {by} says {at_second(now)}"
    )


def _common_names(certificate: Certificate) -> list[str]:
    from cryptography.x509.oid import NameOID

    return [str(name.value) for name in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)]


def _issuer_among(authorities: Sequence[Certificate], holder: Certificate) -> Certificate | None:
    """The authority that issued the holder's certificate; of several the last to expire."""
    from cryptography.exceptions import InvalidSignature

    found = []
    for authority in authorities:
        with contextlib.suppress(InvalidSignature, ValueError, TypeError):
            holder.verify_directly_issued_by(authority)
            found.append(authority)
    return max(found, key=lambda authority: authority.not_valid_after_utc, default=None)


# --- certificates of others ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Holder:
    """The holder of a shown certificate, and the end of its validity."""

    client: Client
    ends: datetime


class Distrusted(CredentialsError):
    """Raised for a certificate that is not trusted, with the reason."""

    def __init__(self, reason: DoorReason, message: str) -> None:
        super().__init__(message)
        self.reason: DoorReason = reason


class Trust:
    """A server's TLS context, and the certificates that it trusts: issued by these authorities, and not revoked."""

    def __init__(self, credentials: Credentials, *, revoked: frozenset[str] = frozenset()) -> None:
        self.context = server_context(credentials)
        self._authority = credentials.authority
        self._revoked = revoked

    def holder(self, certificate: bytes) -> Holder:
        """The holder of a DER certificate; raises Distrusted if it is revoked, expired or of another authority."""
        holder = holder_of(certificate)
        whose = f"the certificate of {holder.client.name}"
        if holder.client.certificate in self._revoked:
            raise Distrusted("revoked", f"{whose} is revoked")
        if not _is_issued_by(certificate, self._authority):
            raise Distrusted("other_authority", f"{whose} is of another authority")
        if holder.ends < datetime.now(UTC):
            raise Distrusted("expired", f"{whose} has expired")
        return holder


def server_context(credentials: Credentials) -> ssl.SSLContext:
    """A TLS 1.3 context for a server that requires clients to show a certificate of the authority.

    Sessions are not resumed, as the certificate may have been revoked since.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.verify_mode = ssl.CERT_REQUIRED
    context.num_tickets = 0
    context.set_alpn_protocols(["h2"])
    context.load_verify_locations(cadata=credentials.authority.decode())
    load_secret(context, credentials.certificate + b"\n" + credentials.key)
    return context


@functools.lru_cache(maxsize=256)
def holder_of(certificate: bytes) -> Holder:
    """The holder that a DER certificate names; the certificate is not checked."""
    from cryptography import x509

    parsed = x509.load_der_x509_certificate(certificate)
    name = next((printable(name, _LONGEST_NAME) for name in _common_names(parsed)), "")
    role = role_of(parsed.subject.rfc4514_string())
    return Holder(Client(name, hashlib.sha256(certificate).hexdigest(), role), parsed.not_valid_after_utc)


@functools.lru_cache(maxsize=256)
def _is_issued_by(certificate: bytes, authority: bytes) -> bool:
    from cryptography import x509

    authorities = x509.load_pem_x509_certificates(authority)
    return _issuer_among(authorities, x509.load_der_x509_certificate(certificate)) is not None
