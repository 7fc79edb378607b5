"""How a vehicle is reached, as a person writes it: udpout:HOST:PORT, serial:DEVICE:BAUD and such."""

from __future__ import annotations

import termios
from collections.abc import Collection
from dataclasses import dataclass

KINDS = ("udpin", "udpout", "tcp", "serial")
_MOST_PORT = 65_535


@dataclass(frozen=True, slots=True)
class Connection:
    """Its kind, the host or device, and the port or the speed in bauds."""

    kind: str
    place: str
    number: int


def parse_connection(text: str, *, kinds: Collection[str] = KINDS) -> Connection:
    """The connection that is written so; raises ValueError with what is wrong about the text."""
    kind, _, rest = text.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in kinds or not place or not (number.isascii() and number.isdecimal()):
        raise ValueError(
            f'expected udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD, found "{text}"'
        )
    if kind != "serial" and int(number) > _MOST_PORT:
        raise ValueError(f'{number} in "{text}" is no port: ports end at {_MOST_PORT}')
    if kind == "serial" and not serial_speed(int(number)):
        raise ValueError(f'{number} in "{text}" is no speed of a serial port: usual are 57600 and 921600')
    return Connection(kind, place, int(number))


def serial_speed(baud: int) -> int:
    """The terminal interface's own number for a speed, 0 if it has none."""
    return int(getattr(termios, f"B{baud}", 0))
