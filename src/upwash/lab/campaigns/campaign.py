"""Many runs, on all cores or on a Dask cluster; an interrupted campaign continues where it stopped."""

from __future__ import annotations

import contextlib
import itertools
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import fmean

import msgspec

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.reading import Document
from upwash.errors import MissionFailed, UsageError
from upwash.lab import processes
from upwash.lab.campaigns.file import ENERGY, CampaignFile, CampaignRow
from upwash.lab.campaigns.sweep import Combination, ParameterSweep
from upwash.lab.outcome import FlightOutcome, fly
from upwash.support.confidence import Mean, mean_or_none
from upwash.support.loading import extra

_CHUNK_RUNS = 5  # an interruption loses few, and handing them out costs nothing
_CHUNK_S = 2.0  # likewise, once the cost of a run is known
_MOST_CHUNK_RUNS = 100
_SAMPLE_RUNS = 8
_SAMPLE_S = 1.0
_CHUNKS_OF_A_THREAD = 4  # of a cluster, handed out before they are needed


@dataclass(frozen=True, slots=True)
class Chunk:
    """Some runs of one combination: one process flies them in turn, and computes their bounds if `bounded`."""

    file: str
    values: tuple[str, ...]
    document: Document
    seeds: tuple[int, ...]
    bounded: bool = True


@dataclass(frozen=True, slots=True)
class CombinationSummary:
    """The means of one combination; None without a completed run."""

    values: tuple[str, ...]
    mission_time_s: Mean | None
    bound_s: float | None  # the mean, of the same runs
    energy_wh: Mean | None  # likewise, with an energy meter
    worst_s: Mean | None  # likewise, where several drones flew
    jain: Mean | None
    lighter: Mean | None  # calls, likewise, with mission.lighter
    failures: dict[int, str]  # reason by seed


@dataclass(frozen=True, slots=True)
class Cost:
    """What is still to be flown, and what one mission costs: seconds of one processor's time."""

    missions: int
    mission_s: float


Fly = Callable[[Sequence[Chunk]], contextlib.AbstractContextManager[Iterator[list[CampaignRow]]]]


def run_campaign(
    file: CampaignFile,
    *,
    fly: Fly,
    flown: Callable[[int], None] = lambda _: None,
    costs: Callable[[Cost], None] | None = None,
) -> list[CombinationSummary]:
    """Flies what is not yet in the file, and sorts it; returns a summary per combination, in the sweep's order.

    `flown` gets the number of new runs, first those that the file had. `costs`, if given, gets the cost of the rest,
    measured with some missions of the campaign.
    """
    flown(len(file.rows))
    chunk_runs = _CHUNK_RUNS
    if costs is not None and (sample := _sample(file.sweep, file.rows)):
        cost = _measure(file, sample, flown)
        if cost.missions:
            costs(cost)
        chunk_runs = max(1, min(_MOST_CHUNK_RUNS, round(_CHUNK_S / cost.mission_s)))
    with fly(list(_chunks(file.sweep, file.rows, chunk_runs))) as chunks:
        for rows in chunks:
            file.append(rows)
            flown(len(rows))
    file.finish()
    return _summaries(file.sweep, file.rows)


def _measure(file: CampaignFile, sample: Sequence[Chunk], flown: Callable[[int], None]) -> Cost:
    took_s: list[float] = []
    for chunk in sample:
        began_s = time.process_time()
        file.append(fly_chunk(chunk))
        took_s.append(time.process_time() - began_s)
        flown(1)
        if sum(took_s) > _SAMPLE_S:
            break
    left = len(file.sweep.combinations) * file.sweep.seeds - len(file.rows)
    return Cost(left, fmean(took_s[1:] or took_s))  # the first one loads what all need


def _sample(sweep: ParameterSweep, done: Iterable[CampaignRow]) -> list[Chunk]:
    """Some of the runs that are left, spread evenly."""
    left = list(_chunks(sweep, done, 1))
    return left[:: max(1, len(left) // _SAMPLE_RUNS)][:_SAMPLE_RUNS]


def fly_sweep(
    sweep: ParameterSweep,
    *,
    fly: Fly,
    flown: Callable[[int], None] = lambda _: None,
    done: Sequence[CampaignRow] = (),
) -> list[CombinationSummary]:
    """Flies what is not `done` of the sweep, without a file; returns what `run_campaign` does, without bounds."""
    rows = list(done)
    with fly([replace(chunk, bounded=False) for chunk in _chunks(sweep, rows, 1)]) as chunks:
        for some in chunks:
            rows += some
            flown(len(some))
    return _summaries(sweep, rows)


def in_processes(workers: int | None = None) -> Fly:
    """A function that flies in processes of this machine; by default one for each core that may be used."""
    return lambda chunks: processes.in_processes(fly_chunk, chunks, workers=workers)


def here_first(workers: int | None = None) -> Fly:
    """A function that flies in this process, and in more processes if the work is long enough."""
    return lambda chunks: processes.here_first(fly_chunk, chunks, workers=workers)


def on_cluster(address: str, *, answer_s: float = 10.0) -> Fly:
    """A function that flies on a Dask cluster's workers; raises UsageError if none answers in time."""
    with extra("campaign"):
        import distributed

    @contextlib.contextmanager
    def fly(chunks: Sequence[Chunk]) -> Generator[Iterator[list[CampaignRow]]]:
        try:
            client = distributed.Client(  # type: ignore[no-untyped-call]
                address, timeout=answer_s, set_as_default=False
            )
        except (OSError, ValueError) as error:
            raise UsageError(f"no Dask scheduler answers at {address}: {error}") from error
        with client:
            left = iter(chunks)
            threads = sum(client.nthreads().values())  # type: ignore[no-untyped-call]
            first = client.map(
                fly_chunk, list(itertools.islice(left, _CHUNKS_OF_A_THREAD * max(1, threads))), pure=False
            )
            flown = distributed.as_completed(  # type: ignore[no-untyped-call]
                first, loop=client.loop, with_results=True
            )

            def results() -> Iterator[list[CampaignRow]]:
                for _, rows in flown:
                    for chunk in itertools.islice(left, 1):
                        flown.add(client.submit(fly_chunk, chunk, pure=False))  # type: ignore[no-untyped-call]
                    yield rows

            yield results()

    return fly


def fly_chunk(chunk: Chunk) -> list[CampaignRow]:
    """Flies the runs one after the other; a run that fails is a row too."""
    return [_fly(chunk, seed) for seed in chunk.seeds]


def _fly(chunk: Chunk, seed: int) -> CampaignRow:
    config = msgspec.structs.replace(drone_config(chunk.document, Path(chunk.file)), seed=seed)
    try:
        flown = fly(config, bounded=chunk.bounded)
    except MissionFailed as error:  # this run's failure, not the others'
        return CampaignRow(chunk.values, seed, config.policy.label, failure=_one_line(str(error)))
    return row_of(chunk.values, config, flown)


def row_of(values: tuple[str, ...], config: DroneConfig, flown: FlightOutcome) -> CampaignRow:
    """The row of a flight with that configuration."""
    totals = asdict(flown.totals) | {"remote": sum(flown.totals.remote.values())}
    if not config.mission.lighter:
        del totals["lighter"]
    energy = asdict(flown.energy) if flown.energy else {}
    fleet = flown.fleet
    return CampaignRow(
        values,
        config.seed,
        flown.policy,
        mission_time_s=flown.mission_time_s,
        completed=flown.completed,
        failure=_one_line(flown.failure),
        bound_s=flown.bound.free_s if flown.bound else None,
        bound_with_joins_s=flown.bound.with_joins_s if flown.bound else None,
        energy_wh=energy.get("total_wh"),
        completed_drones=fleet.completed if fleet else None,
        worst_s=fleet.worst_s if fleet else None,
        jain=fleet.fairness if fleet else None,
        bound_shared_s=flown.least_s if fleet else None,
        **totals,
        **{name: value for name, value in energy.items() if name in ENERGY},
    )


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _chunks(sweep: ParameterSweep, done: Iterable[CampaignRow], runs: int) -> Iterator[Chunk]:
    flown = {(row.values, row.seed) for row in done}
    for combination in sweep.combinations:
        missing = (seed for seed in range(1, sweep.seeds + 1) if (combination.values, seed) not in flown)
        while seeds := tuple(itertools.islice(missing, runs)):
            yield Chunk(str(sweep.file), combination.values, combination.document, seeds)


def _summaries(sweep: ParameterSweep, rows: Sequence[CampaignRow]) -> list[CombinationSummary]:
    by_values: dict[tuple[str, ...], list[CampaignRow]] = defaultdict(list)
    for row in rows:
        by_values[row.values].append(row)
    return [_summary(combination, by_values[combination.values]) for combination in sweep.combinations]


def _summary(combination: Combination, own: Sequence[CampaignRow]) -> CombinationSummary:
    completed = [row for row in own if row.completed]
    bounds_s = [row.bound_s if row.bound_shared_s is None else row.bound_shared_s for row in completed]
    known_s = [bound_s for bound_s in bounds_s if bound_s is not None]
    return CombinationSummary(
        combination.values,
        _mean(row.mission_time_s for row in completed),
        fmean(known_s) if known_s else None,
        _mean(row.energy_wh for row in completed),
        _mean(row.worst_s for row in completed),
        _mean(row.jain for row in completed),
        _mean(row.lighter for row in completed),
        {row.seed: row.failure for row in own if not row.completed},
    )


def _mean(values: Iterable[float | None]) -> Mean | None:
    return mean_or_none([value for value in values if value is not None])
