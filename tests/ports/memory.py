"""A driver and a stand-in vehicle joined in memory, so that both live on virtual time."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, LocalFrame
from upwash.mavlink.packets import PacketReader
from upwash.real.mavlink import (
    DriverPatience,
    FlightSettings,
    MavlinkAutopilot,
    MavlinkLink,
    connect_autopilot,
)
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.connection import PeerConnection
from upwash.vehicle.body.copter import FaultKind
from upwash.vehicle.px4.settings import Px4Settings
from upwash.vehicle.px4.telemetry import UNASKED_S
from upwash.vehicle.server import switched_on

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
AT_ONCE = FlightSettings(patience=DriverPatience(others_s=0.0))  # knows that no other vehicle is there
HASTY = FlightSettings(arm_again_s=0.2, progress_s=0.5, patience=DriverPatience(others_s=0.0))
LATE_S = 0.05
_QUESTIONS = (
    mavlink.MAV_CMD_REQUEST_MESSAGE,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
    401,
)


class Air:
    """Each share: of packets that are lost, that come twice, and that come late, after others."""

    def __init__(self, share: float, *, seed: int) -> None:
        self.share = share
        self._chance = random.Random(seed)

    @property
    def room(self) -> bool:
        """Whether the vehicle's side takes another packet."""
        return True

    def carry(self, packet: bytes, send: Callable[[bytes], None]) -> None:
        if self._happens():
            return
        self._send(packet, send)
        if self._happens():
            self._send(packet, send)

    def _send(self, packet: bytes, send: Callable[[bytes], None]) -> None:
        if self._happens():
            asyncio.get_running_loop().call_later(self._chance.uniform(0, LATE_S), send, packet)
        else:
            send(packet)

    def _happens(self) -> bool:
        return self._chance.random() < self.share


PERFECT = Air(0.0, seed=1)


class Bench:
    """A stand-in vehicle, any number of programs that connect to it, and what they sent."""

    def __init__(self, settings: VehicleSettings | Px4Settings, air: Air = PERFECT) -> None:
        self.air = air
        self.said: list[str] = []
        self.deaf = False  # whether the vehicle hears no program
        self.mute = False  # whether programs do not hear the vehicle
        self.powered = True  # or it cannot be connected to
        self.arrive: Callable[[bytes], None]  # has the program that came last hear that, too
        self.connection: PeerConnection  # of the program that came last
        self.heard: list[Any] = []  # what programs sent, with the time as `at_s`
        self.asked: Counter[int] = Counter()  # how often programs sent each command
        self._unasked = UNASKED_S if isinstance(settings, Px4Settings) else {}
        self.switch_on(settings)

    def switch_on(self, settings: VehicleSettings | Px4Settings) -> None:
        """Starts the vehicle, on the ground at home."""
        self.vehicle = switched_on(settings)
        self.firmware: Any = self.vehicle.firmware
        self.copter: Any = self.firmware.copter
        self._life = asyncio.create_task(self.vehicle.live())
        if not self._unasked:
            PeerConnection(self.vehicle, write=self._note)

    async def switch_off(self) -> None:
        """Ends the vehicle and its connections, in flight too."""
        self._life.cancel()
        await asyncio.gather(self._life, return_exceptions=True)
        for connection in tuple(self.vehicle.connections):
            connection.end()

    @property
    def now_s(self) -> float:
        return self.vehicle.now_s()

    @property
    def cut(self) -> bool:
        return self.deaf and self.mute

    @cut.setter
    def cut(self, cut: bool) -> None:
        """Whether nothing passes between the vehicle and programs."""
        self.deaf = self.mute = cut

    def parameter(self, name: str) -> float:
        value: float = self.copter.parameters[name]
        return value

    def fail(self, kind: FaultKind) -> None:
        self.copter.fail(kind, self.now_s)

    def mend(self, kind: FaultKind) -> None:
        self.copter.mend(kind)

    def commands(self, since_s: float = 0.0) -> list[int]:
        """The commands of programs since then, without questions."""
        return [
            message.command
            for message in self.heard
            if message.at_s >= since_s
            and message.get_type().startswith("COMMAND_")
            and message.command not in _QUESTIONS
        ]

    def setpoints(self, since_s: float = 0.0) -> int:
        """The number of setpoints since then."""
        kind = "SET_POSITION_TARGET_GLOBAL_INT"
        return sum(message.get_type() == kind and message.at_s >= since_s for message in self.heard)

    @asynccontextmanager
    async def program(
        self, settings: FlightSettings = AT_ONCE, *, ground_speed_m_s: float = 60.0, **named: Any
    ) -> AsyncIterator[MavlinkAutopilot]:
        """A driver; at the end of the block it falls silent, as a program that is killed."""
        autopilot = await connect_autopilot(
            self.open,
            frame=LocalFrame(self.copter.settings.home),
            ground_speed_m_s=ground_speed_m_s,
            settings=settings,
            **named,
        )
        try:
            yield autopilot
        finally:
            await autopilot.close()

    @asynccontextmanager
    async def pilot(self) -> AsyncIterator[MavlinkLink]:
        """A ground station, whose link is always perfect."""

        async def open_line(line: Any) -> None:
            connection = PeerConnection(
                self.vehicle, write=lambda data: line.datagram_received(data, ("", 2))
            )
            line.write = lambda packet: self._deliver(packet, connection)

        link = MavlinkLink(open_line, lambda _: None)
        await link.opened.wait()
        yield link
        await link.close()

    async def open(self, line: Any) -> None:
        """Opens a program's line to the vehicle."""
        loop = asyncio.get_running_loop()
        if not self.powered:
            raise ConnectionRefusedError("nobody listens")

        def arrive(packet: bytes) -> None:
            loop.call_soon(line.datagram_received, packet, ("", 1))

        def to_program(data: bytes) -> None:
            if not self.air.room:  # a vehicle sends nothing then, and counts nothing
                connection._codec.seq = (connection._codec.seq - 1) % 256
            elif not self.mute:
                self.air.carry(data, arrive)

        def to_vehicle(packet: bytes) -> None:
            for message in self._deliver(packet, connection):
                message.at_s = loop.time()
                self.heard.append(message)
                self.asked[getattr(message, "command", 0)] += 1

        def write(data: bytes) -> None:
            if not self.deaf:
                self.air.carry(data, to_vehicle)

        self.arrive, line.write = arrive, write
        connection = self.connection = PeerConnection(self.vehicle, write=to_program, hang_up=line.ended.set)
        for number in self._unasked:  # a flight has a hundred thousand of them
            never = mavlink.MAVLink_command_long_message(
                1, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, -1, *(0.0,) * 5
            )
            self._deliver(bytes(never.pack(mavlink.MAVLink(None, 1, 191))), connection)

    def _deliver(self, packet: bytes, connection: PeerConnection) -> list[Any]:
        messages = [message for message, _ in PacketReader().read(packet)]
        for message in messages:
            asyncio.get_running_loop().call_soon(_hear, connection, message)
        return messages

    def _note(self, data: bytes) -> None:
        for message, _ in PacketReader().read(data):
            if message.get_type() == "STATUSTEXT":
                self.said.append(message.text)


def _hear(connection: PeerConnection, message: Any) -> None:
    connection.hear(message)  # looked up now: a test may answer in the vehicle's name


@asynccontextmanager
async def bench(settings: VehicleSettings | Px4Settings = AGILE, air: Air = PERFECT) -> AsyncIterator[Bench]:
    """A stand-in that is switched on."""
    made = Bench(settings, air)
    try:
        yield made
    finally:
        await made.switch_off()


@asynccontextmanager
async def driven(
    settings: VehicleSettings | Px4Settings = AGILE,
    flight: FlightSettings | None = None,
    ground_speed_m_s: float = 5.0,
    before: Callable[[Bench], Awaitable[None]] | None = None,
    air: Air = PERFECT,
) -> AsyncIterator[tuple[Bench, MavlinkAutopilot]]:
    """A stand-in and the driver that has found it, after what happened `before`."""
    async with bench(settings, air) as made:
        if before:
            await before(made)
        async with made.program(flight or FlightSettings(), ground_speed_m_s=ground_speed_m_s) as autopilot:
            yield made, autopilot
