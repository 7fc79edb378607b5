"""What was flown as tables: minutes alone and with servers, and what servers save, paired by seed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby
from statistics import fmean, median, quantiles

from bench.baselines.knowing import Known
from bench.baselines.manners import ALONE, COPIES, LEAST, MANNERS, REPLICATED, SERVED
from bench.baselines.reserving import WAYS, Shared
from bench.gains.kept import Missions

from upwash.support.confidence import Mean, mean_of

NOTICEABLE = 1.0  # % of the mission of the drone alone
_GROUPS = ((0.0, 1.0), (1.0, 3.0), (3.0, 10.0), (10.0, 1e9))  # seconds of a call on the drone
Table = Iterator[tuple[str, ...]]


class World:
    """One world's missions, by seed."""

    def __init__(self, group: str, name: str, missions: Sequence[Missions]) -> None:
        self.group, self.name, self.missions = group, name, missions

    def flies(self, variant: str) -> bool:
        """Whether that variant was flown here."""
        return variant in self.missions[0].times_s

    def times_s(self, variant: str) -> list[float]:
        """The variant's times (s), by seed."""
        return [mission.times_s[variant] for mission in self.missions]

    def mean_s(self, variant: str) -> float:
        """Their mean."""
        return fmean(self.times_s(variant))

    def quickest(self, who: str) -> str:
        """The variant with the least mean of those of the drone alone, or with servers, or of the minimum."""
        return min((f"{who}, {each}" for each in MANNERS if self.flies(f"{who}, {each}")), key=self.mean_s)

    def saved(self, before: str, after: str) -> Mean:
        """By how many % the one is longer than the other."""
        pairs = zip(self.times_s(before), self.times_s(after), strict=True)
        return mean_of([100 * (1 - later_s / earlier_s) for earlier_s, later_s in pairs])


def worlds_of(missions: Sequence[Missions]) -> list[World]:
    """The worlds, in the missions' order."""
    grouped = groupby(missions, lambda each: (each.group, each.world))
    return [World(*key, list(own)) for key, own in grouped]


MANNERS_HEAD = (
    "world",
    "waits",
    "learns",
    "moves",
    "flown well, min",
    "saved by it, %",
    "of the possible, %",
)


def by_manner(worlds: Sequence[World]) -> Table:
    """What servers save in each manner, and between the quickest of each side; a figure for each share of demands."""
    for name in dict.fromkeys(world.name for world in worlds):
        own = [world for world in worlds if world.name == name]
        ways = [[world.quickest(who) for who in (ALONE, SERVED, LEAST)] for world in own]
        pairs = list(zip(own, ways, strict=True))
        yield (
            name,
            *(_all(_saved_by(world, manner) for world in own) for manner in ("waits", "learns", "moves")),
            _all(
                f"{_minutes(world, alone)}, {_minutes(world, served)}" for world, (alone, served, _) in pairs
            ),
            _all(_figure(world.saved(alone, served)) for world, (alone, served, _) in pairs),
            _all(_of_the_possible(world, *names) for world, names in pairs),
        )


DRAWN_HEAD = (
    "both", "worlds", "mean saved", "median", "middle 80 %", "saves 1 % or more", "loses 1 % or more", "worst",
)  # fmt: skip


def by_share(worlds: Sequence[World]) -> Table:
    """What servers save in drawn worlds, where both drones fly in the same manner, and each in its quickest."""
    for manner in ("waits", "learns", "moves"):
        pair = (f"{ALONE}, {manner}", f"{SERVED}, {manner}")
        if flying := [world for world in worlds if all(map(world.flies, pair))]:
            yield (manner, *_spread(flying, lambda _, pair=pair: pair))  # type: ignore[misc]
    yield ("flown well", *_spread(worlds, _quickest))
    for low_s, high_s in _GROUPS:
        some = [world for world in worlds if low_s <= float(world.name.split(", ")[1][:-2]) < high_s]
        name = f"over {low_s:g} s" if high_s > 1e6 else f"{low_s:g} to {high_s:g} s"
        if some:
            yield (f"flown well, calls of {name}", *_spread(some, _quickest))
    for group, name in (("none", "no demands"), ("demands", "demands")):
        if some := [world for world in worlds if world.group == group]:
            yield (f"flown well, {name}", *_spread(some, _quickest))


def lost_most(worlds: Sequence[World], count: int = 5) -> str:
    """The worlds where servers cost most."""
    saved = {world.name.split(",")[0]: world.saved(*_quickest(world)).value for world in worlds}
    least = sorted(saved.items(), key=lambda pair: pair[1])[:count]
    return ", ".join(f"{name} ({-value:.1f} %)" for name, value in least if value < 0)


_SHOWN = ("thesis", "races, stops", REPLICATED)  # the other clients are no stronger
CLIENTS_HEAD = ("world", "look-ahead, min", *_SHOWN, "servers a call")


def by_client(worlds: Sequence[World]) -> Table:
    """Minutes under look-ahead, and by how many % the mission of each other client is shorter (or longer)."""
    reference = f"{SERVED}, waits"
    for world in (*(world for world in worlds if world.group != "held out"), *_held_out(worlds)):
        cells = (_figure(world.saved(reference, name)) for name in _SHOWN)
        yield world.name, f"{world.mean_s(reference) / 60:.2f}", *cells, f"{world.mean_s(COPIES):.2f}"


def _held_out(worlds: Sequence[World]) -> Iterator[World]:
    drawn = [mission for world in worlds if world.group == "held out" for mission in world.missions]
    if drawn:
        yield World("held out", f"{len(drawn)} drawn worlds", drawn)


def by_knowledge(found: Sequence[Known]) -> Table:
    """What going, learning and knowing gain over staying, in %: a row for each kind of demands, the head first."""
    calls = list(dict.fromkeys(row.calls for row in found))
    yield "an answer has a demand", *calls
    for chance in dict.fromkeys(row.chance for row in found):
        own = {row.calls: row.gains.values() for row in found if row.chance == chance}
        yield chance, *(" / ".join(f"{gain:.1f}" for gain, _ in own[each]) for each in calls)


def worst_regrets(found: Sequence[Known]) -> str:
    """By how much a mission that learns is longer at most than the quickest static decision, and than knowing."""
    most: dict[str, tuple[float, Known]] = {}
    for row in found:
        left = {name: 100 - gain for name, (gain, _) in row.gains.items()} | {"stay": 100.0}
        for name, value in (
            (
                "saves against the slower of staying and going",
                100 * (1 - left["learn"] / max(left["stay"], left["go"])),
            ),
            ("loses against the quicker of them", 100 * (left["learn"] / min(left["stay"], left["go"]) - 1)),
            ("loses against knowing the probabilities", 100 * (left["learn"] / left["knows"] - 1)),
        ):
            if name not in most or value > most[name][0]:
                most[name] = (value, row)
    parts = (f"{name} up to {value:.1f} % ({row.calls}; {row.chance})" for name, (value, row) in most.items())
    margin = max(margin for row in found for _, margin in row.gains.values())
    return f"Intervals are ± {margin:.1f} or less. Learning {'; '.join(parts)}."


SHARED_HEAD = ("drones", "local-only, min", *WAYS[1:])


def by_sharing(found: Sequence[Shared]) -> Table:
    """By how many % the mean mission is shorter than local-only, and Jain's index of the savings."""
    for (layout, drones), own in groupby(found, lambda each: (each.layout, each.drones)):
        alone, *others = own
        cells = (f"{way.saved_percent:.1f} ± {way.margin_percent:.1f}, {way.jain:.2f}" for way in others)
        yield f"{drones}, {layout}", f"{alone.mean_min:.1f}", *cells


def in_markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """The table."""
    first, *rest = (f"| {' | '.join(line)} |" for line in (head, *rows))
    return "\n".join((first, "|---" * len(head) + "|", *rest))


def _quickest(world: World) -> tuple[str, str]:
    return world.quickest(ALONE), world.quickest(SERVED)


def _spread(worlds: Sequence[World], pair: Callable[[World], tuple[str, str]]) -> Iterator[str]:
    values = [world.saved(*pair(world)).value for world in worlds]
    mean, cuts = mean_of(values), quantiles(values, n=10) if len(values) > 1 else values * 9
    yield str(len(values))
    yield _percent(mean)
    yield f"{median(values):.1f} %"
    yield f"{cuts[0]:.1f} to {cuts[-1]:.1f} %"
    yield _share(values, lambda value: value >= NOTICEABLE)
    yield _share(values, lambda value: value <= -NOTICEABLE)
    yield f"{min(values):.1f} %"


def _share(values: Sequence[float], holds: Callable[[float], bool]) -> str:
    return f"{100 * sum(map(holds, values)) / len(values):.0f} %"


def _all(cells: Iterable[str]) -> str:
    found = list(cells)
    return " / ".join(found if len(set(found)) > 1 else found[:1])


def _saved_by(world: World, manner: str) -> str:
    alone, served = f"{ALONE}, {manner}", f"{SERVED}, {manner}"
    return f"{round(world.saved(alone, served).value) + 0:d}" if world.flies(alone) else "-"


def _minutes(world: World, variant: str) -> str:
    return f"{world.mean_s(variant) / 60:.1f}"


def _of_the_possible(world: World, alone: str, served: str, least: str) -> str:
    possible_s = world.mean_s(alone) - world.mean_s(least)
    return (
        f"{100 * (world.mean_s(alone) - world.mean_s(served)) / possible_s:.0f}" if possible_s > 1.0 else "-"
    )


def _percent(mean: Mean) -> str:
    return f"{_figure(mean)} %"


def _figure(mean: Mean) -> str:
    margin = f" ± {mean.margin:.1f}" if mean.count > 1 and mean.margin >= 0.05 else ""
    return f"{round(mean.value, 1) + 0.0:.1f}{margin}"  # no "-0.0"
