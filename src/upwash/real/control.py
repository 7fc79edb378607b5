"""What a program and the service instances that it started say to each other, over a socket pair.

The socket is also the leash: when the program dies, however it dies, the instance reads an end of file and ends.
"""

from __future__ import annotations

import msgspec


class Begin(msgspec.Struct, frozen=True, tag="begin"):
    """To the instance, first: what to be. The credentials are PEM text; they touch no disk and no command line."""

    program: str
    service: str
    listen: str
    max_message_bytes: int
    pace_s: dict[str, float]
    authority: str = ""
    certificate: str = ""
    key: str = ""


class Admit(msgspec.Struct, frozen=True, tag="admit"):
    """To the instance: answer these drones and no others."""

    drones: list[str]


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    """From the instance: it can be called at this address."""

    address: str


class Failed(msgspec.Struct, frozen=True, tag="failed"):
    """From the instance: it cannot serve."""

    why: str


class Admitted(msgspec.Struct, frozen=True, tag="admitted"):
    """From the instance: the oldest Admit that was not acknowledged yet is in force."""


class Called(msgspec.Struct, frozen=True, tag="called"):
    """From the instance: this drone called."""

    drone: str


_encoder = msgspec.json.Encoder()
to_instance = msgspec.json.Decoder(Begin | Admit)
from_instance = msgspec.json.Decoder(Ready | Failed | Admitted | Called)


def line(message: Begin | Admit | Ready | Failed | Admitted | Called) -> bytes:
    """A message as one line of JSON."""
    return _encoder.encode(message) + b"\n"
