"""What the drones of a demonstration came to, each and together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

from rich import box
from rich.console import Console
from rich.table import Table

from upwash.cli.demonstration.score import NOTHING, Score, score_photos
from upwash.cli.flying import read_log
from upwash.errors import UsageError
from upwash.eventlog.results import RunResult
from upwash.launch.flight_program import INTERRUPTED
from upwash.support.sentences import say


@dataclass(frozen=True, slots=True)
class Outcome:
    """How one drone's program ended, and what its log says of its flight; None where none began."""

    exit_code: int
    result: RunResult | None
    score: Score | None

    @property
    def in_words(self) -> str:
        """How the flight ended."""
        if self.exit_code == INTERRUPTED:
            return "ended early" if self.result else "did not begin"
        if self.exit_code:
            return f"exit code {self.exit_code}"
        return "completed"


def outcome_of(log: Path, exit_code: int) -> Outcome:
    """What the flight of that log came to, whose program has ended with that code."""
    try:
        return Outcome(exit_code, read_log(log), score_photos(log))
    except UsageError:  # it is empty: the program ended before there was a flight
        return Outcome(exit_code, None, None)


def print_outcomes(outcomes: Mapping[str, Outcome], servers: Sequence[str], console: Console) -> None:
    """Prints a row for each drone, and the mean and the worst of those that were completed."""
    table = Table(box=box.SIMPLE_HEAD)
    for head in ("drone", "flight"):
        table.add_column(head, no_wrap=True)
    places = ("on the\ndrone", *(f"on\n{server}" for server in servers))
    for head in ("time", "saved", *places, "waits", "wasted"):
        table.add_column(head, justify="right", no_wrap=True)
    for drone, outcome in outcomes.items():
        table.add_row(drone, outcome.in_words, *_cells(outcome.result, servers))
    console.print(table)
    for line in (together(outcomes.values()), _found(outcomes.values())):
        say(line, console)


def _cells(result: RunResult | None, servers: Sequence[str]) -> list[str]:
    if result is None:
        return []
    saved_s, totals = saved_of(result), result.totals
    numbers = (totals.local, *(totals.remote.get(server, 0) for server in servers))
    return [
        f"{result.mission_time_s:.1f} s",
        "" if saved_s is None else f"{saved_s:z.1f} s",
        *map(str, (*numbers, totals.waits, totals.waits_failed)),
    ]


def _found(outcomes: Iterable[Outcome]) -> str:
    return sum((each.score for each in outcomes if each.score is not None), start=NOTHING).in_words()


def saved_of(result: RunResult) -> float | None:
    """What offloading saved against the local delays of this flight; None where they are not known."""
    local_only_s = result.local_only_time_s()
    return None if local_only_s is None or not result.completed else local_only_s - result.mission_time_s


def together(outcomes: Iterable[Outcome]) -> str:
    """The mean and the worst of the completed flights, in a sentence."""
    outcomes = list(outcomes)
    completed = [each.result for each in outcomes if each.result is not None and each.result.completed]
    if not completed:
        return f"none of {len(outcomes)} flights was completed"
    times_s = [result.mission_time_s for result in completed]
    saved_s = [each_s for result in completed if (each_s := saved_of(result)) is not None]
    saved = f"; saved: mean {mean(saved_s):z.1f} s, least {min(saved_s):z.1f} s" if saved_s else ""
    return (
        f"{len(completed)} of {len(outcomes)} flights completed; "
        f"mission time: mean {mean(times_s):.1f} s, worst {max(times_s):.1f} s{saved}"
    )
