"""A MAVLink connection on the event loop: messages in, messages out, opened again when it breaks.

pymavlink packs and parses. Its own connections (mavutil) are not used: they block, sleep on another clock than
the loop's, print when a connection ends, and change the environment of the process.
"""

from __future__ import annotations

import asyncio
import io
import math
import os
import socket
import termios
import tty
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import UsageError
from upwash.mavlink.connection import parse_connection, serial_speed
from upwash.mavlink.packets import Message, packed
from upwash.mavlink.signing import SignatureRefusal, Signing
from upwash.real.mavlink.receiver import Address, MessageReceiver, Peer, from_autopilot
from upwash.support.background import end, kept_up, only_logged, start
from upwash.support.text import counted

COMPANION = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER

_OPEN_WITHIN_S = 5.0
_REOPEN_AFTER_S = 1.0
_MOST_UNSENT_BYTES = 65_536
_MOVED_AFTER_S = 10.0
_LONGEST_DATAGRAM_BYTES = 65_536
_DATAGRAMS_AT_ONCE, _DATAGRAMS_AT_ONCE_S = 500, 0.01  # then the loop's other work has its turn
_READ_AT_ONCE_BYTES = 4096  # the same, of a stream


Opener: TypeAlias = "Callable[[_Line], Awaitable[None]]"


class MavlinkLink:
    """A connection that opens itself, and again whenever it breaks, until it is closed.

    `connection` is `udpin:HOST:PORT`, `udpout:HOST:PORT`, `tcp:HOST:PORT` or `serial:DEVICE:BAUD` (UsageError
    otherwise), or a function that opens a line, such as one in memory. `heard` gets each believed message. Over
    `udpin` only one peer is received and answered (see `Peer`); `overheard` gets the messages of other senders. With
    `signing` all outgoing messages are signed, and only messages signed with the same key are received.
    """

    def __init__(
        self,
        connection: str | Opener,
        heard: Callable[[Message], object],
        *,
        signing: Signing | None = None,
        follows: Callable[[Message], bool] = from_autopilot,
        overheard: Callable[[Message], object] = lambda _: None,
        moved_after_s: float = _MOVED_AFTER_S,
    ) -> None:
        self.connection = connection if isinstance(connection, str) else "memory"
        self.opened = asyncio.Event()  # set while it is open
        self.opened_s = 0.0  # when it was last opened, by the loop's clock
        self.trouble = ""  # what last kept it from being open
        self._open = _opener(connection) if isinstance(connection, str) else connection
        self._connects = self.connection.startswith("tcp:")  # the others have no other side to lose
        self._receiver = MessageReceiver(heard, follows, signing, overheard)
        self._peer: Peer | None = None
        if self.connection.startswith("udpin:"):
            self._peer = Peer(self._receiver, moved_after_s=moved_after_s, signed=signing is not None)
        self._signing = signing
        self._line: _Line | None = None
        self._codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=COMPANION)
        kept = kept_up(self._stay_open, name="the link", pause_s=_REOPEN_AFTER_S)
        self._task = start(kept, name="the link", failed=only_logged)

    @property
    def why_silent(self) -> str:
        """The known reasons of a silence, in brackets; empty without any."""
        peer = self._peer
        is_over = self._connects and not math.isinf(self.silent_s)  # bytes came later
        reasons = [self.trouble] if self.trouble and not is_over else []
        if self.refused is not None:
            reasons.append(f"an autopilot was heard, and its messages {self.refused.value}")
        if peer is not None and peer.last_ignored is not None:
            host, port = peer.last_ignored[:2]
            reasons.append(
                f"{counted(peer.ignored, 'datagram')} of others ignored, the last from {host}:{port}"
            )
        return f" ({'; '.join(reasons)})" if reasons else ""

    @property
    def refused(self) -> SignatureRefusal | None:
        """Why the last heartbeat of an autopilot was not believed; None for a believed one, or without any."""
        return self._receiver.refused

    def speak_as_part_of(self, system: int) -> None:
        """Sends as the companion computer of that system from now on."""
        self._codec.srcSystem = system

    def send(self, message: Message) -> None:
        """Sends the message, or drops it while the connection is not open."""
        self.send_bytes(packed(message, self._codec, self._signing))

    def send_bytes(self, data: bytes) -> None:
        """Sends the bytes as they are, or drops them while the connection is not open."""
        if self._line:
            self._line.write(data)

    @property
    def silent_s(self) -> float:
        """Seconds since the last bytes of any sender; infinite if no bytes came since the connection was opened."""
        return asyncio.get_running_loop().time() - self._line.came_s if self._line else math.inf

    def reopen_if_dead(self, after_s: float) -> None:
        """Breaks a TCP connection off that brought nothing for that long; it is opened again."""
        opened_s = asyncio.get_running_loop().time() - self.opened_s
        if self._line and self._connects and min(self.silent_s, opened_s) > after_s:
            self._line.trouble = "nothing came"
            self._line.ended.set()

    async def close(self) -> None:
        """Closes the connection for good."""
        await end(self._task)

    async def _stay_open(self) -> None:
        while True:
            line = _Line(self._receiver, self._peer)
            try:
                async with asyncio.timeout(_OPEN_WITHIN_S):
                    await self._open(line)
                self._line = line
                self.opened_s = asyncio.get_running_loop().time()
                self.opened.set()
                await line.ended.wait()
            except OSError as error:
                line.trouble = error.strerror or str(error) or "no answer"
            finally:
                self._line = None
                self.opened.clear()
                self.trouble = line.trouble
                await line.close()
            await asyncio.sleep(_REOPEN_AFTER_S)


class _Line(asyncio.BufferedProtocol, asyncio.DatagramProtocol):
    """One opening of the connection, from open to broken; its opener sets `write`."""

    def __init__(self, receiver: MessageReceiver, peer: Peer | None) -> None:
        self.write: Callable[[bytes], None] = lambda _: None
        self.peer = peer  # where anyone may send
        self.trouble = ""
        self.came_s = -math.inf  # when the last bytes came
        self.ended = asyncio.Event()
        self.close_socket: Callable[[], None] = lambda: None  # where there is no transport
        self._receiver = receiver
        self._reader = receiver.reader()
        self._buffer = bytearray(_READ_AT_ONCE_BYTES)
        self._transport: asyncio.BaseTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def connection_lost(self, error: Exception | None) -> None:
        self.trouble = str(error) if error else "closed by the other side"
        self.ended.set()

    def get_buffer(self, sizehint: int) -> bytearray:
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        self.data_received(bytes(self._buffer[:nbytes]))

    def data_received(self, data: bytes) -> None:
        self.came_s = asyncio.get_running_loop().time()
        self._receiver.take(data, self._reader)

    def datagram_received(self, data: bytes, address: Address) -> None:
        self.came_s = asyncio.get_running_loop().time()
        if self.peer is None:
            self._receiver.take(data)
        else:
            self.peer.take(data, address, self.came_s)

    def error_received(self, error: Exception) -> None:
        self.trouble = str(error)  # such as "connection refused" by the host: it may well listen later

    async def close(self) -> None:
        """Returns when the line is closed."""
        self.close_socket()
        if self._transport is None:
            return
        if isinstance(self._transport, asyncio.Transport):
            self._transport.abort()
        else:
            self._transport.close()
        await self.ended.wait()


async def _open_udpin(host: str, port: int, line: _Line) -> None:
    # No transport of asyncio's: that reads one datagram a turn, and who sends more would have the vehicle's lost.
    loop = asyncio.get_running_loop()
    family, kind, _, _, place = (await loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM))[0]
    bound = socket.socket(family, kind)
    try:
        bound.setblocking(False)
        bound.bind(place)
    except OSError:
        bound.close()
        raise

    def read() -> None:
        until_s = loop.time() + _DATAGRAMS_AT_ONCE_S
        for _ in range(_DATAGRAMS_AT_ONCE):
            try:
                data, address = bound.recvfrom(_LONGEST_DATAGRAM_BYTES)
            except OSError:  # nothing more for now
                return
            line.datagram_received(data, address)
            if loop.time() > until_s:
                return

    def answer(data: bytes) -> None:
        if line.peer and line.peer.answered:
            try:
                bound.sendto(data, line.peer.answered)
            except OSError as error:
                line.error_received(error)

    def close() -> None:
        loop.remove_reader(bound)
        bound.close()

    loop.add_reader(bound, read)
    line.close_socket = close
    line.write = answer


async def _open_udpout(host: str, port: int, line: _Line) -> None:
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: line, remote_addr=(host, port)
    )
    line.write = transport.sendto


async def _open_tcp(host: str, port: int, line: _Line) -> None:
    transport, _ = await asyncio.get_running_loop().create_connection(lambda: line, host, port)

    def write(data: bytes) -> None:
        if transport.get_write_buffer_size() < _MOST_UNSENT_BYTES and not transport.is_closing():
            transport.write(data)

    line.write = write


async def _open_serial(device: str, baud: int, line: _Line) -> None:
    port = _serial_port(device, baud)
    try:
        await asyncio.get_running_loop().connect_read_pipe(lambda: line, port)
    except BaseException:
        port.close()
        raise

    def write(data: bytes) -> None:
        try:
            os.write(port.fileno(), data)
        except OSError as error:
            line.trouble = str(error)  # a full line costs messages, never the loop's time

    line.write = write


def _serial_port(device: str, baud: int) -> io.FileIO:
    port = io.FileIO(os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK), "r")
    try:
        tty.setraw(port.fileno())
        attributes = termios.tcgetattr(port)
        attributes[2] |= termios.CLOCAL | termios.CREAD
        attributes[2] &= ~termios.CRTSCTS
        attributes[4] = attributes[5] = serial_speed(baud)
        termios.tcsetattr(port, termios.TCSANOW, attributes)
    except termios.error as error:
        port.close()
        raise OSError(*error.args) from error
    return port


_OPENERS: dict[str, Callable[[str, int, _Line], Awaitable[None]]] = {
    "udpin": _open_udpin,
    "udpout": _open_udpout,
    "tcp": _open_tcp,
    "serial": _open_serial,
}


def _opener(connection: str) -> Opener:
    try:
        parsed = parse_connection(connection, kinds=_OPENERS)
    except ValueError as error:
        raise UsageError(f"the connection to the vehicle: {error}") from None
    return partial(_OPENERS[parsed.kind], parsed.place, parsed.number)
