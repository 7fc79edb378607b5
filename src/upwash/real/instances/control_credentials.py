"""The secret that a daemon shares with one container: a key and its certificate, which both ends of TLS show.

One secret opens the container's control line, another the port of its service. Neither certificate is of the
operator's authority.
"""

from __future__ import annotations

import base64
import re
import socket
import ssl
from dataclasses import dataclass, field

from upwash.real.trust.secrets import load_secret

CONTROL_PORT = 7071
SERVICE_PORT = 7070

_PROBE_AFTER_S, _PROBE_PERIOD_S, _PROBES = 2, 1, 4  # the loss of the peer's machine shows within 6 s


@dataclass(frozen=True, slots=True)
class ControlCredentials:
    """A key and its self-signed certificate, as one PEM text."""

    pem: bytes = field(repr=False)

    @staticmethod
    def from_text(text: str) -> ControlCredentials:
        """The credentials from a line that `text()` returned."""
        return ControlCredentials(base64.b64decode(text))

    def text(self) -> str:
        """The credentials in one line."""
        return base64.b64encode(self.pem).decode()

    @property
    def certificate(self) -> bytes:
        """The certificate, which is public."""
        found = re.search(rb"-----BEGIN CERTIFICATE-----.*", self.pem, re.DOTALL)
        assert found is not None  # noqa: S101 - they have one
        return found.group()

    def context(self, *, is_server: bool) -> ssl.SSLContext:
        """TLS with a peer that has the same credentials."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if is_server else ssl.PROTOCOL_TLS_CLIENT)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        context.check_hostname = False
        context.verify_mode = ssl.CERT_REQUIRED
        context.load_verify_locations(cadata=self.certificate.decode())
        load_secret(context, self.pem)
        return context


def new_control_credentials() -> ControlCredentials:
    """New random credentials, valid as long as an authority: a stopped container may be started much later."""
    from cryptography.x509 import BasicConstraints

    from upwash.real.trust.authority import new_key_pair

    pair = new_key_pair("upwash control line", [(BasicConstraints(ca=True, path_length=0), True)])
    return ControlCredentials(pair.key_pem + pair.certificate_pem)


def notice_silence(connection: socket.socket) -> None:
    """Have the kernel break a connection to a machine that is gone."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, _PROBE_AFTER_S)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, _PROBE_PERIOD_S)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, _PROBES)
    silent_ms = (_PROBE_AFTER_S + _PROBES * _PROBE_PERIOD_S) * 1000
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, silent_ms)
