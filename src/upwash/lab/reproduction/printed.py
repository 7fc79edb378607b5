"""What the thesis prints, with its sources, and where it contradicts itself."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from functools import lru_cache
from importlib.resources import files
from typing import NamedTuple

_LOCAL_ONLY, _OFFLOADING, _GAIN = "mission_time_local_only", "mission_time_offloading", "time_gain"
_ROUNDED_AWAY = 0.5  # percent that a printed gain may be from that of the printed times


class Key(NamedTuple):
    """What a printed figure is of."""

    experiment: str
    setup: str
    quantity: str


class Printed(NamedTuple):
    """One figure, and where it is printed."""

    key: Key
    value: float
    unit: str
    source: str


def printed_figures() -> dict[tuple[str, str, str], float]:
    """The thesis's figures by experiment, set-up and quantity; of two for one, its table's."""
    return {each.key: each.value for each in reversed(_printed())}


def contradictions() -> Iterator[str]:
    """Where the thesis prints two figures of one thing, or a gain that its own times do not make."""
    figures, sources = printed_figures(), {each.key: each.source for each in reversed(_printed())}
    for each in _printed():
        where = f"{each.key.experiment}, {each.key.setup}"
        ruling = figures[each.key]
        if each.value != ruling:
            what = each.key.quantity.replace("_", " ")
            yield f"{where}: {what} is {ruling:g} {each.unit} in {sources[each.key]}, {each.value:g} in {each.source}"
        elif each.key.quantity == _GAIN:
            local, offloading = (
                figures[each.key._replace(quantity=quantity)] for quantity in (_LOCAL_ONLY, _OFFLOADING)
            )
            own = 100 * (1 - offloading / local)
            if abs(own - each.value) > _ROUNDED_AWAY:
                yield (
                    f"{where}: {each.source} prints a gain of {each.value:g} %; "
                    f"its own times, {offloading:g} instead of {local:g} min, make {own:.1f} %"
                )


@lru_cache
def _printed() -> tuple[Printed, ...]:
    text = (files("upwash.lab.reproduction") / "thesis" / "printed.csv").read_text(encoding="utf-8")
    return tuple(
        Printed(
            Key(row["experiment"], row["setup"], row["quantity"]),
            float(row["value"]),
            row["unit"],
            row["source"],
        )
        for row in csv.DictReader(text.splitlines())
    )
