"""How flights ended, for whoever opens the page: what a person has to know before they read on."""

from __future__ import annotations

from collections.abc import Sequence

from upwash.report.markup import Markup, element
from upwash.report.record import Record
from upwash.support.text import counted

_MOST = 12  # sentences of a block


def draw_endings(records: Sequence[Record]) -> Markup:
    """A red block where a person had to act, an amber one for what went wrong, or that all went well; of each run."""
    blocks = [block for record in records for block in _ending(record, named=len(records) > 1)]
    heading = "How the flight ended" if len(records) == 1 else "How the flights ended"
    return element("section", element("h2", heading), *blocks)


def _ending(record: Record, *, named: bool) -> list[Markup]:
    of = f"{record.name}: " if named else ""
    notices = record.notices
    waypoints = record.result.waypoints
    reached = "its waypoint reached" if waypoints == 1 else f"all {waypoints} waypoints reached"
    blocks = []
    if notices.urgent:
        blocks.append(_block(f"{of}A person had to act, or has to know", notices.urgent, "urgent"))
    else:
        blocks.append(element("p", f"{of}The mission was completed, {reached}."))
    if notices.cautions:
        blocks.append(_block(f"{of}What went wrong", notices.cautions, "caution"))
    return blocks


def draw_urgent(records: Sequence[Record]) -> list[Markup]:
    """One block for many runs, with the sentences of those that did not end well, and how many have others."""
    urgent = [f"{record.name}: {sentence}" for record in records for sentence in record.notices.urgent]
    warned = sum(bool(record.notices.cautions) for record in records)
    ill = sum(bool(record.notices.urgent) for record in records)
    blocks = []
    if urgent:
        heading = f"In {counted(ill, 'flight')} a person had to act, or has to know"
        blocks.append(_block(heading, urgent, "urgent"))
    if warned:
        heading = f"In {counted(warned, 'flight')} something went wrong on the way: each tells it below"
        blocks.append(_block(heading, (), "caution"))
    return blocks


def _block(heading: str, sentences: Sequence[str], style: str) -> Markup:
    items = [element("li", sentence) for sentence in sentences[:_MOST]]
    if (more := len(sentences) - _MOST) > 0:
        items.append(element("li", f"And {more} more, which the event log tells."))
    told = [element("ul", *items)] if items else []
    return element("div", element("p", element("strong", f"{heading}.")), *told, class_=f"notice {style}")
