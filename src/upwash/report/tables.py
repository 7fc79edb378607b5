"""The tables of a report: the results of flights."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

from upwash.core.operation import titles
from upwash.eventlog.ending import by_place
from upwash.eventlog.results import RunResult, mean_local_delay_s
from upwash.report.markup import Markup, element
from upwash.report.record import Record
from upwash.support.text import lasting

_MOST_ROWS = 300  # of a table
_AT_EITHER_END = 100
Item = TypeVar("Item")


def table(
    caption: str,
    heads: Sequence[str],
    items: Sequence[Item],
    row_of: Callable[[Item], Sequence[str]],
    *,
    rest: str,
) -> Markup:
    """A table with a row for each item, named by its first cell: of many the first and the last, and the `rest`.

    No row is made for an item that is left out: a long flight has more findings than memory has room for as markup.
    """
    first, last, gap = items, items[:0], list[Markup]()
    if len(items) > _MOST_ROWS:
        first, last = items[:_AT_EITHER_END], items[-_AT_EITHER_END:]
        left_out = f"{len(items) - 2 * _AT_EITHER_END} rows are left out: {rest}"
        gap = [element("tr", element("td", left_out, colspan=str(len(heads))))]
    body = [*(_row(row_of(item)) for item in first), *gap, *(_row(row_of(item)) for item in last)]
    return framed(caption, list(map(_head, heads)), body)


def framed(caption: str, heads: Sequence[Markup], rows: Sequence[Markup]) -> Markup:
    """A table of these cells at its head and these rows, which scrolls by itself."""
    head, body = element("thead", element("tr", *heads)), element("tbody", *rows) if rows else Markup()
    return scrolled(element("table", element("caption", caption), head, body), caption)


def _row(cells: Sequence[str]) -> Markup:
    return element("tr", element("th", cells[0], scope="row"), *(element("td", cell) for cell in cells[1:]))


def _head(head: str) -> Markup:
    return element("th", head, scope="col") if head else element("td", "")


def scrolled(content: Markup, name: str) -> Markup:
    """A region that scrolls by itself on narrow screens, by keyboard too."""
    return element("div", content, class_="scroll", tabindex="0", role="group", aria_label=name)


def totals(records: Sequence[Record]) -> Markup:
    """The results of the flights, a column each."""
    heads = ["", *(record.name for record in records)]
    rows = list(total_rows([record.result for record in records]))
    return table("Totals", heads, rows, lambda row: [row[0], *row[1]], rest="--csv FILE writes every call")


def total_rows(results: Sequence[RunResult]) -> Iterator[tuple[str, list[str]]]:
    """The results of the flights: rows with a name and a value for each flight."""
    for name, value in _ALWAYS.items():
        yield name, list(map(value, results))
    for kind in _WHERE_SOME:
        told = {
            name: [str(getattr(result.totals, field)) for result in results] for field, name in kind.items()
        }
        if any(value != "0" for values in told.values() for value in values):
            yield from told.items()
    if any(result.totals.hidden_s for result in results):
        yield "of the calls' time hidden", [lasting(result.totals.hidden_s) for result in results]
    if any(result.energy for result in results):
        yield "drawn from the battery", list(map(_drawn, results))
    yield from _of_operations(results)


def _of_operations(results: Sequence[RunResult]) -> Iterator[tuple[str, list[str]]]:
    """What a call of each operation took on average, and what it took on the drone alone."""
    local_s = [mean_local_delay_s(result.calls) for result in results]
    delays_s = [dict[str, list[float]]() for _ in results]
    for result, delays in zip(results, delays_s, strict=True):
        for call in result.calls:
            delays.setdefault(call.operation, []).append(call.delay_s)
    for operation, title in titles(sorted({name for delays in delays_s for name in delays})).items():
        means = [_mean(delays.get(operation)) for delays in delays_s]
        alone = [f"{local[operation]:.2f} s" if operation in local else "not measured" for local in local_s]
        told = [f"{mean}, {own}" if mean else "" for mean, own in zip(means, alone, strict=True)]
        yield f"mean of {title}, and on the drone", told


def _mean(delays_s: Sequence[float] | None) -> str:
    return f"{sum(delays_s) / len(delays_s):.2f} s" if delays_s else ""


def _reached(result: RunResult) -> str:
    return f"{result.waypoints - len(result.undone)} of {result.waypoints}"


def _waits(result: RunResult) -> str:
    return f"{result.totals.waits}, {result.totals.waits_failed}"


def _local_only(result: RunResult) -> str:
    local_only_s = result.local_only_time_s()
    return "not known" if local_only_s is None else lasting(local_only_s)


def _saved(result: RunResult) -> str:
    local_only_s, saved_s = result.local_only_time_s(), result.saved_s()
    if not local_only_s or saved_s is None:
        return "not known"
    return f"{lasting(saved_s)}, {100 * saved_s / local_only_s:z.0f} %"


def _drawn(result: RunResult) -> str:
    energy = result.energy
    if energy is None:
        return "not metered"
    return f"{energy.total_wh:.1f} Wh, of which {energy.hover_wh:.1f} Wh in hover"


_ALWAYS: Mapping[str, Callable[[RunResult], str]] = {
    "policy": lambda run: run.policy,
    "mission time": lambda run: f"{lasting(run.mission_time_s)}{'' if run.completed else ', not completed'}",
    "waypoints reached": _reached,
    "calls": lambda run: str(run.totals.calls),
    "calls by place": lambda run: by_place(run.totals),
    "calls that fell back to the drone": lambda run: str(run.totals.fallbacks),
    "waits, wasted": _waits,
    "selections of a server": lambda run: str(run.totals.switches),
    "time spent in calls": lambda run: lasting(run.totals.service_delay_s),
    "with every call on the drone": _local_only,
    "saved by offloading": _saved,
}
_WHERE_SOME: Sequence[Mapping[str, str]] = (  # fields of the totals by kind, which is left out if all are 0
    {"lighter": "calls lighter than asked for"},
    {"first_answers": "first answers of the drone", "first_alone": "without a better one in time"},
    {
        "in_time": "answered by the deadline",
        "late": "later than the deadline",
        "second_servers": "also sent to a second server",
    },
    {"went_on": "went on before the answer", "turns_back": "turned back for the answer"},
)


def flights(records: Sequence[Record]) -> Markup:
    """A row a flight."""

    def row(record: Record) -> list[str]:
        result = record.result
        ended = "completed" if result.completed else f"not completed, {_reached(result)} reached"
        return [
            record.name,
            result.policy,
            lasting(result.mission_time_s),
            by_place(result.totals),
            _waits(result),
            str(result.totals.fallbacks),
            _saved(result),
            "left hovering" if result.left_hovering else ended,
        ]

    heads = [
        "flight", "policy", "mission time", "calls", "waits, wasted", "fell back", "saved by offloading",
        "ended",
    ]  # fmt: skip
    return table("Flights", heads, records, row, rest="--json prints every result")
