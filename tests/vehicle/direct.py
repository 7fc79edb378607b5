"""A stand-in spoken to without a network, so that it can live on virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.px4 import understood
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.connection import PeerConnection, StandIn
from upwash.vehicle.px4.settings import Px4Settings
from upwash.vehicle.server import switched_on

Hear = Callable[[Any], None]


@asynccontextmanager
async def directly_linked(
    settings: VehicleSettings | Px4Settings, hear: Hear
) -> AsyncIterator[tuple[StandIn, Hear]]:
    """The vehicle, and how to say something to it; what it says, packed and parsed, goes to `hear`.

    What is said is heard in the loop's next turn, so that one can say something and then wait for the answer.
    """
    codec = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    vehicle = switched_on(settings)

    def parsed(data: bytes) -> list[Any]:
        return [understood(message) for message in mavlink.MAVLink(None).parse_buffer(data) or ()]

    def write(data: bytes) -> None:
        for message in parsed(data):
            hear(message)

    connection = PeerConnection(vehicle, write=write)

    def say(message: Any) -> None:
        for heard in parsed(bytes(message.pack(codec))):
            asyncio.get_running_loop().call_soon(connection.hear, heard)

    life = asyncio.create_task(vehicle.live())
    try:
        yield vehicle, say
    finally:
        connection.end()
        life.cancel()
        await asyncio.gather(life, return_exceptions=True)
