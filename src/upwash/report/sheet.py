"""The flights in words and tables: what their page says on paper, without scripts, and to those who read numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from upwash.eventlog.progress import clock
from upwash.report import tables
from upwash.report.endings import draw_endings, draw_urgent
from upwash.report.gallery import draw_findings
from upwash.report.markup import Markup, element, joined
from upwash.report.numbering import PlacedFinding
from upwash.report.outcome import lasting, what_it_came_to
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record, WorstCall, findings_of
from upwash.report.summary import draw_summary

_SIDE_BY_SIDE = 3  # flights; more are summed up first, and folded each
_PICTURES = 60


def draw_sheet(records: Sequence[Record], shelf: PhotoShelf) -> Markup:
    """Everything about the flights, side by side; more than three flights stand below each other after a summary."""
    found = findings_of(records)
    if len(records) <= _SIDE_BY_SIDE:
        parts = _flights(records, records, found, shelf, pictures=_PICTURES // len(records))
        return _whole(*parts)
    pictures = max(1, _PICTURES // max(1, sum(bool(record.findings) for record in records)))
    folded = [
        element(
            "details",
            element("summary", element("strong", record.name), f": {lasting(record.result.mission_time_s)}"),
            *_flights([record], records, found, shelf, pictures=pictures),
            class_="flight-details",
        )
        for record in records
    ]
    each = element("section", element("h2", "Each flight"), *folded, class_="folded")
    summary = [*draw_urgent(records), *draw_summary(records)]
    together = element("section", *summary, class_="sheet together", aria_label="All flights together")
    return _whole(together, each)


def _whole(*parts: Markup) -> Markup:
    return element("section", *parts, class_="sheet", aria_label="In words and tables")


def _flights(
    shown: Sequence[Record],
    records: Sequence[Record],
    found: Sequence[PlacedFinding],
    shelf: PhotoShelf,
    *,
    pictures: int,
) -> list[Markup]:
    """The flights that are shown, of the records of a page; `pictures` limits the pictures of each flight."""
    told = [record for record in shown if record.findings]

    def findings(record: Record) -> Markup:
        own = [each for each in found if each.flight.log == record.name]
        return draw_findings(record, own, shelf, log=records.index(record), most=pictures)

    outcomes = [record.outcome for record in records]
    return [
        draw_endings(shown),
        *(element("p", what_it_came_to(record.outcome, outcomes), class_="lead") for record in shown),
        tables.totals(shown),
        *([_section(told, "Findings", findings)] if told else []),
        _section(shown, "Worst calls", _worst_calls),
        _section(shown, "Calls", _calls),
        _section(shown, "Servers and places", _places),
    ]


def _section(records: Sequence[Record], heading: str, draw: Callable[[Record], Markup]) -> Markup:
    """The same of each run, side by side where there is room."""
    runs = [
        element(
            "div", element("h3", record.name) if len(records) > 1 else Markup(), draw(record), class_="run"
        )
        for record in records
    ]
    return element("section", element("h2", heading), element("div", *runs, class_="runs"))


def _calls(record: Record) -> Markup:
    gone_on = [tables.answers(record)] if record.answers else []
    return joined(tables.by_operation(record), tables.folded("Each call", tables.calls(record), *gone_on))


def _places(record: Record) -> Markup:
    return joined(
        tables.states(record),
        tables.folded(
            "Each state, range and waypoint",
            tables.steps(record),
            tables.map_places(record),
            tables.measured_places(record),
            tables.waypoints(record),
        ),
    )


def _worst_calls(record: Record) -> Markup:
    if not record.worst:
        return element("p", "No call took longer than was expected of the best place for it.")
    return element("ol", *map(_explained, record.worst))


def _explained(worst: WorstCall) -> Markup:
    result = worst.call.result
    where = "before the first waypoint" if result.waypoint is None else f"waypoint {result.waypoint}"
    at = f"at {clock(result.at_s)}, {worst.loss_s:.1f} s lost"
    heading = element("strong", f"{where}: {result.operation}, {at}")
    reasons = [element("li", reason) for reason in worst.reasons]
    return element("li", heading, element("ul", *reasons) if reasons else "")
