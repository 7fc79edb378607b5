"""What a person sees of several flights at once in a terminal: a row a drone, and what happens to each."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from upwash.core.knowledge.servers import SELECTED
from upwash.eventlog import schema
from upwash.eventlog.narration import STATE_WORDS, Narrator, tone_of
from upwash.eventlog.schema import Event
from upwash.eventlog.terminal import TONE_STYLES, LiveDisplay
from upwash.support.tables import fit
from upwash.support.text import printable


class FleetProgress(LiveDisplay):
    """Follows the events of several flights: a live display on a terminal, a line per event elsewhere.

    Each line begins with the drone's name, and with the seconds since the first of the logs was opened.
    """

    def __init__(self, drones: Sequence[str], waypoints: int, console: Console) -> None:
        self._waypoints = waypoints
        self._width = max(map(len, drones))
        self._drones = {drone: _Drone() for drone in drones}
        self._opened: datetime | None = None
        super().__init__(console)  # which looks at the picture

    def follow(self, drone: str, event: Event) -> None:
        """Takes in one event of that drone's flight."""
        followed = self._drones[drone]
        if isinstance(event, schema.LogOpened):
            self._opened = self._opened or event.time
            followed.behind_s = (event.time - self._opened).total_seconds()
        said = followed.take(event)
        if said is not None:
            at_s = followed.behind_s + event.t
            self._show_of(drone, Text(f"{at_s:7.1f} s  ") + said)

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

    def __init__(self) -> None:
        self.narrator = Narrator()
        self.behind_s = 0.0  # by how much its log was opened after the first one
        self.calls = 0
        self._states: dict[str, str] = {}

    def take(self, event: Event) -> Text | None:
        """What the event says."""
        if isinstance(event, schema.ServerStep):
            self._states[event.server] = event.after
        self.calls += isinstance(event, schema.Call)
        said = self.narrator.tell(event)
        return None if said is None else Text(printable(said.text), style=TONE_STYLES.get(said.tone, ""))

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
