"""A service that tries what a service should not, for tests of the sandbox."""

from __future__ import annotations

import os
import socket
import time
from pathlib import Path

from upwash.service import service


@service
class Mischief:
    def eat_memory(self, most_bytes: int) -> int:
        """Takes memory until there is no more of it, or until that much is taken; returns how much it got."""
        chunk_bytes = 2**24
        taken: list[bytes] = []
        try:
            while len(taken) * chunk_bytes < most_bytes:
                taken.append(b"x" * chunk_bytes)
        except MemoryError:
            pass
        return len(taken) * chunk_bytes

    def fork(self, most: int) -> int:
        """Makes processes until it may no more; returns how many it got."""
        made = 0
        try:
            for _ in range(most):
                if os.fork() == 0:
                    time.sleep(60.0)
                    os._exit(0)
                made += 1
        except OSError:
            pass
        return made

    def fill(self, folder: str, most_bytes: int) -> int:
        """Writes files into the folder until it is full; returns how many bytes it got rid of."""
        written = 0
        try:
            for number in range(1000):
                with Path(folder, f"rubbish-{number}").open("wb") as file:
                    for _ in range(100):
                        if written >= most_bytes:
                            return written
                        written += file.write(bytes(10_000))
                        file.flush()
        except OSError:
            pass
        return written

    def read(self, path: str) -> str:
        """What the file says; how that failed otherwise."""
        try:
            return Path(path).read_text()
        except OSError as error:
            return type(error).__name__

    def connect(self, address: str) -> str:
        """Connects to host:port or to a path; says "connected", or how that failed."""
        host, _, port = address.rpartition(":")
        try:
            if host:
                socket.create_connection((host, int(port)), timeout=5.0).close()
            else:
                with socket.socket(socket.AF_UNIX) as unix:
                    unix.connect(address)
        except OSError as error:
            return type(error).__name__
        return "connected"

    def processes(self) -> list[int]:
        """The processes that it can see."""
        return sorted(int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit())

    def environment(self) -> list[str]:
        """The names of its environment's variables."""
        return sorted(os.environ)
