"""The report: one HTML file that refers to nothing outside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.resources import files

from upwash.core.servers import CHECKING
from upwash.eventlog.narration import MEANINGS, counted
from upwash.eventlog.results import Totals
from upwash.report import tables
from upwash.report.charts import IDLE_HEIGHTS, draw_call_delays, draw_timeline, in_short, state_style
from upwash.report.map import draw_map, view_of
from upwash.report.markup import Markup, element, joined
from upwash.report.palette import stylesheet
from upwash.report.places import Places
from upwash.report.record import Record, ReportedCall

_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'"  # should a browser ever find a reference, it follows none
)
_WORST = 5


def write_page(records: Sequence[Record]) -> str:
    """The page about these runs, side by side where there is room."""
    title = "Flight report: " + ", ".join(record.name for record in records)
    rules = (files("upwash.report") / "style" / "page.css").read_text(encoding="utf-8")
    style = Markup(stylesheet() + rules)
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("title", title),
        element("style", style),
    )
    body = element("body", element("main", element("h1", title), *_sections(records)))
    page = element("html", head, body, lang="en", xmlns="http://www.w3.org/1999/xhtml")
    return f"<!DOCTYPE html>\n{page}\n"


def _sections(records: Sequence[Record]) -> list[Markup]:
    places = Places(sorted({server for record in records for server in record.servers}))
    return [
        *(element("p", what_it_came_to(record, records), class_="lead") for record in records),
        tables.totals(records),
        _call_delays(records, places),
        _map(records, places),
        _timeline(records, places),
        _section(records, "Worst calls", _worst_calls),
        _section(records, "Operations", tables.by_operation),
    ]


def _call_delays(records: Sequence[Record], places: Places) -> Markup:
    longest_call_s = max((call.delay_s for record in records for call in record.result.calls), default=1.0)
    last_waypoint = max(max(record.result.waypoints - 1, 0) for record in records)

    def draw(record: Record) -> Markup:
        chart = draw_call_delays(record, places, longest_s=longest_call_s, last_waypoint=last_waypoint)
        return joined(
            tables.scrolled(chart, f"Chart of call delays, {record.name}"),
            tables.folded("The calls as a table", tables.calls(record)),
        )

    note = _note(
        "A ring marks a call that waited for a server; the broad part of its line is the wait. "
        "A dashed line is what calls took on the drone, on average."
    )
    return _section(records, "Call delay by waypoint", draw, places.legend(), note)


def _map(records: Sequence[Record], places: Places) -> Markup:
    view = view_of(records)

    def draw(record: Record) -> Markup:
        return joined(
            tables.scrolled(draw_map(record, places, view), f"Map, {record.name}", style="scroll map"),
            tables.folded("The map as tables", tables.map_places(record), tables.waypoints(record)),
        )

    turns = " Hooked arrows: where the drone turned back for an answer."
    note = _note(
        "Marks: where each call was made, by the place where it ran. Dotted: the plan. Solid: the way "
        "flown. Dashed circles: the ranges of the servers, as configured. North is up."
        + _where_it_goes(records, turns)
    )
    return _section(records, "Map", draw, places.legend(), note)


def _timeline(records: Sequence[Record], places: Places) -> Markup:
    longest_s = max(record.result.mission_time_s for record in records)

    def draw(record: Record) -> Markup:
        chart = draw_timeline(record, places, longest_s=longest_s)
        return joined(
            tables.scrolled(chart, f"Servers over time, {record.name}"),
            tables.folded("The states as tables", tables.states(record), tables.steps(record)),
            *(
                [tables.folded("The answers that it went on before", tables.answers(record))]
                if record.answers
                else []
            ),
        )

    gone_on = (
        ' In the row "gone on" the drone was away with an answer open; it turned back in the high parts.'
    )
    note = _note(f"Strokes beneath a row are calls that ran on the server.{_where_it_goes(records, gone_on)}")
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


def what_it_came_to(record: Record, records: Sequence[Record]) -> str:
    """What the run came to, also against a run without offloading, where one is among the records."""
    result = record.result
    ended = "" if result.completed else " and was not completed"
    took = f"{record.name}: the mission took {result.mission_time_s:.1f} s under the policy {result.policy}{ended}."
    took += _going(result.totals)
    if not result.totals.remote:
        return f"{took} All {result.totals.calls} calls ran on the drone."
    paced = (
        " Calls on the drone were paced to take as long as on a slower computer." if record.plan.paced else ""
    )
    return f"{took} {_saving(record)}{_against_reference(record, records)}{paced}"


def _going(totals: Totals) -> str:
    if not totals.went_on:
        return ""
    return (
        f" The drone went on before {counted(totals.went_on, 'answer')} and turned back for {totals.turned_back}: "
        f"during {totals.hidden_s:.1f} s of the calls it did something else."
    )


def _saving(record: Record) -> str:
    if record.answers and record.result.completed:
        return "What offloading saved is not known: the drone went on before answers were there."
    local_only_s, saved_s = record.result.local_only_time_s(), record.saved_s
    if local_only_s is None or saved_s is None:
        return "What offloading saved is not known: that takes a completed mission with calls on the drone."
    return (
        f"With every call on the drone, at the local delays measured in it, it would have taken "
        f"{local_only_s:.1f} s: offloading saved {saved_s:z.1f} s, {100 * saved_s / local_only_s:z.0f} %."
    )


def _against_reference(record: Record, records: Sequence[Record]) -> str:
    """The difference to a mission over the same plan that was flown without offloading, where there is one."""
    for reference in records:
        same = reference.plan.waypoints_m == record.plan.waypoints_m and reference.result.completed
        if same and record.result.completed and reference.result.calls and not reference.result.totals.remote:
            longer_s = reference.result.mission_time_s
            less_s = longer_s - record.result.mission_time_s
            return f" It took {less_s:.1f} s less than {reference.name}, {100 * less_s / longer_s:.0f} %."
    return ""


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
    if not record.calls:
        return element("p", "No call was made.")
    worst = sorted(record.calls, key=lambda call: -call.result.delay_s)[:_WORST]
    return element("ol", *(_explained(call) for call in worst))


def _explained(call: ReportedCall) -> Markup:
    heading = element("strong", f"{in_short(call)}, at {call.result.at_s:.1f} s")
    reasons = [element("li", reason) for reason in call.reasons]
    return element("li", heading, element("ul", *reasons) if reasons else "")
