"""An operator's orders to a daemon of the same machine, by its process number, with an answer to each.

The daemon listens at a socket of Linux's abstract namespace, which ends with its process and is no file. An order is
a line, the answer a JSON object. Both ends ask the kernel who the other is: the daemon obeys its own user and root,
and the operator takes an answer from the named process alone.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import os
import pwd
import socket
import struct
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from pathlib import Path
from typing import NoReturn

import msgspec

from upwash.errors import UpwashError, UsageError
from upwash.real.link.streams import readable
from upwash.support.background import beside, end, only_logged, start

_log = logging.getLogger("upwash.serving")
_CREDENTIALS = struct.Struct("3i")  # of a process: its number, user and group
_LONGEST_ORDER_BYTES = 256
_ORDER_S = 5.0
_AGAIN_S = 0.1
_MOST_AT_ONCE = 8
_ROOT = 0

Obey = Callable[[str, str], Awaitable["Obeyed"]]


class Obeyed(msgspec.Struct, frozen=True):
    """What became of an order: by its part what was refused, and why. `file` is the daemon's configuration."""

    refused: Mapping[str, str]
    file: str


@contextlib.asynccontextmanager
async def taking_orders(obey: Obey) -> AsyncIterator[None]:
    """Have `obey(order, by)` answer orders until the end of the block; a failure to listen is logged."""
    with socket.socket(socket.AF_UNIX) as listening:
        listening.setblocking(False)
        try:
            listening.bind(_address(os.getpid()))
            listening.listen()
        except OSError as error:
            _log.warning("no orders are taken but signals, as no socket can be made: %s", error)
            yield
            return
        async with beside(_take(listening, obey), name="orders of operators"):
            yield


async def _take(listening: socket.socket, obey: Obey) -> NoReturn:
    room, conversations = asyncio.Semaphore(_MOST_AT_ONCE), set[asyncio.Task[None]]()
    try:
        while True:
            await readable(listening)
            try:
                connection, _ = listening.accept()
            except OSError:  # the operator hung up before, or no file is left to open
                await asyncio.sleep(_AGAIN_S)
                continue
            connection.setblocking(False)
            own = start(_converse(connection, obey, room), name="an order", failed=only_logged)
            conversations.add(own)
            own.add_done_callback(conversations.discard)
            own.add_done_callback(functools.partial(_close, connection))
    finally:
        await end(*conversations)


def _close(connection: socket.socket, _: object) -> None:
    connection.close()


async def _converse(connection: socket.socket, obey: Obey, room: asyncio.Semaphore) -> None:
    with contextlib.suppress(OSError, TimeoutError, ValueError):
        process, user = _who(connection)
        if user not in (os.geteuid(), _ROOT):
            _log.warning("process %d of user %s may give no orders", process, _name(user))
            return
        async with room:
            async with asyncio.timeout(_ORDER_S):
                order = await _line(connection)
            obeyed = await obey(order, f"process {process} of user {_name(user)}")
        await asyncio.get_running_loop().sock_sendall(connection, msgspec.json.encode(obeyed))


async def _line(connection: socket.socket) -> str:
    """The line that the other end sends; raises ValueError for a line that is too long."""
    line = b""
    while not line.endswith(b"\n"):
        if len(line) > _LONGEST_ORDER_BYTES:
            raise ValueError("the order is too long")
        more = await asyncio.get_running_loop().sock_recv(connection, _LONGEST_ORDER_BYTES)
        if not more:
            break
        line += more
    return line.decode().strip()


def give_order(process: int, order: str) -> Obeyed:
    """Give the daemon of that process number an order, and wait for the answer.

    Raises UsageError where the process takes no orders, and UpwashError if it ends before it has answered.
    """
    with socket.socket(socket.AF_UNIX) as to:
        try:
            to.connect(_address(process))
        except OSError as error:
            raise UsageError(
                f"process {process} takes no orders ({error.strerror}): if it is a daemon, wait until it is "
                "ready; else give the number of one, which systemctl show --property MainPID upwash prints"
            ) from None
        if _who(to)[0] != process:
            raise UsageError(f"another process answers in the place of process {process}: give it no orders")
        said = b""
        with contextlib.suppress(OSError), to.makefile("rb") as answer:
            to.sendall(f"{order}\n".encode())
            said = answer.read()
    try:
        return msgspec.json.decode(said, type=Obeyed)
    except msgspec.MsgspecError:
        raise UpwashError(
            f"process {process} has not answered: it has ended, or does not obey this user; its log says which"
        ) from None


def _address(process: int) -> str:
    numbering = 0  # a machine may have several number spaces of processes
    with contextlib.suppress(OSError):
        numbering = Path("/proc/self/ns/pid").stat().st_ino
    return f"\0upwash-serve-{numbering}-{process}"


def _who(connection: socket.socket) -> tuple[int, int]:
    """The process and the user at the other end, as the kernel knows them."""
    process, user, _ = _CREDENTIALS.unpack(
        connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    )
    return process, user


def _name(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return str(user)
