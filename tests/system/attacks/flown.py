"""A short flight over `udpin`, by way of a router, while somebody attacks the drone's port; what came of it.

The stand-in speaks over TCP to a router, which passes each message on as a datagram: so does a telemetry router on a
companion computer.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, LocalFrame, Position, distance_m
from upwash.errors import AutopilotError
from upwash.mavlink.signing import Signing
from upwash.real.mavlink import DriverPatience, FlightSettings, MavlinkAutopilot, connect_autopilot
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.server import serve_vehicle

HOME = GeoPosition(39.3666, 22.9507)
AGILE = VehicleSettings(
    home=HOME, acceleration_m_s2=300.0, climb_m_s=100.0, descent_m_s=100.0,
    return_speed_m_s=100.0, return_altitude_m=0.0, armable_after_s=0.0,
)  # fmt: skip
HASTY = FlightSettings(
    arm_again_s=0.2,
    progress_s=0.5,
    margin_s=6.0,
    patience=DriverPatience(answer_s=0.3, attempts=4, others_s=0.0, quiet_after_s=0.6, lost_after_s=3.0),
)
KEY = bytes(range(32))
LOCAL = "127.0.0.1"
ALTITUDE_M = 5.0
LEGS = (Position(20.0, 0.0, ALTITUDE_M), Position(20.0, 20.0, ALTITUDE_M))


@dataclass
class Target:
    """Whom to attack: the drone's port, and the router that the vehicle is behind."""

    port: int
    router: Router


@dataclass
class Outcome:
    """What became of the flight.

    `ended` is "flown", or what ended it; `astray` counts the drone's datagrams that went to a stranger, and `off_m`
    is how far from a waypoint the vehicle was at most when the driver took it for there.
    """

    ended: str
    astray: int
    off_m: float
    faults: list[str] = field(default_factory=list)


Attack = Callable[[Target, "Stranger"], Awaitable[None]]


class Stranger(asyncio.DatagramProtocol):
    """A socket of nobody that the drone should know, which counts what it is sent."""

    def __init__(self) -> None:
        self.received = 0
        self._codec = mavlink.MAVLink(None)

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, address: Any) -> None:
        self.received += 1

    def error_received(self, error: Exception) -> None:
        """Nobody listens yet."""

    def send(self, data: bytes) -> None:
        self._transport.sendto(data)

    def say(self, message: Any, *, system: int = 1, component: int = 1, ahead: int = 0) -> None:
        """Sends the message in the name of a system, with sequence numbers that go on."""
        self._codec.srcSystem, self._codec.srcComponent = system, component
        self.send(bytes(message.pack(self._codec)))
        self._codec.seq = (self._codec.seq + 1 + ahead) % 256


class Router(asyncio.DatagramProtocol):
    """Passes the vehicle's messages on to the drone, one a datagram, and the drone's back."""

    def __init__(self, port: int) -> None:
        self.passed: list[bytes] = []  # of the vehicle's
        self.position = Position(0.0, 0.0)  # where the vehicle says it is
        self.answered = asyncio.Event()  # once the drone has spoken to the vehicle
        self.silent = False  # nothing passes either way
        self._port = port
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True

    @asynccontextmanager
    async def running(self, vehicle: str) -> AsyncIterator[Router]:
        host, port = vehicle.split(":")[1:]
        reader, self._writer = await asyncio.open_connection(host, int(port))
        await self.restart()
        carrying = asyncio.create_task(self._carry(reader))
        try:
            yield self
        finally:
            carrying.cancel()
            await asyncio.gather(carrying, return_exceptions=True)
            self._writer.close()
            self._transport.close()

    async def restart(self) -> None:
        """Goes on from another port."""
        before = getattr(self, "_transport", None)
        self._transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: self, local_addr=(LOCAL, 0)
        )
        if before is not None:
            before.close()

    def send(self, data: bytes) -> None:
        """To the drone, as if it were the vehicle's."""
        self._transport.sendto(data, (LOCAL, self._port))

    def datagram_received(self, data: bytes, address: Any) -> None:
        self.answered.set()
        if not self.silent:
            self._writer.write(data)

    def error_received(self, error: Exception) -> None:
        """The drone does not listen yet."""

    async def _carry(self, reader: asyncio.StreamReader) -> None:
        while data := await reader.read(4096):
            for message in self._parser.parse_buffer(data) or ():
                packet = bytes(message.get_msgbuf())
                self.passed.append(packet)
                if message.get_type() == "GLOBAL_POSITION_INT":
                    geo = GeoPosition(message.lat / 1e7, message.lon / 1e7, message.relative_alt / 1e3)
                    self.position = LocalFrame(HOME).position(geo)
                if not self.silent:
                    self.send(packet)


async def flown(attack: Attack | None, *, key: bytes | None = None) -> Outcome:
    """Arms, takes off, flies, returns and lands while the attack goes on, from before the driver connects.

    With a key the vehicle and the driver sign what they say.
    """
    port = free_port()
    loop = asyncio.get_running_loop()
    faults: list[str] = []
    loop.set_exception_handler(lambda _, told: faults.append(str(told.get("exception") or told["message"])))
    vehicle = await serve_vehicle(f"tcp:{LOCAL}:0", AGILE, signing=Signing(key) if key else None)
    transport, stranger = await loop.create_datagram_endpoint(Stranger, remote_addr=(LOCAL, port))
    attacking: asyncio.Task[None] | None = None
    try:
        async with Router(port).running(vehicle.address) as router:
            if attack is not None:
                attacking = asyncio.ensure_future(attack(Target(port, router), stranger))
            ended, off_m = await _fly(f"udpin:{LOCAL}:{port}", router, Signing(key) if key else None)
    finally:
        if attacking is not None:
            attacking.cancel()
            await asyncio.gather(attacking, return_exceptions=True)
        transport.close()
        await vehicle.close()
    return Outcome(ended, stranger.received, off_m, faults)


async def _fly(connection: str, router: Router, signing: Signing | None) -> tuple[str, float]:
    off_m: list[float] = [0.0]
    try:
        autopilot = await connect_autopilot(
            connection,
            frame=LocalFrame(HOME),
            ground_speed_m_s=20.0,
            heartbeat_timeout_s=5.0,
            settings=HASTY,
            signing=signing,
        )
    except AutopilotError as error:
        return str(error), 0.0
    try:
        async with asyncio.timeout(15.0):
            off_m += [distance_m(router.position, there) async for there in _mission(autopilot)]
    except AutopilotError as error:
        return str(error), max(off_m)
    except TimeoutError:
        return "not over after 15 s", max(off_m)
    finally:
        await autopilot.close()
    return "flown", max(off_m)


async def _mission(autopilot: MavlinkAutopilot) -> AsyncIterator[Position]:
    """Yields each waypoint when it is reached."""
    await autopilot.in_the_air()
    await autopilot.claim(resumes=False)
    await autopilot.ready()
    await autopilot.arm()
    await autopilot.takeoff(ALTITUDE_M)
    for leg in LEGS:
        await autopilot.goto(leg)
        yield leg
    await autopilot.return_home_and_land()
    await autopilot.disarm()


def free_port() -> int:
    """A UDP port of this machine that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reserved:
        reserved.bind((LOCAL, 0))
        return int(reserved.getsockname()[1])
