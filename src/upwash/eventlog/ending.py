"""What a person should know of a flight afterwards: its notices, each with when it held, and what was left undone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from upwash.eventlog.narration import at_places, spans
from upwash.eventlog.notices import TEXTS, Level, Notice
from upwash.eventlog.results import RunResult, Totals
from upwash.support.text import clock, counted, printable

_LONGEST_LIST = 200  # characters
_MOST_KINDS = 200  # of notices about one thing, however long the log is
_ACTS = frozenset(
    {"safe end", "disobeys", "left", "control", "stopping", "ended"}
)  # each has a sentence of its own, in red
_PASSES = frozenset({"link", "position"})  # no alarm any more once it is over
_MOMENTS = frozenset({"ended", *TEXTS})  # which hold in a flight longer than they last
_NO_END = "The log ends before the mission does: the program was stopped at once, or is still running"


@dataclass(frozen=True, slots=True)
class Ending:
    """Sentences: `urgent` where a person had to act or the mission fell short, `cautions` of what else went wrong."""

    urgent: Sequence[str] = ()
    cautions: Sequence[str] = ()

    def with_caution(self, words: str) -> Ending:
        """The same with one more, unless it is empty."""
        return replace(self, cautions=[*self.cautions, _sentence(words)]) if words else self


@dataclass(slots=True)
class _Held:
    """A notice, with its last words; `to_s` is the end of its last time, None while it holds.

    The last time began at `given_s`; of a text of the vehicle `given_s` is when the vehicle last sent it.
    """

    notice: Notice
    since_s: float
    given_s: float
    to_s: float | None = None
    longest_s: float = 0.0
    times: int = 0

    @property
    def is_urgent(self) -> bool:
        """Whether a person had to act, or has to know first."""
        is_over = self.notice.about in _PASSES and self.to_s is not None
        return self.notice.about in _ACTS or (self.notice.level is Level.ALARM and not is_over)

    def told(self, began_s: float) -> str:
        """When it held, and the notice."""
        notice, began, over = self.notice, _clock(self.since_s, began_s), self.to_s
        if notice.about in _MOMENTS:
            over = self.given_s
        ended = None if over is None else _clock(over, began_s)
        if ended is None:
            when = f"from {began or 'the start'} on"
        elif not ended:
            when = "before the start"
        elif not began:
            when = f"until {ended}"
        else:
            when = f"at {began}" if began == ended else f"from {began} to {ended}"
        times = max(self.times, notice.times)
        if times > 1:
            longest = f", at the longest for {self.longest_s:.1f} s" if notice.about in _PASSES else ""
            when = f"{times} times {when}{longest}"
        return _sentence(f"{when}: {notice.words}")


class EndingSoFar:
    """Gathers notices one by one; a notice that comes again has one sentence, with the number of its times."""

    def __init__(self) -> None:
        self._told: dict[tuple[str, str], _Held] = {}
        self._now: dict[str, _Held] = {}  # what holds, by the keys of its notices
        self._kinds = Counter[str]()

    def put(self, notice: Notice, now_s: float) -> None:
        """Takes in the next notice, at that second of the log."""
        held = self._now.get(notice.key)
        if held is not None and (not notice.cause or _apart(held.notice) != _apart(notice)):
            held.to_s = now_s
            held.longest_s = max(held.longest_s, now_s - held.given_s)
            del self._now[notice.key]
            held = None
        if not notice.cause:
            return
        if held is None:
            held = self._told.get((notice.key, _apart(notice)))
            if held is None:
                self._kinds[notice.about] += 1
                held = _Held(notice, now_s, now_s)
                if self._kinds[notice.about] <= _MOST_KINDS:
                    self._told[notice.key, _apart(notice)] = held
            held.times, held.to_s, held.given_s = held.times + 1, None, now_s
            self._now[notice.key] = held
        elif notice.about in TEXTS:
            held.given_s = now_s
        action = notice.action or held.notice.action  # a pilot who has the vehicle needs none, and did it
        held.notice = replace(notice, action=action)

    def ending(self, result: RunResult, began_s: float) -> Ending:
        """All sentences, about a mission that began at that second; the result has what it left undone."""
        never = {f"server {name}" for name in result.never_ready}
        told = sorted(
            (held for held in self._told.values() if held.notice.key not in never),
            key=lambda held: held.notice.rank,
        )
        urgent = [held for held in told if held.is_urgent]
        acts = sorted(
            (held for held in urgent if held.notice.about not in TEXTS), key=lambda held: held.since_s
        )
        texts = [held for held in urgent if held.notice.about in TEXTS]
        has_end = result.completed or any(held.notice.about == "ended" for held in self._now.values())
        undone = [reached(result)] if result.undone else []
        short = [*([] if has_end else [_NO_END]), *undone, *left_undone(result)]
        return Ending(
            [
                *(held.told(began_s) for held in acts),
                *map(_sentence, short),
                *(f"{phrase}." for phrase in never_ready(result)),
                *(held.told(began_s) for held in texts),
            ],
            [held.told(began_s) for held in told if not held.is_urgent],
        )


def _apart(notice: Notice) -> str:
    """What sets notices of one key apart in a report."""
    return notice.cause if notice.about in _ACTS else notice.level


def _clock(t: float, began_s: float) -> str:
    """A second of the log as one of the mission; empty before its start."""
    return clock(t - began_s) if t >= began_s else ""


def _sentence(text: str) -> str:
    """The words as a sentence of their own."""
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}"


def reached(result: RunResult) -> str:
    """How many waypoints a mission reached, and which not: "2 of 4 waypoints reached, left undone: 1, 3"."""
    undone = f", left undone: {printable(spans(result.undone), _LONGEST_LIST)}" if result.undone else ""
    return (
        f"{result.waypoints - len(result.undone)} of {counted(result.waypoints, 'waypoint')} reached{undone}"
    )


def by_place(totals: Totals) -> str:
    """Where the calls ran: "18 on the drone, 51 on s1"."""
    return ", ".join(
        [f"{totals.local} on the drone", *(f"{count} on {name}" for name, count in totals.remote.items())]
    )


def went_on(totals: Totals) -> str:
    """What a drone did that did not wait for answers; empty if it waited for all."""
    if not totals.went_on:
        return ""
    return f"flew on before {counted(totals.went_on, 'answer')}, and turned back for {totals.turns_back or 'none'}"


def never_ready(result: RunResult) -> Iterator[str]:
    """The servers that were of no use, and why."""
    return (f"{server} never became ready: {why}" for server, why in result.never_ready.items())


def left_undone(result: RunResult) -> Iterator[str]:
    """What a mission left undone at waypoints: demands, failed calls, and answers that it did not take."""
    if result.not_acted_on:
        one = len(result.not_acted_on) == 1
        answers = "the answer at" if one else "the answers at"
        yield f"not done: what {answers} {at_places(result.not_acted_on)} {'demands' if one else 'demand'}"
    if result.failed_calls:
        calls = "the call" if len(result.failed_calls) == 1 else "the calls"
        yield f"{calls} at {at_places(result.failed_calls)} failed, and the mission did nothing about it"
    if result.not_looked_at:
        answers = "the answer" if len(result.not_looked_at) == 1 else "the answers"
        yield f"not looked at: {answers} at {at_places(result.not_looked_at)}"
    for why, places in result.unanswered.items():
        calls = "the call" if len(places) == 1 else "the calls"
        yield f"without an answer: {calls} at {at_places(places)}, as {why}"
