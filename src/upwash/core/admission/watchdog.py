"""Whether an instance still serves, and for how long a service whose instances fail is not started again.

Laws:
- an instance is of no use in three cases: a call keeps it busy for the limit of a call; it shows no sign of life for
  as long, 20 s at least; it raises in three calls in a row that drones deny, as their own services did not raise;
- the limit of a call is five times the longest answered call, between 20 s and what the operator allows; before any
  call is answered, and after a replacement, it is what the operator allows;
- denials of one drone alone stop no instance while another drone has a slot;
- the first failure of an instance that had started costs no pause; then, and after each start that failed, the
  service is left alone for 10 s, 20 s and so on, 300 s at most; 300 s after the last pause failures are forgotten;
- while one drone was at each of these failures, the pause is that drone's alone.
"""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import dataclass, field

from msgspec import Struct

CALL_LIMIT_S = 60.0  # unless the operator allows more or less
LEAST_LIMIT_S = 20.0
FIRST_PAUSE_S, LONGEST_PAUSE_S = 10.0, 300.0
FORGOTTEN_S = 300.0  # after the last pause
DENIALS = 3  # in a row
_LIMIT_FACTOR = 5.0
_DOUBLINGS = 10  # which lead beyond the longest pause


class Useless(Struct, frozen=True):
    """Why an instance is of no use, and the `Client.key` of each drone whose call showed it."""

    why: str
    drones: frozenset[str]


@dataclass(slots=True)
class Limit:
    """The time that a call of one service may keep its instance busy."""

    longest_s: float = math.inf  # of its answered calls; infinite while that is not known

    def answered(self, took_s: float) -> None:
        """Add a call that was answered `took_s` after it began."""
        self.longest_s = took_s if math.isinf(self.longest_s) else max(self.longest_s, took_s)

    def cut(self, at_most_s: float) -> None:
        """Allow calls the operator's `at_most_s` again, as the instance was replaced."""
        self.longest_s = at_most_s

    def seconds(self, at_most_s: float) -> float:
        """The limit in seconds: five times the longest answered call, from 20 s to the operator's `at_most_s`."""
        return min(at_most_s, max(LEAST_LIMIT_S, _LIMIT_FACTOR * self.longest_s))


class Watch:
    """Follows one instance since it was ready; the instance computes `lanes` calls at a time."""

    def __init__(self, *, lanes: int = 1, now_s: float = 0.0) -> None:
        self.is_condemned = False
        self._lanes = lanes
        self._heard_s = now_s
        self._begun: list[tuple[float, str]] = []  # when each call that is computed began, and whose it is
        self._raised: set[str] = set()  # drones; it raised in their calls since it last returned a value
        self._denied: list[str] = []  # by these drones, since then

    @property
    def callers(self) -> frozenset[str]:
        """The drones whose calls the instance computes now."""
        return frozenset(drone for _, drone in self._begun)

    def heard(self, now_s: float) -> None:
        """Note a sign of life of the instance."""
        self._heard_s = now_s

    def began(self, drone: str, now_s: float) -> None:
        """Note that the instance began to compute a call of the drone."""
        self._begun = [*self._begun, (now_s, drone)][-self._lanes :]

    def ended(self, drone: str, *, took_s: float, outcome: str, now_s: float) -> None:
        """Note the `outcome` of the drone's call that began `took_s` ago, one of `ports.Outcome`."""
        own = [call for call in self._begun if call[1] == drone]
        if own:
            self._begun.remove(min(own, key=lambda call: abs(now_s - took_s - call[0])))
        if outcome == "raised":
            self._raised.add(drone)
        elif outcome == "value":
            self._raised.clear()
            self._denied.clear()

    def denied(self, drone: str) -> None:
        """Note that the instance raised in a call, and the drone's own service did not raise in the same call."""
        if drone in self._raised:
            self._denied = [*self._denied, drone][-DENIALS:]

    def verdict(self, limit_s: float, *, served: Set[str], now_s: float) -> Useless | None:
        """Why the instance is of no use, or None; `served` are the drones that have a slot."""
        overdue = frozenset(drone for began_s, drone in self._begun if now_s - began_s >= limit_s)
        if overdue:
            return Useless(f"a call has kept it busy for {limit_s:.0f} s", overdue)
        silent_s = max(limit_s, LEAST_LIMIT_S)
        if now_s - self._heard_s >= silent_s:
            return Useless(f"it has given no sign of life for {silent_s:.0f} s", self.callers)
        deniers = frozenset(self._denied)
        if len(self._denied) >= DENIALS and (len(deniers) > 1 or served <= deniers):
            return Useless(f"it raised in {DENIALS} calls in a row, which did not raise on drones", deniers)
        return None


@dataclass(slots=True)
class InstanceFailures:
    """The failures in a row of one service's instances, and the pause that follows."""

    count: int = 0
    why: str = ""  # of the last failure
    _until_s: float = -math.inf
    _drones: frozenset[str] = field(default_factory=frozenset)  # that were at each of them

    def add(self, why: str, drones: frozenset[str], *, had_started: bool, now_s: float) -> None:
        """Add the failure of an instance that was computing calls of these drones."""
        forgotten = now_s - self._until_s > FORGOTTEN_S
        of_others = bool(self._drones) and not self._drones & drones
        self.count = 1 if forgotten or of_others else self.count + 1
        self._drones = drones if forgotten else self._drones & drones
        self.why = why
        paused = self.count - had_started
        pause_s = min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** min(paused - 1, _DOUBLINGS)) if paused else 0.0
        self._until_s = now_s + pause_s

    def pause_s(self, drone: str, *, now_s: float) -> float:
        """For how many seconds more the service is not started for the drone; 0 if it may be started."""
        return self.left_s(now_s=now_s) if not self._drones or drone in self._drones else 0.0

    def left_s(self, *, now_s: float) -> float:
        """How many seconds of the pause are left, for all drones or for some."""
        return max(0.0, self._until_s - now_s)
