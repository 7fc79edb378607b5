"""What the figures show, as tables: for those who read numbers, and for those who cannot see figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from upwash.core.geo import Circle
from upwash.core.knowledge.servers import State
from upwash.eventlog import schema
from upwash.eventlog.progress import clock
from upwash.eventlog.results import CallResult, mean_local_delay_s
from upwash.report.markup import Markup, element, joined
from upwash.report.numbering import PlacedFinding
from upwash.report.record import Record
from upwash.report.story import OpenAnswer, Stretch
from upwash.support.text import counted

_MOST_ROWS = 300  # of a table with a row each of what a long flight has many of
_AT_EITHER_END = 100
_IN_THE_LOG = "the event log has all of them"
Item = TypeVar("Item")


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Markup:
    """A table whose first column names its rows."""
    return _whole(caption, heads, [_row(row) for row in rows])


def _long(
    caption: str,
    heads: Sequence[str],
    items: Sequence[Item],
    row_of: Callable[[Item], Sequence[str]],
    *,
    rest: str,
) -> Markup:
    """A table with a row an item: of many the first and the last, and where the `rest` is."""
    if len(items) <= _MOST_ROWS:
        return table(caption, heads, map(row_of, items))
    first, last = items[:_AT_EITHER_END], items[-_AT_EITHER_END:]
    left_out = f"{len(items) - len(first) - len(last)} rows are left out: {rest}"
    gap = element("tr", element("td", left_out, colspan=str(len(heads))))
    return _whole(caption, heads, [*map(_row, map(row_of, first)), gap, *map(_row, map(row_of, last))])


def _row(cells: Sequence[str]) -> Markup:
    return element("tr", element("th", cells[0], scope="row"), *(element("td", cell) for cell in cells[1:]))


def _whole(caption: str, heads: Sequence[str], body: Sequence[Markup]) -> Markup:
    whole = element(
        "table",
        element("caption", caption),
        element("thead", element("tr", *map(_head, heads))),
        element("tbody", *body) if body else "",
    )
    return scrolled(whole, caption)


def _head(head: str) -> Markup:
    return element("th", head, scope="col") if head else element("td", "")


def scrolled(content: Markup, name: str) -> Markup:
    """A region that scrolls by itself on narrow screens, by keyboard too."""
    return element("div", content, class_="scroll", tabindex="0", role="group", aria_label=name)


def folded(summary: str, *content: Markup) -> Markup:
    """Content that is opened by its summary."""
    return element("details", element("summary", summary), *content)


def totals(records: Sequence[Record]) -> Markup:
    """What each run came to, a column each."""
    rows = [
        ["policy", *(record.result.policy for record in records)],
        ["mission time", *(f"{record.result.mission_time_s:.1f} s{_ended(record)}" for record in records)],
        ["waypoints reached", *(_reached(record) for record in records)],
        ["calls", *(str(record.result.totals.calls) for record in records)],
        ["calls on the drone", *(str(record.result.totals.local) for record in records)],
        ["calls on servers", *(_remote(record) for record in records)],
        ["calls that fell back to the drone", *(str(record.result.totals.fallbacks) for record in records)],
        ["waits, wasted", *(_waits(record) for record in records)],
        ["selections of a server", *(str(record.result.totals.switches) for record in records)],
        ["time spent in calls", *(f"{record.result.totals.service_delay_s:.1f} s" for record in records)],
        ["with every call on the drone", *(_local_only(record) for record in records)],
        ["saved by offloading", *(_saved(record) for record in records)],
    ]
    if any(record.result.totals.lighter for record in records):
        rows.append(
            ["calls lighter than asked for", *(str(record.result.totals.lighter) for record in records)]
        )
    if any(record.result.totals.first_answers for record in records):
        rows += [
            ["first answers of the drone", *(str(record.result.totals.first_answers) for record in records)],
            ["without a better one in time", *(str(record.result.totals.first_alone) for record in records)],
        ]
    if any(record.result.totals.in_time or record.result.totals.late for record in records):
        rows += [
            ["answered by the deadline", *(str(record.result.totals.in_time) for record in records)],
            ["later than the deadline", *(str(record.result.totals.late) for record in records)],
            [
                "also sent to a second server",
                *(str(record.result.totals.second_servers) for record in records),
            ],
        ]
    if any(record.answers for record in records):
        rows += [
            ["went on before the answer", *(str(record.result.totals.went_on) for record in records)],
            ["turned back for the answer", *(str(record.result.totals.turns_back) for record in records)],
            ["of the calls' time hidden", *(f"{record.result.totals.hidden_s:.1f} s" for record in records)],
        ]
    if any(record.result.energy for record in records):
        rows.append(["drawn from the battery", *(_drawn(record) for record in records)])
    return table("Totals", ["", *(record.name for record in records)], rows)


def _drawn(record: Record) -> str:
    energy = record.result.energy
    return (
        "not metered"
        if energy is None
        else f"{energy.total_wh:.1f} Wh, of which {energy.hover_wh:.1f} Wh in hover"
    )


def _ended(record: Record) -> str:
    return "" if record.result.completed else ", not completed"


def _reached(record: Record) -> str:
    return f"{_reached_count(record)} of {record.result.waypoints}"


def _reached_count(record: Record) -> int:
    return record.result.waypoints - len(record.result.undone)


def _remote(record: Record) -> str:
    return ", ".join(f"{count} on {name}" for name, count in record.result.totals.remote.items()) or "0"


def _waits(record: Record) -> str:
    return f"{record.result.totals.waits}, {record.result.totals.waits_failed}"


def _local_only(record: Record) -> str:
    local_only_s = record.result.local_only_time_s()
    return "not known" if local_only_s is None else f"{local_only_s:.1f} s"


def _saved(record: Record) -> str:
    local_only_s, saved_s = record.result.local_only_time_s(), record.saved_s
    if not local_only_s or saved_s is None:
        return "not known"
    return f"{saved_s:z.1f} s, {100 * saved_s / local_only_s:z.0f} %"


def flights(records: Sequence[Record]) -> Markup:
    """A row a flight."""

    def row(record: Record) -> list[str]:
        totals = record.result.totals
        return [
            record.name,
            record.result.policy,
            f"{record.result.mission_time_s:.1f} s",
            ", ".join(
                f"{count} on {name}" for name, count in (("the drone", totals.local), *totals.remote.items())
            ),
            _waits(record),
            str(totals.fallbacks),
            _saved(record),
            _how_it_ended(record),
        ]

    heads = [
        "flight", "policy", "mission time", "calls", "waits, wasted", "fell back", "saved by offloading",
        "ended",
    ]  # fmt: skip
    return _long("Flights", heads, records, row, rest="--json prints every result")


def _how_it_ended(record: Record) -> str:
    if record.result.left_hovering:
        return "left hovering"
    if record.result.completed:
        return "completed"
    return (
        f"not completed, {_reached_count(record)} of {counted(record.result.waypoints, 'waypoint')} reached"
    )


def by_operation(record: Record) -> Markup:
    """What calls of each operation took, on the drone and altogether."""
    local_s = mean_local_delay_s(record.result.calls)
    rows = []
    for operation in sorted({call.operation for call in record.result.calls}):
        delays = [call.delay_s for call in record.result.calls if call.operation == operation]
        alone = f"{local_s[operation]:.2f} s" if operation in local_s else "not measured"
        rows.append([operation, str(len(delays)), alone, f"{sum(delays) / len(delays):.2f} s"])
    return table("By operation", ["operation", "calls", "mean on the drone", "mean of all"], rows)


def calls(record: Record) -> Markup:
    """The calls, by waypoint."""
    goes = bool(record.result.totals.hidden_s)

    def row(call: CallResult) -> list[str]:
        return [
            _at(call.waypoint),
            clock(call.at_s + call.delay_s),
            _ran_as(call),
            call.server or "drone",
            f"{call.delay_s:.2f} s",
            f"{call.waited_s:.2f} s, {call.wait}" if call.wait else "",
            *([f"{call.hidden_s:.2f} s" if call.hidden_s else ""] if goes else []),
            call.decision,
        ]

    hidden = ["hidden"] if goes else []
    heads = ["waypoint", "ended at", "operation", "place", "delay", "waited", *hidden, "decision"]
    return _long("Calls by waypoint", heads, record.calls, row, rest="--csv FILE writes every call")


def _ran_as(call: CallResult) -> str:
    return f"{call.operation} instead of {call.asked}" if call.asked else call.operation


def map_places(record: Record) -> Markup:
    """Where the servers were believed to be in range."""

    def row(server: tuple[str, Circle]) -> list[str]:
        name, area = server
        return [name, f"{area.centre.east_m:.1f} m", f"{area.centre.north_m:.1f} m", f"{area.radius_m:g} m"]

    heads = ["server", "east", "north", "range"]
    ranges = list(record.plan.ranges.items())
    return _long("Ranges of the servers, from home", heads, ranges, row, rest=_IN_THE_LOG)


def measured_places(record: Record) -> Markup:
    """What calls to servers without a range came to at each place; empty where there are none."""
    if not record.measured:
        return Markup("")

    def row(known: tuple[str, schema.MeasuredRecord]) -> list[str]:
        server, place = known
        return [
            server,
            f"{place.east_m:.0f} m",
            f"{place.north_m:.0f} m",
            f"{place.answered} of {place.tried}",
            ", ".join(f"{operation} {call_s:.2f} s" for operation, call_s in place.call_s.items()),
            "" if place.goodput_bit_s is None else f"{place.goodput_bit_s / 1e6:.1f} Mbit/s",
        ]

    heads = ["server", "east", "north", "answered", "a call came to", "goodput"]
    return _long("Servers without a range, by place", heads, record.measured, row, rest=_IN_THE_LOG)


def waypoints(record: Record) -> Markup:
    """Where the waypoints are."""

    def row(waypoint: tuple[int, tuple[float, float]]) -> list[str]:
        index, (east_m, north_m) = waypoint
        return [str(index), f"{east_m:.1f} m", f"{north_m:.1f} m"]

    return _long(
        "Waypoints, from home",
        ["waypoint", "east", "north"],
        list(enumerate(record.plan.waypoints_m)),
        row,
        rest="--geojson FILE writes every waypoint",
    )


def findings(found: Sequence[PlacedFinding], *, whose: bool = False) -> Markup:
    """The findings with their places, and with the names of their flights where it matters `whose` each is."""

    def row(each: PlacedFinding) -> list[str]:
        return [
            str(each.number),
            *([each.flight.log] if whose else []),
            clock(each.mission_s),
            _at(each.finding.waypoint),
            coordinates(each),
            element("bdi", each.finding.words),  # may be written from right to left
            *([_reviewed(each)] if are_reviewed else []),
        ]

    are_reviewed = any(each.review for each in found)

    return _long(
        "Findings",
        [
            "finding",
            *(["flight"] if whose else []),
            "at",
            "waypoint",
            "place",
            "what the user was told",
            *(["review"] if are_reviewed else []),
        ],
        found,
        row,
        rest="--findings FILE writes every finding",
    )


def _reviewed(found: PlacedFinding) -> Markup:
    """The verdict and the note of a finding; empty without them."""
    verdict = found.review.verdict.value if found.review and found.is_reviewed else ""
    return joined(verdict, ": " if verdict and found.note else "", element("bdi", found.note))


def coordinates(found: PlacedFinding) -> str:
    """The place in degrees where it is known where home is, else in metres from there."""
    if found.earth is None or found.flight.home is None:
        place = found.finding.place
        return f"{place.east_m:.1f} m east, {place.north_m:.1f} m north of home"
    return "{:.6f}°, {:.6f}°".format(*found.earth)


def answers(record: Record) -> Markup:
    """The answers that it went on before."""

    def row(each: OpenAnswer) -> list[str]:
        turned = each.turned_at
        where = f"{turned.east_m:.1f} m east, {turned.north_m:.1f} m north" if turned else ""
        return [_at(each.waypoint), clock(each.from_s), clock(each.to_s), where]

    heads = ["waypoint", "from", "to", "turned back"]
    return _long("Gone on before the answer", heads, record.answers, row, rest=_IN_THE_LOG)


def _at(waypoint: int | None) -> str:
    return "start" if waypoint is None else str(waypoint)


def states(record: Record) -> Markup:
    """How long each server was in each state."""

    def row(known: tuple[str, Sequence[Stretch]]) -> list[str]:
        server, stretches = known
        seconds = dict.fromkeys(State, 0.0)
        for stretch in stretches:
            seconds[stretch.state] += stretch.to_s - stretch.from_s
        return [server, *(f"{seconds[state]:.1f} s" for state in State)]

    heads = ["server", *(state.value for state in State)]
    return _long("Time in each state", heads, list(record.stretches.items()), row, rest=_IN_THE_LOG)


def steps(record: Record) -> Markup:
    """The stretches of all servers."""

    def row(step: tuple[str, Stretch]) -> list[str]:
        server, stretch = step
        return [server, stretch.state.value, clock(stretch.from_s), clock(stretch.to_s), stretch.why]

    stretches = [(server, each) for server, stretches in record.stretches.items() for each in stretches]
    return _long(
        "States over time", ["server", "state", "from", "to", "why"], stretches, row, rest=_IN_THE_LOG
    )
