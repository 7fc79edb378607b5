"""What a page says on paper and without scripts: how the flights ended, their results, and what they found."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from upwash.core.operation import title_of
from upwash.eventlog.reasons import CallText
from upwash.report import tables
from upwash.report.dots import draw_differences, draw_times
from upwash.report.endings import draw_ending, draw_endings
from upwash.report.gallery import draw_findings
from upwash.report.groups import differences, groups_of, in_words, verdict, what_groups
from upwash.report.markup import Markup, element
from upwash.report.numbering import are_a_fleet
from upwash.report.outcome import what_it_came_to
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record, reviewed_of
from upwash.support.text import clock

_SIDE_BY_SIDE = 3  # flights; more are summed up
_PICTURES = 60
_REST = "upwash report writes each call with --csv FILE, each place with --geojson FILE, and all results with --json."

_OF_TIMES = (
    "A dot is a completed flight. The upright line is the mean, and the bar across it where the true mean lies "
    "with a probability of 95 %."
)
_OF_DIFFERENCES = (
    "A dot is a pair of flights; left of 0 the first policy was the faster. Each row has a scale of its own."
)


def draw_sheet(records: Sequence[Record], shelf: PhotoShelf) -> Markup:
    """The flights side by side; of more than three a summary."""
    if len(records) > _SIDE_BY_SIDE:
        summary = [draw_endings(records), *_summary(records)]
        parts = [element("section", *summary, class_="sheet together", aria_label="All flights together")]
    else:
        s = "s" if len(records) > 1 else ""
        parts = [_section(records, f"How the flight{s} ended", draw_ending), *_results(records)]
    parts += _found(records, shelf)
    if len(records) <= _SIDE_BY_SIDE:
        parts += [tables.totals(records), _section(records, "Worst calls", _worst_calls)]
    rest = element("p", _REST, class_="note")
    return element("section", *parts, rest, class_="sheet", aria_label="In words and tables")


def _results(records: Sequence[Record]) -> list[Markup]:
    outcomes = [each for record in records if (each := record.outcome(record.name)) is not None]
    return [element("p", what_it_came_to(each, outcomes), class_="lead") for each in outcomes]


def _summary(records: Sequence[Record]) -> list[Markup]:
    """The verdict, the times and their differences as figures, and a table with a row a flight."""
    drawn = [element("p", verdict(records), class_="lead")]
    if groups := groups_of(records):
        drawn.append(_figure(f"Mission time by {what_groups(records)}", _OF_TIMES, draw_times(groups)))
    if differing := differences(records):
        listed = element("ul", *(element("li", in_words(each)) for each in differing))
        heading = "Differences within the same scenario and seed"
        drawn.append(_figure(heading, _OF_DIFFERENCES, draw_differences(differing), listed))
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


def _found(records: Sequence[Record], shelf: PhotoShelf) -> list[Markup]:
    """What was found: by a fleet in one list, by one drone flight by flight; nothing where nothing was."""
    found = reviewed_of(records)
    told = [record for record in records if record.findings]
    if not told:
        return []
    if are_a_fleet([record.drone for record in records]):
        drawn = draw_findings(found, shelf, most=_PICTURES, whose=True)
        return [element("section", element("h2", "Findings"), drawn)]
    names, most = [record.name for record in records], max(1, _PICTURES // len(told))

    def own(record: Record) -> Markup:
        return draw_findings(found.of_flight(names.index(record.name)), shelf, most=most)

    return [_section(told, "Findings", own)]


def _section(records: Sequence[Record], heading: str, draw: Callable[[Record], Markup]) -> Markup:
    """The same of each flight, side by side where there is room."""
    named = len(records) > 1
    runs = [
        element("div", element("h3", record.name) if named else Markup(), draw(record), class_="run")
        for record in records
    ]
    return element("section", element("h2", heading), element("div", *runs, class_="runs"))


def _worst_calls(record: Record) -> Markup:
    if not record.worst:
        return element("p", "No call took longer than was expected of the best place for it.")
    return element("ol", *map(_explained, record.worst))


def _explained(worst: CallText) -> Markup:
    call, outcome = worst.call, worst.call.outcome
    where = "before the first waypoint" if call.waypoint is None else f"waypoint {call.waypoint}"
    at = f"ended at {clock(call.at_s + outcome.delay_s)}, {call.loss_s:.1f} s lost"
    heading = element("strong", f"{where}: {title_of(outcome.operation)}, {at}")
    reasons = [element("li", reason) for reason in worst.reasons]
    return element("li", heading, element("ul", *reasons) if reasons else "")
