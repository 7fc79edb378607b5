"""The servers over the time of the mission: a row each, with its states and the calls that ran there."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

from upwash.core.knowledge.servers import CHECKING, State
from upwash.eventlog.narration import counted, named
from upwash.report.axes import LEFT, RIGHT, TOP, WIDTH, Axis, figure, label
from upwash.report.going import OpenAnswer
from upwash.report.markup import Markup, element, joined
from upwash.report.places import Places, name_of
from upwash.report.record import Record, Stretch

IDLE_HEIGHTS = {State.AVL: 3.0, State.AVL_R: 8.0}  # shape as well as colour: idle states are thin
_ROW, _BAR = 34.0, 20.0
_WIDE_ENOUGH_FOR_TEXT = 46.0
_NARROW, _NARROWEST = 4.0, 0.5  # bars, of which the former have no border, and may not be narrower
_MANY = (
    200  # stretches of a server, or calls on it, above which what is as narrow as a stroke has none to itself
)
_STROKE = 1.5


def draw_timeline(record: Record, places: Places, *, longest_s: float) -> Markup:
    """The states of each server over the mission, a row each, with the calls that ran there beneath."""
    left = LEFT + 40
    x = Axis(0, longest_s, left, WIDTH - RIGHT)
    bottom = TOP + _ROW * (len(record.servers) + bool(record.answers))
    stroke_s = _STROKE * (longest_s or 1.0) / (WIDTH - RIGHT - left)
    calls_at_s: dict[str | None, list[float]] = defaultdict(list)
    for call in record.result.calls:
        calls_at_s[call.server].append(call.at_s)
    rows: list[Markup] = []
    for row, server in enumerate(record.servers):
        top = TOP + row * _ROW
        rows.append(label(server, left - 8, top + 15, anchor="end", style="row"))
        stretches = _drawable(record.stretches.get(server, ()), stroke_s)
        rows += [_draw_stretch(stretch, x, top) for stretch in stretches]
        rows += [
            element(
                "line", x1=x(at_s), x2=x(at_s), y1=top + _BAR + 2, y2=top + _BAR + 7,
                class_=f"stem {places.colour(server)}",
            )
            for at_s in _apart(calls_at_s[server], stroke_s)
        ]  # fmt: skip
    if record.answers:
        rows += _draw_answers(record.answers, x, bottom - _ROW, left, stroke_s)
    along = [
        joined(
            element("line", x1=x(value), x2=x(value), y1=TOP, y2=bottom, class_="grid"),
            label(f"{value:g}", x(value), bottom + 16),
        )
        for value in x.ticks(8)
    ]
    return figure(
        f"States of the servers over the mission, {record.name}",
        _states_in_words(record),
        WIDTH,
        bottom + 40,
        *along,
        *rows,
        label("seconds of the mission", (left + WIDTH - RIGHT) / 2, bottom + 34, style="axis"),
    )


def is_coarse(record: Record) -> bool:
    """Whether what is as narrow as a stroke has none to itself."""
    return any(len(stretches) > _MANY for stretches in record.stretches.values())


def _drawable(stretches: Sequence[Stretch], stroke_s: float) -> Sequence[Stretch]:
    """The stretches; where there are many, in each stroke's time the state alone that lasted longest in it."""
    if len(stretches) <= _MANY:
        return stretches
    spent_s: dict[int, dict[State, float]] = defaultdict(lambda: defaultdict(float))
    for stretch in stretches:
        for stroke in range(int(stretch.from_s / stroke_s), int(stretch.to_s / stroke_s) + 1):
            begins_s, ends_s = stroke * stroke_s, (stroke + 1) * stroke_s
            spent_s[stroke][stretch.state] += min(ends_s, stretch.to_s) - max(begins_s, stretch.from_s)
    longest = {stroke: max(states, key=states.__getitem__) for stroke, states in spent_s.items()}
    return [
        Stretch(state, first * stroke_s, (last + 1) * stroke_s, "for the most part")
        for state, first, last in _runs(sorted(longest.items()))
    ]


def _runs(states: Iterable[tuple[int, State]]) -> Iterator[tuple[State, int, int]]:
    """What follows each other in the same state: the state, the first and the last number."""
    for state, group in itertools.groupby(states, key=lambda each: each[1]):
        numbers = [number for number, _ in group]
        yield state, numbers[0], numbers[-1]


def _apart(times_s: Sequence[float], stroke_s: float) -> Iterable[float]:
    """The times; where there are many, one alone of those that one stroke would hide."""
    if len(times_s) <= _MANY:
        return times_s
    return {int(at_s / stroke_s): at_s for at_s in times_s}.values()


def _draw_answers(
    answers: Sequence[OpenAnswer], x: Axis, top: float, left: float, stroke_s: float
) -> Iterator[Markup]:
    """The times in which the drone had gone on, thin where it did not have to turn back."""
    yield label("gone on", left - 8, top + 15, anchor="end", style="row")
    if len(answers) > _MANY:
        answers = list(
            {(int(each.from_s / stroke_s), each.turned_at is None): each for each in answers}.values()
        )
    for each in answers:
        height = 8.0 if each.turned_at is None else _BAR
        back = "" if each.turned_at is None else ", turned back"
        about = f"{named(each.waypoint)}: gone on from {each.from_s:.1f} to {each.to_s:.1f} s{back}"
        yield element(
            "rect", element("title", about), x=x(each.from_s), y=top + (_BAR - height) / 2,
            width=max(_NARROWEST, x(each.to_s) - x(each.from_s)), height=height, class_="state gone-on",
        )  # fmt: skip


def _draw_stretch(stretch: Stretch, x: Axis, top: float) -> Markup:
    start, width = x(stretch.from_s), max(_NARROWEST, x(stretch.to_s) - x(stretch.from_s))
    why = f" ({stretch.why})" if stretch.why else ""
    about = element("title", f"{stretch.state} from {stretch.from_s:.1f} to {stretch.to_s:.1f} s{why}")
    height = IDLE_HEIGHTS.get(stretch.state, _BAR)
    bar = element(
        "rect", about, x=start, y=top + (_BAR - height) / 2, width=width, height=height,
        class_=f"state {state_style(stretch.state)}{' narrow' if width < _NARROW else ''}",
    )  # fmt: skip
    if stretch.state in IDLE_HEIGHTS or width < _WIDE_ENOUGH_FOR_TEXT + 4 * len(stretch.state):
        return bar
    return joined(bar, label(stretch.state, start + width / 2, top + 14, style="in-bar"))


def state_style(state: State) -> str:
    """The class that draws a state."""
    return "state-check" if state in CHECKING else f"state-{state.lower()}"


def state_seconds(stretches: Sequence[Stretch]) -> dict[State, float]:
    """How long the server was in each state."""
    seconds: dict[State, float] = dict.fromkeys(State, 0.0)
    for stretch in stretches:
        seconds[stretch.state] += stretch.to_s - stretch.from_s
    return seconds


def _states_in_words(record: Record) -> str:
    told = []
    for server, stretches in record.stretches.items():
        spent = ", ".join(
            f"{state} {seconds_s:.0f} s" for state, seconds_s in state_seconds(stretches).items() if seconds_s
        )
        told.append(f"{name_of(server)}: {spent}")
    if record.answers:
        told.append(f"gone on before {counted(len(record.answers), 'answer')}")
    return "; ".join(told) + "."
