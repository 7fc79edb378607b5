"""What a person sees of a flight in a terminal: progress while it lasts, a table at the end."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from upwash.config import DroneConfig
from upwash.results import RunResult

_RECENT = 10
_WORTH_SHOWING_S = 0.05
_SAFE_ENDS = {"return": "returning to land", "land": "landing where it is", "hold": "stopping to hover"}
_LEFT_HOVERING = "The vehicle hovers where it is, and nobody flies it now: take over with the remote control."
_STATE_STYLES = {"READY": "green", "CHECK": "yellow", "CHECK-R": "yellow", "BLACKLISTED": "red"}


class Progress:
    """Follows the events of a flight: a live display on a terminal, a line per event elsewhere."""

    def __init__(self, config: DroneConfig, waypoints: int, console: Console) -> None:
        self._console = console
        self._states = {server.name: ("AVL", "") for server in config.servers}
        self._waypoints = waypoints
        self._reached = 0
        self._doing = "starting the services of the drone"
        self._where = ""
        self.started = False  # whether the mission has begun
        self._recent: deque[Text] = deque(maxlen=_RECENT)
        self._live = Live(console=console, get_renderable=self._picture, refresh_per_second=8)

    def __enter__(self) -> Progress:
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

    def follow(self, event: Mapping[str, Any]) -> None:
        """Takes in one event."""
        said = self._take_in(event)
        if said is None:
            return
        line = Text(f"{event['t']:7.1f} s  ") + said
        self._recent.append(line)
        if not self._console.is_terminal:
            self._console.print(line, soft_wrap=True)

    def _take_in(self, event: Mapping[str, Any]) -> Text | None:
        match event:
            case {"event": "position", "east_m": east_m, "north_m": north_m, "altitude_m": altitude_m}:
                self._where = f"{east_m:.0f} m east, {north_m:.0f} m north, {altitude_m:.0f} m up"
                return None
            case {"event": "call"}:
                return _call_line(event, self._doing)
            case {"server": server, "before": before, "after": after}:
                self._states[server] = (after, event["why"])
                why = f" ({event['why']})" if event["why"] else ""
                return Text(f"{server}: {before} → {after}{why}", style=_STATE_STYLES.get(after, "dim"))
            case _:
                return self._flight_event(event)

    def _flight_event(self, event: Mapping[str, Any]) -> Text | None:
        said: Text | None = None
        match event:
            case {"event": "local_ready", "service": service}:
                said = Text(f"{service} is ready on the drone")
            case {"event": "mission_started", "policy": policy}:
                self.started = True
                self._doing = "before take-off"
                done = event.get("done", ())
                self._reached = len(done)
                before = f"taken up again, {len(done)} waypoints done before" if done else "started"
                said = Text(f"mission {before}, policy {policy}")
            case {"event": "leg", "waypoint": waypoint}:
                self._doing = f"flying to waypoint {waypoint}"
            case {"event": "arrived", "waypoint": waypoint}:
                self._doing = f"at waypoint {waypoint}"
                self._reached += 1
            case {"event": "returning" | "landed" as doing}:
                self._doing = doing
                said = Text("returning home to land" if doing == "returning" else "landed")
            case {"event": "notified", "message": message}:
                said = Text(f"told the user: {_describe(message)}", style="bold magenta")
            case {"event": "stopping", "why": why}:
                said = Text(f"stopping ({why}); once more ends this at once, the vehicle left to itself")
                said.stylize("bold red")
            case {"event": "safe_end", "action": action, "why": why}:
                self._doing = _SAFE_ENDS[action]
                said = Text(f"{self._doing}: {why}", style="bold red")
            case {"event": "left_hovering"}:
                self._doing = "hovering"
                said = Text(_LEFT_HOVERING, style="bold red")
            case {"event": "left_to_pilot" | "mission_ended" as ending, "why": why}:
                said = Text(f"{ending.replace('_', ' ')}: {why}", style="bold red")
            case {"event": name, "why": why} if name.endswith("_failed"):
                said = Text(f"{name.replace('_', ' ')}: {why}", style="red")
            case {"event": "local_ended", "service": service, "how": how}:
                said = Text(f"{service} on the drone ended ({how}); starting it again", style="red")
        return said

    def _picture(self) -> Group:
        servers = Table(box=None, padding=(0, 2))
        servers.add_column("server")
        servers.add_column("state")
        servers.add_column("why", style="dim")
        for name, (state, why) in self._states.items():
            servers.add_row(name, Text(state, style=_STATE_STYLES.get(state, "")), why)
        head = Text(f"{self._doing} · {self._reached} of {self._waypoints} waypoints reached · {self._where}")
        return Group(head, servers, *self._recent)


def print_result(result: RunResult, console: Console, *, paced: bool) -> None:
    """Prints a table of the calls, the totals, and the mission time against what local calls would have made it."""
    _print_calls(result, console)
    totals = result.totals
    servers = ", ".join(f"{count} on {server}" for server, count in totals.remote.items())
    console.print(
        f"{totals.calls} calls: {totals.local} on the drone{', ' + servers if servers else ''}; "
        f"{totals.switches} selections, {totals.waits} waits of which {totals.waits_failed} in vain, "
        f"{totals.fallbacks} fell back to the drone; {totals.service_delay_s:.1f} s spent in calls",
        soft_wrap=True,
    )
    _print_times(result, console, paced=paced)
    _print_waypoints(result, console)


def _print_waypoints(result: RunResult, console: Console) -> None:
    undone = f", left undone: {_ranges(result.undone)}" if result.undone else ""
    reached = result.waypoints - len(result.undone)
    console.print(f"{reached} of {result.waypoints} waypoints reached{undone}", soft_wrap=True)
    if result.left_hovering:
        console.print(Text(_LEFT_HOVERING, style="bold red"), soft_wrap=True)


def _ranges(numbers: Sequence[int]) -> str:
    """Ascending numbers, those that follow each other as one range: 3, 7-11."""
    starts = [number for number in numbers if number - 1 not in numbers]
    ends = [number for number in numbers if number + 1 not in numbers]
    return ", ".join(
        f"{start}" if start == end else f"{start}-{end}" for start, end in zip(starts, ends, strict=True)
    )


def _print_calls(result: RunResult, console: Console) -> None:
    operations = sorted({call.operation for call in result.calls})
    several = len(operations) > 1
    table = Table(title=Text("Service calls" if several else f"Calls of {''.join(operations)}"))
    table.add_column("waypoint", justify="right")
    if several:
        table.add_column("operation")
    table.add_column("place")
    table.add_column("delay", justify="right")
    table.add_column("waited", justify="right")
    table.add_column("decision")
    for call in result.calls:
        waypoint = "" if call.waypoint is None else str(call.waypoint)
        operation = [call.operation] if several else []
        place = "drone" if call.place == "local" else call.place
        waited = f"{call.waited_s:.1f} s" if call.waited_s >= _WORTH_SHOWING_S else ""
        cells = (waypoint, *operation, place, f"{call.delay_s:.2f} s", waited, call.decision)
        table.add_row(*(Text(cell) for cell in cells))  # as text: [heavy] is no markup
    console.print(table)


def _print_times(result: RunResult, console: Console, *, paced: bool) -> None:
    ended = "" if result.completed else ", not completed"
    local_only_s = result.local_only_time_s()
    if local_only_s is None or not result.totals.remote or not result.completed:
        console.print(f"mission time {result.mission_time_s:.1f} s{ended}", soft_wrap=True)
        return
    saved = 100 * (1 - result.mission_time_s / local_only_s)
    console.print(
        f"mission time {result.mission_time_s:.1f} s; with every call on the drone, at the local delay "
        f"measured in this flight, {local_only_s:.1f} s: {saved:.0f} % saved",
        soft_wrap=True,
    )
    if paced:
        console.print(
            "Calls on the drone were paced (local_pace_s) to take as long as on a slower computer.",
            soft_wrap=True,
        )


def _call_line(event: Mapping[str, Any], doing: str) -> Text:
    place = "on the drone" if event["place"] == "local" else f"on {event['place']}"
    waited = f" after waiting {event['waited_s']:.1f} s" if event["wait"] else ""
    return Text(
        f"{doing}: {event['operation']} {place}, {event['delay_s']:.2f} s{waited} ({event['decision']})",
        style="" if event["place"] == "local" else "cyan",
    )


def _describe(message: object) -> str:
    """A message to the user in one line: detections by their number and labels, anything else as it is."""
    if isinstance(message, list) and all(isinstance(item, dict) and "label" in item for item in message):
        labels = [item["label"] for item in message]
        return ", ".join(f"{labels.count(label)} x {label}" for label in dict.fromkeys(labels))
    return str(message)
