"""What metrics cost a drone, and what an answer to Prometheus takes: `python -m bench.metrics`.

The events are those of the thesis's simulated mission; the least of twenty rounds counts, as the machine may be busy.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from bench.program import command_line
from prometheus_client import generate_latest

from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.run import simulate
from upwash.lab.scenario import read_scenario
from upwash.metrics.drone import DroneMetrics

ROUNDS, QUICK_ROUNDS = 20, 1


def main() -> None:
    """Measures and prints."""
    rounds = QUICK_ROUNDS if command_line("metrics", __doc__).parse_args().quick else ROUNDS
    config = read_scenario(Path(__file__).parents[1] / "scenarios/thesis.toml")
    events = simulate(config).events
    calls = [event for event in events if isinstance(event, schema.Call)]
    metrics = DroneMetrics([server.name for server in config.servers])
    for what, some in (("event", events), ("call", calls)):
        took_s = _least_s(functools.partial(_follow, metrics, some), rounds)
        print(f"{1e6 * took_s / len(some):.1f} us for each {what}")
    answer = generate_latest(metrics.registry)
    answer_s = _least_s(lambda: generate_latest(metrics.registry), rounds)
    print(f"{1e3 * answer_s:.1f} ms for an answer of {len(answer) / 1e3:.0f} kB to Prometheus")


def _follow(metrics: DroneMetrics, events: Sequence[Event]) -> None:
    for event in events:
        metrics.follow(event)


def _least_s(do: Callable[[], object], rounds: int) -> float:
    times_s = []
    for _ in range(rounds):
        began_s = time.perf_counter()
        do()
        times_s.append(time.perf_counter() - began_s)
    return min(times_s)


if __name__ == "__main__":
    main()
