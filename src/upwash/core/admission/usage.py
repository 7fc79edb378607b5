"""What each drone, and each team of drones, has used of one server: slot time, calls and seconds of computing.

Laws:
- a team is the part of a drone's name before its first "-"; a drone without one is a team of its own;
- slot time is measured here; instances report calls and seconds of computing;
- a call counts when it has ended, whether or not the drone still has a slot, and a dropped call has no answer;
- a drone with a slot is never forgotten; the longest unseen of the other drones and of the teams are forgotten.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

from msgspec import Struct

from upwash.core.admission.clients import Client, DroneUsage, TeamUsage

_MOST_DRONES = 200
_MOST_TEAMS = 100


def team_of(drone: str) -> str:
    """The team of a drone: "north" for "north-1", the whole name without a "-"."""
    return drone.partition("-")[0] or drone


class LeaseEnded(Struct, frozen=True):
    """A drone's slot ended: how long the drone had it, and what it used meanwhile.

    A peer had the slot held, and the drone did not come, if `held_by` names that peer.
    """

    server: str
    drone: str
    slot_s: float
    calls: int
    computed_s: float
    held_by: str = ""


@dataclass(slots=True)
class _Use:
    slot_s: float = 0.0  # of slots that were given back
    calls: int = 0
    computed_s: float = 0.0
    called_s: float | None = None  # when its last call ended

    def counts(self, now_s: float) -> tuple[int, float, float | None]:
        """The calls, their seconds of computing, and how long ago the last one ended."""
        return self.calls, self.computed_s, None if self.called_s is None else now_s - self.called_s


@dataclass(slots=True)
class _Slot:
    since_s: float
    calls: int  # before it had the slot
    computed_s: float


def _taken_up(used: DroneUsage | TeamUsage, held_s: float, now_s: float) -> _Use:
    """The usage without the slots held now, which go on being counted here."""
    called_s = None if used.called_ago_s is None else now_s - used.called_ago_s
    return _Use(used.slot_s - held_s, used.calls, used.computed_s, called_s)


class Usage:
    """What drones and teams have used of one server."""

    def __init__(self, server: str) -> None:
        self._server = server
        self._drones: OrderedDict[str, _Use] = OrderedDict()  # by name, the latest seen last
        self._teams: OrderedDict[str, _Use] = OrderedDict()
        self._slots: dict[str, _Slot] = {}  # by drone
        self._names: dict[str, str] = {}  # of the drones, by `Client.key`

    def took(self, drone: Client, *, now_s: float) -> None:
        """Note that the drone has a slot, a new or an extended one."""
        use, _ = self._seen(drone.name)
        self._names[drone.key] = drone.name
        self._slots.setdefault(drone.name, _Slot(now_s, use.calls, use.computed_s))
        self._forget()

    def gave_back(self, drone: str, *, held_by: str, now_s: float) -> LeaseEnded:
        """Note that the drone's slot ended; return what was used of it."""
        use, team = self._seen(drone)
        slot = self._slots.pop(drone)
        slot_s = now_s - slot.since_s
        use.slot_s += slot_s
        team.slot_s += slot_s
        self._forget()
        calls, computed_s = use.calls - slot.calls, use.computed_s - slot.computed_s
        return LeaseEnded(self._server, drone, slot_s, calls, computed_s, held_by)

    def take_up(self, drones: Sequence[DroneUsage], teams: Sequence[TeamUsage], *, now_s: float) -> None:
        """Continue the counts of the former daemon; a slot that a drone has here began there."""
        held_s = dict.fromkeys((team_of(usage.drone) for usage in drones), 0.0)
        for drone in drones:
            holds_s = drone.holds_s or 0.0
            held_s[team_of(drone.drone)] += holds_s
            self._drones[drone.drone] = _taken_up(drone, holds_s, now_s)
            if drone.drone in self._slots:
                self._slots[drone.drone] = _Slot(now_s - holds_s, drone.calls, drone.computed_s)
        for team in teams:
            self._teams[team.team] = _taken_up(team, held_s.get(team.team, 0.0), now_s)
        self._forget()

    def called(self, drone: str, *, took_s: float, is_answered: bool, now_s: float) -> None:
        """Add a call of the drone with that `Client.key` that was computed for `took_s`."""
        name = self._names.get(drone)
        if name is not None:
            for use in self._seen(name):
                use.calls += is_answered
                use.computed_s += took_s
                use.called_s = now_s

    def drones(self, *, now_s: float) -> list[DroneUsage]:
        """The usage of each drone by name."""
        told = []
        for name, use in sorted(self._drones.items()):
            slot = self._slots.get(name)
            holds_s = None if slot is None else now_s - slot.since_s
            slot_s = use.slot_s + (holds_s or 0.0)
            told.append(DroneUsage(name, team_of(name), holds_s, slot_s, *use.counts(now_s)))
        return told

    def teams(self, *, now_s: float) -> list[TeamUsage]:
        """The usage of each team by name; forgotten drones count."""
        told = []
        for team, use in sorted(self._teams.items()):
            slots_s = [now_s - slot.since_s for name, slot in self._slots.items() if team_of(name) == team]
            told.append(TeamUsage(team, len(slots_s), use.slot_s + sum(slots_s), *use.counts(now_s)))
        return told

    def _seen(self, drone: str) -> tuple[_Use, _Use]:
        team = team_of(drone)
        use, of_team = self._drones.setdefault(drone, _Use()), self._teams.setdefault(team, _Use())
        self._drones.move_to_end(drone)
        self._teams.move_to_end(team)
        return use, of_team

    def _forget(self) -> None:
        kept = set(self._slots)
        for known, most, in_use in (
            (self._drones, _MOST_DRONES, kept),
            (self._teams, _MOST_TEAMS, {team_of(name) for name in kept}),
        ):
            unseen = [name for name in known if name not in in_use]
            for name in unseen[: max(0, len(known) - most)]:
                del known[name]
        self._names = {key: name for key, name in self._names.items() if name in self._drones}
