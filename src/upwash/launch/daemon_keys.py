"""The certificates that an edge daemon shows, believes and refuses, read again at each reload."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import os
from datetime import UTC, datetime, timedelta
from typing import NoReturn

from upwash.config.daemon import DaemonConfig, DaemonKeysConfig
from upwash.errors import CredentialsError
from upwash.ports import Link
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.credentials import (
    Credentials,
    Trust,
    at_second,
    read_credentials,
    read_revoked,
)
from upwash.rpc.protocol import CertificateStatus
from upwash.support.text import command

_log = logging.getLogger("upwash.serving")

_EXPIRY_WARNING = timedelta(days=30)
_EXPIRY_LOOK_S = 86_400.0


class DaemonKeys:
    """The daemon's certificates as they are now: for its door, towards its peers, and in what it tells of itself.

    What the functions `read_..._of` return is in force once a method `take_...` has it. `revoked` are certificates
    that the daemon before refused.
    """

    def __init__(self, config: DaemonConfig, *, revoked: frozenset[str] = frozenset()) -> None:
        self.revoked = revoked
        self.take_credentials(config, read_credentials_of(config))
        if config.keys:
            self.revoked = read_revoked_of(config.keys, revoked)

    def take_revoked(self, listed: frozenset[str]) -> None:
        """Refuses exactly these certificates from now on."""
        self.revoked = listed

    def take_credentials(self, config: DaemonConfig, credentials: Credentials | None) -> None:
        """Shows and believes these from now on."""
        self.credentials = credentials
        self._dialer = GrpcDialer(
            config.identities[0].name, credentials, max_message_bytes=config.max_message_bytes
        )

    @property
    def digest(self) -> str:
        """The SHA-256 of the authority's file and the certificate's, one after the other; "" without certificates."""
        known = self.credentials
        return hashlib.sha256(known.authority + known.certificate).hexdigest() if known else ""

    @property
    def digest_of_revoked(self) -> str:
        """The SHA-256 of the revoked certificates' fingerprints, one a line in their order; equal lists have one."""
        return hashlib.sha256("".join(f"{each}\n" for each in sorted(self.revoked)).encode()).hexdigest()

    def dial(self, address: str, *, server: str) -> Link:
        """A link to a peer."""
        return self._dialer.dial(address, server=server)

    def trust(self) -> Trust:
        """What the door needs; there are certificates."""
        assert self.credentials is not None  # noqa: S101 - there is no door without
        return Trust(self.credentials, revoked=self.revoked)

    @property
    def certificates(self) -> list[CertificateStatus]:
        """Whose they are, and until when they are valid."""
        expiries = self.credentials.expiries if self.credentials else {}
        return [CertificateStatus(holder, expires) for holder, expires in expiries.items()]


def read_revoked_of(keys: DaemonKeysConfig, known: frozenset[str]) -> frozenset[str]:
    """The certificates of the list; raises CredentialsError, also for no entry where some were `known`."""
    file = keys.list_of_revoked
    is_there = keys.revoked is not None or os.path.lexists(file)
    listed = read_revoked(file) if is_there else frozenset[str]()
    if known and not listed:
        what = "has no entry any more" if is_there else "is not there any more"
        raise CredentialsError(
            f"{file} {what}: restore it, or restart the daemon if no certificate is revoked from now on"
        )
    return listed


def read_credentials_of(config: DaemonConfig) -> Credentials | None:
    """The credentials of the configuration's files; None where none are used. Raises CredentialsError."""
    if config.keys is None:
        return None
    credentials = read_credentials(config.keys.authority, config.keys.certificate, config.keys.key)
    names = ",".join(identity.name for identity in config.identities)
    remedy = f"make one with {command('upwash', 'keys', 'DIR', '--server', names)}"
    for identity in config.identities:
        if identity.name not in credentials.names:
            raise CredentialsError(
                f"the certificate is for {', '.join(credentials.names)}, but this daemon acts as "
                f"{identity.name}: {remedy}"
            )
    if not credentials.is_for("serving") or (config.peers and not credentials.is_for("calling")):
        raise CredentialsError(f"{config.keys.certificate}: not a certificate for a daemon: {remedy}")
    return None if config.listen.startswith("unix:") else credentials


def warn_without_list(config: DaemonConfig) -> None:
    """Warns where no list of revoked certificates is there: to revoke a certificate changes nothing here."""
    if config.keys and not os.path.lexists(config.keys.list_of_revoked):
        _log.warning(
            "no list of revoked certificates is read: put the revoked.txt of `upwash keys DIR --revoke NAME` beside "
            "%s, or name it as keys.revoked; until then no certificate can be taken back",
            config.keys.authority,
        )


async def watch_expiry(keys: DaemonKeys) -> NoReturn:
    """Warns of certificates that end soon, every day."""
    while True:
        for certificate in keys.certificates:
            now = datetime.now(UTC)
            left = certificate.expires - now
            if left < timedelta():
                _log.error(
                    "the certificate of %s ended on %s, and this computer's clock says %s: drones do not believe it",
                    certificate.holder,
                    certificate.expires,
                    at_second(now),
                )
                continue
            level = logging.WARNING if left < _EXPIRY_WARNING else logging.INFO
            _log.log(
                level,
                "the certificate of %s ends in %d days, on %s",
                certificate.holder,
                left.days,
                certificate.expires,
            )
        await asyncio.sleep(_EXPIRY_LOOK_S)
