"""A new daemon replaces the running one, so that its program can be changed while drones fly.

    the old daemon                                   the new daemon, its child
    starts it, with the listening socket and         reads the configuration, takes up the leases,
    the drones that are served                       starts the same services, accepts connections, reports it
    accepts no more connections, hangs up            renews every lease, with its own endpoints
    serves its drones until their leases end

For a moment both accept connections, and none is refused: each waits in the socket until a daemon takes it. If the
new daemon does not come up, the old one goes on.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Collection, Iterator, Mapping, MutableMapping, Sequence

import msgspec
from msgspec import Struct

from upwash.core.admission.clients import DroneUsage, TeamUsage
from upwash.errors import UpwashError
from upwash.real.link.streams import readable

_VARIABLE = "UPWASH_HANDED_OVER"
_READY = b"ready"
_PARENT = os.getppid()  # of a successor the old daemon, until that ends
_log = logging.getLogger("upwash.serving")


class Served(Struct, frozen=True):
    """The drones that a server serves, by name and certificate, and the services that run there."""

    drones: Sequence[tuple[str, str]]
    services: Sequence[str]


class Used(Struct, frozen=True):
    """The usage of a server by drones and by teams."""

    drones: Sequence[DroneUsage]
    teams: Sequence[TeamUsage]


class HandedOver(Struct, frozen=True):
    """What the new daemon gets from the old one; the `..._file` fields are open file descriptors."""

    listen: str
    socket_file: int
    ready_file: int
    servers: Mapping[str, Served]
    usage_file: int
    revoked_file: int = -1  # an earlier daemon leaves it out

    def revoked(self) -> frozenset[str]:
        """The certificates that the old daemon refuses; call it only once. Raises UpwashError."""
        if self.revoked_file < 0:
            return frozenset()
        try:
            return frozenset(_read_memory(self.revoked_file).decode("ascii").split())
        except (OSError, UnicodeDecodeError) as error:
            raise UpwashError(
                f"the certificates that the daemon before refuses cannot be read: {error}"
            ) from None

    def usage(self) -> Mapping[str, Used]:
        """The usage of each server, empty if it cannot be read; call it only once."""
        try:
            return _usage.decode(_read_memory(self.usage_file))
        except (OSError, msgspec.MsgspecError) as error:
            _log.warning("what drones used counts from zero again: %s", error)
            return {}

    def listening(self) -> socket.socket:
        """The socket that drones connect to."""
        return socket.socket(fileno=self.socket_file)

    def reload(self) -> None:
        """Have the old daemon reload too while it serves its last drones."""
        if os.getppid() == _PARENT:
            with contextlib.suppress(OSError):
                os.kill(_PARENT, signal.SIGHUP)

    def ready(self) -> None:
        """Reports to the old daemon that it may end."""
        with contextlib.suppress(OSError):  # it has ended already
            os.write(self.ready_file, _READY)
        with contextlib.suppress(OSError):
            os.close(self.ready_file)


def _read_memory(descriptor: int) -> bytes:
    with open(descriptor, "rb") as file:
        file.seek(0)
        return file.read()


@contextlib.contextmanager
def _in_memory(name: str, content: bytes) -> Iterator[int]:
    """A file with that content; an environment variable has 128 KiB at most."""
    with open(os.memfd_create(name), "wb", buffering=0) as file:  # noqa: PTH123 - in memory
        file.write(content)
        yield file.fileno()


_usage = msgspec.json.Decoder(dict[str, Used])


def handed_over(environment: MutableMapping[str, str]) -> HandedOver | None:
    """The hand-over of the former daemon from the environment, which is removed there; None without one."""
    given = environment.pop(_VARIABLE, "")
    return msgspec.json.decode(given, type=HandedOver) if given else None


async def hand_over(
    listening: socket.socket,
    listen: str,
    servers: Mapping[str, Served],
    usage: Mapping[str, Used],
    revoked: Collection[str],
    *,
    environment: Mapping[str, str],
    timeout_s: float,
) -> int:
    """Starts this program as it is on the disk now, with that environment; returns its process once it is ready.

    Raises UpwashError if the process ends before or is not ready in time; it does not run any more then.
    """
    ready, theirs = socket.socketpair()
    with ready:
        with (
            theirs,
            _in_memory("usage", msgspec.json.encode(usage)) as used,
            _in_memory("revoked", "\n".join(revoked).encode()) as refused,
        ):
            files = (listening.fileno(), theirs.fileno(), used, refused)
            given = HandedOver(listen, files[0], files[1], servers, *files[2:])
            new = subprocess.Popen(  # noqa: ASYNC220, S603 - asyncio's own would end it together with the loop
                [sys.executable, *sys.orig_argv[1:]],
                stderr=sys.stderr,  # where file descriptor 2 leads to a log that ends with this daemon
                pass_fds=files,
                env={**os.environ, **environment, _VARIABLE: msgspec.json.encode(given).decode()},
            )
        try:
            async with asyncio.timeout(timeout_s):
                await readable(ready)
            if ready.recv(len(_READY)) != _READY:
                code = await asyncio.to_thread(new.wait)
                raise UpwashError(f"the new daemon ended with code {code}: its own log says why")
        except BaseException as error:
            new.kill()
            await asyncio.to_thread(new.wait)
            if isinstance(error, TimeoutError):
                raise UpwashError(
                    f"the new daemon was not ready within {timeout_s:g} s: it was ended"
                ) from None
            raise
    return new.pid
