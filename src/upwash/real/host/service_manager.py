"""Tells systemd, or whoever else started a program with NOTIFY_SOCKET set, how it is doing.

The protocol is a datagram of text: sd_notify(3).
"""

from __future__ import annotations

import logging
import socket
import time

_VARIABLE = "NOTIFY_SOCKET"
_log = logging.getLogger("upwash.service_manager")


class ServiceManager:
    """The service manager that listens at the address; with an empty one there is none, and nothing is told."""

    def __init__(self, address: str) -> None:
        self._address = address

    @property
    def environment(self) -> dict[str, str]:
        """What a program needs that is to tell it how it is doing."""
        return {_VARIABLE: self._address} if self._address else {}

    def ready(self) -> None:
        """The program serves, with the configuration that it read last."""
        self._tell("READY=1")

    def reloading(self) -> None:
        """The program reads its configuration again; `ready` ends it."""
        self._tell(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def main_is(self, process: int) -> None:
        """From now on that process is the service."""
        self._tell(f"MAINPID={process}")

    def stopping(self, status: str) -> None:
        """The program is ending, and this is what it waits for."""
        self._tell(f"STOPPING=1\nSTATUS={status}")

    def _tell(self, state: str) -> None:
        if not self._address:
            return
        name = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as to:
                to.sendto(state.encode(), name)
        except OSError as error:
            _log.warning("the service manager at %s cannot be told: %s", self._address, error)
