"""A simulated vehicle: its mode, its motors and its motion. It obeys every command, whoever the owner is.

The vehicle steers by its own estimate of its position, and all of its motions are in terms of that estimate. The
estimate is the true position until it jumps.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeAlias

import msgspec

from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.control import Heartbeat
from upwash.core.vehicle.way_home import WayHome
from upwash.sim.borders import Borders
from upwash.sim.link import Observe, unobserved
from upwash.vehicle.body.kinematics import Motion, Phase, braking, duration_s, leg, steadily

GUIDED, LOITER, RETURN, LAND, STABILIZE = "GUIDED", "LOITER", "RTL", "LAND", "STABILIZE"

_PILOT_LANDS_AFTER_S = 20.0  # also a ground station, and a vehicle that has caught itself after a restart
_CATCHES_ITSELF_WITHIN_S = 1.0  # a restart that takes longer leaves the motors off
_LOWEST_M = 2.0  # above the ground, that a ground station sends it to
_GRAVITY_M_S2 = 9.81
_Way: TypeAlias = Callable[[Position], tuple[Phase, ...]]


class FlightModel(Protocol):
    """How a vehicle flies; `vehicle.arducopter` is one."""

    @property
    def returning(self) -> WayHome:
        """How the vehicle returns and lands, never faster than it does."""

    def takeoff(self, ground: Position, altitude_m: float) -> tuple[Phase, ...]:
        """The phases of a climb straight up to the altitude."""

    def waypoint_leg(self, start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
        """The phases of a leg, from rest to rest."""

    def hold(self, start: Position, velocity: Velocity) -> tuple[Phase, ...]:
        """The phases of a hold by the program, from the velocity to rest."""

    def arrival_s(self, phases: tuple[Phase, ...]) -> float:
        """Seconds from the start of the phases until the vehicle counts as arrived."""

    def return_and_land(self, start: Position, home: Position) -> tuple[Phase, ...]:
        """The phases of a return, from rest to `home`: to the ground, or to its altitude above that."""

    def landing(self, start: Position) -> tuple[Phase, ...]:
        """The phases of a landing, from rest straight down to the ground."""


class ModelVehicle:
    """A simulated vehicle, which at first stands disarmed, or hovers where another program left it.

    `observe` gets each command ("commanded") and each takeover ("taken", `by`), and `moved` each motion as it begins.
    `changed` is replaced and set when its motors start or stop, and when it begins to move by itself; waits for a
    border end then, too. Altitudes count from the ground at its start.
    """

    def __init__(
        self,
        ground: Position,
        manner: FlightModel,
        *,
        ground_speed_m_s: float,
        hovers_at: Position | None = None,
        observe: Observe = unobserved,
        moved: Callable[[Motion[Phase]], None] = lambda _: None,
    ) -> None:
        # What its heartbeat says; a new object whenever that changes.
        self.report = Heartbeat(GUIDED, armed=hovers_at is not None, remote_moved=False)
        self.changed = asyncio.Event()
        self.ground_speed_m_s = ground_speed_m_s  # of its legs
        self.home = ground
        self.target: Position | None = None  # that it was last sent to
        self.boots = 0  # of its autopilot, since the start
        self.is_booting = False
        self._loop = asyncio.get_running_loop()
        self._manner = manner
        self._motion: Motion[Phase] = Motion(0.0, (), hovers_at or ground)
        # The position is read many times an instant, and computed once.
        self._located_s = -math.inf
        self._position = self._motion.end
        self._astray_east_m = self._astray_north_m = 0.0  # of the estimate, from the true position
        self.borders = Borders(self._motion)
        self._touchdown: asyncio.TimerHandle | None = None  # of a landing by itself or by a person
        self._way_down: _Way = manner.landing
        self._observe = observe
        self._moved = moved
        self._moved(self._motion)

    @property
    def mode(self) -> str:
        """The flight mode."""
        return self.report.mode

    @property
    def armed(self) -> bool:
        """Whether its motors run."""
        return self.report.armed

    @property
    def motion(self) -> Motion[Phase]:
        """The motion since the last command, or since its own last action."""
        return self._motion

    @property
    def true_position(self) -> Position:
        """The true position now."""
        here = self.position
        if not (self._astray_east_m or self._astray_north_m):
            return here
        return Position(
            here.east_m - self._astray_east_m, here.north_m - self._astray_north_m, here.altitude_m
        )

    @property
    def position(self) -> Position:
        """The reported position now: the vehicle's own estimate."""
        now_s = self._loop.time()
        if self._located_s != now_s:
            self._located_s, self._position = now_s, self._motion.position(now_s)
        return self._position

    @property
    def velocity(self) -> Velocity:
        """How it moves now."""
        return self._motion.velocity(self._loop.time())

    @property
    def flies(self) -> bool:
        """Whether it is off the ground."""
        return self.position.altitude_m > 0

    def obey(
        self,
        command: str,
        *,
        mode: str | None = None,
        armed: bool | None = None,
        target: Position | None = None,
    ) -> None:
        """Obey a command of the program: change the mode, the motors, the target, or none of them."""
        self._observe("commanded", command=command)
        if mode is not None:
            self._report(mode=mode, remote_moved=False)
        if target is not None:
            self.target = target
        if armed is not None:
            self._report(armed=armed, on_ground=None)
            self._tell_change()

    def move(self, phases: tuple[Phase, ...], end: Position) -> None:
        """Begin a motion, by a command obeyed before; `end` is its exact end."""
        self._begin(phases, end)
        self.borders.moves(self._motion)

    def follow(self, motion: Motion[Phase]) -> None:
        """Begin a motion that was recorded, by a command obeyed before."""
        self._set(motion)
        self.borders.moves(motion)

    def settle(self, end: Position) -> None:
        """Rest exactly at the end of a motion, as its timer may be a nanosecond early."""
        self._begin((), end)
        self.borders.settles(self._motion)

    def _begin(self, phases: tuple[Phase, ...], end: Position) -> None:
        self._set(Motion(self._loop.time(), phases, end))

    def _set(self, motion: Motion[Phase]) -> None:
        self._motion = motion
        self._located_s = -math.inf
        self._moved(self._motion)

    # --- what it does without a command ---------------------------------------------------------------------

    def be_taken_by_pilot(self, *, back_after_s: float, before_back: Callable[[], None]) -> None:
        """A pilot takes the vehicle in another mode, may give it back after `back_after_s`, and lands it."""
        self._observe("taken", by="pilot")
        self._report(armed=True)
        self._change_mode(LOITER, by_remote=True)
        if back_after_s < _PILOT_LANDS_AFTER_S:
            self._loop.call_later(back_after_s, self._be_given_back, before_back)
        self._loop.call_later(_PILOT_LANDS_AFTER_S, partial(self._land, by_remote=True))

    def be_diverted(self, shift: tuple[float, float, float]) -> None:
        """A ground station sends the vehicle east, north and up in the program's own mode, and later lands it.

        Nothing happens in another mode, or on the ground.
        """
        if not (self.flies and self.mode == GUIDED):
            return
        self._observe("taken", by="ground station")
        here, (east_m, north_m, up_m) = self.position, shift
        altitude_m = max(_LOWEST_M, here.altitude_m + up_m)
        self.target = Position(here.east_m + east_m, here.north_m + north_m, altitude_m)
        self._move_by_itself(self._leg_to(self.target), self.target)
        self._loop.call_later(_PILOT_LANDS_AFTER_S, self._land)

    def move_home(self, shift: tuple[float, float, float]) -> None:
        """A ground station moves the vehicle's home in flight; on the ground nothing happens."""
        if self.flies:
            east_m, north_m, up_m = shift
            home = self.home
            self.home = Position(home.east_m + east_m, home.north_m + north_m, home.altitude_m + up_m)

    def jump(self, east_m: float, north_m: float) -> tuple[Position, Position]:
        """Let the estimate jump; in flight the vehicle corrects its course. Return the estimates before and after."""
        before = self.position
        here = Position(before.east_m + east_m, before.north_m + north_m, before.altitude_m)
        self._astray_east_m += east_m
        self._astray_north_m += north_m
        end = self._motion.end
        self._begin((), here)
        self._correct_course(here, end)
        return before, here

    def restart(self, *, back_after_s: float) -> None:
        """Restart the autopilot: for `back_after_s` it sends nothing, and its motors stand still.

        After a short restart the vehicle recovers in the air, in its mode, and later a pilot lands it; else it falls.
        """
        if self.armed:
            self._observe("taken", by="restarted autopilot")
        self.is_booting = True
        if self.flies:
            self._come_down(_falling)
        else:
            self._move_by_itself((), self.position)
        self._loop.call_later(back_after_s, self._be_back, back_after_s <= _CATCHES_ITSELF_WITHIN_S)

    def _be_back(self, soon: bool) -> None:
        self.is_booting = False
        self.boots += 1
        if soon and self.flies and self.armed:  # a disarmed vehicle keeps falling
            self._stop_coming_down()
            self._move_by_itself((), self.position)
            self._loop.call_later(_PILOT_LANDS_AFTER_S, self._be_landed_by_pilot)
        else:
            self._report(mode=STABILIZE, armed=False, on_ground=not self.flies)
            self._tell_change()

    def fail_safe(self) -> None:
        """Let a fail-safe land the vehicle where it is, as for a low battery; not while it is disarmed.

        No report of a vehicle that lands already differs from a command: that is "taken_unseen".
        """
        if not self.armed:
            return
        self._observe("taken_unseen" if self.mode == LAND else "taken", by="fail-safe")
        self._report(failsafe="Battery Failsafe")
        self._land()

    def fall(self) -> None:
        """Stop the motors in the air, as for an empty battery: the vehicle falls straight down."""
        if not self.flies:
            return
        self._observe("taken", by="fail-safe")
        self._report(failsafe="Battery empty")
        self._change_mode(LAND)
        self._come_down(_falling)

    def _be_given_back(self, before_back: Callable[[], None]) -> None:
        if self.is_booting or (self.flies and not self.armed):  # it falls
            return
        before_back()
        self._change_mode(GUIDED, by_remote=True)

    def _change_mode(self, mode: str, *, by_remote: bool = False) -> None:
        self._stop_coming_down()
        self._report(mode=mode, remote_moved=by_remote)
        self._move_by_itself((), self.position)

    def _be_landed_by_pilot(self) -> None:
        if self.armed:
            self._observe("taken", by="pilot")
            self._land(by_remote=True)

    def _land(self, *, by_remote: bool = False) -> None:
        if self.armed and not self.is_booting:
            self._change_mode(LAND, by_remote=by_remote)
            self._come_down(self._manner.landing)

    def _come_down(self, way: _Way) -> None:
        self._stop_coming_down()
        here = self.position
        ground = Position(here.east_m, here.north_m)
        self._move_by_itself(way(here) if self.flies else (), ground)
        self._way_down = way
        self._touchdown = self._loop.call_at(self._motion.ends_s, self._touch_down, ground)

    def _stop_coming_down(self) -> None:
        if self._touchdown is not None:
            self._touchdown.cancel()
            self._touchdown = None

    def _touch_down(self, ground: Position) -> None:
        self._touchdown = None
        self.settle(ground)
        self._report(armed=False, on_ground=True)
        self._tell_change()

    def _correct_course(self, here: Position, end: Position) -> None:
        """Move from the position after a jump to the end of the present motion."""
        if not self.flies:
            self.borders.settles(self._motion)
        elif self._touchdown is not None:
            self._come_down(self._way_down)
        elif self.mode == RETURN:
            self._move_by_itself(self._manner.return_and_land(here, end), end)
        elif self.mode == LAND:
            self._move_by_itself(self._manner.landing(here), Position(here.east_m, here.north_m))
        else:
            self._move_by_itself(self._leg_to(end), end)

    def _leg_to(self, end: Position) -> tuple[Phase, ...]:
        return self._manner.waypoint_leg(self.position, end, ground_speed_m_s=self.ground_speed_m_s)

    def _move_by_itself(self, phases: tuple[Phase, ...], end: Position) -> None:
        self.move(phases, end)
        self._tell_change()

    def _report(self, **changed: Any) -> None:
        self.report = msgspec.structs.replace(self.report, **changed)

    def _tell_change(self) -> None:
        changed, self.changed = self.changed, asyncio.Event()
        changed.set()
        self.borders.interrupt()


def _falling(start: Position) -> tuple[Phase, ...]:
    lasts_s = math.sqrt(2 * start.altitude_m / _GRAVITY_M_S2)
    return (Phase(start, Velocity(up_m_s=-1.0), 0.0, _GRAVITY_M_S2, lasts_s),)


_AT_ONCE = 1e9  # metres a second, and more of them each second


@dataclass(frozen=True, slots=True)
class Plain:
    """A manner with one acceleration, and fixed times for take-off, return and landing."""

    acceleration_m_s2: float
    takeoff_s: float
    return_and_land_s: float

    @property
    def returning(self) -> WayHome:
        """A return in its fixed time."""
        return WayHome(
            altitude_m=0.0,
            climb_m_s=_AT_ONCE,
            speed_m_s=_AT_ONCE,
            acceleration_m_s2=_AT_ONCE,
            hover_s=self.return_and_land_s,
            descent_m_s=_AT_ONCE,
            slowly_below_m=0.0,
            landing_m_s=_AT_ONCE,
        )

    def takeoff(self, ground: Position, altitude_m: float) -> tuple[Phase, ...]:
        """The phases of a climb straight up in the fixed time."""
        return steadily(
            ground, Position(ground.east_m, ground.north_m, altitude_m), duration_s=self.takeoff_s
        )

    def waypoint_leg(self, start: Position, end: Position, *, ground_speed_m_s: float) -> tuple[Phase, ...]:
        """The phases of a leg, from rest to rest, with one acceleration."""
        return leg(start, end, cruise_m_s=ground_speed_m_s, acceleration_m_s2=self.acceleration_m_s2)

    def hold(self, start: Position, velocity: Velocity) -> tuple[Phase, ...]:
        """The phases of braking straight ahead, with the same acceleration."""
        return braking(start, velocity, acceleration_m_s2=self.acceleration_m_s2)

    def arrival_s(self, phases: tuple[Phase, ...]) -> float:
        """Seconds until the vehicle rests."""
        return duration_s(phases)

    def return_and_land(self, start: Position, home: Position) -> tuple[Phase, ...]:
        """The phases of a flight straight to home in the fixed time."""
        return steadily(start, home, duration_s=self.return_and_land_s)

    def landing(self, start: Position) -> tuple[Phase, ...]:
        """The phases of a descent straight down, in the time of a return."""
        return steadily(start, Position(start.east_m, start.north_m), duration_s=self.return_and_land_s)
