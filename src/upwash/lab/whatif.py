"""What flights would have been like under other policies and settings: replays in worlds that fit their logs.

A replay is one flight more, in a drawn world. The interval of a policy holds that flight with a probability of 95 %.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from upwash.core.policies.names import POLICIES
from upwash.errors import UsageError
from upwash.eventlog.schema import Event
from upwash.lab import processes
from upwash.lab.flown import FlownMission, read_flown
from upwash.lab.flown_world import FlownWorld
from upwash.lab.run import simulate
from upwash.lab.scenario import read_scenario
from upwash.support.confidence import Mean, mean_of, student_quantile
from upwash.support.text import counted

DRAWS = 12
_FEW = 10  # calls
_DOUBT, _MUCH = 0.0125, 0.03
_NO_SERVERS = "no call of this flight ran on a server, so its log knows nothing about calls there"
_SETTINGS: tuple[tuple[str, object], ...] = (
    *(("gain_wait", value) for value in (0.05, 0.1, 0.5)),
    *(("gain_switch", value) for value in (0.05, 0.1, 0.5)),
    ("hedge", False),
    ("hedge", True),
    *(("stay_or_go", value) for value in ("stay", "go", "learn")),
)


@dataclass(frozen=True, slots=True)
class ReplayedTime:
    """The time (s) that the mission would have taken; it lies within `low_s` and `high_s` with 95 % probability."""

    policy: str
    time_s: float
    low_s: float
    high_s: float


@dataclass(frozen=True, slots=True)
class WhatIf:
    """A flight and its predictions, the quickest first.

    `flown_s` is the time of the part that is replayed, `refused` says of policies why they have no prediction, and
    `notes` what the log does not know.
    """

    policy: str
    flown_s: float
    calls: int
    remote_calls: int
    predictions: Sequence[ReplayedTime]
    refused: dict[str, str]
    notes: Sequence[str]


@dataclass(frozen=True, slots=True)
class Tuned:
    """A setting of the policy, and the seconds that it saves in all flights together; negative for a loss."""

    setting: str
    saved: Mean


@dataclass(frozen=True, slots=True)
class Tuning:
    """What settings would have gained in the flights, the best first, against the `policy` by default.

    The `best` is chosen in one half of the replays, and its saving is that of the other half; None if none saves more
    than its margin in the first half. `estimates` has what was measured of servers, as keys of a configuration.
    """

    policy: str
    flown_s: float
    settings: Sequence[Tuned]
    best: Tuned | None
    estimates: Sequence[str]


@dataclass(frozen=True, slots=True)
class Replays:
    """How many replays of a policy there are, and in how many processes; `done` is called after each."""

    draws: int = DRAWS
    workers: int | None = None
    done: Callable[[], None] = lambda: None


@dataclass(frozen=True, slots=True)
class _Replay:
    world: FlownWorld
    policy: str
    seed: int
    key: str = ""
    value: object = None


def what_if(
    log: Iterable[Event],
    policies: Sequence[str] = POLICIES,
    *,
    replays: Replays = Replays(),
) -> WhatIf:
    """A prediction for each policy, from replays of it; UsageError where the flight cannot be replayed."""
    flown, draws = read_flown(log), replays.draws
    wanted = list(dict.fromkeys([*policies, *((flown.policy,) if flown.policy in POLICIES else ())]))
    refused = {policy: _NO_SERVERS for policy in wanted if policy != "local-only" and not flown.answers}
    known = [policy for policy in wanted if policy not in refused]
    world = FlownWorld(flown)
    parts = [_Replay(world, policy, seed) for policy in known for seed in range(1, draws + 1)]
    times = iter(processes.in_order(_replayed_s, parts, workers=replays.workers, done=replays.done))
    logs: dict[str, list[float]] = {}
    for policy in known:
        logs[policy] = [math.log(time_s) for time_s in itertools.islice(times, draws) if time_s]
        if len(logs[policy]) * 2 <= draws:
            refused[policy] = f"{draws - len(logs.pop(policy))} of {draws} replays were not completed"
    notes = [*flown.notes, *_unknown(flown)]
    doubt = _DOUBT
    if flown.policy in logs:  # its replays should be like the flight itself
        own = logs[flown.policy]
        excess = max(0.0, abs(math.log(flown.time_s) - fmean(own)) - stdev(own))
        doubt = math.hypot(_DOUBT, excess)
        if excess > _MUCH:
            notes.append(
                f"replays under {flown.policy} are unlike the flight itself by more than {100 * excess:.0f} %"
            )
    predictions = [predicted(policy, found, doubt) for policy, found in logs.items()]
    return WhatIf(
        policy=flown.policy,
        flown_s=flown.time_s,
        calls=sum(map(len, flown.calls.values())),
        remote_calls=flown.remote_calls,
        predictions=sorted(predictions, key=lambda found: found.time_s),
        refused=refused,
        notes=notes,
    )


def tune(
    logs: Sequence[Iterable[Event]],
    policy: str | None = None,
    *,
    replays: Replays = Replays(),
) -> Tuning:
    """What settings of the policy, by default the first flight's, would have saved in the flights together."""
    flights = [read_flown(log) for log in logs]
    policy = policy or flights[0].policy
    if policy == "local-only" or any(not flown.answers for flown in flights):
        raise UsageError(f"there is nothing to tune: {_NO_SERVERS}")
    late = any(flown.late for flown in flights)
    settings: list[tuple[str, object]] = [("", None), ("estimates", "as measured")]
    settings += [setting for setting in _SETTINGS if late or setting[0] != "stay_or_go"]
    worlds = [FlownWorld(flown) for flown in flights]
    draws = replays.draws
    seeds = range(1, draws + 1)
    parts = [
        _Replay(world, policy, seed, *setting) for setting in settings for seed in seeds for world in worlds
    ]
    times = iter(processes.in_order(_replayed_s, parts, workers=replays.workers, done=replays.done))
    sums = [[_sum(itertools.islice(times, len(worlds))) for _ in seeds] for _ in settings]
    saved = {}
    for (key, value), after in zip(settings[1:], sums[1:], strict=True):
        found = [before_s - after_s for before_s, after_s in zip(sums[0], after, strict=True)]
        if len(finite := list(filter(math.isfinite, found))) > draws / 2:
            saved[f"{key} = {value}"] = finite
    tuned = [Tuned(name, mean_of(found)) for name, found in saved.items()]
    return Tuning(
        policy=policy,
        flown_s=sum(flown.time_s for flown in flights),
        settings=sorted(tuned, key=lambda found: -found.saved.value),
        best=best_of(saved),
        estimates=list(dict.fromkeys(line for flown in flights for line in flown.estimates())),
    )


def best_of(saved: Mapping[str, Sequence[float]]) -> Tuned | None:
    """The setting that saves most in every other replay, with what it saves in those that did not choose it.

    None where it saves nothing for sure in the replays that chose it.
    """
    chosen = max(saved, key=lambda name: fmean(saved[name][::2]), default=None)
    if chosen is None or (first := mean_of(saved[chosen][::2])).value <= first.margin:
        return None
    return Tuned(chosen, mean_of(saved[chosen][1::2]))


def _sum(times: Iterator[float | None]) -> float:
    """The sum of the flights' times; NaN where one was not completed."""
    return sum(math.nan if time_s is None else time_s for time_s in times)


def _replayed_s(replay: _Replay) -> float | None:
    measured = replay.key == "estimates"
    overrides = {f"policy.{replay.key}": replay.value} if replay.key and not measured else {}
    document = replay.world.draw(replay.seed, as_measured=measured)
    config = read_scenario(document, policy=replay.policy, seed=replay.seed, overrides=overrides)
    run = simulate(config)
    return run.result.mission_time_s if run.result.completed else None


def predicted(policy: str, logs: Sequence[float], doubt: float) -> ReplayedTime:
    """The prediction by the logarithms of replayed times; `doubt` is the relative deviation of the model itself.

    The interval is that of one flight more, and as wide as the replays at least.
    """
    mean = fmean(logs)
    deviation = math.sqrt(stdev(logs) ** 2 * (1 + 1 / len(logs)) + doubt**2)
    margin = student_quantile(len(logs) - 1) * deviation
    low, high = min(mean - margin, *logs), max(mean + margin, *logs)
    return ReplayedTime(policy, math.exp(mean), math.exp(low), math.exp(high))


def _unknown(flown: FlownMission) -> Iterator[str]:
    """What the log does not know, which widens the intervals."""
    unused = [name for name, server in flown.servers.items() if not server.answers]
    if unused and flown.answers:
        yield f"never used in this flight: {', '.join(unused)}; their speed, start and faults are drawn"
    onboard = [operation for operation in flown.operations if not flown.local_s.get(operation)]
    if onboard:
        yield f"never computed on the drone: {', '.join(onboard)}; the delay there is as it was believed"
    count = sum(map(len, flown.local_s.values()))
    if count < _FEW:
        yield f"{counted(count, 'call')} ended on the drone, too few to see whether its computer gets hot"


def order_of(found: Sequence[ReplayedTime]) -> Iterator[str]:
    """Which policies are quicker than others for sure: their intervals do not overlap."""
    for one in found:
        slower = [other.policy for other in found if one.high_s < other.low_s]
        if slower:
            yield f"{one.policy} is quicker than {', '.join(slower)}"
