"""Where a stand-in PX4 flies by itself: up at a take-off, to a place, home, and down."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto

from upwash.core.geo import Position, ground_distance_m
from upwash.core.vehicle.return_place import RallyPoints, ReturnPlace
from upwash.mavlink.px4 import Mode
from upwash.vehicle.body.copter import HOME
from upwash.vehicle.body.parameters import ParameterTable
from upwash.vehicle.px4.airframe import ALTITUDE_REACHED_M, LANDS_WITHIN_M, REACTION_S
from upwash.vehicle.px4.body import CLIMB_M_S, CLIMBING_M_S2, Body, Steering, landing_sink_m_s

LEAST_LIFT_M = 0.3
LOWEST_M, _HIGHEST_M = -200.0, 1_000.0
_TURNS_BEYOND_M = 2.0
_SLOWEST_M_S, _FASTEST_M_S = 0.1, 30.0
_POINTS_FIRST, _BY_MISSION, _POINTS_ONLY = 1, (2, 4), 5  # of RTL_TYPE
_AT_HOME_M, _NEARER_M = 10.0, 2.0  # of rally points, against home


@dataclass(frozen=True, slots=True)
class Reposition:
    """A command to fly to a place. Without a place it holds; without an altitude it keeps the present altitude."""

    east_north_m: tuple[float, float] | None
    altitude_m: float | None
    speed_m_s: float
    yaw_deg: float | None

    def target(self, here: Position) -> Position:
        """The position to fly to, for a command received at `here`."""
        target = Position(*(self.east_north_m or (here.east_m, here.north_m)), here.altitude_m)
        return target if self.altitude_m is None else target.at_altitude(self.altitude_m)


class _Returning(Enum):
    """How far it has come in RTL."""

    CLIMBS = auto()
    FLIES = auto()
    SINKS = auto()  # before it waits
    WAITS = auto()
    LANDS = auto()


class Navigator:
    """The place that it flies to or holds, how fast, and how far it has come in a return."""

    def __init__(
        self,
        parameters: ParameterTable,
        body: Body,
        tell: Callable[..., None],
        *,
        home_altitude_m: float,
        now_s: float,
        rally: Sequence[Position] = (),
    ) -> None:
        self.takeoff_altitude_m: float | None = None
        self._parameters = parameters
        self._body = body
        self._tell = tell
        self._home_altitude_m = home_altitude_m
        self._place: Position | None = None
        self._altitude_m = 0.0
        self._heading_deg: float | None = None
        self._moves_s = now_s
        self._cruise_m_s = parameters["MPC_XY_CRUISE"]
        self._returning = _Returning.CLIMBS
        self._rally = rally
        self._end = HOME  # of its return
        self._lands_s = math.inf

    @property
    def target(self) -> Position | None:
        """The position that it flies to; None if it flies to none."""
        return self._place.at_altitude(self._altitude_m) if self._place else None

    @property
    def lands_at_home(self) -> bool:
        """Whether its return has reached the landing."""
        return self._returning is _Returning.LANDS

    def enter(self, mode: Mode, *, before: Mode, armed: bool) -> None:
        """Begins a mode."""
        if mode is Mode.LOITER and before is Mode.TAKEOFF:
            self._cruise_m_s = self._parameters["MPC_XY_CRUISE"]
            return
        self._place, self._heading_deg = None, None
        self._altitude_m = self._body.altitude_m
        self._cruise_m_s = self._parameters["MPC_XY_CRUISE"]
        if mode is Mode.RTL and armed:
            self._begin_return()

    def _begin_return(self) -> None:
        self._returning = _Returning.CLIMBS
        self._end, self._lands_s = self._chosen_end(), math.inf
        away_m = ground_distance_m(self._body.position, self._end)
        if away_m > self._parameters["RTL_MIN_DIST"]:
            return_m = self._end.altitude_m + self._parameters["RTL_RETURN_ALT"]
            self._altitude_m = max(self._altitude_m, return_m)
        above_sea_m = self._altitude_m + self._home_altitude_m
        self._tell("vrtl_return_at", round(above_sea_m), round(self._altitude_m))

    def _chosen_end(self) -> Position:
        """Home or a rally point, by RTL_TYPE; a stored mission is not modelled."""
        kind = self._parameters["RTL_TYPE"]
        if kind in _BY_MISSION:
            return HOME
        points = tuple(
            ReturnPlace(f"rally point {number}", place)
            for number, place in enumerate(self._rally, 1)
            if kind == _POINTS_ONLY or ground_distance_m(place, HOME) > _AT_HOME_M
        )
        rally = RallyPoints(
            points, home_counts=kind not in (_POINTS_FIRST, _POINTS_ONLY), nearer_by_m=_NEARER_M
        )
        return rally.chosen(self._body.position, HOME).position

    def take_off_to(self, altitude_m: float, *, grounded: bool) -> bool:
        """Sets the altitude of a take-off; returns False if it is not above the vehicle or too high."""
        self.takeoff_altitude_m = None
        if not self._body.altitude_m + LEAST_LIFT_M < altitude_m <= _HIGHEST_M:
            if not grounded:
                self.takeoff_altitude_m = self._body.altitude_m
            return False
        self.takeoff_altitude_m = altitude_m
        return True

    def lifted(self) -> None:
        """Notes that the vehicle has left the ground: it climbs above this place."""
        self._place, self._altitude_m = self._body.position, self.takeoff_altitude_m or 0.0

    def reposition(self, wish: Reposition, now_s: float, *, was_holding: bool) -> None:
        """Flies to the place; the former speed is kept only if the vehicle was holding and no other is given."""
        target = wish.target(self._body.position)
        if 0 < wish.speed_m_s < math.inf:
            self._cruise_m_s = wish.speed_m_s
        elif not was_holding:
            self._cruise_m_s = self._parameters["MPC_XY_CRUISE"]
        if wish.east_north_m is not None:
            self._place = target
        elif wish.altitude_m is None and wish.yaw_deg is None:
            self._place = None
        self._altitude_m = target.altitude_m
        self._heading_deg = wish.yaw_deg
        self._moves_s = now_s + REACTION_S

    def change_speed(self, speed_m_s: float) -> None:
        """Flies on with that speed."""
        if 0 < speed_m_s < math.inf:
            self._cruise_m_s = speed_m_s

    def ends_climb(self) -> bool:
        """Whether a take-off has reached its altitude, which it holds from then on."""
        target_m = self._climbs_to_m()
        if abs(target_m - self._body.altitude_m) > ALTITUDE_REACHED_M:
            return False
        self._place, self._altitude_m = self._place or self._body.position, target_m
        return True

    def climbing(self, now_s: float) -> Steering:
        """The steering of a take-off: straight up."""
        return replace(
            self._holding_at(self._climbs_to_m(), now_s),
            climb_m_s=CLIMB_M_S,
            climb_m_s2=CLIMBING_M_S2,
            turns_to_deg=None,
        )

    def _climbs_to_m(self) -> float:
        return self.takeoff_altitude_m if self.takeoff_altitude_m is not None else self._body.altitude_m

    def holding(self, now_s: float) -> Steering:
        """The steering to the place that it holds."""
        return self._holding_at(self._altitude_m, now_s)

    def _holding_at(self, altitude_m: float, now_s: float) -> Steering:
        """The steering that holds its place or, without one, brakes; where it stops is its place from then on."""
        if self._place is None and self._body.told_to_stand:
            self._place = self._body.position
        if now_s < self._moves_s:
            return Steering(place=self._body.position, altitude_m=altitude_m)
        return Steering(
            place=self._place,
            cap_m_s=within_limits(self._cruise_m_s, self._parameters),
            altitude_m=altitude_m,
            turns_to_deg=self._heading_deg if self._heading_deg is not None else self._course_deg(),
        )

    def _course_deg(self) -> float | None:
        if self._place is None or ground_distance_m(self._place, self._body.position) <= _TURNS_BEYOND_M:
            return None
        here = self._body.position
        east_m, north_m = self._place.east_m - here.east_m, self._place.north_m - here.north_m
        return math.degrees(math.atan2(east_m, north_m)) % 360

    def on_the_way_home(self, now_s: float) -> Steering:
        """The steering of a return: up, home, and down."""
        if self._returning is _Returning.CLIMBS:
            if abs(self._altitude_m - self._body.altitude_m) > ALTITUDE_REACHED_M:
                return self.holding(now_s)
            self._returning, self._place = _Returning.FLIES, self._end.at_altitude(self._altitude_m)
        if self._returning is _Returning.FLIES:
            if ground_distance_m(self._body.position, self._end) > LANDS_WITHIN_M:
                return self.holding(now_s)
            self._begin_descent()
        if self._returning in (_Returning.SINKS, _Returning.WAITS) and self._still_waits(now_s):
            return self.holding(now_s)
        return self.landing(now_s)

    def _begin_descent(self) -> None:
        if self._parameters["RTL_LAND_DELAY"]:
            self._returning = _Returning.SINKS
            low_m = self._end.altitude_m + self._parameters["RTL_DESCEND_ALT"]
            self._altitude_m = min(low_m, self._altitude_m)
        else:
            self._begin_landing()

    def _still_waits(self, now_s: float) -> bool:
        """Whether it sinks to the altitude of its wait, or waits there; below 0 RTL_LAND_DELAY has no end."""
        if self._returning is _Returning.SINKS:
            if abs(self._altitude_m - self._body.altitude_m) > ALTITUDE_REACHED_M:
                return True
            delay_s = self._parameters["RTL_LAND_DELAY"]
            self._returning, self._lands_s = _Returning.WAITS, now_s + (delay_s if delay_s >= 0 else math.inf)
        if now_s < self._lands_s:
            return True
        self._begin_landing()
        return False

    def _begin_landing(self) -> None:
        self._returning = _Returning.LANDS
        self._tell("rtl_land_at_destination")

    def landing(self, now_s: float) -> Steering:
        """The steering of a landing: down to the ground."""
        sink_m_s = landing_sink_m_s(self._body.altitude_m)
        return replace(self._holding_at(-math.inf, now_s), sink_m_s=sink_m_s, turns_to_deg=None)


def within_limits(speed_m_s: float, parameters: ParameterTable) -> float:
    """The speed over the ground, no higher than the vehicle flies at all."""
    return min(max(speed_m_s, _SLOWEST_M_S), max(parameters["MPC_XY_VEL_MAX"], _SLOWEST_M_S), _FASTEST_M_S)
