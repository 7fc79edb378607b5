"""What a person sees of several flights at once in a terminal: a row a drone, and what happens to each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from upwash.core.knowledge.servers import SELECTED
from upwash.eventlog import schema
from upwash.eventlog.narration import STATE_WORDS, tone_of
from upwash.eventlog.schema import Event
from upwash.eventlog.terminal import TONE_STYLES, Course, LiveDisplay, marks_of
from upwash.support.tables import fit
from upwash.support.text import printable


class FleetProgress(LiveDisplay):
    """Follows the events of several flights: a live display on a terminal, a line per event elsewhere.

    Each line begins with the drone's name, and with the time of its own mission.
    """

    def __init__(
        self, drones: Sequence[str], servers: Iterable[str], waypoints: int, console: Console
    ) -> None:
        self._waypoints = waypoints
        self._width = max(map(len, drones))
        marks = marks_of(servers)
        self._drones = {drone: _Drone(marks) for drone in drones}
        super().__init__(console)  # which looks at the picture

    def __exit__(self, *ended: Any) -> None:
        for name, drone in self._drones.items():
            for line in drone.rest():
                self._show_of(name, line)
        super().__exit__(*ended)

    def follow(self, drone: str, event: Event) -> None:
        """Takes in one event of that drone's flight."""
        for line in self._drones[drone].take(event):
            self._show_of(drone, line)

    def say(self, drone: str, line: str) -> None:
        """Shows what that drone's program printed."""
        self._show_of(drone, Text(printable(line), style="red"))

    def _show_of(self, drone: str, line: Text) -> None:
        self._show(Text(f"{drone:<{self._width}}  ") + line)

    def _picture(self) -> Group:
        table = Table("drone", "", "waypoints", "server", "calls", box=None, padding=(0, 1))
        for name, drone in self._drones.items():
            reached = f"{drone.narrator.reached} of {self._waypoints}"
            table.add_row(name, drone.doing, reached, drone.server, str(drone.calls))
        fit(table, self._console.width)
        return Group(table)


class _Drone:
    """One drone, as far as its log has told."""

    def __init__(self, marks: Mapping[str, str]) -> None:
        self._course = Course(marks)
        self.narrator, self.rest = self._course.narrator, self._course.rest
        self.calls = 0
        self._states: dict[str, str] = {}

    def take(self, event: Event) -> Iterator[Text]:
        """The lines that are complete with the event."""
        if isinstance(event, schema.ServerStep):
            self._states[event.server] = event.after
        self.calls += isinstance(event, schema.Call)
        return self._course.take(event)

    @property
    def doing(self) -> Text:
        """What it does, or who else has its vehicle."""
        if self.narrator.control:
            return Text(printable(self.narrator.control), style="bold red")
        return Text(self.narrator.doing)

    @property
    def server(self) -> Text:
        """The server that it uses, or is about to, with its state."""
        used = [(server, state) for server, state in self._states.items() if state in SELECTED]
        texts = [
            Text(f"{printable(server)} {STATE_WORDS[state]}", style=TONE_STYLES[tone_of(state)])
            for server, state in used
        ]
        return Text(", ").join(texts)
