"""A flight in a terminal: progress during the flight, a table at the end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from types import TracebackType
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.table import Column, Table
from rich.text import Text

from upwash.eventlog import schema
from upwash.eventlog.ending import by_place, left_undone, never_ready, reached, went_on
from upwash.eventlog.narration import STATE_WORDS, Narrator, Sentence, Tone, tone_of
from upwash.eventlog.notices import LEFT_HOVERING
from upwash.eventlog.results import EnergyTotals, RunResult, Totals
from upwash.eventlog.schema import Event
from upwash.support.sentences import say
from upwash.support.tables import fit, show_table
from upwash.support.text import counted, printable

_STILL_WAITING_S = 10.0  # without a line; then a line repeats the state, if the terminal shows no picture
_WORTH_SHOWING_S = 0.05
_FEW_CALLS = 20  # their rows leave the verdict in sight
_LONG_ARMING_S = 1.0
TONE_STYLES = {
    Tone.ASIDE: "dim",
    Tone.CHECKING: "yellow",
    Tone.READY: "green",
    Tone.REMOTE: "cyan",
    Tone.FOUND: "bold magenta",
    Tone.TROUBLE: "red",
    Tone.ALARM: "bold red",
}


class LiveDisplay:
    """Prints lines; on a terminal an updated picture stays below them.

    Output of other programs appears among the lines.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, get_renderable=self._picture, refresh_per_second=8)

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._console.is_terminal:
            self._live.stop()

    def _show(self, line: Text) -> None:
        say(line, self._console)

    def _picture(self) -> Group:
        """The current picture."""
        raise NotImplementedError


class Progress(LiveDisplay):
    """Follows the events of a flight: a live display on a terminal, a line per event elsewhere."""

    def __init__(self, servers: Iterable[str], waypoints: int, console: Console) -> None:
        self._states: dict[str, tuple[str, str]] = dict.fromkeys(servers, ("AVL", ""))
        self._waypoints = waypoints
        self._narrator = Narrator()
        self._now_s = self._said_s = 0.0
        super().__init__(console)  # which looks at the picture

    def follow(self, event: Event) -> None:
        """Takes in one event."""
        if isinstance(event, schema.ServerStep):
            self._states[event.server] = (event.after, printable(event.why))
        self._now_s = event.t
        said = self._narrator.tell(event) or self._still_waiting()
        if said is None:
            return
        self._said_s = event.t
        self._show(
            Text(f"{self._narrator.began.text(event.t):>11}  ")
            + Text(printable(said.text), style=TONE_STYLES.get(said.tone, ""))
        )

    def _still_waiting(self) -> Sentence | None:
        now = self._narrator
        if self._now_s - self._said_s < _STILL_WAITING_S or self._console.is_terminal:
            return None
        if now.down_s is not None:
            return Sentence(f"{now.doing}: {_down(now.down_s)}", Tone.ASIDE)
        if now.waits_since_s is None:
            return None
        return Sentence(
            f"still {now.doing}, for {self._now_s - now.waits_since_s:.0f} s: {now.waits_for}", Tone.ASIDE
        )

    def _picture(self) -> Group:
        now = self._narrator
        since_s = now.waits_since_s
        waited = "" if since_s is None else f" for {self._now_s - since_s:.0f} s"
        down = "" if now.down_s is None else f", {_down(now.down_s)}"
        reached = f"{now.reached} of {counted(self._waypoints, 'waypoint')} reached"
        answers = f" · {counted(now.open_answers, 'answer')} open" if now.open_answers else ""
        head = Text(f"{now.doing}{waited}{down}{answers} · {reached} · {now.where}")
        taken = [Text(printable(now.control), style="bold red")] if now.control else []
        return Group(head, *taken, *([self._servers()] if self._states else []))

    def _servers(self) -> Table:
        servers = Table("server", "state", Column("why", style="dim"), box=None, padding=(0, 2))
        for name, (state, why) in self._states.items():
            servers.add_row(name, Text(STATE_WORDS[state], style=TONE_STYLES[tone_of(state)]), why)
        fit(servers, self._console.width)
        return servers


def _down(down_s: float) -> str:
    return f"on the ground in {down_s:.0f} s"


def print_result(
    result: RunResult, console: Console, *, paced: bool, servers: bool, beside: str = "", calls: bool = False
) -> None:
    """Prints the mission time against what local calls would have made it, the totals, and then rows of the calls.

    More than a few calls have their rows only with `calls`. Without `servers` there is no word of what only they
    could have done; what was not in use is not counted. `beside` is a sentence about the mission time.
    """
    totals = result.totals
    _print_times(result, console, paced=paced)
    if beside:
        say(beside, console)
    _print_waypoints(result, console)
    if result.calls:
        say(_calls_line(totals, servers=servers), console)
    if totals.first_answers:
        say(first_answers_line(totals), console)
    if totals.in_time or totals.late:
        say(deadlines_line(totals), console)
    if totals.lighter:
        say(_lighter_line(result), console)
    if going := went_on(totals):
        say(going, console)
    if result.energy is not None:
        say(_energy_line(result.energy), console)
    for phrase in never_ready(result):
        say(Text(printable(phrase), style="yellow"), console)
    if result.offloading_failed:
        why = f"every call ran on the drone after a defect: {printable(result.offloading_failed)}"
        say(Text(why, style="yellow"), console)
    if calls or len(result.calls) <= _FEW_CALLS:
        if result.calls:
            console.print()
            _print_calls(result, console, servers=servers)
    else:
        say(
            Text(
                "--calls prints a row for each call; upwash explain LOG says why each ran where it ran",
                style="dim",
            ),
            console,
        )


def _calls_line(totals: Totals, *, servers: bool) -> str:
    parts = [f"{counted(totals.calls, 'call')}: {by_place(totals)}"]
    if totals.switches:
        parts += [
            f"{counted(totals.switches, 'selection')} of a server",
            _waits(totals),
            f"{totals.fallbacks or 'none'} fell back to the drone",
        ]
    elif servers:
        parts.append("no server was selected")
    waited_s = totals.service_delay_s - totals.hidden_s
    spent = "spent in calls" if not totals.hidden_s else "waited for answers"
    return "; ".join((*parts, f"{waited_s:.1f} s {spent}"))


def _waits(totals: Totals) -> str:
    if not totals.waits:
        return "no waits"
    return f"{counted(totals.waits, 'wait')}, {totals.waits_failed or 'none'} wasted"


def first_answers_line(totals: Totals) -> str:
    """How many calls had a better answer after the first, and how many none by the deadline."""
    better, alone = totals.first_answers - totals.first_alone, totals.first_alone or "none"
    return (
        f"two answers: {better} better ones after {counted(totals.first_answers, 'first one')}, {alone} alone"
    )


def deadlines_line(totals: Totals) -> str:
    """How many calls kept their deadline, and how many a second server got too."""
    second = totals.second_servers or "none"
    calls = counted(totals.in_time + totals.late, "call")
    return f"deadlines: {totals.in_time} of {calls} answered in time; {second} went to a second server too"


def _lighter_line(result: RunResult) -> str:
    keys = Counter(call.key for call in result.calls if call.key)
    counts = ", ".join(f"{count} {key}" for key, count in sorted(keys.items()))
    return f"{counted(result.totals.lighter, 'call')} lighter than asked for, to be over in time: {counts}"


def _energy_line(energy: EnergyTotals) -> str:
    of = "" if energy.battery_wh is None else f" of {energy.battery_wh:g} Wh"
    return (
        f"{energy.total_wh:.1f} Wh{of} drawn: flight {energy.flight_wh:.1f}, hover {energy.hover_wh:.1f}, "
        f"computing {energy.computing_wh:.2f}, radio {energy.radio_wh:.2f}"
    )


def _print_waypoints(result: RunResult, console: Console) -> None:
    if result.waypoints:
        say(reached(result), console)
    for phrase in left_undone(result):
        say(Text(phrase, style="yellow"), console)
    if result.left_hovering:
        say(Text(LEFT_HOVERING, style="bold red"), console)


def _print_calls(result: RunResult, console: Console, *, servers: bool) -> None:
    operations = sorted({call.operation for call in result.calls})
    several = len(operations) > 1
    shown = _short_names(operations)
    title = Text("Service calls" if several else f"Calls of {''.join(operations)}", style="bold")
    table = Table(box=None, padding=(0, 1), title=title, title_justify="left")
    table.add_column("waypoint", justify="right", no_wrap=True)
    if several:
        table.add_column("operation", no_wrap=True)
    if servers:
        table.add_column("place", overflow="fold")
    table.add_column("delay", justify="right", no_wrap=True)
    if servers:
        table.add_column("waited", justify="right", no_wrap=True)
        table.add_column("decision")
    for call in result.calls:
        waypoint = "" if call.waypoint is None else str(call.waypoint)
        operation = [shown[call.operation]] if several else []
        place = [call.server or "drone"] if servers else []
        waited = f"{call.waited_s:.1f} s" if call.waited_s >= _WORTH_SHOWING_S else ""
        why = [waited, call.decision] if servers else []
        cells = (waypoint, *operation, *place, f"{call.delay_s:.2f} s", *why)
        table.add_row(*(Text(printable(cell)) for cell in cells))  # as text: [heavy] is no markup
    show_table(table, console)


def _short_names(operations: Sequence[str]) -> dict[str, str]:
    """The operations without their services, where that leaves no two alike."""
    short = [operation.partition(".")[2] for operation in operations]
    return dict(zip(operations, short if len(set(short)) == len(short) else operations, strict=True))


def _print_times(result: RunResult, console: Console, *, paced: bool) -> None:
    if result.arming_s >= _LONG_ARMING_S:
        say(f"waited {result.arming_s:.1f} s until the vehicle could be armed", console)
    ended = "" if result.completed else ", not completed"
    local_only_s = result.local_only_time_s()
    if local_only_s is None or not result.totals.remote or not result.completed:
        say(f"mission time {result.mission_time_s:.1f} s{ended}", console)
        return
    saved = 100 * (1 - result.mission_time_s / local_only_s)
    say(
        f"mission time {result.mission_time_s:.1f} s; with every call on the drone, at the local delay "
        f"measured in this flight, {local_only_s:.1f} s: {saved:z.0f} % saved",
        console,
    )
    if paced:
        say(
            "Calls on the drone were paced (local_pace_s) to take as long as on a slower computer.",
            console,
        )
