"""The certificates that an edge daemon shows and believes, read again whenever its configuration is."""

from __future__ import annotations

import asyncio
import logging
from datetime import UTC, datetime, timedelta
from typing import NoReturn

from upwash.config import DaemonConfig
from upwash.errors import CredentialsError
from upwash.ports import Link
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.credentials import Credentials, Trust, at_second, read_credentials, read_revoked
from upwash.rpc.protocol import CertificateStatus
from upwash.support.text import command

_log = logging.getLogger("upwash.serving")

_EXPIRY_WARNING = timedelta(days=30)
_EXPIRY_LOOK_S = 86_400.0


class DaemonKeys:
    """The daemon's certificates as they are now: for its door, towards its peers, and in what it tells of itself."""

    def __init__(self, config: DaemonConfig) -> None:
        self.renew(config)

    def renew(self, config: DaemonConfig) -> None:
        """Reads the files again; where they are no good, CredentialsError is raised and the old ones stay."""
        credentials, revoked = _credentials(config), config.keys.revoked if config.keys else None
        self.revoked = read_revoked(revoked) if revoked else frozenset[str]()
        self.credentials = credentials
        self._dialer = GrpcDialer(
            config.identities[0].name, credentials, max_message_bytes=config.max_message_bytes
        )

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


def _credentials(config: DaemonConfig) -> Credentials | None:
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
