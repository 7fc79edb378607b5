"""The vehicle as a mission uses it: each verb logged, held against the fences, and blocking until it is true."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Coroutine, Iterator, Sequence
from typing import Any, Literal

from upwash.core.geo import EarthPosition, Position, Waypoint, rounded
from upwash.core.selection.events import (
    DescentBegun,
    MissionBegun,
    SelectionEvent,
    TargetUnknown,
)
from upwash.core.vehicle.telemetry import Telemetry
from upwash.drone.homecoming import Homecoming
from upwash.drone.late_acts import LateActs, Onwards
from upwash.drone.legs import Legs
from upwash.drone.mission import MissionThread
from upwash.drone.pending import AnswerAction, Demand, index_of, position_of
from upwash.drone.rows import RowRules, Rows
from upwash.drone.site import Site, require_altitude
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.schema import SEVERITIES
from upwash.ports import Autopilot, ComingDown, Journal, VehicleLimits
from upwash.support.text import printable

Severity = Literal["emergency", "alert", "critical", "error", "warning", "notice", "info", "debug"]
_LONGEST_TEXT_BYTES = 200  # four chunks of STATUSTEXT
_AtPlace = type[schema.Armed | schema.Holding | schema.Disarmed]


class Vehicle:
    """The vehicle as a mission uses it: a method returns when its action is complete, or raises AutopilotError."""

    def __init__(
        self,
        autopilot: Autopilot,
        thread: MissionThread,
        journal: Journal,
        *,
        site: Site,
        homecoming: Homecoming,
        tell: Callable[[SelectionEvent], None],
        late: LateActs,
        rows: RowRules | None = None,
    ) -> None:
        self._autopilot = autopilot
        self._homecoming = homecoming
        self._thread = thread
        self._journal = journal
        self._site = site
        self._tell = tell
        self._legs = Legs(
            autopilot, journal, site=site, tell=tell, default_m_s=rows.ground_speed_m_s if rows else 0.0
        )
        self._in_the_air = False
        self._found_flying = False  # it has taken off before this program began, and not landed since
        self._open: AnswerAction[Any] | None = None
        self._late = late
        self._due: list[AnswerAction[Any]] = []  # acts that are done now, at stops
        self._owed: list[AnswerAction[Any]] = []  # acts whose time is not decided, at stops
        self._acts = False
        self._rows = (
            Rows(
                VehicleHandle(self), thread, journal, plan=site.waypoints, way=site.way, rules=rows, late=late
            )
            if rows
            else None
        )

    @property
    def position(self) -> Position:
        """The drone's position relative to the mission's home, in metres."""
        return self._autopilot.position

    @property
    def earth_position(self) -> EarthPosition | None:
        """The drone's place on the Earth in degrees (WGS 84), and its altitude above the sea; None while unknown.

        `above_sea_m` and `unix_s`, the time by its GPS, are None if the vehicle does not report them, as in a
        simulation.
        """
        return self._autopilot.earth_position

    @property
    def in_the_air(self) -> bool:
        """Whether the mission has taken off and not landed since."""
        return self._in_the_air

    @property
    def battery_percent(self) -> float | None:
        """The battery's charge in percent, as last reported; None if the vehicle does not report it."""
        return self._autopilot.telemetry.battery_percent

    @property
    def telemetry(self) -> Telemetry:
        """The vehicle's last reports: speed, attitude, heading, GPS, mode, battery."""
        return self._autopilot.telemetry

    @property
    def on_a_leg(self) -> bool:
        """Whether the vehicle is on its way to a place where the mission sent it."""
        return self._legs.on_a_leg

    @property
    def place(self) -> Waypoint | Position | None:
        """The place where the mission last sent the vehicle; None before its first leg."""
        return self._legs.place

    @property
    def waypoint(self) -> int | None:
        """The index of the waypoint where the mission last sent the vehicle; None for a place off the plan."""
        return index_of(self._legs.place)

    @property
    def ground_speed_m_s(self) -> float | None:
        """The ground speed of legs as the mission last set it; None for the configured speed."""
        return self._legs.ground_speed_m_s

    def _take_up(self) -> None:
        """Note that the vehicle is in the air, where an earlier program left it."""
        self._in_the_air = self._found_flying = True
        self._tell(MissionBegun(self._autopilot.energy, self._autopilot.pace))

    def arm(self) -> None:
        """Waits until the vehicle is ready to fly, then arms its motors.

        Raises AutopilotRefused if the vehicle stands too far from the mission, or its own fence forbids a part of it.
        """
        if not self._found_flying:  # arming would change the mode that it flies in
            self._thread.call(self._logged(self._arm, schema.Armed))

    def takeoff(self, altitude_m: float) -> None:
        """Takes off and climbs to the altitude above home; a vehicle found flying only climbs, and never sinks."""
        if self._found_flying:
            self._thread.call(self._climb(altitude_m))
            return
        self._legs.stands_at = None
        self._in_the_air = True  # from the attempt on: it may fail half-way up
        self._thread.call(self._takeoff(altitude_m))

    def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the ground speed of the following legs, in metres per second."""
        self._thread.call(self._legs.set_ground_speed(ground_speed_m_s))

    def goto(self, place: Waypoint | Position, *, unless: Demand[Any] | None = None) -> bool:
        """Flies to a waypoint or position; returns True on arrival, at rest, and after the waypoint's hold time.

        On a row of `mission.photos` it returns True when the drone passes the waypoint, and the drone flies on.
        With `unless=pending.demands(...)`, an answer with that demand stops the flight: the vehicle brakes and `goto`
        returns False, at rest on the way, or at the target if that is nearer. Raises AutopilotRefused, without a
        movement, if the plan's geofence forbids the place or the way.
        """
        self._thread.require_turn()
        if self._rows is not None and unless is None:
            self._rows.goto(place)
            return True
        if self._rows is not None:
            self._rows.fly_over(place)
            self._rows.stop()
        else:
            self._act_before(place)
        if self._open is None or unless is not None:
            return self._fly(place, unless=unless)
        with self._settling(self._open) as answer:
            answer.fly_on(place)
        return True

    def turn_to(self, heading_deg: float) -> None:
        """Turns the hovering vehicle's nose to a heading, in degrees clockwise from north, until the next leg.

        Raises UsageError unless the heading is from 0 to 360.
        """
        if not 0 <= heading_deg <= 360:
            raise UsageError(f"turn_to: heading_deg is {heading_deg}: give degrees from 0 to 360")
        self._settle()
        self._thread.call(self._turn_to(heading_deg % 360))

    def send_text(self, text: str, *, severity: Severity = "info") -> None:
        """Sends a text to the ground station as the vehicle's own (MAVLink's STATUSTEXT), without a confirmation.

        Raises UsageError unless the text has 1 to 200 bytes in UTF-8.
        """
        if severity not in SEVERITIES:
            raise UsageError(f"send_text: no severity {severity!r}: choose of {', '.join(SEVERITIES)}")
        if not 0 < (size := len(text.encode())) <= _LONGEST_TEXT_BYTES:
            raise UsageError(
                f"send_text: {size} bytes: give a text of 1 to {_LONGEST_TEXT_BYTES} bytes in UTF-8"
            )
        self._thread.call(self._send_text(SEVERITIES.index(severity), text))

    def hover(self, duration_s: float) -> None:
        """Hovers where the vehicle is for `duration_s`; on a row it first comes back to the last spot."""
        self._thread.require_turn()
        if self._rows is not None:
            self._rows.rest()
        self._thread.call(asyncio.sleep(duration_s))

    def hold(self) -> None:
        """Stops the vehicle, and returns when it hovers."""
        self._settle()
        self._legs.stands_at = None
        self._thread.call(self._logged(self._autopilot.hold, schema.Holding))

    def return_home_and_land(self) -> None:
        """Flies back to the vehicle's home or rally point, lands, and returns when it has landed."""
        self._come_down("return", self._homecoming.return_and_land, schema.Returning)

    def land(self) -> None:
        """Lands where the vehicle is, and returns when it has landed."""
        self._come_down("land", self._homecoming.land, schema.Landing)

    def disarm(self) -> None:
        """Stops the motors of the landed vehicle."""
        self._settle()
        self._thread.call(self._logged(self._autopilot.disarm, schema.Disarmed))

    def _settle(self, *, comes_back: bool = True) -> None:
        """Wait for all open answers, and do what they demand; come back to the last place, or do not."""
        self._thread.require_turn()
        if self._rows is not None:
            self._rows.settle(comes_back=comes_back)
            return
        here = self._legs.place
        self._settle_open()
        while acts := self._late.all() + self._taken_owed():
            self._act(acts)
            self._settle_open()
        if comes_back and here is not None and here != self._legs.place:
            self._fly(here, back=True)

    def _settle_open(self, *, puts_off: bool = False) -> None:
        if self._open is not None:
            with self._settling(self._open) as answer:
                answer.settle(puts_off=puts_off)

    def _act_before(self, place: Waypoint | Position) -> None:
        """Do the acts that were put off to here, and those that would be late further on."""
        if not (self._late or self._due or self._owed) or self._acts:
            return
        here, onwards = self._legs.place, Onwards(place, position_of(place))
        due = self._late.due_after(here)
        self._act([*due, *self._thread.call(self._late.due(onwards)), *self._owed_now(onwards)])
        now = self._legs.place
        if here and now and here != now and not self._legs.allows(position_of(now), position_of(place)):
            self._fly(here, back=True)

    def _owed_now(self, onwards: Onwards) -> list[AnswerAction[Any]]:
        """The owed acts that are not put off."""
        return [act for act in self._taken_owed() if not (act.demands() and self._is_put_off(act, onwards))]

    def _taken_owed(self) -> list[AnswerAction[Any]]:
        owed, self._owed = self._owed, []
        return owed

    def _is_put_off(self, act: AnswerAction[Any], onwards: Onwards) -> bool:
        if not self._thread.call(self._late.puts_off(act, onwards, self._legs.allows)):
            return False
        act.put_off()
        return True

    def _act(self, acts: Sequence[AnswerAction[Any]]) -> None:
        """Do these acts one after the other; those that an exception of one leaves are done with the next."""
        self._due += acts
        if self._acts:
            return
        self._acts = True
        try:
            while self._due:
                self._due.pop(0).come_back(0.0)
        finally:
            self._acts = False

    def _puts_off(self, answer: AnswerAction[Any], place: Waypoint | Position | None = None) -> bool:
        """Whether the act is put off on the leg to the place, or at rest at the last waypoint."""
        target = place or self._legs.place
        if target is None:
            return False
        end = position_of(target)
        return self._is_put_off(answer, Onwards(target, end, end, rests=place is None))

    def _owe(self, act: AnswerAction[Any]) -> None:
        if self._rows is not None:
            self._rows.owe(act)
        else:
            self._owed.append(act)

    def _leave(self) -> None:
        """Fly over the places after the last photo; not to return when there was no photo left to take."""
        if self._rows is not None and (self._site.waypoints or self._site.ending == "land"):
            self._rows.leave(self._site.leaving)

    def _settle_for_call(self) -> None:
        """The same before another call is made; on rows several are open."""
        if self._rows is None:
            self._settle_open(puts_off=True)

    def _fly(
        self,
        place: Waypoint | Position,
        *,
        unless: Demand[Any] | None = None,
        late: AnswerAction[Any] | None = None,
        back: bool = False,
    ) -> bool:
        """As `goto`, without settling the open answer; the act of a `late` one may be put off."""
        if back and self._rows is not None:
            self._rows.fly_around(position_of(place))
        self._legs.place = place
        if isinstance(place, Waypoint):
            verb = self._legs.goto(
                place.position,
                waypoint=place.index,
                ground_speed_m_s=place.ground_speed_m_s,
                hold_s=0.0 if back else place.hold_s,
                back=back,
            )
        else:
            verb = self._legs.goto(place, back=back)
        if unless is None:
            self._thread.call(verb)
            return True
        if self._thread.call(self._legs.until_answered(verb, unless)):
            return True
        try:
            while not unless.holds():
                if unless.pending.done():
                    return self._fly_on(place, late)
                if self._thread.call(self._legs.until_answered(None, unless)):  # a better answer may come
                    return True
            if late is None:
                unless.note()  # before it brakes: who takes the vehicle then has it with this left undone
            elif late.demands() and self._puts_off(late, place):
                self._thread.call(self._legs.arrive())
                return True
        except BaseException:
            self._thread.call(self._legs.stop_short_of(position_of(place)))
            raise
        self._thread.call(self._legs.stop_short_of(position_of(place)))
        return False

    def _fly_on(self, place: Waypoint | Position, late: AnswerAction[Any] | None) -> bool:
        """Fly on to the place with an answer that demands nothing; False after acts on objects that it shows."""
        if late is not None and late.only_tells:
            late.finish(0.0)
        end = position_of(place)
        due = [] if self._acts else self._owed_now(Onwards(place, end, end, rests=False))
        self._thread.call(self._legs.stop_short_of(end) if due else self._legs.arrive())
        self._act(due)
        return not due

    @contextlib.contextmanager
    def _settling(self, answer: AnswerAction[Any]) -> Iterator[AnswerAction[Any]]:
        """Close the open answer during the block, as acting on it flies too; reopen it if the block fails."""
        self._thread.require_turn()
        self._open = None
        try:
            yield answer
        finally:
            if not answer.is_over:
                self._open = answer

    def _come_down(
        self,
        how: ComingDown,
        verb: Callable[[], Coroutine[Any, Any, None]],
        doing: type[schema.Returning | schema.Landing],
    ) -> None:
        self._settle(comes_back=how == "land")
        if self._rows is not None:
            self._rows.seek_answers()
        self._thread.call(self._descend(verb, doing))
        self._in_the_air = self._found_flying = False
        if self._rows is not None:
            self._rows.after_landing()

    async def _descend(
        self, verb: Callable[[], Coroutine[Any, Any, None]], doing: type[schema.Returning | schema.Landing]
    ) -> None:
        self._tell(DescentBegun())
        self._journal.record(doing(position=rounded(self._autopilot.position)))
        await verb()
        self._journal.record(self._homecoming.landed())

    async def _turn_to(self, heading_deg: float) -> None:
        await self._autopilot.turn_to(heading_deg)
        self._journal.record(schema.Turned(heading_deg=heading_deg))

    async def _send_text(self, severity: int, text: str) -> None:
        self._autopilot.say(severity, text)
        self._journal.record(schema.TextSent(severity=severity, text=printable(text)))

    async def _arm(self) -> None:
        await self._autopilot.ready()
        limits = await self._autopilot.limits()
        self._record_limits(limits)
        stands = self._autopilot.position
        self._site.require_reachable(stands)
        self._site.require_within(limits, stands)
        for why in self._site.doubts(limits, stands):
            self._journal.record(schema.SiteDoubt(why=why))
        self._legs.limits = limits
        self._journal.record(schema.Arming())
        await self._autopilot.arm()
        self._tell(MissionBegun(self._autopilot.energy, self._autopilot.pace))

    def _record_limits(self, limits: VehicleLimits) -> None:
        battery = self._autopilot.energy
        self._journal.record(
            schema.LimitsRead(
                home=rounded(limits.home) if limits.home else None,
                home_above_sea_m=limits.home_above_sea_m,
                highest_m=limits.highest_m,
                lowest_m=limits.lowest_m,
                fences=[fence.name for fence in limits.fences],
                low_percent=battery.low_percent,
                critical_percent=battery.critical_percent,
                rally=[rounded(point.position) for point in limits.rally.points],
            )
        )

    async def _takeoff(self, altitude_m: float) -> None:
        require_altitude(self._legs.limits, altitude_m, step=f"takeoff to {altitude_m:g} m")
        self._tell(TargetUnknown())
        self._journal.record(schema.TakingOff(altitude_m=altitude_m))
        await self._autopilot.takeoff(altitude_m)
        self._journal.record(
            schema.TookOff(altitude_m=altitude_m, position=rounded(self._autopilot.position))
        )

    async def _climb(self, altitude_m: float) -> None:
        here = self._autopilot.position
        if here.altitude_m < altitude_m:  # never down: only the plan knows what is below
            require_altitude(self._legs.limits, altitude_m, step=f"climb to {altitude_m:g} m")
            await self._autopilot.goto(Position(here.east_m, here.north_m, altitude_m))

    async def _logged(self, verb: Callable[[], Coroutine[Any, Any, None]], after: _AtPlace) -> None:
        self._tell(TargetUnknown())
        await verb()
        self._journal.record(after(position=rounded(self._autopilot.position)))


class VehicleHandle:
    """What a flight and its answers do with the vehicle, and a mission cannot."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._legs = legs = vehicle._legs
        self.settle = vehicle._settle
        self.end_leg = legs.end
        self.take_up = vehicle._take_up
        self.fly = vehicle._fly
        self.settle_for_call = vehicle._settle_for_call
        self.allows = legs.allows
        self.set_off = legs.set_off
        self.passes = legs.passes
        self.left = legs.left
        self.head_for = legs.head_for
        self.fly_on = legs.fly_on
        self.fly_through = legs.fly_through
        self.turn = legs.turn
        self.leave = vehicle._leave
        self.puts_off = vehicle._puts_off
        self.owe = vehicle._owe
        self.arrive = legs.arrive
        self.stop = legs.stop

    @property
    def flies_rows(self) -> bool:
        """Whether it flies rows without stopping, with several answers open."""
        return self._vehicle._rows is not None and not self._vehicle._rows.rests_always

    def rests(self) -> bool:
        """Whether the last leg is over."""
        return self._legs.rests

    def place(self) -> Waypoint | Position | None:
        """Where it was last sent to."""
        return self._legs.place

    def position(self) -> Position:
        """Where it is."""
        return self._vehicle.position

    def leave_open(self, answer: AnswerAction[Any]) -> None:
        """Have the verbs that follow settle the answer."""
        if self._vehicle._rows is not None:
            self._vehicle._rows.leave_open(answer)
        else:
            self._vehicle._open = answer
