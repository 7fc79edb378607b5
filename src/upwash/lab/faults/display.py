"""What a person sees of worlds that were flown: the broken promises, and how to see each again."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
from rich.console import Console
from rich.text import Text

from upwash.lab.faults.campaign import ChaosFlight, WorldVerdict, fly_world, judge
from upwash.lab.faults.promises import Broken
from upwash.lab.outcome import quiet_daemons
from upwash.lab.processes import in_processes
from upwash.lab.scenario import as_toml
from upwash.support.output_files import write_file
from upwash.support.progress import work
from upwash.support.sentences import say
from upwash.support.text import plural

_CHUNK = 20  # worlds that a process flies together
_REPLAYED_EVERY = 20  # every 20th world is flown again and must leave the same log
_FAILURES_SHOWN = 20


class Summary(msgspec.Struct):
    """The results of many worlds."""

    worlds: int = 0
    flights: int = 0
    calls: int = 0
    replayed: int = 0
    longest_s: tuple[float, float] = (0.0, 0.0)  # the longest call, and its bound
    spare_s: float = math.inf  # the least that a call left of its bound
    broken: list[Broken] = msgspec.field(default_factory=list)
    took_s: float = 0.0

    def add(self, verdict: WorldVerdict) -> None:
        """Takes in one world."""
        self.worlds += 1
        self.flights += verdict.drones
        self.calls += verdict.calls
        self.replayed += is_replayed(verdict.seed)
        self.longest_s = max(self.longest_s, verdict.longest_s)
        self.spare_s = min(self.spare_s, verdict.spare_s)
        self.broken += verdict.broken


def is_replayed(seed: int) -> bool:
    """Whether the world of that seed is one of those that are flown twice."""
    return seed % _REPLAYED_EVERY == 0


def judge_all(seeds: Sequence[int]) -> list[WorldVerdict]:
    """Flies the worlds of the seeds one after the other."""
    with quiet_daemons():
        return [judge(seed, replay=is_replayed(seed)) for seed in seeds]


def show_chaos(
    seeds: range, *, minutes: float | None = None, workers: int | None = None, out: Path | None = None
) -> bool:
    """Flies the worlds, prints each broken promise and a summary; returns whether none was broken.

    With `minutes` it hands out no more worlds after that time. The summary is left in the file `out`, as JSON.
    """
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)  # before the hours of flying
    console, summary, began_s = Console(), Summary(), time.monotonic()
    chunks = [seeds[first : first + _CHUNK] for first in range(0, len(seeds), _CHUNK)]
    with work("worlds", len(seeds)) as flown, in_processes(judge_all, chunks, workers=workers) as done:
        for verdicts in done:
            for verdict in verdicts:
                _show_broken(verdict.broken, console, shown=len(summary.broken))
                summary.add(verdict)
            flown(len(verdicts))
            if minutes is not None and time.monotonic() - began_s > 60 * minutes:
                break
    summary.took_s = time.monotonic() - began_s
    _show_summary(summary, console)
    if out is not None:
        write_file(out, msgspec.json.format(msgspec.json.encode(summary)) + b"\n")
    return not summary.broken


def replay(seed: int, log: Path | None) -> bool:
    """Flies one world, prints its result, and returns whether no promise was broken.

    With `log`, each drone's event log and scenario are written there and beside it, and what an observer saw.
    """
    console = Console()
    flown = fly_world(seed)
    if log is not None:
        for file in _write(flown, log):
            console.print(str(file), soft_wrap=True)
    _show_broken(flown.broken, console, shown=0, hint=False)
    if not flown.broken:
        console.print(f"seed {seed}: no promise broken")
    return not flown.broken


def _write(flown: ChaosFlight, log: Path) -> Iterator[Path]:
    for document, run in zip(flown.documents, flown.runs, strict=True):
        first = run is flown.runs[0]
        own = log if first else log.with_name(f"{log.stem}-{document['name']}{log.suffix}")
        write_file(own, run.log())
        yield own
        scenario = own.with_suffix(".toml")
        write_file(scenario, as_toml(document).encode())
        yield scenario
    seen = log.with_name(f"{log.stem}-seen{log.suffix}")
    write_file(seen, b"".join(msgspec.json.encode(fact) + b"\n" for fact in flown.seen))
    yield seen


def _show_broken(broken: Sequence[Broken], console: Console, *, shown: int, hint: bool = True) -> None:
    for breach in broken[: max(0, _FAILURES_SHOWN - shown)]:
        say(Text(f"{breach.promise} broken by seed {breach.seed}: {breach.why}", style="red"), console)
        if breach.event is not None:
            console.print(
                f"  first bad event: {msgspec.json.encode(breach.event).decode()}",
                markup=False,
                soft_wrap=True,
            )
        if hint:
            console.print(
                f"  see it again: upwash chaos --seed {breach.seed} --log chaos-{breach.seed}.jsonl",
                soft_wrap=True,
            )


def _counted(number: int, noun: str) -> str:
    return f"{number:,} {noun if number == 1 else plural(noun)}"


def _show_summary(summary: Summary, console: Console) -> None:
    worlds = {breach.seed for breach in summary.broken}
    flown = f"{_counted(summary.flights, 'flight')} and {_counted(summary.calls, 'call')}"
    took = f"{summary.took_s / 60:.1f} min; {_counted(summary.replayed, 'world')} flown again"
    say(Text(f"{_counted(summary.worlds, 'world')} with {flown} in {took}"), console)
    delay_s, bound_s = summary.longest_s
    longest = f"the longest call took {delay_s:.2f} s of at most {bound_s:.2f} s"
    say(Text(f"{longest}; none left less than {summary.spare_s:.3f} s of its bound"), console)
    said = f"promises broken in {_counted(len(worlds), 'world')}" if worlds else "no promise broken"
    console.print(said, style="red" if worlds else "green", highlight=False)
