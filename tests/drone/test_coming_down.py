"""How long the vehicle still needs to the ground, as the program brings it down and follows it."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest
from msgspec.structs import replace

from upwash.core.geo import Position
from upwash.core.vehicle.control import Control, Owner
from upwash.core.vehicle.return_place import RallyPoints, ReturnPlace
from upwash.core.vehicle.way_home import ARDUCOPTER, UNKNOWN, EnergyFacts, WayDown, WayHome
from upwash.drone.coming_down import Homecoming
from upwash.eventlog import schema
from upwash.ports import ComingDown
from upwash.sim.journal import MemoryJournal
from upwash.sim.loop import run_virtually

HERE = Position(300.0, 40.0, 20.0)
OURS, PILOTS = Control(Owner.PROGRAM, 0.0, "claimed"), Control(Owner.PILOT, 0.0, "stick")


class Vehicle:
    """What a homecoming needs of an autopilot: its verbs never end by themselves."""

    def __init__(self, facts: EnergyFacts = EnergyFacts()) -> None:  # noqa: B008 - frozen
        self.energy = facts
        self.position = HERE
        self.position_is_sure = True
        self.control = OURS
        self.stands = False
        self.told: list[str] = []
        self.touched_down = asyncio.Event()

    async def return_home_and_land(self) -> None:
        self.told.append("return")
        await self.touched_down.wait()

    async def land(self) -> None:
        self.told.append("land")
        await self.touched_down.wait()


class Scene:
    """A vehicle on its way down, and what is said of it."""

    def __init__(self, facts: EnergyFacts) -> None:
        vehicle: Any = Vehicle(facts)
        self.vehicle = vehicle
        self.journal = MemoryJournal()
        self.journal.begin()
        self.homecoming = Homecoming(self.vehicle, self.journal)

    async def begin(self, doing: ComingDown) -> asyncio.Task[None]:
        verb = self.homecoming.land if doing == "land" else self.homecoming.return_and_land
        task = asyncio.create_task(verb())
        await asyncio.sleep(0)
        return task

    def events(self, kind: type[schema.Event]) -> list[Any]:
        return [event for event in self.journal.events if isinstance(event, kind)]


def left_s(facts: EnergyFacts, doing: ComingDown) -> float | None:
    async def look() -> float | None:
        scene = Scene(facts)
        task = await scene.begin(doing)
        said_s = scene.homecoming.left_s
        task.cancel()
        return said_s

    return run_virtually(look())


def needed_s(way: WayHome, home: Position | None) -> float:
    return WayDown(way, HERE, home).left_s(HERE, now_s=0.0)


@pytest.mark.parametrize("home", [Position(300.0, 0.0, 0.0), Position(-500.0, 0.0, 0.0), None])
@pytest.mark.parametrize("way", [ARDUCOPTER, None])
def test_a_return_goes_to_the_home_and_in_the_manner_that_the_vehicle_reports(
    way: WayHome | None, home: Position | None
) -> None:
    facts = EnergyFacts(home=home, way_home=way)
    assert left_s(facts, "return") == needed_s(way or UNKNOWN, home or Position(0.0, 0.0))
    assert left_s(facts, "land") == needed_s(way or UNKNOWN, None)


def test_a_return_goes_to_the_rally_point_that_the_firmware_chooses() -> None:
    point = ReturnPlace("rally point 1", Position(310.0, 60.0), altitude_m=50.0)
    facts = EnergyFacts(home=Position(0.0, 0.0), way_home=ARDUCOPTER, rally=RallyPoints((point,)))
    assert left_s(facts, "return") == needed_s(ARDUCOPTER.to(point), point.position)
    assert ARDUCOPTER.to(point).altitude_m == 50.0


def test_nothing_is_known_of_a_vehicle_that_stands_or_flies_on_or_for_another() -> None:
    async def look() -> None:
        scene = Scene(EnergyFacts())
        assert scene.homecoming.left_s is None
        task = await scene.begin("return")
        assert scene.homecoming.left_s is not None
        scene.vehicle.stands = True
        assert scene.homecoming.left_s is None
        scene.vehicle.stands, scene.vehicle.control = False, PILOTS
        assert scene.homecoming.left_s is None
        task.cancel()

    run_virtually(look())


HOME = Position(0.0, 0.0)
AT_5_M = Position(0.3, 0.2, 5.0)
TOLD = EnergyFacts(home=HOME, way_home=replace(ARDUCOPTER, low_m=5.0, waits_s=math.inf))


def hovering(
    facts: EnergyFacts, *, for_s: float, owner: Control = OURS, hurry: bool = False, at: Position = AT_5_M
) -> Scene:
    """A return that has come to 5 m above home, and stays there."""

    async def look() -> Scene:
        scene = Scene(facts)
        scene.vehicle.control = owner
        task = await scene.begin("return")
        scene.vehicle.position = AT_5_M.at_altitude(15.0)
        await asyncio.sleep(4.0)
        scene.vehicle.position = at
        if hurry:
            scene.homecoming.hurry("20 % is left")
        await asyncio.sleep(for_s)
        task.cancel()
        return scene

    return run_virtually(look())


def test_a_return_that_hovers_is_told_as_that_and_landed() -> None:
    assert hovering(TOLD, for_s=9.0).vehicle.told == ["return"]
    scene = hovering(TOLD, for_s=13.0)
    assert scene.vehicle.told == ["return", "land"]
    (told,) = scene.events(schema.ReturnHovers)
    assert told.position == AT_5_M
    assert "it hovers 5 m above home" in told.why


def test_a_hover_that_no_parameter_told_is_seen_all_the_same() -> None:
    for facts in EnergyFacts(), EnergyFacts(home=HOME, way_home=ARDUCOPTER, guessed=("RTL_ALT_FINAL",)):
        assert hovering(facts, for_s=13.0).vehicle.told == ["return", "land"]


def test_a_vehicle_that_is_not_ours_is_not_landed() -> None:
    scene = hovering(TOLD, for_s=100.0, owner=PILOTS)
    assert scene.vehicle.told == ["return"]
    assert not scene.events(schema.ReturnHovers)


def test_a_hover_with_the_reserve_used_up_is_landed_at_once() -> None:
    scene = hovering(TOLD, for_s=5.0, hurry=True)
    assert scene.vehicle.told == ["return", "land"]
    assert [event.why for event in scene.events(schema.ReserveOnTheWayDown)] == ["20 % is left"]
    (hovers,) = scene.events(schema.ReturnHovers)
    assert hovers.why == "the vehicle's return hovers 5 m above home, and the reserve is used up"


def test_a_vehicle_that_rests_on_the_ground_does_not_hover() -> None:
    """An ArduCopter in strong wind does not notice its landing."""
    scene = hovering(TOLD, at=HOME, for_s=20.0)
    assert scene.vehicle.told == ["return", "land"]
    (told,) = scene.events(schema.ReturnHovers)
    assert told.why == "the vehicle rests at the height of home and does not report its landing"


def test_a_vehicle_that_should_stand_already_has_no_time_left() -> None:
    """Otherwise it would be on the ground in 0 s again and again."""

    async def look() -> float | None:
        scene = Scene(TOLD)
        scene.vehicle.position = Position(0.0, 0.0)
        await scene.begin("land")
        return scene.homecoming.left_s

    assert run_virtually(look()) is None


def test_a_landing_in_doubt_of_the_position_has_no_place() -> None:
    """A return flies to where the vehicle believes home to be; a glitch of 56 m lands it 56 m beside."""

    async def look(*, is_sure: bool) -> schema.Landed:
        scene = Scene(TOLD)
        scene.vehicle.position, scene.vehicle.position_is_sure = Position(0.0, 0.0), is_sure
        return scene.homecoming.landed()

    sure, unsure = run_virtually(look(is_sure=True)), run_virtually(look(is_sure=False))
    assert (sure.at, sure.from_home_m) == ("home", 0.0)
    assert (unsure.at, unsure.from_home_m) == ("", None)


@pytest.mark.parametrize(
    ("stopped_after_s", "told"), [(9.0, ["return", "return", "land"]), (13.0, ["return", "land", "land"])]
)
def test_a_safe_end_goes_on_with_the_missions_return(stopped_after_s: float, told: list[str]) -> None:
    """At 9 s the vehicle has rested for 8 s, which count; at 13 s it is landed already."""

    async def look() -> Scene:
        scene = Scene(TOLD)
        mission = await scene.begin("return")
        scene.vehicle.position = AT_5_M
        await asyncio.sleep(stopped_after_s)
        mission.cancel()
        await asyncio.sleep(1.0)
        await scene.begin("return")
        await asyncio.sleep(3.0)
        return scene

    scene = run_virtually(look())
    assert scene.vehicle.told == told
    assert len(scene.events(schema.ReturnHovers)) == 1


def test_a_way_home_on_which_the_vehicle_comes_no_nearer_is_said_each_minute() -> None:
    async def look() -> Scene:
        scene = Scene(EnergyFacts(home=HOME, way_home=ARDUCOPTER))
        task = await scene.begin("return")
        await asyncio.sleep(29.5)
        assert not scene.events(schema.NoNearer)
        await asyncio.sleep(2.0)
        assert scene.homecoming.left_s is None, "nobody knows when it is on the ground"
        await asyncio.sleep(62.0)
        scene.vehicle.position = Position(290.0, 40.0, 20.0)
        await asyncio.sleep(2.0)
        assert scene.homecoming.left_s is not None
        task.cancel()
        return scene

    first, second = run_virtually(look()).events(schema.NoNearer)
    assert (first.to, first.away_m, first.for_s) == ("home", 302.7, 30.0)
    assert second.for_s == 90.0
