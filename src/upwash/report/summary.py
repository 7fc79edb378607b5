"""The summary of many flights, which stands before each of them."""

from __future__ import annotations

from collections.abc import Sequence

from upwash.report import tables
from upwash.report.dots import draw_differences, draw_times
from upwash.report.groups import differences, groups_of, in_words, verdict, what_groups
from upwash.report.markup import Markup, element
from upwash.report.record import Record


def draw_summary(records: Sequence[Record]) -> list[Markup]:
    """The verdict, the times and their differences as figures, and a table with a row a flight."""
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
