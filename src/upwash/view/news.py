"""Turns the events of a log, one by one, into the facts that a page shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from msgspec.structs import replace

from upwash.core.geo import LocalFrame, Position
from upwash.core.operation import ON_DRONE
from upwash.core.vehicle.control import Owner
from upwash.eventlog import schema
from upwash.eventlog.causes import Considered, Course, course_after
from upwash.eventlog.narration import STATE_WORDS, Narrator, tone_of
from upwash.eventlog.notices import Notice
from upwash.eventlog.objects import found_objects
from upwash.eventlog.reasons import ExplainedAnswer, ExplainedCall, call_lines, decision_lines
from upwash.eventlog.schema import Event
from upwash.report.findings import Finding
from upwash.report.photos import Shot
from upwash.report.story import Story, place_of
from upwash.support.text import by_name
from upwash.view import facts
from upwash.view.facts import Fact
from upwash.view.state import ShownControl

_ON_CALLS = (
    schema.Decided,
    schema.Hedged,
    schema.Seconded,
    schema.RemoteFailed,
    schema.RemoteRaised,
    schema.TurnOver,
)
_REPORTED = (
    "ground_speed_m_s", "heading_deg", "battery_percent", "server", "round_trip_s", "down_s",
)  # fmt: skip
_STALE_S = 1.5  # a flown log has a position each second, a simulated log with each event


class News:
    """Tells of a story what each event changes; `outlined` has the numbers of the photos with findings.

    `shots` are the photos until now, `ended` says whether the run is over. `keeps` says of a photo's source whether
    its photos can be had.
    """

    def __init__(self, keeps: Callable[[str], bool]) -> None:
        self.story = Story()
        self.shots: list[Shot] = []
        self.outlined: set[int] = set()
        self.ended = False
        self._keeps = keeps
        self._narrator = Narrator()
        self._began_s: float | None = None
        self._policy = ""
        self._place: Position | None = None
        self._placed_s = 0.0
        self._control = ShownControl()
        self._doing: facts.DoingFact | None = None
        self._vehicle = facts.VehicleFact(at_s=0.0)
        self._course: Course | None = None
        self._left_out = self._beside = ""
        self._unfinished: list[ExplainedCall] = []  # they name servers that are still left alone

    def take(self, event: Event) -> Iterable[Fact]:
        """What the next event tells."""
        self.story.take(event)
        # Most events of a long log are positions.
        if type(event) is schema.PositionReport and self._doing and not self.story.noticed:
            here = Position(event.east_m, event.north_m, event.altitude_m)
            self._control.take(event)
            fix = (self._fix(here, event),) if self._is_news(here) else ()
            return (*fix, *self._state(event))
        return self._told(event)

    @property
    def _now_s(self) -> float:
        return self.story.now_s

    def lacks(self, left_out: str) -> Iterator[Fact]:
        """The notice about lines that are no events; nothing if the notice was given before."""
        if left_out != self._left_out:
            self._left_out = left_out
            cause = left_out[:1].upper() + left_out[1:]
            yield self._notice(Notice("log", cause, since_s=self._now_s))

    def _told(self, event: Event) -> Iterator[Fact]:
        said, explained = self._narrator.tell(event), self.story.explained
        yield from self._whereabouts(event)
        yield from self._progress(event)
        yield from self._photos(event)
        yield from self._under_way(event)
        if isinstance(explained, ExplainedCall):
            yield self._call(explained)
        yield from self._amended(event, explained)
        yield from self._going(event, explained)
        yield from map(self._notice, self.story.noticed)
        if isinstance(event, schema.ServerStep):
            yield self._step(event.server)
        if said is not None:
            yield facts.SaidFact(at_s=self._now_s, words=said.text, tone=said.tone)

    def _notice(self, notice: Notice) -> facts.NoticeFact:
        told = {name: getattr(notice, name) for name in facts.NoticeFact.__struct_fields__ if name != "at_s"}
        return facts.NoticeFact(at_s=self._now_s, **told)

    # --- where the drone is, and what it does -----------------------------------------------------------------

    def _whereabouts(self, event: Event) -> Iterator[Fact]:
        here = place_of(event, self._place)
        if here is None and (self._place is None or self._now_s - self._placed_s > _STALE_S):
            here = self._place if isinstance(event, schema.SetOff) else None  # simulated logs do not say
        if here is not None and self._is_news(here):
            yield self._fix(here, event if isinstance(event, schema.PositionReport) else None)
        if isinstance(event, schema.LimitsRead):
            if event.home is not None:
                yield facts.HomeFact(at_s=self._now_s, east_m=event.home.east_m, north_m=event.home.north_m)
            low, critical = event.low_percent, event.critical_percent
            if low or critical:
                yield facts.StagesFact(at_s=self._now_s, low_percent=low, critical_percent=critical)

    def _is_news(self, here: Position) -> bool:
        return here != self._place or self._now_s - self._placed_s > _STALE_S

    def _fix(self, here: Position, report: schema.PositionReport | None) -> facts.FixFact:
        self._place, self._placed_s = here, self._now_s
        told = {} if report is None else {name: getattr(report, name) for name in _REPORTED}
        return facts.FixFact(
            at_s=self._now_s, east_m=here.east_m, north_m=here.north_m, altitude_m=here.altitude_m, **told
        )

    def _progress(self, event: Event) -> Iterator[Fact]:
        match event:
            case schema.LogOpened(time=time):
                yield facts.OpenedFact(at_s=self._now_s, epoch_s=time.timestamp())
            case schema.VehicleFound(firmware=firmware, type=kind, version=version):
                yield facts.FirmwareFact(at_s=self._now_s, name=firmware, type=kind, version=version)
            case schema.Planned():
                yield self._plan(event)
                for server, known in event.measured.items():
                    yield from (self._measured(server, place) for place in known)
            case schema.LogResumed():
                self.ended = False
                for server in sorted(self.story.steps, key=by_name):
                    yield self._step(server)
            case schema.MissionStarted(policy=policy):
                self._policy = policy
            case schema.PlaceMeasured(server=server, place=place):
                yield self._measured(server, place)
            case schema.Foreseen():
                yield facts.ForecastFact(
                    at_s=self._now_s,
                    ends_s=event.as_asked_s,
                    reached_s=event.reached_s,
                    lightest_s=event.lightest_s,
                    finish_by_s=event.finish_by_s,
                )
            case schema.MissionCompleted() | schema.MissionEnded():
                self.ended = True
                yield facts.EndedFact(at_s=self._now_s, completed=isinstance(event, schema.MissionCompleted))
        if self._began_s != (began_s := self.story.tally.began_s):
            self._began_s = began_s
            yield facts.BeganFact(at_s=self._now_s, policy=self._policy, drone=self.story.drone or "")
        self._control.take(event)
        yield from self._state(event)

    def _state(self, event: Event) -> Iterator[Fact]:
        control, vehicle = self._control, self._vehicle
        now = replace(vehicle, mode=control.mode, armed=control.armed)
        if isinstance(event, schema.PositionReport) and event.gps is not None:
            now = replace(now, gps=event.gps, satellites=event.satellites)
        if now != vehicle:
            self._vehicle = replace(now, at_s=self._now_s)
            yield self._vehicle
        doing = facts.DoingFact(
            at_s=0.0,
            words=control.words(self._narrator.doing),
            reached=self._narrator.reached,
            who=control.who,
            tone=control.tone,
            stands=self._narrator.stands,
        )
        if doing != self._doing:
            self._doing = doing
            yield replace(doing, at_s=self._now_s)

    def _measured(self, server: str, place: schema.MeasuredRecord) -> facts.MeasuredFact:
        return facts.MeasuredFact(
            at_s=self._now_s,
            server=server,
            east_m=place.east_m,
            north_m=place.north_m,
            answered=place.answered / place.tried if place.tried else 0.0,
        )

    def _plan(self, plan: schema.Planned) -> facts.PlanFact:
        home = plan.home
        return facts.PlanFact(
            at_s=self._now_s,
            waypoints_m=plan.way_m,
            ranges={
                name: (area.centre.east_m, area.centre.north_m, area.radius_m)
                for name, area in plan.ranges.items()
            },
            home=(home.latitude_deg, home.longitude_deg) if home else None,
            metres_per_degree=LocalFrame(home).metres_per_degree() if home else None,
        )

    # --- servers and calls ------------------------------------------------------------------------------------

    def _step(self, server: str) -> facts.StepFact:
        _, state, why = self.story.steps[server][-1]
        words = STATE_WORDS[state]
        return facts.StepFact(at_s=self._now_s, server=server, state=words, tone=tone_of(state), why=why)

    def _under_way(self, event: Event) -> Iterator[Fact]:
        """Where the open call is, or the last of several, if the event changes that."""
        before, decisions = self._course, self.story.reasons.under_way
        if isinstance(event, _ON_CALLS):
            self._course = course_after(event, decisions[-1], before) if decisions else None
        elif isinstance(event, schema.Call) and decisions:  # of the other calls
            self._course = course_after(decisions[-1].decided, decisions[-1], None)
        elif _ends_call(event):
            self._course = None
            if isinstance(event, schema.Call):  # which tells by itself that it is over
                return
        if self._course is before:
            return
        if self._course is None:
            yield facts.DecisionFact(at_s=self._now_s, number=self.story.reasons.ended, waypoint=None)
        else:
            yield self._decision(self._course, decisions[-1])

    def _decision(self, course: Course, decision: Considered) -> facts.DecisionFact:
        decided, alone = decision.decided, course.server is None
        limit_s = decided.local_s if alone else course.at_most_s
        here = self.story.tally.whereabouts.of_call_under_way
        return facts.DecisionFact(
            at_s=self._now_s,
            number=self.story.reasons.ended,
            operation=decided.operation,
            waypoint=here if decided.waypoint is None else decided.waypoint,
            words=[f"{course.sentence}.", *decision_lines(decided)],
            estimates=_estimates(decision),
            began_s=course.began_s,
            from_s=course.from_s,
            doing=course.doing,
            bound="" if limit_s is None else "about" if alone else "at most",
            limit_s=limit_s,
            also_local=not alone and course.alone_from_s is not None,
        )

    def _amended(self, event: Event, explained: ExplainedCall | ExplainedAnswer | None) -> Iterator[Fact]:
        """The calls whose sentences say more since a server is no longer left alone."""
        if isinstance(explained, ExplainedCall) and not explained.is_final:
            self._unfinished.append(explained)
        if self._unfinished and isinstance(event, (schema.ServerStep, schema.LogResumed)):
            for call in self._unfinished:
                if call.is_final:
                    yield facts.AmendedFact(
                        at_s=self._now_s, number=call.number, words=list(call_lines(call))
                    )
            self._unfinished = [call for call in self._unfinished if not call.is_final]

    def _call(self, call: ExplainedCall) -> facts.CallFact:
        outcome, place = call.outcome, call.position or self._place
        return facts.CallFact(
            at_s=self._now_s,
            operation=outcome.operation,
            waypoint=call.waypoint,
            place=outcome.place,
            delay_s=outcome.delay_s,
            waited_s=outcome.waited_s,
            wait=outcome.wait,
            words=list(call_lines(call)),
            estimates=_estimates(call.decisions[0]) if call.decisions else (),
            lost_s=call.loss_s,
            queued_s=outcome.queued_s or 0.0,
            east_m=place.east_m if place else None,
            north_m=place.north_m if place else None,
        )

    def _going(self, event: Event, explained: ExplainedCall | ExplainedAnswer | None) -> Iterator[Fact]:
        match event:
            case schema.StayOrGo(goes=True, waypoint=waypoint, why=why):
                yield facts.GoingFact(at_s=self._now_s, waypoint=waypoint, words=why)
            case schema.Arrived(passing=True, waypoint=waypoint):
                yield facts.GoingFact(at_s=self._now_s, waypoint=waypoint, words="it takes photos in flight")
            case schema.TurnedBack(waypoint=waypoint, position=at):
                yield facts.TurnFact(
                    at_s=self._now_s, waypoint=waypoint, east_m=at.east_m, north_m=at.north_m
                )
            case schema.CallStarted(waypoint=waypoint):
                yield facts.StartedFact(at_s=self._now_s, waypoint=waypoint)
            case schema.AnswerTaken(waypoint=waypoint):
                hidden_s = explained.hidden_s if isinstance(explained, ExplainedAnswer) else 0.0
                yield facts.AnswerFact(at_s=self._now_s, waypoint=waypoint, hidden_s=hidden_s)
        if (kind := _beside(event, self._beside)) != self._beside:
            self._beside = kind
            yield facts.BesideFact(at_s=self._now_s, kind=kind)

    # --- photos -----------------------------------------------------------------------------------------------

    def _photos(self, event: Event) -> Iterator[Fact]:
        photo = self.story.finder.pairing.last
        if isinstance(event, schema.PhotoTaken) and photo is not None:
            self.shots.append(photo.shot)
            corners_m = photo.corners_m
            yield facts.ShotFact(
                at_s=self._now_s,
                number=photo.number,
                waypoint=photo.waypoint,
                source=photo.shot.source,
                kept=self._keeps(photo.shot.source),
                truth=found_objects(event.truth),
                footprint_m=corners_m and [(round(east, 2), round(north, 2)) for east, north in corners_m],
            )
        for each in self.story.found:
            if each.photo is not None:
                self.outlined.add(each.photo.number)
            yield self._told_of(each)

    def _told_of(self, found: Finding) -> facts.ToldFact:
        return facts.ToldFact(
            at_s=self._now_s,
            what=found.what,
            waypoint=found.waypoint,
            east_m=found.place.east_m,
            north_m=found.place.north_m,
            score=found.score,
            box=found.box,
            photo=found.photo.number if found.photo else None,
            pictured=bool(found.box and found.photo and self._keeps(found.photo.shot.source)),
        )


def _estimates(decision: Considered) -> Sequence[facts.Estimate]:
    """What the call was expected to take at each place, the drone first."""
    decided = decision.decided
    local = [] if decided.local_s is None else [facts.Estimate(place=ON_DRONE, call_s=decided.local_s)]
    if decided.selected is None or decided.remote_s is None:
        return local
    there = facts.Estimate(place=decided.selected, call_s=decided.remote_s, wait_s=decision.wait_s)
    return [*local, there]


def _beside(event: Event, before: str) -> str:
    """What keeps the drone off its way after the event: "detour", "wait" or nothing."""
    match event:
        case schema.TurnedBack():
            return "detour"
        case schema.PhotosWait() | schema.SoughtAnswers():
            return "wait"
        case schema.SetOff(back=False) | schema.Returning() | schema.Landing() | schema.SafeEnd():
            return ""
        case schema.ControlChanged() | schema.MissionStarted() | schema.MissionEnded():
            return ""
    return before


def _ends_call(event: Event) -> bool:
    """Whether no call is under way after it."""
    match event:
        case schema.Call() | schema.MissionCompleted() | schema.MissionEnded() | schema.LogResumed():
            return True
        case schema.AnswerTaken(failed=why):  # no event reports the end of a failed call
            return bool(why)
        case schema.ControlChanged(owner=owner):
            return owner is not Owner.PROGRAM
    return False
