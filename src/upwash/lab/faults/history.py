"""What is known of a flight after its end, for the checks of all promises."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from upwash.config.checks import only_on_servers
from upwash.config.drone import DroneConfig
from upwash.config.world import FaultConfig
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.observer import Observation
from upwash.lab.run import Run

Fact = Event | Observation
Breach = tuple[Fact | None, str]  # the bad event or None, and what is bad about it
Logged = TypeVar("Logged", bound=Event)
SLACK_S = 0.1
ROUNDING_S = 2e-6  # of the times in a log
_SOON_BACK_S = 40.0  # a vehicle whose position jumped, and well within the patience with a leg
ANSWER_S = 5.0  # the timeout of a request to a daemon
_MOST_CRASHES = 12  # that a flight is tested with


@dataclass(frozen=True)
class History:
    """What is known of one flight after its end.

    `seen` are the events of an observer, also those of other drones in the same world; `alone` is the same mission
    with the same seed and no server, None if the two cannot be compared.
    """

    config: DroneConfig
    run: Run
    seen: Sequence[Observation] = ()
    alone: Run | None = None

    def own(self, *names: str) -> Iterator[Observation]:
        """What the observer saw of this drone, of those names."""
        return (fact for fact in self.seen if fact.event in names and fact.drone == self.config.name)

    def logged(self, *kinds: type[Logged]) -> Iterator[Logged]:
        """The events of those kinds in the drone's log."""
        return (event for event in self.run.events if isinstance(event, kinds))

    @functools.cached_property
    def calls(self) -> list[FlownCall]:
        """The calls in the drone's log, in order."""
        return list(calls_of(self.run.events, within_s=self.within_s))

    def crashes(self, *kinds: type[Event]) -> Iterator[tuple[Event, list[Event]]]:
        """Some events of those kinds, each with the events before it: the log of a drone that is killed then."""
        events = [event for event in self.run.events if not isinstance(event, schema.MissionCompleted)]
        moments = [number for number, event in enumerate(events) if isinstance(event, kinds)]
        for number in moments[:: max(1, len(moments) // _MOST_CRASHES)]:
            yield events[number], events[:number]

    @property
    def flies_rows(self) -> bool:
        """Whether the drone flies rows without stopping, with several answers open."""
        return self.config.mission.photos is not None

    @property
    def within_s(self) -> float:
        """How long after its call a better answer counts; 0 where calls have one answer."""
        twice = (service.two_answers for service in self.config.services)
        return max((answers.within_s for answers in twice if answers), default=0.0)

    @property
    def asks_servers(self) -> bool:
        """Whether only servers run the mission's service."""
        return any(map(only_on_servers, self.config.services))

    @property
    def draws_objects(self) -> bool:
        """Whether the mission acts on objects, and leaves its way for them."""
        return self.config.event is not None and bool(self.config.event.objects)

    @property
    def position_jumps(self) -> bool:
        """Whether a log of this world may not say where the drone truly is."""
        return any(fault.kind == "jump" for fault in self.config.faults)

    @property
    def may_be_cut_short(self) -> bool:
        """Whether the autopilot fails or the battery may end in this world, so that the mission may end early."""
        if self.config.mission.reserve_s is not None:
            return True
        faults = (fault for fault in self.config.faults if fault.target == "autopilot")
        return any(not self._is_overcome(fault) for fault in faults)

    def _is_overcome(self, fault: FaultConfig) -> bool:
        """Whether the mission continues after the fault: no leg may exceed its patience."""
        match fault.kind:
            case "slow" | "home" | "impostor" | "hovers" | "rally":
                return True
            case "diverted" | "restart":  # of a vehicle that stands
                return not any(self.own("taken"))
            case "jump":
                east_m, north_m, _ = fault.moved_m
                to_and_fro_s = 2 * math.hypot(east_m, north_m) / self.config.mission.ground_speed_m_s
                return fault.to_s - fault.from_s + to_and_fro_s < _SOON_BACK_S
        return False


@dataclass(frozen=True, slots=True)
class FlownCall:
    """One call of the mission, its decisions, and its hedge, second server and wait in vain in a queue, or None.

    A better answer counts `within_s`.
    """

    decisions: tuple[schema.Decided, ...]
    ended: schema.Call
    hedged: schema.Hedged | None = None
    seconded: schema.Seconded | None = None
    queued: schema.RemoteQueued | None = None
    within_s: float = 0.0

    @property
    def allowed_s(self) -> float:
        """The time that the rules allowed it for waits and tries, 0 for those that they did not allow.

        A hedged call counts until the drone's own service started; from then on that service's time counts, as in a
        call that is raced.
        """
        waits_s = sum((decision.at_most_s or 0.0 for decision in self.decisions), self.queued_s)
        if self.hedged is not None:
            return waits_s + self.hedged.after_s
        return waits_s + (deadline_of(self.sent) if self.sent is not None else 0.0)

    @property
    def tried(self) -> list[schema.Decided]:
        """The decisions for servers."""
        return [decision for decision in self.decisions if decision.decision == "remote"]

    @property
    def sent(self) -> schema.Decided | None:
        """The decision for a server without the drone's own service beside it, or None."""
        return next((decision for decision in self.tried if not decision.raced), None)

    @property
    def queued_s(self) -> float:
        """How long the drone's own service was busy with an earlier call that was hedged."""
        return self.ended.queued_s or 0.0

    @property
    def computed(self) -> bool:
        """Whether the drone's own service was at it."""
        return self.hedged is not None or self.ended.server is None or self.ended.onboard_s > 0

    @property
    def bound_s(self) -> float:
        """The longest that it may have taken."""
        return max(self.allowed_s + self.ended.onboard_s, self.within_s) + SLACK_S


def deadline_of(decided: schema.Decided) -> float:
    """The deadline (s) of a decision for a server."""
    assert decided.deadline_s is not None  # noqa: S101 - such a decision has one
    return decided.deadline_s


def calls_of(events: Iterable[Event], *, within_s: float = 0.0) -> Iterator[FlownCall]:
    """The calls of an event log, in order; their better answers count `within_s`."""
    decisions: dict[int | None, list[schema.Decided]] = {}  # by waypoint, of several open calls
    hedged: dict[int | None, schema.Hedged] = {}
    seconded: dict[int | None, schema.Seconded] = {}
    queued: dict[int | None, schema.RemoteQueued] = {}
    for event in events:
        match event:
            case schema.Decided():
                decisions.setdefault(event.waypoint, []).append(event)
            case schema.Hedged():
                hedged[event.waypoint] = event
            case schema.Seconded():
                seconded[event.waypoint] = event
            case schema.RemoteQueued():
                queued.setdefault(event.waypoint, event)  # a later one is of a server beside the drone
            case schema.Call(waypoint=call):
                found = hedged.pop(call, None), seconded.pop(call, None), queued.pop(call, None)
                yield FlownCall(tuple(decisions.pop(call, ())), event, *found, within_s)


def service_of(
    fact: schema.Call | schema.Decided | schema.Dropped | schema.Seconded | schema.SentWhole | Observation,
) -> str:
    """The service that the event's call is of."""
    return fact.operation.partition(".")[0]
