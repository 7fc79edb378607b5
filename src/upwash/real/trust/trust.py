"""Whose certificate is believed: TLS for who answers, and who called by the certificate that was shown."""

from __future__ import annotations

import functools
import hashlib
import os
import ssl
from dataclasses import dataclass
from datetime import UTC, datetime

from upwash.core.admission.clients import Client, DoorReason
from upwash.errors import CredentialsError
from upwash.real.trust.credentials import Credentials, role_of
from upwash.support.text import printable

_LONGEST_NAME = 255


@dataclass(frozen=True, slots=True)
class Holder:
    """Who showed a certificate, and until when it is valid."""

    client: Client
    ends: datetime


class Distrusted(CredentialsError):
    """A certificate that is not believed, and why in short."""

    def __init__(self, reason: DoorReason, message: str) -> None:
        super().__init__(message)
        self.reason: DoorReason = reason


class Trust:
    """The authority's certificates and the operator's list of revoked ones, as they are now."""

    def __init__(self, credentials: Credentials, *, revoked: frozenset[str] = frozenset()) -> None:
        self.context = server_context(credentials)
        self._authority = credentials.authority
        self._revoked = revoked

    def holder(self, certificate: bytes) -> Holder:
        """Whose the DER certificate is; raises Distrusted where it is revoked or of no authority of these."""
        holder = holder_of(certificate)
        if holder.client.certificate in self._revoked:
            raise Distrusted("revoked", f"the certificate of {holder.client.name} is revoked")
        if not _issued_by(certificate, self._authority):
            raise Distrusted(
                "other_authority", f"the certificate of {holder.client.name} is of another authority"
            )
        if holder.ends < datetime.now(UTC):
            raise Distrusted("expired", f"the certificate of {holder.client.name} has expired")
        return holder


def server_context(credentials: Credentials) -> ssl.SSLContext:
    """TLS 1.3 with whoever shows a certificate of the authority.

    Sessions are not resumed, or a revoked one might be.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.verify_mode = ssl.CERT_REQUIRED
    context.num_tickets = 0
    context.set_alpn_protocols(["h2"])
    context.load_verify_locations(cadata=credentials.authority.decode())
    load_secret(context, credentials.certificate + b"\n" + credentials.key)
    return context


def load_secret(context: ssl.SSLContext, pem: bytes) -> None:
    """Has the context show the certificate in the text, by the key in it."""
    secret = os.memfd_create("secret")  # the ssl module reads files only
    try:
        os.write(secret, pem)
        context.load_cert_chain(f"/proc/self/fd/{secret}")
    finally:
        os.close(secret)


@functools.lru_cache(maxsize=256)
def holder_of(certificate: bytes) -> Holder:
    """What a DER certificate says of its holder."""
    from cryptography import x509
    from cryptography.x509.oid import NameOID

    parsed = x509.load_der_x509_certificate(certificate)
    names = parsed.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    name = printable(str(names[0].value), _LONGEST_NAME) if names else ""
    role = role_of(parsed.subject.rfc4514_string())
    fingerprint = hashlib.sha256(certificate).hexdigest()
    return Holder(Client(name, fingerprint, role), parsed.not_valid_after_utc)


@functools.lru_cache(maxsize=256)
def _issued_by(certificate: bytes, authority: bytes) -> bool:
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature

    parsed = x509.load_der_x509_certificate(certificate)
    for issuer in x509.load_pem_x509_certificates(authority):
        try:
            parsed.verify_directly_issued_by(issuer)
        except (InvalidSignature, ValueError, TypeError):
            continue
        return True
    return False
