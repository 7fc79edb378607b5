"""Reports a program's state to systemd, or another service manager that started it with NOTIFY_SOCKET set.

The protocol is a datagram of text: sd_notify(3).
"""

from __future__ import annotations

import logging
import socket
import time

_VARIABLE = "NOTIFY_SOCKET"
_log = logging.getLogger("upwash.service_manager")


class ServiceManager:
    """The service manager at the address; without an address, methods send nothing."""

    def __init__(self, address: str) -> None:
        self._address = address

    @property
    def environment(self) -> dict[str, str]:
        """The environment variables with which another program can report to it."""
        return {_VARIABLE: self._address} if self._address else {}

    def ready(self) -> None:
        """Report that the program serves, with the configuration that it read last."""
        self._send("READY=1")

    def reloading(self) -> None:
        """Report that the program reads its configuration again; `ready` ends that state."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def main_is(self, process: int) -> None:
        """Report that the service's main process is the one of that number from now on."""
        self._send(f"MAINPID={process}")

    def stopping(self, status: str) -> None:
        """Report that the program is ending; `status` is a text for people, such as what it waits for."""
        self._send(f"STOPPING=1\nSTATUS={status}")

    def _send(self, state: str) -> None:
        if not self._address:
            return
        name = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as to:
                to.sendto(state.encode(), name)
        except OSError as error:
            _log.warning("the service manager at %s cannot be told: %s", self._address, error)
