"""A service that tries what a service should not, for tests of the sandbox."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import mmap
import os
import resource
import signal
import socket
import time
from pathlib import Path

from upwash.rpc.service import service


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

    def writable(self, folder: str) -> list[str]:
        """The files below the folder that can be opened for writing."""
        found = []
        for place, _, names in os.walk(folder):
            for name in names:
                with contextlib.suppress(OSError):
                    os.close(os.open(f"{place}/{name}", os.O_WRONLY | os.O_NONBLOCK))
                    found.append(f"{place}/{name}")
        return found

    def environment_of(self, process: int) -> list[str]:
        """The variables that the process began with."""
        return Path(f"/proc/{process}/environ").read_text().split("\0")

    def open_files(self) -> list[str]:
        """What the service inherited, of which kind."""
        return sorted(
            str(Path(f"/proc/self/fd/{number}").readlink()) for number in range(3, 100) if _is_open(number)
        )

    def ask_kernel(self, number: int, arguments: list[int]) -> str:
        """Makes the call of that number; says "done", or how that failed."""
        ctypes.set_errno(0)
        longs = [ctypes.c_long(argument) for argument in arguments]
        answer = ctypes.CDLL(None, use_errno=True).syscall(ctypes.c_long(number), *longs)
        return "done" if answer >= 0 else errno.errorcode[ctypes.get_errno()]

    def open_socket(self, family: int, kind: int, protocol: int, *, pair: bool) -> str:
        """Makes a socket, or two; says "done", or how that failed."""
        try:
            if pair:
                socket.socketpair(socket.AddressFamily(family), kind, protocol)
            else:
                socket.socket(family, kind, protocol).close()
        except OSError as error:
            return errno.errorcode[error.errno or 0]
        return "done"

    def map_memory(self, flags: int, path: str) -> str:
        """Takes memory that is nobody's data; says "done", or how that failed."""
        try:
            with open(path or "/dev/null", "r+b") as file:  # noqa: PTH123
                mmap.mmap(file.fileno() if path else -1, 2**29, flags=flags)[0:1] = b"x"
        except OSError as error:
            return errno.errorcode[error.errno or 0]
        return "done"

    def limits(self) -> list[tuple[int, int]]:
        """How large its cores may be, and how many files it may open."""
        return [resource.getrlimit(each) for each in (resource.RLIMIT_CORE, resource.RLIMIT_NOFILE)]

    def first_to_be_killed(self) -> int:
        """How gladly the kernel would end it, of at most 1000."""
        return int(Path("/proc/self/oom_score_adj").read_text())

    def crash(self) -> None:
        """Ends with a signal that makes a core."""
        os.kill(os.getpid(), signal.SIGABRT)

    def look_up(self, host: str) -> int:
        """How many addresses a name has."""
        return len(socket.getaddrinfo(host, 80))

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


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True
