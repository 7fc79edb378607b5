"""Reports a program's state to systemd, or another service manager that started it with NOTIFY_SOCKET set.

The protocol is a datagram of text: sd_notify(3). With WATCHDOG_USEC the manager ends a silent program:
sd_watchdog_enabled(3).
"""

from __future__ import annotations

import asyncio
import logging
import socket
import time
from collections.abc import MutableMapping
from typing import NoReturn

from upwash.support.background import never

_ADDRESS, _WATCHDOG = "NOTIFY_SOCKET", "WATCHDOG_USEC"
_log = logging.getLogger("upwash.service_manager")


class ServiceManager:
    """The service manager at the address; without an address, methods send nothing.

    The manager ends a program that is silent for `watchdog_us` microseconds; 0 is no watchdog.
    """

    def __init__(self, address: str, watchdog_us: int = 0) -> None:
        self._address = address
        self._watchdog_us = watchdog_us if address else 0

    @classmethod
    def taken_from(cls, environment: MutableMapping[str, str]) -> ServiceManager:
        """The manager that the environment names. Its variables are removed: child processes do not report to it."""
        watchdog = environment.pop(_WATCHDOG, "")
        return cls(environment.pop(_ADDRESS, ""), int(watchdog) if watchdog.isdecimal() else 0)

    @property
    def environment(self) -> dict[str, str]:
        """The environment variables with which another program can report to it."""
        watchdog = {_WATCHDOG: str(self._watchdog_us)} if self._watchdog_us else {}
        return {_ADDRESS: self._address, **watchdog} if self._address else {}

    async def heartbeat(self) -> NoReturn:
        """Report that the event loop does its work, twice in the manager's time, until cancelled."""
        while self._watchdog_us:
            self._send("WATCHDOG=1")
            await asyncio.sleep(self._watchdog_us / 2e6)
        await never()

    def ready(self) -> None:
        """Report that the program serves, with the configuration that it read last."""
        self._send("READY=1")

    def reloading(self) -> None:
        """Report that the program reads its configuration again; `ready` ends that state."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def main_is(self, process: int) -> None:
        """Report that the service's main process is the one of that number, which alone reports from now on."""
        self._send(f"MAINPID={process}")
        self._address, self._watchdog_us = "", 0

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
