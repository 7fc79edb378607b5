"""The share of the possible gain that each variant reaches, and the gain of each step of the ladder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from bench.gains.kept import Missions

from upwash.support.confidence import Mean, mean_of


@dataclass(frozen=True)
class MeasuredWorld:
    """One world: mission times and bounds by seed, in seconds; the variants are in the ladder's order."""

    group: str
    name: str
    bounds_s: Sequence[float]
    times_s: Mapping[str, Sequence[float]]

    @property
    def steps(self) -> Sequence[str]:
        """The variants but the first one, which gains are counted from."""
        return list(self.times_s)[1:]

    @property
    def _reference_s(self) -> Sequence[float]:
        return next(iter(self.times_s.values()))

    @property
    def possible_s(self) -> Mean:
        """What the theoretical minimum gains over the first variant."""
        return mean_of([own - bound for own, bound in zip(self._reference_s, self.bounds_s, strict=True)])

    def share(self, variant: str) -> Mean:
        """How much of that the variant gains: 0 is nothing, 1 is all of it. Of each seed's share, the mean."""
        seeds = zip(self._reference_s, self.times_s[variant], self.bounds_s, strict=True)
        return mean_of([(reference - own) / (reference - bound) for reference, own, bound in seeds])

    def step_s(self, variant: str) -> Mean:
        """By how much the mission is shorter than under the variant before, seed by seed."""
        return mean_of([before - own for before, own in self._pairs(variant)])

    def changes(self, variant: str) -> bool:
        """Whether any mission takes another time than under the variant before."""
        return any(own != before for before, own in self._pairs(variant))

    def _pairs(self, variant: str) -> list[tuple[float, float]]:
        names = list(self.times_s)
        before = names[names.index(variant) - 1]
        return list(zip(self.times_s[before], self.times_s[variant], strict=True))


def measured_worlds(missions: Iterable[Missions]) -> list[MeasuredWorld]:
    """The worlds in the order of the missions; in each, every variant that flew there flew every seed."""
    worlds = []
    for (group, name), rows in groupby(missions, lambda row: (row.group, row.world)):
        own = sorted(rows, key=lambda row: row.seed)
        times_s = {variant: [row.times_s[variant] for row in own] for variant in own[0].times_s}
        worlds.append(MeasuredWorld(group, name, [row.bound_s for row in own], times_s))
    return worlds
