"""The first seconds with a vehicle: whether another one is there, and whether this one answers."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.scripted import SYSTEM, Script, scripted

from upwash.errors import AutopilotRefused
from upwash.mavlink.signing import Signing
from upwash.real.mavlink import DriverPatience, FlightSettings

OTHERS_S, SIGNED_S = 2.5, 4.0
CAUTIOUS = FlightSettings(patience=DriverPatience(others_s=OTHERS_S, signed_s=SIGNED_S))
BOLD = replace(CAUTIOUS, patience=replace(CAUTIOUS.patience, others_s=0.0))


class Joined(Script):
    """A vehicle that another one joins after two seconds."""

    async def live(self) -> None:
        asyncio.get_running_loop().call_later(2.0, self.join)
        await super().live()

    def join(self) -> None:
        other = mavlink.MAVLink(None, SYSTEM + 1, 1)
        self._line.datagram_received(bytes(self.heartbeat().pack(other)), ("", 1))


@pytest.mark.parametrize(("system", "waits_s"), [(None, OTHERS_S), (SYSTEM, 0.0)])
@pytest.mark.virtual
async def test_other_vehicles_have_some_seconds_unless_the_system_is_said(
    system: int | None, waits_s: float
) -> None:
    begun_s = asyncio.get_running_loop().time()
    async with scripted(CAUTIOUS, system=system) as script:
        # the first heartbeat comes after a second at most, and the version is told at once
        assert waits_s <= script.now_s - begun_s <= waits_s + 1.01


@pytest.mark.parametrize(("system", "flown"), [(None, False), (SYSTEM, True)])
@pytest.mark.virtual
async def test_of_two_vehicles_the_one_that_was_said_is_flown(system: int | None, *, flown: bool) -> None:
    if flown:
        async with scripted(CAUTIOUS, system=system, kind=Joined) as script:
            assert script.autopilot.vehicle.ids == (SYSTEM, 1)
        return
    with pytest.raises(AutopilotRefused, match="connect: several vehicles are on the link"):
        async with scripted(CAUTIOUS, system=system, kind=Joined):
            pass


class Curt(Script):
    """A vehicle that answers some seconds after the questions."""

    answers_after_s = 0.0

    def _answer(self, message: Any) -> None:
        asyncio.get_running_loop().call_later(self.answers_after_s, super()._answer, message)


@pytest.mark.parametrize(
    ("signs", "after_s", "flown"),
    [(True, 0.0, True), (True, 3.9, True), (True, 4.1, False), (False, 4.1, True)],
)
@pytest.mark.virtual
async def test_a_vehicle_that_signs_has_four_seconds_for_its_first_answer(
    *, signs: bool, after_s: float, flown: bool
) -> None:
    named = {"signing": Signing(bytes(32)) if signs else None, "answers_after_s": after_s}
    kind = type("Signed", (Curt,), named)
    if flown:
        async with scripted(BOLD, kind=kind) as script:
            assert script.commands(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL)
        return
    with pytest.raises(AutopilotRefused, match="signs its messages and answers none that is not signed"):
        async with scripted(BOLD, kind=kind):
            pass


@pytest.mark.virtual
async def test_a_listener_hears_the_vehicle_until_its_block_ends() -> None:
    async with scripted() as script:
        heard: list[Any] = []
        with script.autopilot.vehicle.listening(heard.append):
            await script.beat()
            count = len(heard)
        await script.beat()
        assert len(heard) == count > 0
