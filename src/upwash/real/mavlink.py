"""A MAVLink connection on the event loop: messages in, messages out, opened again when it breaks.

pymavlink packs and parses. Its own connections (mavutil) are not used: they block, sleep on another clock than
the loop's, print when a connection ends, and change the environment of the process.
"""

from __future__ import annotations

import asyncio
import io
import os
import termios
import tty
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import UsageError

Message: TypeAlias = Any  # pymavlink's messages are not typed

COMPANION = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER

_OPEN_WITHIN_S = 5.0
_REOPEN_AFTER_S = 1.0
_MOST_UNSENT_BYTES = 65_536
_NOT_UNDERSTOOD = (mavlink.MAVLink_bad_data, mavlink.MAVLink_unknown)  # garbage, or no checksum to verify


class MavlinkLink:
    """A connection that opens itself, and again whenever it broke, until it is closed.

    `connection` is `udpin:HOST:PORT`, `udpout:HOST:PORT`, `tcp:HOST:PORT` or `serial:DEVICE:BAUD`; UsageError
    otherwise. `heard` is called with each message.
    """

    def __init__(self, connection: str, heard: Callable[[Message], None]) -> None:
        self.connection = connection
        self.opened = asyncio.Event()  # set while it is open
        self.opened_s = 0.0  # when it last was, by the loop's clock
        self.trouble = ""  # what last kept it from being open
        self._open = _opener(connection)
        self._connects = connection.startswith("tcp:")  # the others have no other side to lose
        self._heard = heard
        self._line: _Line | None = None
        self._codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=COMPANION)
        self._task = asyncio.create_task(self._stay_open())

    def speak_as_part_of(self, system: int) -> None:
        """Sends as the companion computer of that system from now on."""
        self._codec.srcSystem = system

    def send(self, message: Message) -> None:
        """Sends the message, or drops it while the connection is not open."""
        data = bytes(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256
        self.send_bytes(data)

    def send_bytes(self, data: bytes) -> None:
        """Sends them as they are, or drops them while the connection is not open."""
        if self._line:
            self._line.write(data)

    def reopen(self) -> None:
        """Breaks the connection off, if one was made, to make it anew."""
        if self._line and self._connects:
            self._line.trouble = "nothing came"
            self._line.ended.set()

    async def close(self) -> None:
        """Closes the connection for good."""
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    async def _stay_open(self) -> None:
        while True:
            line = _Line(self._heard)
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


class _Line(asyncio.Protocol, asyncio.DatagramProtocol):
    """One opening of the connection, from open to broken."""

    def __init__(self, heard: Callable[[Message], None]) -> None:
        self.write: Callable[[bytes], None] = lambda _: None
        self.peer: tuple[str | Any, int] | None = None  # whom a datagram was last heard from
        self.trouble = ""
        self.ended = asyncio.Event()
        self._heard = heard
        self._parser = _parser()
        self._transport: asyncio.BaseTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def connection_lost(self, error: Exception | None) -> None:
        self.trouble = str(error) if error else "closed by the other side"
        self.ended.set()

    def data_received(self, data: bytes) -> None:
        self._take(self._parser, data)

    def datagram_received(self, data: bytes, address: tuple[str | Any, int]) -> None:
        self.peer = address
        self._take(_parser(), data)  # a datagram holds whole messages: a broken one cannot spoil the next

    def error_received(self, error: Exception) -> None:
        self.trouble = str(error)  # such as "connection refused" by the host: it may well listen later

    async def close(self) -> None:
        """Returns when the line is closed."""
        if self._transport is None:
            return
        if isinstance(self._transport, asyncio.Transport):
            self._transport.abort()
        else:
            self._transport.close()
        await self.ended.wait()

    def _take(self, parser: Any, data: bytes) -> None:
        for message in parser.parse_buffer(data) or ():
            if not isinstance(message, _NOT_UNDERSTOOD):
                self._heard(message)


def _parser() -> Any:
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True  # what cannot be understood becomes a message of its own, not an exception
    return parser


async def _open_udpin(host: str, port: int, line: _Line) -> None:
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: line, local_addr=(host, port)
    )

    def answer(data: bytes) -> None:
        if line.peer:
            transport.sendto(data, line.peer)

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
        attributes[4] = attributes[5] = _speed(baud)
        termios.tcsetattr(port, termios.TCSANOW, attributes)
    except termios.error as error:
        port.close()
        raise OSError(*error.args) from error
    return port


def _speed(baud: int) -> int:
    """The terminal interface's own number for a speed, 0 if it has none."""
    return int(getattr(termios, f"B{baud}", 0))


_OPENERS: dict[str, Callable[[str, int, _Line], Awaitable[None]]] = {
    "udpin": _open_udpin,
    "udpout": _open_udpout,
    "tcp": _open_tcp,
    "serial": _open_serial,
}


def _opener(connection: str) -> Callable[[_Line], Awaitable[None]]:
    kind, _, rest = connection.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in _OPENERS or not place or not number.isdecimal():
        raise UsageError(
            f'the autopilot cannot be reached at "{connection}"; '
            "write udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"
        )
    if kind != "serial" and int(number) > 65_535:
        raise UsageError(f'"{connection}": {number} is no port; ports end at 65535')
    if kind == "serial" and not _speed(int(number)):
        raise UsageError(f'"{connection}": {number} is no speed of a serial port; usual are 57600 and 921600')
    return partial(_OPENERS[kind], place, int(number))
