"""How flights ended: what a person has to know before they read on."""

from __future__ import annotations

from collections.abc import Sequence

from upwash.eventlog.ending import reached
from upwash.report.markup import Markup, element, joined
from upwash.report.record import Record
from upwash.support.text import counted

_MOST = 20  # sentences of a flight, or flights
_ACT = "a person had to act, or has to know"


def draw_ending(record: Record) -> Markup:
    """A red block where a person had to act, an amber one for what went wrong, or that all went well."""
    ending = record.ending
    well = element("p", f"The mission was completed, {reached(record.result)}.")
    return joined(
        _block(f"A{_ACT[1:]}", ending.urgent, "urgent") if ending.urgent else well,
        _block("What went wrong", ending.cautions, "caution"),
    )


def draw_endings(records: Sequence[Record]) -> Markup:
    """The same of many flights, under their names; nothing of a flight that has no such sentences."""
    urgent = [_named(record, record.ending.urgent) for record in records if record.ending.urgent]
    cautions = [_named(record, record.ending.cautions) for record in records if record.ending.cautions]
    return joined(
        _block(f"In {counted(len(urgent), 'flight')} {_ACT}", urgent, "urgent"),
        _block(f"In {counted(len(cautions), 'flight')} something went wrong on the way", cautions, "caution"),
    )


def _named(record: Record, sentences: Sequence[str]) -> Markup:
    return joined(f"{record.name}: ", _listed(sentences))


def _block(heading: str, items: Sequence[str], style: str) -> Markup:
    """A block of these items; nothing without any."""
    if not items:
        return Markup()
    head = element("p", element("strong", f"{heading}."))
    return element("div", head, _listed(items), class_=f"notice {style}")


def _listed(items: Sequence[str]) -> Markup:
    listed = [element("li", item) for item in items[:_MOST]]
    if (more := len(items) - _MOST) > 0:
        listed.append(element("li", f"And {more} more: the event log tells all."))
    return element("ul", *listed)
