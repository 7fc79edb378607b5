"""The legs that the vehicle flies, on the loop: from rest to rest, or on along a row. Fences may forbid a leg."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from upwash.core.geo import Position, Via, Waypoint, distance_m
from upwash.core.selection.events import LegBegun, LegEnded, MissionBegun, SelectionEvent
from upwash.drone.answers import AnswerAction, one_answered
from upwash.drone.pending import Demand
from upwash.drone.places import Place, ahead_m, index_of, is_far, is_missed, lies_on, nearest_on, position_of
from upwash.drone.site import Site
from upwash.errors import AutopilotError
from upwash.eventlog import schema
from upwash.ports import Autopilot, Journal, VehicleLimits
from upwash.support.background import begin, first

_SHORT_M = 1.0  # a leg without a spot to pass
_LEAST_S = 0.005  # between two looks at the position: 4 cm at 8 m/s
_FASTER = 1.25  # a vehicle may exceed the speed of its leg: a PX4 flew 4.4 m/s for 4
_UNSURE_S = 0.1  # between two looks while the position is in doubt

_Way: TypeAlias = tuple[Position, Position]  # from the start of a leg to its end


@dataclass(eq=False)
class Legs:
    """Flies one leg after the other, and knows where the vehicle was last sent to.

    `limits` are the vehicle's own, read before arming. `stands_at` is where exactly it was sent, which is
    not quite where it is; None on a leg. `ground_speed_m_s` is the speed as it was last set, None for the configured
    one. `found_flying` is a vehicle that has taken off before this program began, and not landed since.
    """

    autopilot: Autopilot
    journal: Journal
    site: Site
    tell: Callable[[SelectionEvent], None]
    default_m_s: float
    limits: VehicleLimits = field(default_factory=VehicleLimits, init=False)
    in_the_air: bool = field(default=False, init=False)
    found_flying: bool = field(default=False, init=False)
    ground_speed_m_s: float | None = field(default=None, init=False)
    on_a_leg: bool = field(default=False, init=False)
    stands_at: Position | None = field(default=None, init=False)
    place: Place | None = field(default=None, init=False)
    # The leg that is flown while the mission looks at an answer.
    _leg: asyncio.Task[None] | None = field(default=None, init=False)
    _way: _Way | None = field(default=None, init=False)

    @property
    def position(self) -> Position:
        """Where the vehicle is."""
        return self.autopilot.position

    @property
    def leg_speed_m_s(self) -> float | None:
        """The commanded speed of the leg that is flown; None between legs."""
        return (self.ground_speed_m_s or self.default_m_s) if self.on_a_leg else None

    def take_up(self) -> None:
        """Note that the vehicle is in the air, where an earlier program left it."""
        self.in_the_air = self.found_flying = True
        self.tell(MissionBegun(self.autopilot.energy, self.autopilot.pace))

    @property
    def rests(self) -> bool:
        """Whether the last leg is over."""
        return self._leg is None

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Set the ground speed of the following legs, in metres per second."""
        await self.autopilot.set_ground_speed(ground_speed_m_s)
        self.ground_speed_m_s = ground_speed_m_s

    async def goto(self, place: Place, *, back: bool = False) -> None:
        """Fly to a place, from rest to rest, `back` to a waypoint whose calls are over.

        Raises AutopilotRefused if a fence forbids the way.
        """
        self.place = place
        position, hold_s = position_of(place), 0.0
        self.site.require_leg(self.limits, self.stands_at or self.autopilot.position, position)
        if isinstance(place, Waypoint):
            await self._set_planned_speed(place.ground_speed_m_s)
            hold_s = 0.0 if back else place.hold_s
        self.journal.record(schema.SetOff(**_named(place), back=back))
        self.tell(LegBegun(position, self.ground_speed_m_s, back=back))
        await self._fly(position)
        self.tell(LegEnded())
        self.journal.record(schema.Arrived(**_named(place), hold_s=hold_s))
        if hold_s:
            await asyncio.sleep(hold_s)

    async def _set_planned_speed(self, ground_speed_m_s: float | None) -> None:
        if ground_speed_m_s is not None and ground_speed_m_s != self.ground_speed_m_s:
            await self.set_ground_speed(ground_speed_m_s)

    async def _fly(self, end: Position) -> None:
        self.stands_at = None
        self.on_a_leg = True
        try:
            await self.autopilot.goto(end)
        finally:
            self.on_a_leg = False
        self.stands_at = end

    async def until_answered(self, verb: Coroutine[Any, Any, None] | None, demand: Demand[Any]) -> bool:
        """Begin to fly, or fly on; return True on arrival, or False, still in flight, when an answer is there."""
        self._leg = self._leg if verb is None else begin(verb)
        return await self._ends_before(one_answered([demand]))

    async def _ends_before(self, *waits: Coroutine[Any, Any, Any]) -> bool:
        """Return True at rest at the end of the leg, or False, still in flight, after the first of the waits."""
        leg = self._leg
        assert leg is not None  # noqa: S101 - it was begun
        try:
            await first(asyncio.wait([leg]), *waits)
        except asyncio.CancelledError:
            await self.end()
            raise
        if leg.done():
            await self.arrive()
            return True
        return False

    def allows(self, start: Position, target: Position) -> bool:
        """Whether no fence forbids the leg."""
        return self.site.allows_leg(self.limits, start, target)

    async def set_off(self, end: Position, ground_speed_m_s: float | None = None) -> None:
        """Set off for the end of a leg, and do not wait for the arrival."""
        await self.arrive()
        start = self.stands_at or self.autopilot.position
        self.site.require_leg(self.limits, start, end)

        async def fly() -> None:
            await self._set_planned_speed(ground_speed_m_s)
            await self._fly(end)

        self._way, self._leg = (start, end), begin(fly())

    def passes(self, place: Place) -> bool:
        """Whether the leg that is flown passes the place, or has just passed it; True too in doubt of its place."""
        way, spot = self._way, position_of(place)
        return way is not None and lies_on(spot, *way) and not self._misses(spot, way)

    def left(self) -> Position:
        """The place of the last leg that is nearest to the vehicle; the vehicle's place before the first leg."""
        here = self.autopilot.position
        return here if self._way is None else nearest_on(*self._way, here)

    def head_for(self, place: Place, via: tuple[Via, ...] = ()) -> None:
        """Note that the place is the next one on the leg, or on those over `via`."""
        self.journal.record(schema.SetOff(**_named(place)))
        self.turn(place, via)

    def turn(self, place: Place, via: tuple[Via, ...] = ()) -> None:
        """Note that the next leg on the way to the place begins."""
        self.place = place
        planned_m_s = place.ground_speed_m_s if isinstance(place, Waypoint) and not via else None
        self.tell(LegBegun(position_of(place), planned_m_s or self.ground_speed_m_s, via=via))

    async def fly_on(self, place: Place, answers: Sequence[AnswerAction[Any]]) -> bool:
        """Return True where it passes the place, or rests there at the end of the leg.

        Return False when one of the answers is there, or when it has missed the place.
        """
        way, position = self._way, position_of(place)
        assert way is not None  # noqa: S101 - it was set off
        if not await self.fly_through(position, answers) or self._misses(position, way):
            return False
        self.tell(LegEnded())
        hold: dict[str, Any] = (
            {"hold_s": place.hold_s} if isinstance(place, Waypoint) and place.hold_s else {}
        )
        self.journal.record(schema.Arrived(**_named(place), **hold, passing=not self.rests))
        return True

    async def fly_through(self, position: Position, answers: Sequence[AnswerAction[Any]]) -> bool:
        """As `fly_on`, of a place that is none of the mission's."""
        way, is_there = self._way, False
        assert way is not None  # noqa: S101 - it was set off

        async def passes() -> None:
            nonlocal is_there
            await self._passed(position, way)
            is_there = True

        waits: list[Coroutine[Any, Any, Any]] = [one_answered(answers)] if answers else []
        if position != way[1] and distance_m(*way) > _SHORT_M:
            waits.append(passes())
        return await self._ends_before(*waits) or is_there

    async def _passed(self, spot: Position, way: _Way) -> None:
        vehicle, fastest_m_s = self.autopilot, self.ground_speed_m_s or self.default_m_s
        while True:
            left_m = ahead_m(spot, vehicle.position, start=way[0], end=way[1])
            if left_m <= 0 and vehicle.position_is_sure:
                return
            velocity = vehicle.telemetry.velocity
            speed_m_s = max(fastest_m_s, velocity.speed_m_s if velocity else 0.0)
            ahead_s = left_m / (_FASTER * speed_m_s)
            await asyncio.sleep(max(_LEAST_S, ahead_s) if left_m > 0 else _UNSURE_S)

    def _misses(self, spot: Position, way: _Way) -> bool:
        """Whether it is sure to have passed a spot too far away, or long ago, as in a silence of its link.

        A leg that is flown reaches its end. At rest only a spot where the vehicle surely is counts as reached.
        """
        here, is_sure = self.autopilot.position, self.autopilot.position_is_sure
        if self.rests and (not is_sure or is_far(spot, here)):
            return True
        start, end = way
        if end in (spot, start) or not is_sure:
            return False
        speed_m_s = self.ground_speed_m_s or self.default_m_s
        return is_missed(spot, here, start=start, end=end, speed_m_s=speed_m_s)

    async def stop(self) -> None:
        """Brake and end the leg, or fly it to its end if that is nearer."""
        if self._leg is not None and self._way is not None:
            await self.stop_short_of(self._way[1])

    async def arrive(self) -> None:
        """Wait until the vehicle rests at the end of the leg."""
        leg, self._leg = self._leg, None
        if leg is not None:
            await leg

    async def stop_short_of(self, target: Position) -> None:
        """Brake; end the leg at its target instead if braking would lead beyond it, where no check was made."""
        here, stopping_place = self.autopilot.position, self.autopilot.stopping_place
        if distance_m(here, stopping_place) > distance_m(here, target):
            await self.arrive()
        else:
            await self.end()
            await self.autopilot.hold()

    async def end(self) -> None:
        """Cancel the leg under way, if any."""
        leg, self._leg = self._leg, None
        if leg is not None:
            leg.cancel()
            with contextlib.suppress(asyncio.CancelledError, AutopilotError):
                await leg


def _named(place: Place) -> dict[str, Any]:
    position = position_of(place)
    return {"waypoint": index_of(place), "east_m": position.east_m, "north_m": position.north_m}
