"""The vehicle's fence: two heights, a circle around home, and areas to keep to or to keep out of.

As ArduPilot's AC_Fence has it: which kinds are switched on changes with FENCE_ENABLE, and with arming and the end
of a take-off where FENCE_AUTOENABLE says that. Home is at the origin.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from enum import IntEnum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position, ground_distance_m
from upwash.vehicle.ardupilot.boot import NOTICE, WARNING, Text
from upwash.vehicle.body.copter import HOME
from upwash.vehicle.body.fence import FenceItem, UploadedFence
from upwash.vehicle.body.parameters import ParameterTable

_CEILING, _CIRCLE, _AREAS, _FLOOR = 1, 2, 4, 8  # FENCE_TYPE's bits
_ALL = _CEILING | _CIRCLE | _AREAS | _FLOOR
_NAMES = {_CEILING: "Max Alt", _CIRCLE: "Circle", _AREAS: "Polygon", _FLOOR: "Min Alt"}
_AFTER_TAKEOFF, _WHEN_ARMED = (1, 2), 3  # FENCE_AUTOENABLE
_LOCKS_MODE, _JOINS = 1, 2  # FENCE_OPTIONS' bits


class Breach(IntEnum):
    """FENCE_BREACH."""

    NONE = 0
    FLOOR = 1
    HEIGHT = 2
    BOUNDARY = 3


class FenceWatch(UploadedFence):
    """The fence that it has, which kinds of it are switched on, and whether they are kept to."""

    def __init__(self, parameters: ParameterTable, now_s: float, say: Callable[[Text], None]) -> None:
        super().__init__()
        self._say = say
        self.breaches = 0  # so far
        self.breached_s = now_s  # the last time
        self._parameters = parameters
        self._on = 0  # the kinds that are switched on
        self._switches = (0.0, 0.0)  # FENCE_ENABLE and FENCE_AUTOENABLE, read last
        self._broken = 0  # the kinds that are not kept to

    @property
    def breach(self) -> Breach:
        """The kind of limit that is broken now, as FENCE_STATUS reports it."""
        if self._broken & (_CIRCLE | _AREAS):
            return Breach.BOUNDARY
        if self._broken & _CEILING:
            return Breach.HEIGHT
        return Breach.FLOOR if self._broken else Breach.NONE

    @property
    def ceiling_m(self) -> float | None:
        """The highest altitude of a return in m: the ceiling less its margin; None if no ceiling is on."""
        if not self._enabled() & _CEILING:
            return None
        return self._parameters["FENCE_ALT_MAX"] - self._parameters["FENCE_MARGIN"]

    @property
    def locks_mode(self) -> bool:
        """Whether a breach keeps its mode from being changed."""
        return bool(self._broken) and bool(int(self._parameters["FENCE_OPTIONS"]) & _LOCKS_MODE)

    def set(self, items: tuple[FenceItem, ...]) -> None:
        """Takes the areas of a new fence; ValueError where the items describe none."""
        super().set(items)
        self._parameters.change("FENCE_TOTAL", len(items))

    def allows(self, target: Position) -> bool:
        """Whether the fence lets it fly there: up to its borders."""
        return not self._beyond(target, self._enabled(), past=operator.gt)

    def objections(self, place: Position | None) -> list[str]:
        """The fence's reasons against arming at the place; `place` is None if the vehicle does not know it."""
        told = self._parameters
        configured = int(told["FENCE_TYPE"])
        counts = bool(told["FENCE_ENABLE"] or told["FENCE_AUTOENABLE"])
        objections = []
        if told["FENCE_ENABLE"] and not self._present():
            objections.append("Fences enabled, but none selected")
        if place is None:
            placeless = configured & (_CIRCLE | _AREAS) and counts and self._present()
            return [*objections, "Fence requires position"] if placeless else objections
        armed_only = self._present() & _AREAS if told["FENCE_AUTOENABLE"] == _WHEN_ARMED else 0
        if broken := self._breached(place, (self._enabled() | armed_only) & (_CIRCLE | _AREAS)):
            objections.append(f"Vehicle breaching {_named(broken)}")
        return objections

    def refuse(self, why: str) -> int:
        """Drops its areas for an upload that makes no sense; returns the MAV_MISSION_RESULT of that."""
        self.set(())
        self._say(Text(why, WARNING))
        self._say(Text("Fence validation failed", WARNING))
        return int(mavlink.MAV_MISSION_ERROR)

    def arm(self) -> None:
        """Switches on what arming switches on."""
        if self._parameters["FENCE_AUTOENABLE"] == _WHEN_ARMED:
            self._switch_on(_ALL & ~_FLOOR)

    def disarm(self) -> None:
        """Switches off what disarming switches off, and forgets breaches."""
        self._broken = 0
        if self._parameters["FENCE_AUTOENABLE"] == _WHEN_ARMED:
            self._switch_off(_ALL)

    def end_takeoff(self) -> None:
        """Switches on what the end of a take-off switches on."""
        if self._parameters["FENCE_AUTOENABLE"] in _AFTER_TAKEOFF:
            self._switch_on(_ALL)

    def begin_landing(self) -> None:
        """Switches the floor off for a landing, or with FENCE_AUTOENABLE 1 all of the fence."""
        self._switch_off(_ALL if self._parameters["FENCE_AUTOENABLE"] == 1 else _FLOOR)

    def watch(self, position: Position | None, now_s: float) -> bool:
        """Checks the place, None unless the vehicle flies; returns whether a limit is newly broken."""
        if position is not None and self._reaches_floor(position):
            self._on |= _FLOOR
            self._say(Text("Min Alt fence enabled (auto enable)", NOTICE))
        broken = 0 if position is None else self._breached(position, self._enabled())
        new, before, self._broken = broken & ~self._broken, self._broken, broken
        if new:
            self.breaches += 1
            self.breached_s = now_s
            self._say(Text(f"{_named(new)} breached", NOTICE))
        elif before and not broken:
            self._say(Text("Fence breach cleared", NOTICE))
        return bool(new)

    def _enabled(self) -> int:
        """The kinds that are switched on and present; a changed parameter resets them."""
        switches = self._parameters["FENCE_ENABLE"], self._parameters["FENCE_AUTOENABLE"]
        if switches != self._switches:
            self._switches = switches
            self._on = _ALL & ~_FLOOR if switches[0] else 0
        return self._on & self._present()

    def _present(self) -> int:
        """The kinds that FENCE_TYPE selects, areas only where there are any."""
        return int(self._parameters["FENCE_TYPE"]) & (_ALL if self.areas else _ALL & ~_AREAS)

    def _switch_on(self, kinds: int) -> None:
        if new := kinds & self._present() & ~self._enabled():
            self._say(Text(f"{_named(new)} auto-enabled", NOTICE))
        self._on |= kinds

    def _switch_off(self, kinds: int) -> None:
        if gone := kinds & self._enabled():
            self._say(Text(f"{_named(gone)} auto-disabled", NOTICE))
        self._on &= ~kinds

    def _reaches_floor(self, position: Position) -> bool:
        """Whether it rises above its floor, which is switched on at that moment."""
        told = self._parameters
        may = bool(told["FENCE_ENABLE"]) or told["FENCE_AUTOENABLE"] in (2, _WHEN_ARMED)
        off = bool(self._present() & _FLOOR & ~self._enabled())
        return may and off and position.altitude_m >= told["FENCE_ALT_MIN"] + told["FENCE_MARGIN"]

    def _breached(self, place: Position, kinds: int) -> int:
        """Those of the kinds that the place breaks; a place on a border breaks them."""
        return self._beyond(place, kinds, past=operator.ge)

    def _beyond(self, place: Position, kinds: int, *, past: Callable[[float, float], bool]) -> int:
        told = self._parameters
        beyond = {
            _CEILING: past(place.altitude_m, told["FENCE_ALT_MAX"]),
            _FLOOR: past(told["FENCE_ALT_MIN"], place.altitude_m),
            _CIRCLE: past(ground_distance_m(place, HOME), told["FENCE_RADIUS"]),
            _AREAS: not self._in_areas(place),
        }
        return sum(kind for kind, is_beyond in beyond.items() if kinds & kind and is_beyond)

    def _in_areas(self, position: Position) -> bool:
        """Whether the place is allowed by the areas; FENCE_OPTIONS may join the areas to stay in."""
        inclusions = [area.allows(position) for area in self.areas if area.inclusion]
        enough = any if int(self._parameters["FENCE_OPTIONS"]) & _JOINS else all
        outside = all(area.allows(position) for area in self.areas if not area.inclusion)
        return outside and (not inclusions or enough(inclusions))


def _named(kinds: int) -> str:
    names = [name for kind, name in _NAMES.items() if kinds & kind]
    if len(names) == 1:
        return f"{names[0]} fence"
    return f"{', '.join(names[:-1])} and {names[-1]} fences"
