"""One run of a log, followed event by event: what its reports, its page and files for others tell of it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from upwash.core.geo import GeoPosition, Position
from upwash.core.knowledge.servers import State
from upwash.eventlog import schema
from upwash.eventlog.ending import EndingSoFar
from upwash.eventlog.notices import Notice, Notices
from upwash.eventlog.reasons import CallText, ExplainedAnswer, ExplainedCall, Reasons, worst_of
from upwash.eventlog.results import Tally
from upwash.eventlog.schema import Event
from upwash.report.findings import Finder, Finding
from upwash.report.numbering import FlightFindings
from upwash.report.outcome import UNPLANNED, Outcome
from upwash.support.text import by_name

_WORST = 5


@dataclass(frozen=True, slots=True)
class Stretch:
    """A time that a server spent in one state, in seconds of the mission, and why it came into it."""

    state: State
    from_s: float
    to_s: float
    why: str


class Story:
    """Follows one run. A log's `LogOpened` begins another run, for another story.

    `opening` is the first event, `plan` the first plan, and `drone` None before the mission began. The last event
    told of objects that were `found`, of a call or of an answer that it `explained`, and of what a person should know
    (`noticed`). `places` are those where the drone made each call, and `worst` has the calls that lost most, the
    worst first. `steps` has the states of each server, with their seconds of the log and their reasons.
    """

    def __init__(self) -> None:
        self.now_s = 0.0
        self.opening: Event | None = None
        self.plan = UNPLANNED
        self.home: GeoPosition | None = None
        self.drone: str | None = None
        self.tally = Tally()
        self.reasons = Reasons()
        self.explained: ExplainedCall | ExplainedAnswer | None = None
        self.places: list[Position | None] = []
        self.worst: list[CallText] = []
        self.finder = Finder()
        self.found: Sequence[Finding] = ()
        self.steps: dict[str, list[tuple[float, State, str]]] = {}
        self.noticed: Sequence[Notice] = ()
        self._notices = Notices()
        self._ending = EndingSoFar()

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        self.opening = self.opening or event
        self.now_s = max(self.now_s, event.t)
        if not self.tally.completed:
            self.tally.take(event)
        # Most events of a long log are positions.
        if type(event) is schema.PositionReport and not self._notices.is_stale(event.t):
            self.explained, self.found, self.noticed = None, (), ()
            return
        self.noticed = list(self._notices.take(event))
        for notice in self.noticed:
            self._ending.put(notice, event.t)
        self.explained, self.found = self.reasons.take(event), self.finder.take(event)
        self._take_explained(self.explained)
        match event:
            case schema.Planned():
                self.plan = event if self.plan is UNPLANNED else self.plan
                self.home = self.home or event.home
                for server in (*event.ranges, *event.measured):
                    self._know(server)
            case schema.MissionStarted(drone=drone):
                self.drone = drone
            case schema.LogResumed():  # a program that starts again knows no server's state
                for steps in self.steps.values():
                    steps.append((event.t, State.AVL, "taken up again"))
            case schema.ServerStep(server=server):
                self._know(server, event.before).append((event.t, event.after, event.why))

    def _take_explained(self, explained: ExplainedCall | ExplainedAnswer | None) -> None:
        match explained:
            case ExplainedCall():
                self.places.append(explained.position)
                self.worst = worst_of([*self.worst, CallText(explained)], _WORST)
            case ExplainedAnswer(number=number):
                for text in self.worst:
                    if text.call.number == number:
                        text.answers.append(explained)

    def _know(self, server: str, state: State = State.AVL) -> list[tuple[float, State, str]]:
        """The steps of the server, which had that state if nothing was known of it."""
        return self.steps.setdefault(server, [(0.0, state, "")])

    @property
    def began_s(self) -> float:
        """The mission's begin, in seconds of the log; 0 before."""
        return self.tally.began_s or 0.0

    @property
    def opened(self) -> datetime | None:
        """The time of day at second 0 of the log, None for a simulated one."""
        return self.opening.time if isinstance(self.opening, schema.LogOpened) else None

    @property
    def simulated(self) -> schema.Simulated | None:
        """The simulation's own first line, None for a flight."""
        return self.opening if isinstance(self.opening, schema.Simulated) else None

    @property
    def stretches(self) -> dict[str, list[Stretch]]:
        """The times of each server in each state until now, by the servers' names."""
        ended_s = self.now_s - self.began_s
        found: dict[str, list[Stretch]] = {}
        for server in sorted(self.steps, key=by_name):
            steps = self.steps[server]
            marks_s = [*(max(0.0, at_s - self.began_s) for at_s, _, _ in steps), ended_s]
            found[server] = [
                Stretch(state, from_s, to_s, why)
                for (_, state, why), (from_s, to_s) in zip(steps, itertools.pairwise(marks_s), strict=True)
                if to_s > from_s
            ]
        return found

    @property
    def findings(self) -> Sequence[Finding]:
        """Each sighting that the log tells, until now."""
        return self.finder.found

    def findings_of(self, log: str) -> FlightFindings:
        """What was found until now, on the flight of that log."""
        return FlightFindings(log, self.drone, self.opened, self.began_s, self.home, list(self.findings))

    def outcome(self, name: str) -> Outcome | None:
        """The outcome of the run until now, under that name; None before the mission."""
        if self.tally.began_s is None:
            return None
        world = (self.simulated.scenario, self.simulated.seed) if self.simulated else None
        return Outcome(name, self.plan, self.tally.result(), world)


def place_of(event: Event, last: Position | None) -> Position | None:
    """Where an event tells that the drone was; as high as `last` where it tells a place without an altitude."""
    match event:
        case schema.PositionReport(east_m=east_m, north_m=north_m, altitude_m=altitude_m):
            return Position(east_m, north_m, altitude_m)
        case schema.Arrived(east_m=east_m, north_m=north_m):
            return Position(east_m, north_m, last.altitude_m if last else 0.0)
    place = getattr(event, "position", None)
    return place if isinstance(place, Position) else None
