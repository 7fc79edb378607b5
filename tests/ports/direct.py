"""A stand-in vehicle and its driver without a network between them, so that both live on virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

import upwash.real.mavlink.heard
from upwash.core.geo import LocalFrame
from upwash.mavlink.px4 import understood
from upwash.real.mavlink import FlightSettings, MavlinkAutopilot, connect_autopilot
from upwash.real.mavlink.link import COMPANION
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.connection import PeerConnection, StandIn
from upwash.vehicle.px4.settings import Px4Settings
from upwash.vehicle.px4.telemetry import UNASKED_S
from upwash.vehicle.px4.vehicle import Quadrotor
from upwash.vehicle.server import firmware


class Sky:
    """The stand-in, who talks to it, and what the driver has said to it."""

    def __init__(self, settings: Px4Settings | VehicleSettings) -> None:
        autopilot = firmware(settings, now_s=asyncio.get_running_loop().time())
        self.vehicle = StandIn(autopilot, settings.speedup)
        self.copter: Quadrotor = autopilot.copter
        self.cut = False  # nothing passes to or from the driver
        self.link: PeerConnection  # the driver's
        self.heard: list[Any] = []  # what the driver said, with the time as `at_s`

    def now_s(self) -> float:
        """The loop's time."""
        return asyncio.get_running_loop().time()

    def commands(self, since_s: float = 0.0) -> list[int]:
        """What the driver commanded since then, questions left out."""
        questions = (
            mavlink.MAV_CMD_REQUEST_MESSAGE,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
            401,
        )
        return [
            message.command
            for message in self.heard
            if message.at_s >= since_s
            and message.get_type().startswith("COMMAND_")
            and message.command not in questions
        ]

    def setpoints(self, since_s: float = 0.0) -> int:
        """How many setpoints came since then."""
        kind = "SET_POSITION_TARGET_GLOBAL_INT"
        return sum(message.get_type() == kind and message.at_s >= since_s for message in self.heard)


class _DirectLink:
    """What `MavlinkLink` is, to one stand-in."""

    def __init__(self, sky: Sky, heard: Callable[[Any], None]) -> None:
        self.connection = "direct"
        self.opened = asyncio.Event()
        self.opened.set()
        self.opened_s = sky.now_s()
        self.why_silent = ""
        self.refused = None
        self._sky = sky
        self._hear = heard
        self._codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=COMPANION)
        self._connection = sky.link = PeerConnection(sky.vehicle, write=self._written)
        for number in UNASKED_S:  # a flight has a hundred thousand of them
            never = mavlink.MAVLink_command_long_message(
                1, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, -1, *(0.0,) * 5
            )
            self.send(never)

    def speak_as_part_of(self, system: int) -> None:
        self._codec.srcSystem = system

    def send(self, message: Any) -> None:
        for heard in _parsed(bytes(message.pack(self._codec))):
            if not self._sky.cut:
                heard.at_s = self._sky.now_s()
                self._sky.heard.append(heard)
                asyncio.get_running_loop().call_soon(self._connection.hear, heard)

    def reopen(self) -> None:
        """Nothing to open."""

    async def close(self) -> None:
        self._connection.end()

    def _written(self, data: bytes) -> None:
        if not self._sky.cut:
            for message in _parsed(data):
                asyncio.get_running_loop().call_soon(self._hear, understood(message))


def _parsed(data: bytes) -> list[Any]:
    return mavlink.MAVLink(None).parse_buffer(data) or []


@asynccontextmanager
async def connected_to(
    sky: Sky, flight: FlightSettings | None = None, ground_speed_m_s: float = 5.0
) -> AsyncIterator[MavlinkAutopilot]:
    """The driver, which has found the stand-in."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            upwash.real.mavlink.heard,
            "MavlinkLink",
            lambda _connection, heard, **_: _DirectLink(sky, heard),
        )
        autopilot = await connect_autopilot(
            "direct",
            frame=LocalFrame(sky.copter.settings.home),
            ground_speed_m_s=ground_speed_m_s,
            settings=flight or FlightSettings(),
        )
    try:
        yield autopilot
    finally:
        await autopilot.close()


@asynccontextmanager
async def flown_directly(
    settings: Px4Settings | VehicleSettings,
    flight: FlightSettings | None = None,
    ground_speed_m_s: float = 5.0,
    before: Callable[[Sky], Awaitable[None]] | None = None,
) -> AsyncIterator[tuple[Sky, MavlinkAutopilot]]:
    """A stand-in and the driver that has found it, after what happened `before`."""
    sky = Sky(settings)
    life = asyncio.create_task(sky.vehicle.live())
    try:
        if before:
            await before(sky)
        async with connected_to(sky, flight, ground_speed_m_s) as autopilot:
            yield sky, autopilot
    finally:
        life.cancel()
        await asyncio.gather(life, return_exceptions=True)
