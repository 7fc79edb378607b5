"""A driver and a stand-in vehicle joined in memory, so that both can live on virtual time."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.lossy import Air

from upwash.core.geo import GeoPosition, LocalFrame
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot, Patience, connect_autopilot, link
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.firmware import ArduCopterFirmware
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.connection import PeerConnection, StandIn

HOME = GeoPosition(39.3666, 22.9507)
AGILE = VehicleSettings(
    home=HOME,
    acceleration_m_s2=300.0,
    climb_m_s=100.0,
    descent_m_s=100.0,
    return_speed_m_s=100.0,
    return_altitude_m=0.0,
    armable_after_s=0.0,
)
AT_ONCE = FlightSettings(patience=Patience(others_s=0.0))  # knows that no other vehicle is there
PERFECT = Air(0.0, seed=1)


class Bench:
    """A vehicle that any number of programs may connect to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, settings: VehicleSettings, air: Air) -> None:
        self.copter = Copter(settings, now_s=asyncio.get_running_loop().time())
        self.firmware = ArduCopterFirmware(self.copter)
        self.vehicle = StandIn(self.firmware, settings.speedup)
        self.said: list[str] = []
        self.deaf = False  # whether the vehicle hears nobody
        self.mute = False
        self.powered = True  # or it cannot be connected to
        self.arrive: Callable[[bytes], None]  # has the program that came last hear that, too
        self.connection: PeerConnection  # of the program that came last
        self.asked: Counter[int] = Counter()  # how often each command came from programs
        self._air = air
        monkeypatch.setitem(link._OPENERS, "memory", self._open)
        PeerConnection(self.vehicle, write=self._note)

    @property
    def now_s(self) -> float:
        return self.vehicle.now_s()

    def parameter(self, name: str) -> float:
        return self.copter.parameters[name]

    @asynccontextmanager
    async def program(
        self, settings: FlightSettings = AT_ONCE, **named: Any
    ) -> AsyncIterator[MavlinkAutopilot]:
        """A driver; at the end of the block it falls silent without a word, as a program that is killed."""
        autopilot = await connect_autopilot(
            "memory:vehicle:1", frame=LocalFrame(HOME), ground_speed_m_s=60.0, settings=settings, **named
        )
        try:
            yield autopilot
        finally:
            await autopilot.close()

    async def _open(self, _host: str, _port: int, line: Any) -> None:
        loop = asyncio.get_running_loop()
        if not self.powered:
            raise ConnectionRefusedError("nobody listens")

        def arrive(packet: bytes) -> None:
            loop.call_soon(line.datagram_received, packet, ("", 1))

        self.arrive = arrive

        def to_program(data: bytes) -> None:
            if not self._air.room:  # a vehicle sends nothing then, and counts nothing
                connection._codec.seq = (connection._codec.seq - 1) % 256
            elif not self.mute:
                self._air.carry(data, arrive)

        connection = self.connection = PeerConnection(self.vehicle, write=to_program)

        def to_vehicle(packet: bytes) -> None:
            for message in mavlink.MAVLink(None).parse_buffer(packet) or []:
                self.asked[getattr(message, "command", 0)] += 1
                loop.call_soon(connection.hear, message)

        def write(data: bytes) -> None:
            if not self.deaf:
                self._air.carry(data, to_vehicle)

        line.write = write

    def _note(self, data: bytes) -> None:
        for message in mavlink.MAVLink(None).parse_buffer(data) or []:
            if message.get_type() == "STATUSTEXT":
                self.said.append(message.text)


@asynccontextmanager
async def bench(
    monkeypatch: pytest.MonkeyPatch, settings: VehicleSettings = AGILE, air: Air = PERFECT
) -> AsyncIterator[Bench]:
    """A stand-in that is switched on."""
    async with AsyncExitStack() as stack:
        made = Bench(monkeypatch, settings, air)
        life = asyncio.create_task(made.vehicle.live())

        async def switch_off() -> None:
            life.cancel()
            await asyncio.gather(life, return_exceptions=True)
            for connection in tuple(made.vehicle.connections):
                connection.end()

        stack.push_async_callback(switch_off)
        yield made
