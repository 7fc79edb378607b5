"""What a log knows of a flight and of its world, and the mission that flies it again."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from statistics import fmean, median

import msgspec

from upwash.core.geo import Circle, Position, ground_distance_m
from upwash.core.knowledge.servers import SELECTED, State
from upwash.drone.api import Drone
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.results import RunResult, read_result
from upwash.eventlog.schema import Event
from upwash.rpc.service import service

LEAST_S = 1e-3
UNUSED = "unused"  # an operation that the mission could have called, and did not
_MOST_CALLS, _LONGEST_S = 5_000, 48 * 3600.0
_BY_CALLS = (schema.CallFailedInRange, schema.CallFailedOutOfRange)
_OTHER_CALLS = (schema.FirstAnswer, schema.Unanswered, schema.SoughtAnswers)
_FAILURES = (schema.CheckFailed, schema.NetworkLost, *_BY_CALLS)


@service(profile_by="key")
class Flown:
    """Stands for the services of a log: a call has the delay of its operation, the `key`."""

    def call(self, photo: bytes, key: str) -> list[str]:
        """Nothing: modelled services answer by themselves."""
        return []


def fly_again(drone: Drone, mode: str) -> None:
    """Visits the plan's waypoints, and calls at each what the log's mission called there.

    `mode` is the operation of one call at each waypoint, or JSON: for each waypoint the operations of its calls.
    """
    flown = drone.service(Flown)
    stops = msgspec.json.decode(mode, type=list[list[str]]) if mode.startswith("[") else None
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for number, waypoint in enumerate(drone.plan):
        drone.autopilot.goto(waypoint)
        photo = drone.camera.take_photo()
        *before, last = (stops[number] if stops else [mode]) or [""]
        for key in before:
            flown.call(photo, key)
        if last:
            pending = drone.start(flown.call, photo, last)
            drone.stay_or_go(pending, lambda _: drone.autopilot.hover(drone.action_s))
    drone.end_flight()
    drone.autopilot.disarm()


@dataclass(frozen=True, slots=True)
class Contact:
    """A sign of a server's life or of its failure at that second, at that distance; perhaps by a call."""

    t: float
    distance_m: float
    good: bool
    by_call: bool


@dataclass(slots=True)
class FlownServer:
    """What a log knows of a server: its believed range, what was believed, and what was measured; in seconds.

    `share` is the believed delay there, as a share of that on the drone.
    """

    circle: Circle
    call_s: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))  # by operation
    believed_s: dict[str, float] = field(default_factory=dict)
    share: float | None = None
    join_s: list[float] = field(default_factory=list)
    start_s: list[float] = field(default_factory=list)
    check_s: dict[State, float] = field(default_factory=dict)  # as it was believed
    contacts: list[Contact] = field(default_factory=list)

    @property
    def answers(self) -> int:
        """The number of calls that it answered, some of them too late."""
        return sum(map(len, self.call_s.values()))


@dataclass(slots=True)
class FlownMission:
    """A flight, gathered event by event; times are seconds of the log, and `time_s` is of the part that is replayed.

    `notes` say what is not replayed, or not known.
    """

    policy: str = ""
    began_s: float = 0.0
    time_s: float = 0.0
    altitude_m: float = 20.0
    takeoff_s: float = 0.0
    stop_s: float = 0.0  # of the photo, and of all else at a stop but calls and actions
    action_s: float = 0.0
    landing_s: float = 0.0
    stops: dict[int, tuple[float, float]] = field(default_factory=dict)  # by waypoint, in the flight's order
    calls: dict[int, list[str]] = field(default_factory=dict)  # operations by waypoint
    remote_calls: int = 0
    demanding: set[int | None] = field(default_factory=set)
    legs: list[tuple[float, float]] = field(default_factory=list)  # length, and time
    late: bool = False  # the mission could go on before its answers
    stay_or_go: str = "stay"
    peers: bool | None = None
    radios: int | None = None
    local_s: dict[str, list[tuple[float, float]]] = field(default_factory=lambda: defaultdict(list))
    busy: list[tuple[float, float]] = field(default_factory=list)  # when the drone computed, and how long
    believed_s: dict[str, float] = field(default_factory=dict)
    servers: dict[str, FlownServer] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    ended_early: str = ""
    _now_s: float = 0.0
    _stays: list[list[float]] = field(default_factory=list)  # arrival, seconds spent on answers, departure
    _actions_s: list[float] = field(default_factory=list)
    _started: int = 0  # calls that the mission did not wait for yet
    _taken_s: float = 0.0  # when the last answer was taken
    _here: tuple[float, float] | None = None
    _set_off: tuple[int | None, float] | None = None
    _checks: dict[int, float] = field(default_factory=dict)  # when a check last got on
    _decided: dict[tuple[str, str | None], schema.Decided] = field(default_factory=dict)
    _states: dict[str, State] = field(default_factory=dict)
    _means_s: list[float] = field(default_factory=list)  # of operations on the drone, by belief
    _alone: bool = True

    @property
    def operations(self) -> list[str]:
        """All operations of the calls."""
        return sorted({operation for calls in self.calls.values() for operation in calls})

    @property
    def answers(self) -> int:
        """The number of calls that servers answered."""
        return sum(server.answers for server in self.servers.values())

    def estimates(self) -> Iterator[str]:
        """What was measured of each server, as the keys of its table."""
        for name, server in self.servers.items():
            times: dict[str, list[str]] = defaultdict(list)
            for operation, calls in server.call_s.items():
                service_name, _, method = operation.removesuffix("]").partition(".")
                method, _, key = method.partition("[")
                times[service_name].append(f'"{key or method}" = {fmean(calls):.3g}')
            said = [f"remote_call_s.{called} = {{ {', '.join(keys)} }}" for called, keys in times.items()]
            if said and server.join_s:
                said.append(f"check_running_s = {fmean(server.join_s):.3g}")
                if server.start_s:
                    said.append(f"check_s = {fmean(server.join_s) + fmean(server.start_s):.3g}")
                yield f"{name}: {', '.join(said)}"

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        if not self.ended_early:
            self._now_s = max(self._now_s, event.t)
        for take in (self._take_flight, self._take_answers, self._take_servers):
            take(event, event.t)

    def _take_flight(self, event: Event, t: float) -> None:
        match event:
            case schema.Planned():
                self.servers = {name: FlownServer(circle) for name, circle in event.ranges.items()}
            case schema.MissionStarted():
                self.policy, self.began_s = event.policy, t
            case schema.Armed() if not self.stops:
                self.began_s = t
            case schema.TookOff() if not self.stops:
                self.altitude_m, self.takeoff_s = event.altitude_m, t - self.began_s
            case schema.MissionEnded() | schema.Stopping() | schema.SafeEnd():
                self.ended_early = self.ended_early or event.why
            case schema.ControlChanged(owner=owner) if self.stops and owner != "program":
                self.ended_early = self.ended_early or f"{owner} took the vehicle over: {event.why}"
            case schema.SetOff():
                self._leave(t)
                self._set_off = (event.waypoint, t)
            case schema.Returning() | schema.Landing():
                self._leave(t)
            case schema.TurnedBack():  # and at rest
                self._here = (event.position.east_m, event.position.north_m)
            case schema.Arrived():
                self._arrive(event)

    def _take_answers(self, event: Event, t: float) -> None:
        match event:
            case schema.CallStarted():
                self._started += 1
                self.late = True
            case schema.AnswerTaken():
                self._spend(event.waited_s)
                self._taken_s = t
                if event.demanded:
                    self.demanding.add(event.waypoint)
            case schema.Demanded(failed=""):
                self.demanding.add(event.waypoint)
            case schema.Acted() if event.waypoint in self.demanding:
                self._actions_s.append(t - self._taken_s)
                self._spend(t - self._taken_s)
            case schema.StayOrGo() if self.stay_or_go != "go":
                self.stay_or_go = "go" if event.why == "it always goes" else "learn"
            case schema.Decided():
                self._decide(event)
            case schema.Call():
                self._call(event)

    def _take_servers(self, event: Event, t: float) -> None:
        match event:
            case schema.Prepared() | schema.NotPrepared():
                self.peers = True
            case schema.NoSlot() | schema.TurnOver():
                self._alone = False
            case schema.Dropped() if event.server in self.servers:
                if (made := self._decided.pop((event.operation, event.server), None)) is not None:
                    self.servers[event.server].call_s[event.operation].append(max(LEAST_S, t - made.t))
            case schema.Joined() if event.server in self.servers and event.check in self._checks:
                self.servers[event.server].join_s.append(max(0.0, t - self._checks[event.check]))
                self._checks[event.check] = t
        if isinstance(event, schema.ServerStep):
            self._step(event)

    def _leave(self, t: float) -> None:
        if self._stays and len(self._stays[-1]) < 3:
            self._stays[-1].append(t)

    def _spend(self, seconds: float) -> None:
        if self._stays and len(self._stays[-1]) < 3:
            self._stays[-1][1] += seconds

    def _arrive(self, event: schema.Arrived) -> None:
        place = (event.east_m, event.north_m)
        if self._here is not None and self._set_off is not None and self._set_off[0] == event.waypoint:
            self.legs.append((math.dist(self._here, place), event.t - self._set_off[1]))
        self._here, self._set_off = place, None
        if event.waypoint is not None and event.waypoint not in self.stops and not self.ended_early:
            self._leave(event.t)
            self.stops[event.waypoint] = place
            self._stays.append([event.t, 0.0])

    def _decide(self, event: schema.Decided) -> None:
        if event.local_s is not None:
            self.believed_s.setdefault(event.operation, event.local_s)
        if event.decision == "remote":
            self._decided[event.operation, event.server] = event
        server = self.servers.get(event.selected or "")
        if server is not None and event.remote_s is not None:
            server.believed_s.setdefault(event.operation, event.remote_s)
        if server is not None and event.check_s is not None and event.state is not None and not server.join_s:
            server.check_s.setdefault(event.state, event.check_s)

    def _call(self, event: schema.Call) -> None:
        if self._started:
            self._started -= 1  # its answer is taken later
        else:
            self._spend(event.delay_s)
        onboard_s, began_s = event.onboard_s, event.t - event.onboard_s
        if event.server is None:
            if onboard_s > 0:
                self.local_s[event.operation].append((began_s, onboard_s))
                self.busy.append((began_s, onboard_s))
            return
        if onboard_s > 0:  # the drone ended it too, unheard
            self.busy.append((began_s, max(onboard_s, self.believed_s.get(event.operation, 0.0))))
        server = self.servers.get(event.server)
        made = self._decided.pop((event.operation, event.server), None)
        if server is not None:
            call_s = event.delay_s - event.waited_s if made is None else event.t - made.t
            server.call_s[event.operation].append(max(LEAST_S, call_s))
            self._meet(server, event.t, made.position if made else None, good=True, by_call=True)

    def _meet(
        self, server: FlownServer, t: float, place: Position | None, *, good: bool, by_call: bool = False
    ) -> None:
        distance_m = ground_distance_m(place, server.circle.centre) if place is not None else 0.0
        server.contacts.append(Contact(t - self.began_s, distance_m, good, by_call))

    def _step(self, event: schema.ServerStep) -> None:
        if event.local_mean_call_s is not None:
            self._means_s.append(event.local_mean_call_s)
        self._states[event.server] = event.after
        if sum(state in SELECTED for state in self._states.values()) > 1:
            self.radios = 2
        for name, mean_s in event.mean_call_s.items():
            if name in self.servers and mean_s and event.local_mean_call_s and not self.servers[name].answers:
                self.servers[name].share = mean_s / event.local_mean_call_s
        if (server := self.servers.get(event.server)) is None:
            return
        if isinstance(event, schema.Selected | schema.FoundStopped):
            self._checks[event.check] = event.t
        if isinstance(event, schema.FoundRunning | schema.FoundStopped | schema.Started):
            self._meet(server, event.t, event.position, good=True)
        if isinstance(event, schema.Started) and event.check in self._checks:
            server.start_s.append(max(0.0, event.t - self._checks[event.check]))
        if isinstance(event, _FAILURES):
            self._meet(server, event.t, event.position, good=False, by_call=isinstance(event, _BY_CALLS))

    def finish(self, result: RunResult) -> None:
        """Computes what needs all events; UsageError where they make no mission that can be replayed."""
        if not self.stops:
            raise UsageError("the drone reached no waypoint in this log: there is nothing to replay")
        last_s = self._now_s
        if not result.completed:
            last_s = self._stays[-1][2] if len(self._stays[-1]) == 3 else last_s
            self.notes.append(
                f"the flight ended early ({self.ended_early or 'its log ends'}): the figures are for its first "
                f"{len(self.stops)} waypoints, without the way home"
            )
        self._leave(last_s)
        self.time_s = last_s - self.began_s
        self.calls = {index: [] for index in self.stops}
        for call in result.calls:
            if call.waypoint in self.calls:
                self.calls[call.waypoint].append(call.asked or call.operation)
        self.remote_calls = result.totals.calls - result.totals.local
        longest_s = max([sum(call_s for _, call_s in self.busy), *self.believed_s.values()])
        if len(self.stops) + len(result.calls) > _MOST_CALLS:
            raise UsageError(
                f"the flight has more than {_MOST_CALLS:,} stops and calls, the most that are replayed"
            )
        if not 0 < self.time_s <= _LONGEST_S or longest_s > 2 * self.time_s + 60:
            raise UsageError("the times of this log contradict one another, or are longer than 48 h")
        if self.calls and not self.believed_s:
            self.notes.append("the decisions have no inputs: the beliefs are taken from what was measured")
        if not self._alone:
            self.notes.append("other drones used its servers, and the replay has none")
        self.stop_s = max(0.0, fmean(left_s - came_s - spent_s for came_s, spent_s, left_s in self._stays))
        self.action_s = max(0.0, median(self._actions_s)) if self._actions_s else 0.0
        self.landing_s = max(0.0, last_s - self._stays[-1][2]) if result.completed else 0.0
        self.busy = sorted((t - self.began_s, call_s) for t, call_s in self.busy)
        for operation, calls in self.local_s.items():
            self.local_s[operation] = [(t - self.began_s, call_s) for t, call_s in calls]
        self._complete_beliefs()

    def _complete_beliefs(self) -> None:
        if len(self.operations) == 1 and self._means_s:  # which are of this operation after three calls
            believed_s = self.believed_s.setdefault(self.operations[0], self._means_s[-1])
            other_s = 2 * self._means_s[0] - believed_s
            if other_s > LEAST_S and abs(other_s - believed_s) > LEAST_S:
                self.believed_s[UNUSED] = other_s
        for operation in self.operations:
            if operation not in self.believed_s and not self.local_s.get(operation):
                raise UsageError(
                    f"{operation} never ran on the drone, and the log does not say what was believed"
                )


def read_flown(log: Iterable[Event]) -> FlownMission:
    """What the events say of the flight and of its world; UsageError with the reason where it cannot be replayed."""
    events = list(log)
    started = [event for event in events if isinstance(event, schema.MissionStarted)]
    if not started:
        raise UsageError("the log has no mission to replay: it has no mission_started")
    if len(drones := sorted({event.drone for event in started})) > 1:
        raise UsageError(
            f"the log has missions of several drones ({', '.join(drones[:5])}): give a log of one"
        )
    if started[-1].done or any(isinstance(event, schema.LogResumed) for event in events):
        raise UsageError("the mission was broken off and resumed: only whole flights are replayed")
    if any(isinstance(event, schema.PhotosWait) or getattr(event, "passing", False) for event in events):
        raise UsageError(
            "the drone took photos on rows without stopping, and only missions that stop are replayed: "
            "compare policies in a scenario of them"
        )
    if any(isinstance(event, _OTHER_CALLS) for event in events):
        raise UsageError(
            "calls of this flight have two answers, or run on servers alone: these are not replayed"
        )
    flown = FlownMission()
    for event in events:
        flown.take(event)
    flown.finish(read_result(events))
    return flown
