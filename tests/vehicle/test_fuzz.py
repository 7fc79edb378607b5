"""Nonsense into both ends of the link: nothing crashes, and nothing moves."""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Any, NamedTuple

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.vehicle.absurd import absurd_orders, every_message, garbage, orders_for_others

from upwash.core.geo import GeoPosition
from upwash.mavlink.px4 import Mode
from upwash.real.mavlink import DriverPatience, MavlinkLink
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.vehicle import MavlinkVehicle
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.px4.settings import Px4Settings
from upwash.vehicle.server import serve_vehicle

HOME = GeoPosition(39.3666, 22.9507)
BYTES = 1_000_000
AGILE = VehicleSettings(home=HOME, acceleration_m_s2=100.0, climb_m_s=50.0, armable_after_s=0.0)


def collect_errors() -> list[dict[str, Any]]:
    """What goes wrong in callbacks, where no test would see it."""
    errors: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: errors.append(context))
    return errors


async def vandalise(connection: str, chance: random.Random, count_bytes: int) -> None:
    """Sends garbage, absurd messages and orders for others."""
    vandal = MavlinkLink(connection, lambda _: None)
    await vandal.opened.wait()
    for piece in garbage(count_bytes, chance):
        vandal.send_bytes(piece)
        await asyncio.sleep(0)  # the vehicle reads as fast as it is written to
    for message in (*every_message(chance), *absurd_orders(chance), *orders_for_others()):
        if not is_sense(message):
            vandal.send(message)
            await asyncio.sleep(0)
    await asyncio.sleep(0.3)
    await vandal.close()


def is_sense(message: Any) -> bool:
    """PX4 obeys a take-off to NaN, and climbs until the next order. Mode 0 is STABILIZE of ArduCopter."""
    match getattr(message, "command", None):
        case mavlink.MAV_CMD_NAV_TAKEOFF:
            return math.isnan(getattr(message, "param7", getattr(message, "z", 0.0)))
        case mavlink.MAV_CMD_DO_SET_MODE:
            return bool(message.param2 == 0)
    return False


class Flown(NamedTuple):
    """A vehicle that is flown by bare messages: those for its take-off, its mode then, and the one that lands it."""

    settings: VehicleSettings | Px4Settings
    takes_off: tuple[Any, ...]
    mode: int
    returns: Any
    returning: int
    drift_m: float  # that no message causes


LONG, NAN = mavlink.MAVLink_command_long_message, math.nan
ARM = LONG(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
FLOWN = {
    "ArduCopter": Flown(
        AGILE,
        (LONG(1, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0), ARM, LONG(1, 1, 22, 0, 0, 0, 0, 0, 0, 0, 10.0)),
        mavlink.COPTER_MODE_GUIDED,
        LONG(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0),
        mavlink.COPTER_MODE_RTL,
        0.1,
    ),
    "PX4": Flown(
        Px4Settings(home=HOME, armable_after_s=0.0, speedup=10.0),
        (ARM, LONG(1, 1, 22, 0, NAN, 0, 0, NAN, NAN, NAN, 10.0)),
        Mode.LOITER,
        LONG(1, 1, 176, 0, 1, Mode.RTL.main, Mode.RTL.sub, 0, 0, 0, 0),
        Mode.RTL,
        0.5,
    ),
}


@pytest.mark.parametrize("flown", FLOWN.values(), ids=FLOWN)
@pytest.mark.parametrize("kind", ["udp", "tcp"])
async def test_a_flying_vehicle_is_not_moved_by_nonsense(kind: str, flown: Flown) -> None:
    errors, chance = collect_errors(), random.Random(3)
    last: dict[str, Any] = {}

    async def until(condition: Callable[[], Any]) -> None:
        async with asyncio.timeout(20.0):
            while not condition():  # noqa: ASYNC110
                await asyncio.sleep(0.01)

    async with AsyncExitStack() as stack:
        vehicle = await serve_vehicle(f"{kind}:127.0.0.1:0", flown.settings)
        stack.push_async_callback(vehicle.close)
        connection = vehicle.address.replace("udp:", "udpout:")
        link = MavlinkLink(connection, lambda message: last.update({message.get_type(): message}))
        stack.push_async_callback(link.close)
        await link.opened.wait()
        link.send(LONG(1, 1, 511, 0, 33, 1e5, 0, 0, 0, 0, 0))
        await until(lambda: "GLOBAL_POSITION_INT" in last)
        for message in flown.takes_off:
            link.send(message)
        await until(lambda: last["GLOBAL_POSITION_INT"].alt > 9_900 and last["GLOBAL_POSITION_INT"].vz == 0)
        before = last["GLOBAL_POSITION_INT"]

        await vandalise(connection, chance, BYTES)

        assert errors == []
        assert last["HEARTBEAT"].custom_mode == flown.mode
        after = last["GLOBAL_POSITION_INT"]
        moved_e7 = max(abs(after.lat - before.lat), abs(after.lon - before.lon))
        assert moved_e7 <= flown.drift_m * 100
        assert abs(after.alt - before.alt) < flown.drift_m * 1000
        link.send(flown.returns)
        await until(lambda: last["HEARTBEAT"].custom_mode == flown.returning)  # it still obeys


class FakeVehicle(asyncio.DatagramProtocol):
    """Says what a test lets it say, and remembers what it heard."""

    def __init__(self) -> None:
        self.heard: list[Any] = []
        self.codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.peer: Any = None

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self.transport = transport

    def datagram_received(self, data: bytes, sender: Any) -> None:
        self.peer = sender
        self.heard += mavlink.MAVLink(None).parse_buffer(data) or ()

    def say(self, message: Any) -> None:
        self.transport.sendto(bytes(message.pack(self.codec)), self.peer)
        self.codec.seq = (self.codec.seq + 1) % 256


async def test_a_driver_that_hears_nonsense_goes_on_and_tells_nobody_to_move() -> None:
    errors, chance = collect_errors(), random.Random(2)
    transport, fake = await asyncio.get_running_loop().create_datagram_endpoint(
        FakeVehicle, local_addr=("127.0.0.1", 0)
    )
    copter = MavlinkVehicle(
        f"udpout:127.0.0.1:{transport.get_extra_info('sockname')[1]}", DriverPatience(), [ARDUCOPTER]
    )
    while fake.peer is None:  # noqa: ASYNC110
        await asyncio.sleep(0.01)
    beat = mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3)
    place = mavlink.MAVLink_global_position_int_message(1_000, 393_666_000, 229_507_000, 0, 5_000, 0, 0, 0, 0)
    fake.say(beat)
    fake.say(place)
    await copter.found(within_s=2.0)
    for piece in garbage(BYTES, chance):
        transport.sendto(piece, fake.peer)
        await asyncio.sleep(0)
    for _ in range(5):
        for message in every_message(chance):
            if message.get_type() != "BAD_DATA":
                fake.say(message)
                await asyncio.sleep(0)
    fake.say(beat)
    fake.say(place)
    await asyncio.sleep(0.2)

    assert errors == []
    assert copter.telemetry.position == GeoPosition(39.3666, 22.9507, 5.0)
    assert copter.telemetry.mode == 0
    charges = copter.telemetry.batteries.charges_percent.values()
    assert all(percent is None or 0 <= percent <= 100 for percent in charges)
    asked = {(message.get_type(), getattr(message, "command", None)) for message in fake.heard}
    assert asked <= {
        ("HEARTBEAT", None),
        ("TIMESYNC", None),
        ("COMMAND_LONG", mavlink.MAV_CMD_SET_MESSAGE_INTERVAL),
        ("COMMAND_LONG", mavlink.MAV_CMD_REQUEST_MESSAGE),  # whose the vehicle is, after a silence
    }
    await copter.close()
    transport.close()
