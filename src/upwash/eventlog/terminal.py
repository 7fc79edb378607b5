"""A flight in a terminal: progress during the flight, a table at the end."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any, Self

from rich.console import Console, Group
from rich.live import Live
from rich.table import Column, Table
from rich.text import Text

from upwash.core.knowledge.servers import State
from upwash.core.operation import ON_DRONE, titles
from upwash.eventlog import schema
from upwash.eventlog.ending import by_place, left_undone, never_ready, reached, went_on
from upwash.eventlog.narration import STATE_WORDS, Narrator, Tone, in_one_line, tone_of
from upwash.eventlog.notices import LEFT_HOVERING
from upwash.eventlog.reasons import explained_calls
from upwash.eventlog.results import EnergyTotals, RunResult, Totals
from upwash.eventlog.schema import Event
from upwash.support.sentences import say
from upwash.support.tables import fit, show_table
from upwash.support.text import clock, counted, lasting, printable

_STILL_WAITING_S = 10.0  # without a line; then a line repeats the state, if the terminal shows no picture
_WORTH_SHOWING_S = 0.05
_TOLD_WITHIN_S = 0.5  # after a call: what the mission tells its user of it
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


class Course:
    """The lines of one flight, one for each call with what the mission told its user of it, marked by its place."""

    def __init__(self, marks: Mapping[str, str]) -> None:
        self.narrator = Narrator()
        self._marks = marks
        self._call: tuple[float, Text] | None = None  # which waits for what the mission tells

    def take(self, event: Event) -> Iterator[Text]:
        """The lines that are complete with the event, each with its time before it."""
        said = self.narrator.tell(event)
        if self._call is not None and isinstance(event, schema.Notified):
            told = Text(in_one_line(event.message), style=TONE_STYLES[Tone.FOUND])
            yield self._call[1] + Text(" · ") + told
            self._call = None
            return
        if said is not None or (self._call is not None and event.t > self._call[0] + _TOLD_WITHIN_S):
            yield from self.rest()
        if said is None:
            return
        mark = self._marks.get(event.place, " ") if isinstance(event, schema.Call) else " "
        line = Text(f"{self.narrator.began.text(event.t):>8}  {mark} ")
        line += Text(printable(said.text), style=TONE_STYLES.get(said.tone, ""))
        if isinstance(event, schema.Call):
            self._call = event.t, line
            return
        if isinstance(event, schema.MissionStarted) and len(self._marks) > 1:
            places = (f"{mark} {'drone' if at == ON_DRONE else at}" for at, mark in self._marks.items())
            line += Text(f"; {'  '.join(places)}", style="dim")
        yield line

    def rest(self) -> Iterator[Text]:
        """The line that still waits."""
        if self._call is not None:
            yield self._call[1]
            self._call = None


def marks_of(servers: Iterable[str]) -> dict[str, str]:
    """A mark for each place of a call, in one order."""
    return {ON_DRONE: "●", **dict(zip(servers, itertools.cycle("■▲◆▼★"), strict=False))}


class FlightProgress(LiveDisplay):
    """Follows the events of a flight: a live display on a terminal, a line per event elsewhere."""

    def __init__(self, servers: Iterable[str], waypoints: int, console: Console) -> None:
        self._states: dict[str, tuple[str, str]] = dict.fromkeys(servers, (State.AVL, ""))
        self._waypoints = waypoints
        self._marks = marks_of(self._states)
        self._course = Course(self._marks)
        self._narrator = self._course.narrator
        self._now_s = self._said_s = 0.0
        super().__init__(console)  # which looks at the picture

    def __exit__(self, *ended: Any) -> None:
        for line in self._course.rest():
            self._show(line)
        super().__exit__(*ended)

    def follow(self, event: Event) -> None:
        """Takes in one event."""
        if isinstance(event, schema.ServerStep):
            self._states[event.server] = (event.after, printable(event.why))
        self._now_s = event.t
        lines = [*self._course.take(event)] or self._still_waiting()
        for line in lines:
            self._said_s = event.t
            self._show(line)

    def _still_waiting(self) -> Sequence[Text]:
        now = self._narrator
        if self._now_s - self._said_s < _STILL_WAITING_S or self._console.is_terminal:
            return []
        if now.down_s is not None:
            said = f"{now.doing}: {_down(now.down_s)}"
        elif now.waits_since_s is not None:
            said = f"still {now.doing}, for {self._now_s - now.waits_since_s:.0f} s: {now.waits_for}"
        else:
            return []
        return [Text(f"{now.began.text(self._now_s):>8}    ") + Text(printable(said), style="dim")]

    def _picture(self) -> Group:
        now = self._narrator
        since_s, left_s = now.waits_since_s, now.left_s(self._now_s)
        parts = [
            now.doing + ("" if since_s is None else f" for {self._now_s - since_s:.0f} s"),
            "" if now.down_s is None else _down(now.down_s),
            f"{counted(now.open_answers, 'answer')} open" if now.open_answers else "",
            f"{now.reached} of {counted(self._waypoints, 'waypoint')} reached",
            now.where,
            "" if left_s is None else f"about {clock(left_s)} left",
        ]
        taken = [Text(printable(now.control), style="bold red")] if now.control else []
        last = Text(" · ".join(filter(None, parts)))
        return Group(*([self._servers()] if self._states else []), *taken, last)

    def _servers(self) -> Table:
        servers = Table("", "server", "state", Column("why", style="dim"), box=None, padding=(0, 1))
        for name, (state, why) in self._states.items():
            words = Text(STATE_WORDS[state], style=TONE_STYLES[tone_of(state)])
            servers.add_row(self._marks[name], name, words, why)
        fit(servers, self._console.width)
        return servers


def _down(down_s: float) -> str:
    return f"on the ground in {clock(down_s)}"


def print_result(
    result: RunResult,
    events: Iterable[Event],
    console: Console,
    *,
    paced: bool,
    servers: bool,
    beside: str = "",
    calls: bool = False,
) -> None:
    """Prints the mission time against what local calls would have made it, the totals, and then rows of the calls.

    The result is that of the `events`. More than a few calls have their rows only with `calls`. Without `servers`
    there is no word of what only they could have done; what was not in use is not counted. `beside` is a sentence
    about the mission time.
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
            _print_calls(result, events, console, servers=servers)
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
    return "; ".join((*parts, f"{lasting(waited_s)} {spent}"))


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


def _print_calls(result: RunResult, events: Iterable[Event], console: Console, *, servers: bool) -> None:
    named = titles({call.operation for call in result.calls})
    several = len(named) > 1
    causes = [text.call.cause for text in explained_calls(events)]
    title = Text("Service calls" if several else f"Calls of {''.join(named.values())}", style="bold")
    table = Table(box=None, padding=(0, 1), title=title, title_justify="left")
    table.add_column("waypoint", justify="right", no_wrap=True)
    if several:
        table.add_column("service", no_wrap=True)
    if servers:
        table.add_column("place", overflow="fold")
    table.add_column("delay", justify="right", no_wrap=True)
    if servers:
        table.add_column("waited", justify="right", no_wrap=True)
        table.add_column("why")
    for call, cause in zip(result.calls, causes, strict=True):
        waypoint = "" if call.waypoint is None else str(call.waypoint)
        operation = [named[call.operation]] if several else []
        place = [call.server or "drone"] if servers else []
        waited = f"{call.waited_s:.1f} s" if call.waited_s >= _WORTH_SHOWING_S else ""
        why = [waited, cause or ("" if call.decision == "server ready" else call.decision)] if servers else []
        cells = (waypoint, *operation, *place, f"{call.delay_s:.2f} s", *why)
        table.add_row(*(Text(printable(cell)) for cell in cells))  # as text: [heavy] is no markup
    show_table(table, console)


def _print_times(result: RunResult, console: Console, *, paced: bool) -> None:
    if result.arming_s >= _LONG_ARMING_S:
        say(f"waited {result.arming_s:.1f} s until the vehicle could be armed", console)
    ended = "" if result.completed else ", not completed"
    local_only_s = result.local_only_time_s()
    if local_only_s is None or not result.totals.remote or not result.completed:
        say(f"mission time {lasting(result.mission_time_s)}{ended}", console)
        return
    saved = 100 * (1 - result.mission_time_s / local_only_s)
    say(
        f"mission time {lasting(result.mission_time_s)}; with every call on the drone, at the local delay "
        f"measured in this flight, {lasting(local_only_s)}: {saved:z.0f} % saved",
        console,
    )
    if paced:
        say(
            "Calls on the drone were paced (local_pace_s) to take as long as on a slower computer.",
            console,
        )
