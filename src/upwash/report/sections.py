"""The parts of the report about one flight, or about few side by side where there is room."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from upwash.core.knowledge.servers import CHECKING
from upwash.eventlog.narration import MEANINGS
from upwash.report import tables
from upwash.report.delays import MANY, draw_call_delays, in_short, waypoints_a_box
from upwash.report.endings import draw_endings
from upwash.report.findings import MOST_PICTURED
from upwash.report.gallery import draw_findings
from upwash.report.map import draw_map
from upwash.report.markup import Markup, element, joined
from upwash.report.outcome import what_it_came_to
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record, WorstCall
from upwash.report.scales import Scales
from upwash.report.timeline import IDLE_HEIGHTS, draw_timeline, is_coarse, state_style


def draw_sections(
    shown: Sequence[Record], records: Sequence[Record], scales: Scales, shelf: PhotoShelf, *, pictures: int
) -> list[Markup]:
    """Everything about the flights that are shown, of the records that the page is about; so many pictures each."""
    told = [record for record in shown if record.findings]
    findings = (
        [_section(told, "Findings", lambda record: draw_findings(record, shelf, pictures))] if told else []
    )
    outcomes = [record.outcome for record in records]
    return [
        draw_endings(shown),
        *(element("p", what_it_came_to(record.outcome, outcomes), class_="lead") for record in shown),
        tables.totals(shown),
        *findings,
        _call_delays(shown, scales),
        _map(shown, scales),
        _timeline(shown, scales),
        _section(shown, "Worst calls", _worst_calls),
        _section(shown, "Operations", tables.by_operation),
    ]


def _call_delays(records: Sequence[Record], scales: Scales) -> Markup:
    def draw(record: Record) -> Markup:
        chart = draw_call_delays(
            record, scales.places, longest_s=scales.longest_call_s, last_waypoint=scales.last_waypoint
        )
        return joined(
            tables.scrolled(chart, f"Chart of call delays, {record.name}"),
            tables.folded("The calls as a table", tables.calls(record)),
        )

    marks = (
        "A ring marks a call that waited for a server; the broad part of its line is the wait."
        if any(len(record.calls) <= MANY for record in records)
        else ""
    )
    size = waypoints_a_box(scales.last_waypoint)
    boxes = (
        f"Of more than {MANY} calls, a mark is the middle one of those at {size} waypoints in a row, the bar has "
        "half of them, the line all; strokes beneath the axis are calls that waited for a server."
        if any(len(record.calls) > MANY for record in records)
        else ""
    )
    means = "A dashed line is what calls took on the drone, on average."
    note = _note(" ".join(filter(None, [marks, boxes, means])))
    return _section(records, "Call delay by waypoint", draw, scales.places.legend(), note)


def _map(records: Sequence[Record], scales: Scales) -> Markup:
    def draw(record: Record) -> Markup:
        drawing = draw_map(record, scales.places, scales.view)
        return joined(
            tables.scrolled(drawing, f"Map, {record.name}", style="scroll map"),
            tables.folded(
                "The map as tables",
                tables.map_places(record),
                tables.measured_places(record),
                tables.waypoints(record),
            ),
        )

    most = max(len(record.findings) for record in records)
    later = (
        f"the first {MOST_PICTURED} findings; rings: later ones" if most > MOST_PICTURED else "the findings"
    )
    numbers = f" Numbers: {later}." if most else ""
    measured = (
        " Discs: where servers without a range were asked something; the fuller, the more was answered."
        if any(record.measured for record in records)
        else ""
    )
    turns = " Hooked arrows: where the drone turned back for an answer."
    note = _note(
        "Marks: where each call was made, by the place where it ran. Dotted: the plan. Solid: the way "
        "flown. Dashed circles: the ranges of the servers, as configured. North is up."
        + measured
        + numbers
        + _where_it_goes(records, turns)
    )
    return _section(records, "Map", draw, scales.places.legend(), note)


def _timeline(records: Sequence[Record], scales: Scales) -> Markup:
    def draw(record: Record) -> Markup:
        chart = draw_timeline(record, scales.places, longest_s=scales.longest_s)
        return joined(
            tables.scrolled(chart, f"Servers over time, {record.name}"),
            tables.folded("The states as tables", tables.states(record), tables.steps(record)),
            *(
                [tables.folded("The answers that it went on before", tables.answers(record))]
                if record.answers
                else []
            ),
        )

    coarse = (
        " Where states follow each other closely, the one that lasted longest is drawn."
        if any(map(is_coarse, records))
        else ""
    )
    gone_on = (
        ' In the row "gone on" the drone was away with an answer open; it turned back in the high parts.'
    )
    strokes = "Strokes beneath a row are calls that ran on the server."
    note = _note(f"{strokes}{coarse}{_where_it_goes(records, gone_on)}")
    return _section(records, "Servers over time", draw, _states_legend(), note)


def _section(
    records: Sequence[Record], heading: str, draw: Callable[[Record], Markup], *before: Markup
) -> Markup:
    """The same of each run, side by side where there is room."""
    runs = [
        element(
            "div", element("h3", record.name) if len(records) > 1 else Markup(), draw(record), class_="run"
        )
        for record in records
    ]
    return element("section", element("h2", heading), *before, element("div", *runs, class_="runs"))


def _where_it_goes(records: Sequence[Record], words: str) -> str:
    """The words, where a drone went on before an answer."""
    return words if any(record.answers for record in records) else ""


def _note(text: str) -> Markup:
    return element("p", text, class_="note")


def _states_legend() -> Markup:
    entries = []
    for state, meaning in MEANINGS.items():
        height = IDLE_HEIGHTS.get(state, 14.0)
        bar = element(
            "rect", x=1, y=8 - height / 2, width=22, height=height, class_=f"state {state_style(state)}"
        )
        picture = element("svg", bar, viewBox="0 0 24 16", width=24, height=16, aria_hidden="true")
        names = ", ".join(sorted(CHECKING)) if state in CHECKING else state.value
        entries.append(element("span", picture, f"{names}: {meaning}", class_="entry"))
    return element("p", *entries, class_="legend")


def _worst_calls(record: Record) -> Markup:
    if not record.worst:
        return element("p", "No call was made.")
    return element("ol", *map(_explained, record.worst))


def _explained(worst: WorstCall) -> Markup:
    heading = element("strong", f"{in_short(worst.call)}, at {worst.call.result.at_s:.1f} s")
    reasons = [element("li", reason) for reason in worst.reasons]
    return element("li", heading, element("ul", *reasons) if reasons else "")
