"""A daemon has the next one take its place, so that its program can be changed while drones fly.

    the old daemon                                   the new one, its child
    starts it, with the listening socket             reads the configuration, takes up the leases
    and with who is served                           starts the same services, accepts connections, says so
    accepts no more connections, hangs up            is asked to renew every lease, and answers with its own endpoints
    serves whom it served, until their leases end

Both accept for a moment, and none is refused: a connection waits in the socket until one of them takes it. Where the
new one does not come up, the old one goes on as if nothing had been.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import subprocess
import sys
from collections.abc import Mapping, MutableMapping, Sequence

import msgspec
from msgspec import Struct

from upwash.core.admission.clients import DroneUsage, TeamUsage
from upwash.errors import UpwashError
from upwash.real.link.streams import readable

_VARIABLE = "UPWASH_HANDED_OVER"
_READY = b"ready"
_log = logging.getLogger("upwash.serving")


class Served(Struct, frozen=True):
    """Whom one server serves, by name and certificate, and the services that run there."""

    drones: Sequence[tuple[str, str]]
    services: Sequence[str]


class Used(Struct, frozen=True):
    """What drones and teams have used of one server."""

    drones: Sequence[DroneUsage]
    teams: Sequence[TeamUsage]


class HandedOver(Struct, frozen=True):
    """What the new daemon is given: its files are numbers of open ones."""

    listen: str
    socket_file: int
    ready_file: int
    servers: Mapping[str, Served]
    usage_file: int = -1  # which an earlier daemon does not give

    def usage(self) -> Mapping[str, Used]:
        """What has been used of each server; nothing where that cannot be known. Only once."""
        if self.usage_file < 0:
            return {}
        try:
            with open(self.usage_file, "rb") as file:  # noqa: PTH123 - a file descriptor
                file.seek(0)
                return _usage.decode(file.read())
        except (OSError, msgspec.MsgspecError) as error:
            _log.warning("what drones used counts from zero again: %s", error)
            return {}

    def listening(self) -> socket.socket:
        """The socket at which drones connect."""
        return socket.socket(fileno=self.socket_file)

    def ready(self) -> None:
        """Tells the old daemon that it may go."""
        with contextlib.suppress(OSError):  # it has gone already: then nobody is left to be told
            os.write(self.ready_file, _READY)
        with contextlib.suppress(OSError):
            os.close(self.ready_file)


_usage = msgspec.json.Decoder(dict[str, Used])


def handed_over(environment: MutableMapping[str, str]) -> HandedOver | None:
    """What this daemon is given, where it was started to take another one's place."""
    told = environment.pop(_VARIABLE, "")
    return msgspec.json.decode(told, type=HandedOver) if told else None


async def hand_over(
    listening: socket.socket,
    listen: str,
    servers: Mapping[str, Served],
    usage: Mapping[str, Used],
    *,
    environment: Mapping[str, str],
    timeout_s: float,
) -> int:
    """Starts this program anew, as it is on the disk now, with that environment.

    Returns its process once it is ready; raises UpwashError where it ends before, or takes longer. After any error
    nothing of it is left.
    """
    ready, theirs = socket.socketpair()
    with ready:
        # In a file: a variable of the environment has 128 KiB at most.
        with theirs, open(os.memfd_create("usage"), "wb", buffering=0) as used:  # noqa: ASYNC230, PTH123 - in memory
            used.write(msgspec.json.encode(usage))
            given = HandedOver(listen, listening.fileno(), theirs.fileno(), servers, used.fileno())
            new = subprocess.Popen(  # noqa: ASYNC220, S603 - asyncio's own would end it together with the loop
                [sys.executable, *sys.orig_argv[1:]],
                stderr=sys.stderr,  # where file descriptor 2 leads to a log that ends with this daemon
                pass_fds=(listening.fileno(), theirs.fileno(), used.fileno()),
                env={**os.environ, **environment, _VARIABLE: msgspec.json.encode(given).decode()},
            )
        try:
            await _until_ready(new, ready, timeout_s=timeout_s)
        except BaseException:
            new.kill()
            await asyncio.to_thread(new.wait)
            raise
    return new.pid


async def _until_ready(new: subprocess.Popen[bytes], ready: socket.socket, *, timeout_s: float) -> None:
    try:
        async with asyncio.timeout(timeout_s):
            await readable(ready)
    except TimeoutError:
        raise UpwashError(f"the new daemon was not ready within {timeout_s:g} s: it was ended") from None
    if ready.recv(len(_READY)) != _READY:
        code = await asyncio.to_thread(new.wait)
        raise UpwashError(f"the new daemon ended with code {code}: its own log says why")
