"""The flights in words and tables: what their page says on paper, without scripts, and to those who read numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from upwash.eventlog.progress import clock
from upwash.eventlog.reasons import CallText
from upwash.report import tables
from upwash.report.dots import draw_differences, draw_times
from upwash.report.endings import draw_endings, draw_urgent
from upwash.report.gallery import draw_findings
from upwash.report.groups import differences, groups_of, in_words, verdict, what_groups
from upwash.report.markup import Markup, element, joined
from upwash.report.numbering import are_a_fleet
from upwash.report.outcome import lasting, what_it_came_to
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record, reviewed_of

_SIDE_BY_SIDE = 3  # flights; more are summed up first, and folded each
_PICTURES = 60


def draw_sheet(records: Sequence[Record], shelf: PhotoShelf) -> Markup:
    """Everything about the flights, side by side; more than three flights stand below each other after a summary."""
    found = _Found(records, shelf)
    if len(records) <= _SIDE_BY_SIDE:
        return _whole(*_flights(records, records, found))
    folded = [
        element(
            "details",
            element("summary", element("strong", record.name), f": {lasting(record.result.mission_time_s)}"),
            *_flights([record], records, found),
            class_="flight-details",
        )
        for record in records
    ]
    each = element("section", element("h2", "Each flight"), *folded, class_="folded")
    summary = [*draw_urgent(records), *_summary(records)]
    together = element("section", *summary, class_="sheet together", aria_label="All flights together")
    return _whole(together, *found.of_fleet(), each)


def _summary(records: Sequence[Record]) -> list[Markup]:
    """Of many flights: the verdict, the times and their differences as figures, and a table with a row a flight."""
    drawn = [element("p", verdict(records), class_="lead")]
    groups, differing = groups_of(records), differences(records)
    if groups:
        drawn.append(
            _figure(
                f"Mission time by {what_groups(records)}",
                "A dot is a completed flight. The upright line is the mean, and the bar across it where the true "
                "mean lies with a probability of 95 %.",
                draw_times(groups),
            )
        )
    if differing:
        drawn.append(
            _figure(
                "Differences within the same scenario and seed",
                "A dot is a pair of flights; left of 0 the first policy was the faster. Each row has a scale of its "
                "own.",
                draw_differences(differing),
                element("ul", *(element("li", in_words(each)) for each in differing)),
            )
        )
    drawn.append(element("section", element("h2", "All flights"), tables.flights(records)))
    return drawn


def _figure(heading: str, note: str, drawing: Markup, *after: Markup) -> Markup:
    return element(
        "section",
        element("h2", heading),
        element("p", note, class_="note"),
        tables.scrolled(drawing, heading),
        *after,
    )


def _whole(*parts: Markup) -> Markup:
    return element("section", *parts, class_="sheet", aria_label="In words and tables")


class _Found:
    """Draws what was found: by a fleet in one list, by one drone flight by flight."""

    def __init__(self, records: Sequence[Record], shelf: PhotoShelf) -> None:
        self._shelf = shelf
        self._all = reviewed_of(records)
        self._names = [record.name for record in records]
        self._is_fleet = are_a_fleet([record.drone for record in records])
        beside = (
            len(records) if len(records) <= _SIDE_BY_SIDE else sum(bool(each.findings) for each in records)
        )
        self._pictures = max(1, _PICTURES // max(1, beside))

    def of_fleet(self) -> Sequence[Markup]:
        """The list of the whole fleet; nothing if the flights are no fleet, or found nothing."""
        if not self._is_fleet or not self._all.everything:
            return []
        drawn = draw_findings(self._all, self._shelf, most=_PICTURES, whose=True)
        return [element("section", element("h2", "Findings"), drawn)]

    def of_flights(self, records: Sequence[Record]) -> Sequence[Markup]:
        """The list of each of these flights; nothing if the flights are a fleet, or found nothing."""
        told = [record for record in records if record.findings]
        return [_section(told, "Findings", self._of)] if told and not self._is_fleet else []

    def _of(self, record: Record) -> Markup:
        own = self._all.of_flight(self._names.index(record.name))
        return draw_findings(own, self._shelf, most=self._pictures)


def _flights(shown: Sequence[Record], records: Sequence[Record], found: _Found) -> list[Markup]:
    """The flights that are shown, of the records of a page."""
    outcomes = [record.outcome for record in records]
    return [
        draw_endings(shown),
        *(element("p", what_it_came_to(record.outcome, outcomes), class_="lead") for record in shown),
        tables.totals(shown),
        *(found.of_fleet() if len(shown) == len(records) else []),
        *found.of_flights(shown),
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


def _explained(worst: CallText) -> Markup:
    call, outcome = worst.call, worst.call.outcome
    where = "before the first waypoint" if call.waypoint is None else f"waypoint {call.waypoint}"
    at = f"ended at {clock(call.at_s + outcome.delay_s)}, {call.loss_s:.1f} s lost"
    heading = element("strong", f"{where}: {outcome.operation}, {at}")
    reasons = [element("li", reason) for reason in worst.reasons]
    return element("li", heading, element("ul", *reasons) if reasons else "")
