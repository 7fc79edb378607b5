"""What the figures show, as tables: for those who read numbers, and for those who cannot see figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from upwash.core.servers import State
from upwash.eventlog.results import CallResult, mean_local_delay_s
from upwash.report.charts import state_seconds
from upwash.report.markup import Markup, element
from upwash.report.places import name_of
from upwash.report.record import Record


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> Markup:
    """A table whose first column names its rows."""
    body = [
        element(
            "tr",
            element("th", row[0], scope="row"),
            *(element("td", cell) for cell in row[1:]),
        )
        for row in rows
    ]
    whole = element(
        "table",
        element("caption", caption),
        element("thead", element("tr", *(element("th", head, scope="col") for head in heads))),
        element("tbody", *body) if body else "",
    )
    return scrolled(whole, caption)


def scrolled(content: Markup, name: str, *, style: str = "scroll") -> Markup:
    """A region that scrolls by itself on narrow screens, by keyboard too."""
    return element("div", content, class_=style, tabindex="0", role="region", aria_label=name)


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
        ["waits, of which in vain", *(_waits(record) for record in records)],
        ["selections of a server", *(str(record.result.totals.switches) for record in records)],
        ["time spent in calls", *(f"{record.result.totals.service_delay_s:.1f} s" for record in records)],
        ["with every call on the drone", *(_local_only(record) for record in records)],
        ["saved by offloading", *(_saved(record) for record in records)],
    ]
    if any(record.result.totals.lighter for record in records):
        rows.append(
            ["calls lighter than asked for", *(str(record.result.totals.lighter) for record in records)]
        )
    if any(record.answers for record in records):
        rows += [
            ["went on before the answer", *(str(record.result.totals.went_on) for record in records)],
            ["turned back for the answer", *(str(record.result.totals.turned_back) for record in records)],
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
    return f"{record.result.waypoints - len(record.result.undone)} of {record.result.waypoints}"


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
    """Every call, by waypoint."""
    goes = bool(record.result.totals.hidden_s)
    rows = [
        [
            _at(call.result.waypoint),
            f"{call.result.at_s:.1f} s",
            _ran_as(call.result),
            name_of(call.result.server),
            f"{call.result.delay_s:.2f} s",
            f"{call.result.waited_s:.2f} s, {call.wait}" if call.wait else "",
            *([f"{call.result.hidden_s:.2f} s" if call.result.hidden_s else ""] if goes else []),
            call.result.decision,
        ]
        for call in record.calls
    ]
    hidden = ["hidden"] if goes else []
    heads = ["waypoint", "at", "operation", "place", "delay", "waited", *hidden, "decision"]
    return table("Calls by waypoint", heads, rows)


def _ran_as(call: CallResult) -> str:
    return f"{call.operation} instead of {call.asked}" if call.asked else call.operation


def map_places(record: Record) -> Markup:
    """Where the servers were believed to be in range."""
    rows = [
        [name, f"{area.centre.east_m:.1f} m", f"{area.centre.north_m:.1f} m", f"{area.radius_m:g} m"]
        for name, area in record.plan.ranges.items()
    ]
    return table("Ranges of the servers, from home", ["server", "east", "north", "range"], rows)


def waypoints(record: Record) -> Markup:
    """Where the waypoints are."""
    rows = [
        [str(index), f"{east_m:.1f} m", f"{north_m:.1f} m"]
        for index, (east_m, north_m) in enumerate(record.plan.waypoints_m)
    ]
    return table("Waypoints, from home", ["waypoint", "east", "north"], rows)


def answers(record: Record) -> Markup:
    """Every answer that the drone went on before."""
    rows = [
        [
            _at(each.waypoint),
            f"{each.from_s:.1f} s",
            f"{each.to_s:.1f} s",
            f"{each.turned_at.east_m:.1f} m east, {each.turned_at.north_m:.1f} m north"
            if each.turned_at
            else "",
        ]
        for each in record.answers
    ]
    return table("Gone on before the answer", ["waypoint", "from", "to", "turned back"], rows)


def _at(waypoint: int | None) -> str:
    return "start" if waypoint is None else str(waypoint)


def states(record: Record) -> Markup:
    """How long each server was in each state."""
    rows = []
    for server, stretches in record.stretches.items():
        seconds = state_seconds(stretches)
        rows.append([server, *(f"{seconds[state]:.1f} s" for state in State)])
    return table("Time in each state", ["server", *(state.value for state in State)], rows)


def steps(record: Record) -> Markup:
    """Every stretch of every server."""
    rows = [
        [server, stretch.state.value, f"{stretch.from_s:.1f} s", f"{stretch.to_s:.1f} s", stretch.why]
        for server, stretches in record.stretches.items()
        for stretch in stretches
    ]
    return table("States over time", ["server", "state", "from", "to", "why"], rows)
