"""Many flights, by the policy or the drone that flew them: mean times, and differences within the same scenarios."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from upwash.report.record import Record
from upwash.support.confidence import Mean, mean_of
from upwash.support.text import counted, lasting

_APART = "\u00a0"  # where no line ends


@dataclass(frozen=True, slots=True)
class Group:
    """The completed flights that have a policy, or a drone, in common, and the mean of their mission times."""

    name: str
    flights: Sequence[Record]
    time_s: Mean


@dataclass(frozen=True, slots=True)
class Pair:
    """Two flights of the same scenario and seed: by how much longer the mission took with the first policy."""

    name: str
    longer_s: float


@dataclass(frozen=True, slots=True)
class Difference:
    """How much longer missions take with `policy` than with `reference`, by the pairs that were flown with both."""

    policy: str
    reference: str
    pairs: Sequence[Pair]
    longer_s: Mean


def what_groups(records: Sequence[Record]) -> str:
    """What flights are told apart by: their policy, or their drone where all have the same policy."""
    policies = {record.result.policy for record in records}
    drones = {record.drone for record in records}
    return "drone" if len(policies) == 1 and len(drones) > 1 else "policy"


def groups_of(records: Sequence[Record]) -> list[Group]:
    """The groups, the fastest first; a flight that was not completed is in none."""
    by_drone = what_groups(records) == "drone"
    flights: dict[str, list[Record]] = defaultdict(list)
    for record in records:
        if record.result.completed:
            flights[(record.drone or "") if by_drone else record.result.policy].append(record)
    groups = [
        Group(name, flown, mean_of([record.result.mission_time_s for record in flown]))
        for name, flown in sorted(flights.items())
    ]
    return sorted(groups, key=lambda group: group.time_s.value)


def differences(records: Sequence[Record]) -> list[Difference]:
    """Of any two policies with which the same scenario and seed were flown, the faster first.

    Of several completed flights with the same policy, scenario, seed and drone the last counts.
    """
    flown: dict[str, dict[tuple[str, int, str], Record]] = defaultdict(dict)
    for record in records:
        if record.simulated is not None and record.result.completed:
            key = record.simulated.scenario, record.simulated.seed, record.drone or ""
            flown[record.result.policy][key] = record
    return [
        difference
        for policy, reference in itertools.combinations(sorted(flown), 2)
        if (difference := _difference(policy, reference, flown)) is not None
    ]


def _difference(
    policy: str, reference: str, flown: Mapping[str, Mapping[tuple[str, int, str], Record]]
) -> Difference | None:
    common = [key for key in flown[policy] if key in flown[reference]]
    if not common:
        return None
    pairs = []
    for key in common:
        own, other = flown[policy][key].result, flown[reference][key].result
        pairs.append(Pair(_named(key), own.mission_time_s - other.mission_time_s))
    mean = mean_of([pair.longer_s for pair in pairs])
    if mean.value <= 0:
        return Difference(policy, reference, pairs, mean)
    turned = [Pair(pair.name, -pair.longer_s) for pair in pairs]
    return Difference(reference, policy, turned, Mean(mean.count, -mean.value, mean.margin))


def _named(key: tuple[str, int, str]) -> str:
    scenario, seed, drone = key
    return f"{scenario}, seed {seed}{f', {drone}' if drone else ''}"


def in_seconds(mean: Mean) -> str:
    """The mean with its confidence, on one line; equal missions, as those without [noise], have none."""
    margin = f"{_APART}±{_APART}{mean.margin:.1f}" if 0 < mean.margin < math.inf else ""
    return f"{mean.value:z.1f}{margin}{_APART}s"


def verdict(records: Sequence[Record]) -> str:
    """The summary of many flights, in a sentence."""
    completed = sum(record.result.completed for record in records)
    which = "all" if completed == len(records) else str(completed)
    counts = f"{counted(len(records), 'flight')}, {which} completed"
    groups = groups_of(records)
    if not groups:
        return f"{counts}."
    means = ", ".join(
        f"{lasting(group.time_s.value, group.time_s.margin)} with {group.name or 'no name'}"
        for group in groups
    )
    return f"{counts}; the mission took on average {means}."


def in_words(difference: Difference) -> str:
    """What the pairs say of the two policies."""
    mean, pairs = difference.longer_s, counted(len(difference.pairs), "pair")
    if mean.count > 1 and mean.value + mean.margin >= 0:
        return (
            f"Between {difference.policy} and {difference.reference} no difference shows: "
            f"{in_seconds(mean)} in {pairs}."
        )
    less_s = in_seconds(Mean(mean.count, -mean.value, mean.margin))
    faster = sum(pair.longer_s < 0 for pair in difference.pairs)
    return (
        f"{difference.policy} took {less_s} less than {difference.reference} on average, and was faster in "
        f"{faster} of {pairs}."
    )
