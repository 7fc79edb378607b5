"""What PX4's fail-safes do, and when: each has a cause and an action, and the most severe one acts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum, auto

from upwash.mavlink.px4 import Mode


class Cause(Enum):
    """Why a fail-safe acts."""

    LOW_BATTERY = auto()
    CRITICAL_BATTERY = auto()
    EMERGENCY_BATTERY = auto()
    MANUAL_CONTROL = auto()
    GROUND_STATION = auto()
    OFFBOARD = auto()
    GEOFENCE = auto()
    POSITION = auto()


class Action(IntEnum):
    """What a fail-safe does, from the mildest on; the numbers are those of PX4's events."""

    WARN = 1
    POSCTL = 2
    ALTCTL = 3
    STABILIZED = 4
    HOLD = 5
    RTL = 6
    LAND = 7
    DESCEND = 8
    DISARM = 9
    TERMINATE = 10


MODES_OF_ACTIONS = {
    Action.POSCTL: Mode.POSCTL,
    Action.ALTCTL: Mode.ALTCTL,
    Action.STABILIZED: Mode.STABILIZED,
    Action.HOLD: Mode.LOITER,
    Action.RTL: Mode.RTL,
    Action.LAND: Mode.LAND,
    Action.DESCEND: Mode.LAND,
}
"""The mode that each is flown in."""


FENCE_ACTIONS = {1: Action.WARN, 2: Action.HOLD, 3: Action.RTL, 4: Action.TERMINATE, 5: Action.LAND}
OFFBOARD_ACTIONS = {
    0: Action.POSCTL,
    1: Action.ALTCTL,
    2: Action.STABILIZED,
    3: Action.RTL,
    4: Action.LAND,
    5: Action.HOLD,
    6: Action.TERMINATE,
    7: Action.DISARM,
}
LINK_ACTIONS = {1: Action.HOLD, 2: Action.RTL, 3: Action.LAND, 5: Action.TERMINATE, 6: Action.DISARM}
"""The actions by the numbers in GF_ACTION, in COM_OBL_RC_ACT, and in NAV_DLL_ACT and NAV_RCL_ACT."""

_NAMED_CAUSES = {
    Cause.MANUAL_CONTROL: 1,
    Cause.GROUND_STATION: 2,
    Cause.CRITICAL_BATTERY: 4,
    Cause.EMERGENCY_BATTERY: 5,
}


@dataclass(frozen=True, slots=True)
class Danger:
    """The action that a cause demands, at once or after a time in Hold. A danger that sticks outlives its cause."""

    action: Action
    at_once: bool = False
    sticks: bool = False


@dataclass(frozen=True, slots=True)
class FailsafeChange:
    """A fail-safe that begins: its action, or with `waits` the time in Hold before it."""

    cause: Cause
    action: Action
    waits: bool = False


class Failsafe:
    """The present dangers, and the action against the most severe one."""

    def __init__(self) -> None:
        self._known: dict[Cause, Danger] = {}
        self._overruled: set[Cause] = set()
        self._acts_s = 0.0
        self._announced: FailsafeChange | None = None
        self.action: Action | None = None

    @property
    def waits(self) -> bool:
        """Whether it holds before it acts; sticks do not take over then."""
        return self._announced is not None and self._announced.waits

    def because_of(self, cause: Cause) -> bool:
        """Whether the present action is because of the cause."""
        return self.action is not None and self._announced is not None and self._announced.cause is cause

    def watch(
        self, dangers: Mapping[Cause, Danger], now_s: float, *, delay_s: float
    ) -> Iterator[FailsafeChange]:
        """Takes note of what is dangerous now; yields what is begun because of it."""
        for cause in self._known.keys() - dangers.keys():
            if not self._known[cause].sticks or cause in self._overruled:
                del self._known[cause]
                self._overruled.discard(cause)
        for cause, danger in dangers.items():
            if cause not in self._known and danger.action is Action.WARN:
                yield FailsafeChange(cause, danger.action)
            self._known[cause] = danger
        yield from self._choose(now_s, delay_s)

    def _choose(self, now_s: float, delay_s: float) -> Iterator[FailsafeChange]:
        acting = {
            cause: danger
            for cause, danger in self._known.items()
            if danger.action > Action.WARN and cause not in self._overruled
        }
        if not acting:
            self.action, self._announced = None, None
            return
        cause = max(acting, key=lambda cause: acting[cause].action)
        danger = acting[cause]
        if self.action is None:
            waits = Action.HOLD < danger.action < Action.DISARM and not danger.at_once
            self._acts_s = now_s + delay_s if waits else now_s
        elif danger.at_once or danger.action >= Action.DISARM:
            self._acts_s = min(self._acts_s, now_s)
        change = FailsafeChange(cause, danger.action, waits=now_s < self._acts_s)
        if change != self._announced and not (change.waits and self.waits):
            yield change
        self._announced = change
        self.action = Action.HOLD if change.waits else danger.action

    def overrule(self) -> bool:
        """Ends the action for a person's command; returns whether there was one."""
        acted = self.action is not None
        self._overruled = set(self._known)
        self.action, self._announced = None, None
        return acted

    def clear(self) -> None:
        """Forgets everything, as at disarming."""
        self._known.clear()
        self._overruled.clear()
        self.action, self._announced = None, None


def announce(
    change: FailsafeChange, intended: Mode, breaches: list[str], *, delay_s: float, tell: Callable[..., None]
) -> None:
    """Tells what a fail-safe begins, after a delay in Hold where it waits."""
    if change.action is Action.WARN:
        if change.cause is Cause.LOW_BATTERY:
            tell("commander_failsafe_enter_low_bat")
        return
    if change.cause is Cause.GEOFENCE:
        for name in breaches:
            tell(name, 2**32 - 1, 20)
    named = _NAMED_CAUSES.get(change.cause)
    cause = (named,) if named else ()
    if change.waits:
        event = "commander_failsafe_enter_hold" if named else "commander_failsafe_enter_generic_hold"
        tell(event, intended, change.action, round(delay_s), *cause)
    elif change.action is Action.DESCEND:
        tell("commander_failsafe_enter_autopilot_disengaged", intended, change.action)
    else:
        event = "commander_failsafe_enter" if named else "commander_failsafe_enter_generic"
        tell(event, intended, change.action, *cause)
