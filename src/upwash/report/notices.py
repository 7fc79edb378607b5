"""What a person should know of a flight first: where they had to act, what was left undone, and what went wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from upwash.core.knowledge.servers import State
from upwash.core.vehicle.control import Owner
from upwash.eventlog import schema
from upwash.eventlog.narration import (
    SAFE_ENDS,
    WARNING,
    WAS_LEFT_HOVERING,
    Narrator,
    Tone,
    left_undone,
    spans,
    who_has_it,
)
from upwash.eventlog.progress import clock
from upwash.eventlog.results import RunResult
from upwash.eventlog.schema import SEVERITIES, Event
from upwash.support.text import by_name, counted, printable

_LONGEST_LIST = 200  # characters
_MOST_KINDS = 200  # of troubles that are told apart, however long the log is
# Told by their number, at the end; or no trouble, and frequent.
_PASSED_OVER = frozenset(
    {
        schema.PositionReport,
        schema.Decided,
        schema.Call,
        schema.SetOff,
        schema.Arrived,
        schema.PhotoTaken,
        schema.AutopilotPhoto,
        schema.CallStarted,
        schema.AnswerTaken,
        schema.Energy,
        schema.RemoteFailed,
        schema.RemoteRaised,
        schema.Unanswered,
    }
)


@dataclass(frozen=True, slots=True)
class Notices:
    """Sentences: `urgent` where a person had to act or the mission fell short, `cautions` of what else went wrong."""

    urgent: Sequence[str] = ()
    cautions: Sequence[str] = ()

    def with_caution(self, words: str) -> Notices:
        """The same with one more, unless it is empty."""
        return replace(self, cautions=[*self.cautions, _sentence(words)]) if words else self


class NoticesTaken:
    """Gathers them event by event; what happened often is told once, with its number."""

    def __init__(self) -> None:
        self._narrator = Narrator()
        self._urgent: dict[str, None] = {}  # in their order, each once
        self._troubles: dict[str, int] = {}
        self._blacklisted: dict[str, tuple[int, str]] = {}  # by server: how often, and when and why last
        self._lost_links, self._longest_silence_s = 0, 0.0
        self._has_end = False

    def take(self, event: Event, at_s: float) -> None:
        """Takes in the next event, of that second of the mission."""
        if type(event) in _PASSED_OVER:
            return
        if (urgent := self._urgent_of(event, clock(at_s))) is not None:
            self._urgent[urgent] = None
            return
        match event:
            case schema.ServerStep(before=before, after=State.BLACKLISTED) if before is not State.BLACKLISTED:
                self._blacklist(event, clock(at_s))
            case schema.LinkLost():
                self._lost_links += 1
                self._longest_silence_s = max(self._longest_silence_s, event.silent_s)
            case schema.LinkRestored(silent_s=silent_s):
                self._longest_silence_s = max(self._longest_silence_s, silent_s)
            case schema.EventsLost(count=count):
                self._trouble(f"{counted(count, 'event')} could not be written: the log lacks them")
            case schema.VehicleSaid(severity=severity, text=text) if severity <= WARNING:
                self._trouble(f"the vehicle said: {text} ({SEVERITIES[severity]})")
            case schema.MissionCompleted():
                self._has_end = True
            case schema.ServerStep():
                pass
            case _:
                said = self._narrator.tell(event)
                if said is not None and said.tone in {Tone.TROUBLE, Tone.ALARM}:
                    self._trouble(said.text)

    def _urgent_of(self, event: Event, at: str) -> str | None:
        match event:
            case schema.LeftHovering():
                return WAS_LEFT_HOVERING
            case schema.SafeEnd(action=action, why=why):
                return f"At {at} the flight was ended early by {SAFE_ENDS[action]}: {why}"
            case schema.SafeEndFailed(action=action, why=why):
                return f"At {at} the vehicle did not obey ({SAFE_ENDS[action]}): {why}"
            case schema.ControlChanged(owner=owner, why=why) if owner not in {Owner.PROGRAM, Owner.NOBODY}:
                return f"From {at} on {who_has_it(owner)} had the vehicle: {why}"
            case schema.LeftToPilot(why=why):
                return f"From {at} on the program sent nothing to the vehicle: {why}"
            case schema.FollowingEnded(why=why):
                return f"The log ends before the vehicle stood: {why}"
            case schema.Stopping(why=why):
                return f"At {at} the mission was stopped: {why}"
            case schema.MissionEnded(why=why):
                self._has_end = True
                return f"The mission ended early, at {at}: {why}"
            case schema.LogResumed():
                self._has_end = False
        return None

    def _blacklist(self, step: schema.ServerStep, at: str) -> None:
        times, _ = self._blacklisted.get(step.server, (0, ""))
        why = step.why.removeprefix(f"{step.server}: ")
        self._blacklisted[step.server] = (times + 1, f"at {at}: {why}")

    def _trouble(self, text: str) -> None:
        if text in self._troubles or len(self._troubles) < _MOST_KINDS:
            self._troubles[text] = self._troubles.get(text, 0) + 1

    def notices(self, result: RunResult) -> Notices:
        """All of them; the result tells what the mission came to at its end."""
        urgent = [*self._urgent, *self._fell_short(result)]
        return Notices(
            [_sentence(each) for each in urgent], [_sentence(each) for each in self._cautions(result)]
        )

    def _fell_short(self, result: RunResult) -> Iterator[str]:
        if not self._has_end:
            yield "The log ends before the mission does: the program was stopped at once, or is still running"
        if result.undone:
            which = printable(spans(result.undone), _LONGEST_LIST)
            yield f"{len(result.undone)} of {counted(result.waypoints, 'waypoint')} left undone: {which}"
        yield from left_undone(result)
        for server, why in result.never_ready.items():
            yield f"The server {server} never became ready: {why}"

    def _cautions(self, result: RunResult) -> Iterator[str]:
        if fallbacks := result.totals.fallbacks:
            why = "a server gave no usable answer, or the drone left its range"
            yield f"{counted(fallbacks, 'call')} fell back to the drone: {why}"
        for server, (times, last) in sorted(self._blacklisted.items(), key=lambda entry: by_name(entry[0])):
            yield f"The server {server} was blacklisted {_often(times)}, last {last}"
        if self._lost_links:
            yield (
                f"The vehicle fell silent {_often(self._lost_links)}, at the longest for "
                f"{self._longest_silence_s:.1f} s"
            )
        for text, often in self._troubles.items():
            yield text if often == 1 else f"{text} ({_often(often)})"


def _often(number: int) -> str:
    return "once" if number == 1 else f"{number} times"


def _sentence(text: str) -> str:
    """The words as a sentence of their own."""
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}"
