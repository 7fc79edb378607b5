"""What readers of a log follow event by event: the mission's time, the place of each call, and the open demands."""

from __future__ import annotations

from collections import deque

from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.support.text import clock

# Most events of a long log are positions: a set lookup skips them faster than a match statement.
_UNDER_WAY = schema.PhotoTaken, schema.CallStarted, schema.Call, schema.SetOff, schema.LogResumed
TIME_EVENTS = frozenset({schema.MissionStarted, schema.Armed, *_UNDER_WAY})


class MissionTime:
    """The begin of the mission's time, followed event by event: the arming for the first leg.

    `at_s` is None before the mission has started. A mission that took photos or called services before arming, or
    that was resumed in the air, begins with its start.
    """

    def __init__(self) -> None:
        self.at_s: float | None = None
        self.arming_s = 0.0
        self._settled = False

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        if type(event) not in TIME_EVENTS or self._settled:
            return
        if self.at_s is None:
            self.at_s = event.t if isinstance(event, schema.MissionStarted) else None
        elif isinstance(event, schema.Armed):
            self.arming_s = event.t - self.at_s
            self.at_s, self._settled = event.t, True
        elif isinstance(event, _UNDER_WAY):
            self._settled = True

    def text(self, t: float) -> str:
        """A second of the log as text: of the mission; before its begin the second of the log, in brackets."""
        if self.at_s is None or not self._settled:
            return f"[{clock(t)}]"
        return clock(t - self.at_s)


class MissionEnd:
    """When the mission will be over: by its forecast, and by how much later each waypoint was reached."""

    def __init__(self) -> None:
        self._foreseen: schema.Foreseen | None = None
        self._late_s = 0.0

    def take(self, event: Event, began_s: float) -> None:
        """Takes in the next event of the mission that began at that second of the log."""
        match event:
            case schema.Foreseen():
                self._foreseen, self._late_s = event, 0.0
            case schema.Arrived(waypoint=int(number)) if self._foreseen:
                if number < len(self._foreseen.reached_s):
                    self._late_s = event.t - began_s - self._foreseen.reached_s[number]
            case schema.PositionReport(down_s=float(down_s)) if self._foreseen:
                self._late_s = event.t - began_s + down_s - self._foreseen.as_asked_s

    def left_s(self, now_s: float) -> float | None:
        """The time that is left at that second of the mission; None without a forecast."""
        if self._foreseen is None:
            return None
        return max(0.0, self._foreseen.as_asked_s + self._late_s - now_s)


class CallPlaces:
    """The waypoints of a flight's calls: `here` is the last arrival, `of_call` the waypoint of the last call.

    `answered` is the number, from 0, of the call whose answer the last event took; None after any other event.
    """

    def __init__(self) -> None:
        self.here: int | None = None
        self.of_call: int | None = None
        self.answered: int | None = None
        self._calls = 0  # ended
        self._under_way: deque[int | None] = deque()  # waypoints of the open calls
        self._untaken: list[tuple[int | None, int]] = []  # ended calls: waypoint and number

    @property
    def of_call_under_way(self) -> int | None:
        """The waypoint of the open call; without one, of a call that begins now."""
        return self._under_way[0] if self._under_way else self.here

    @property
    def open_calls(self) -> int:
        """The number of calls that the mission started and that are not over."""
        return len(self._under_way)

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        self.answered = None
        match event:
            case schema.MissionStarted():
                self.here = None
                self._under_way.clear()
                self._untaken.clear()
            case schema.Arrived(waypoint=waypoint):
                self.here = waypoint
            case schema.CallStarted(waypoint=waypoint):
                self._under_way.append(waypoint)
            case schema.Call(waypoint=waypoint):
                off_plan = waypoint is not None or None in self._under_way
                self.of_call = waypoint if off_plan else self.of_call_under_way
                if self.of_call in self._under_way:
                    self._under_way.remove(self.of_call)
                    self._untaken.append((self.of_call, self._calls))
                self._calls += 1
            case schema.Unanswered(waypoint=waypoint) if waypoint in self._under_way:
                self._under_way.remove(waypoint)
            case schema.AnswerTaken(waypoint=waypoint, failed=""):
                self.answered = self._taken(waypoint)
            case schema.AnswerTaken(waypoint=waypoint) if waypoint in self._under_way:
                self._under_way.remove(waypoint)  # no event reports the end of a failed call

    def _taken(self, waypoint: int | None) -> int | None:
        """The number of the last call at the waypoint; the mission dropped earlier ones."""
        for made_at, number in reversed(self._untaken):
            if made_at == waypoint:
                self._untaken.remove((made_at, number))
                return number
        return None


_OF_DEMANDS = schema.CallStarted, schema.Demanded, schema.AnswerTaken, schema.Acted, schema.NotActed
DEMAND_EVENTS = frozenset({schema.MissionStarted, *_OF_DEMANDS})


class OpenDemands:
    """What a flight, and the flights that resumed it, have left open, by waypoint.

    `answers`: started calls whose answers the mission has not taken. `demands`: answers whose demanded action is not
    done. `failures`: failed calls without a reaction. An action on an object is open at the waypoint whose photo
    showed that object first.
    """

    def __init__(self) -> None:
        self.answers: set[int | None] = set()
        self.failures: set[int | None] = set()
        self._demands: set[int | None] = set()
        self._objects: dict[int, int | None] = {}  # the waypoint of each, by its number

    @property
    def demands(self) -> set[int | None]:
        """The waypoints of answers whose demanded action is not done."""
        return self._demands | set(self._objects.values())

    @property
    def waypoints(self) -> set[int | None]:
        """All waypoints with something open."""
        return self.answers | self.demands | self.failures

    def take(self, event: Event) -> None:
        """Takes in the next event."""
        match event:
            case schema.MissionStarted():  # a flight that is resumed asks again at these waypoints
                self._demands |= set(self._objects.values())
                self._objects.clear()
            case schema.CallStarted(waypoint=waypoint):
                self.answers.add(waypoint)
            case schema.Demanded(waypoint=waypoint, object=schema.FoundRecord(number=number)):
                self._objects[number] = waypoint
            case schema.Acted(object=schema.FoundRecord(number=number)) | schema.NotActed(object=number):
                self._objects.pop(number, None)
            case schema.Demanded(waypoint=waypoint, failed=failed):
                (self.failures if failed else self._demands).add(waypoint)
            case schema.AnswerTaken(waypoint=waypoint):
                self._settle(waypoint)
                if event.failed:
                    self.failures.add(waypoint)
                elif event.demanded:
                    self._demands.add(waypoint)
            case schema.Acted(waypoint=waypoint):
                self._settle(waypoint)

    def _settle(self, waypoint: int | None) -> None:
        for open_ones in (self.answers, self._demands, self.failures):
            open_ones.discard(waypoint)
