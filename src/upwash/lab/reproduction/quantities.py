"""The figures that the thesis gives, as simulated missions have them, beside those that it prints."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import NamedTuple

from upwash.lab.reproduction.cells import (
    EXPERIMENTS,
    NAIVE,
    SETUPS,
    CellFlight,
    CellResult,
    Experiment,
    ThesisCell,
    cells,
    fly_all,
    local_only,
)
from upwash.support.confidence import Mean, mean_of


class ThesisQuantity(NamedTuple):
    """A figure, and the name that it has in printed.csv."""

    name: str
    label: str
    unit: str


LOCAL_ONLY = ThesisQuantity("mission_time_local_only", "mission time, no offloading", "min")
OFFLOADING = ThesisQuantity("mission_time_offloading", "mission time, offloading", "min")
_GAIN = ThesisQuantity("time_gain", "time gain", "percent")
_BOUND = ThesisQuantity("mission_time_over_the_bound", "  above the theoretical minimum", "percent")
_RATIO = ThesisQuantity("total_service_delay_local_over_offloading", "service delay, local / offl.", "ratio")
_WAITS = ThesisQuantity("waits_decided", "decisions to wait", "count")
_IN_VAIN = ThesisQuantity("waits_in_vain", "  of them wasted", "count")
_SAVED = ThesisQuantity(
    "saving_of_waiting_over_local_at_those_waypoints", "service delay saved by waiting", "percent"
)
_SAVED_THERE = ThesisQuantity(
    "saving_of_waiting_at_those_waypoints_alone", "  of the calls that waited", "percent"
)
_NAIVE_DELAY, _NAIVE_TIME = "naive_selection_extra_service_delay", "naive_selection_extra_mission_time"
_FLOWN = "_flown"  # what the thesis estimated from logs

_FORMS = {"min": "{:.2f} min", "ratio": "{:.2f} x", "count": "{:.1f}", "percent": "{:.1f} %"}


@dataclass(frozen=True)
class Comparison:
    """One figure as flown, a value per seed, and as the thesis prints it, or None."""

    setup: str
    experiment: Experiment
    quantity: ThesisQuantity
    values: Sequence[float]
    printed: float | None

    @property
    def mean(self) -> Mean:
        """The mean over the seeds, with its 95 % confidence."""
        return mean_of(self.values)

    @property
    def deviation_percent(self) -> float | None:
        """The difference of the mean from the printed figure, in percent; None without one, or if it is 0."""
        return 100 * (self.mean.value / self.printed - 1) if self.printed else None

    def written(self) -> tuple[str, str, str]:
        """The mean, the printed figure and how far it is from that: counts and percentages by their difference."""
        mean, unit = self.mean, self.quantity.unit
        margin = f" ± {mean.margin:.2f}" if mean.count > 1 else ""
        ours = _FORMS[unit].format(mean.value) + margin
        if self.printed is None:
            return ours, "", ""
        difference = mean.value - self.printed
        deviation = f"{100 * difference / self.printed:+.1f} %" if self.printed else ""
        if unit == "count":
            deviation = f"{difference:+.1f}"
        elif unit == "percent":
            deviation = f"{difference:+.1f} points"
        return ours, f"{self.printed:g}", deviation


def reproduce(
    *, seeds: int, workers: int | None = None, progress: Callable[[], None] = lambda: None
) -> list[Comparison]:
    """Flies every cell with seeds 1 to `seeds`, calling `progress` after each of `missions(seeds)` missions."""
    flights = [CellFlight(cell, seed) for cell in cells() for seed in range(1, seeds + 1)]
    flown: dict[ThesisCell, list[CellResult]] = {cell: [] for cell in cells()}
    for flight, result in zip(flights, fly_all(flights, workers=workers, progress=progress), strict=True):
        flown[flight.cell].append(result)
    return list(_compare(flown))


def missions(seeds: int) -> int:
    """The number of missions that `reproduce` flies."""
    return len(cells()) * seeds


def _compare(flown: Mapping[ThesisCell, Sequence[CellResult]]) -> Iterator[Comparison]:
    printed = printed_figures()
    for setup in SETUPS:
        for experiment in EXPERIMENTS:
            for quantity, values in _quantities(flown, setup, experiment):
                its_name = quantity.name.removesuffix(_FLOWN)
                yield Comparison(
                    setup, experiment, quantity, values, printed.get((experiment.name, setup, its_name))
                )


def _quantities(
    flown: Mapping[ThesisCell, Sequence[CellResult]], setup: str, experiment: Experiment
) -> Iterator[tuple[ThesisQuantity, list[float]]]:
    local = flown[local_only(setup, experiment)]
    aware = flown[ThesisCell(setup, experiment, "location-aware")]
    pairs = list(zip(local, aware, strict=True))
    if not experiment.slow_s2:
        yield LOCAL_ONLY, [flight.mission_min for flight in local]
    yield OFFLOADING, [flight.mission_min for flight in aware]
    yield _GAIN, [100 * (1 - its.mission_min / ours.mission_min) for ours, its in pairs]
    yield _BOUND, [100 * (flight.mission_min / flight.bound_min - 1) for flight in aware]
    yield _RATIO, [ours.service_delay_s / its.service_delay_s for ours, its in pairs]
    yield _WAITS, [len(flight.waited_calls_s) for flight in aware]
    yield _IN_VAIN, [flight.waits_in_vain for flight in aware]
    waiting = [flight for flight in aware if flight.waited_calls_s]
    if waiting:
        yield _SAVED, [100 * flight.saved_s / (flight.service_delay_s + flight.saved_s) for flight in waiting]
        local_s = [flight.local_call_s * len(flight.waited_calls_s) for flight in waiting]
        yield (
            _SAVED_THERE,
            [100 * its.saved_s / alone_s for its, alone_s in zip(waiting, local_s, strict=True)],
        )
    if experiment == NAIVE:
        equal = flown[ThesisCell(setup, Experiment(experiment.mode, slow_s2=False), "location-aware")]
        yield from _naive(flown[ThesisCell(setup, experiment, "opportunistic")], aware, "flown", _FLOWN)
        yield from _naive(list(map(_with_slow_calls, equal, aware)), aware, "logs")


def _naive(
    naive: Sequence[CellResult], aware: Sequence[CellResult], by: str, suffix: str = ""
) -> Iterator[tuple[ThesisQuantity, list[float]]]:
    """What the naive selection costs by the logs, or as flown."""
    pairs = list(zip(naive, aware, strict=True))

    def quantity(name: str, label: str, unit: str) -> ThesisQuantity:
        return ThesisQuantity(name + suffix, f"naive, {by}: {label}", unit)

    delays = [100 * (ours.service_delay_s / its.service_delay_s - 1) for ours, its in pairs]
    yield quantity(_NAIVE_DELAY, "service delay", "percent"), delays
    longer_min = [ours.mission_min - its.mission_min for ours, its in pairs]
    yield quantity(_NAIVE_TIME, "longer mission", "min"), longer_min
    shares = [100 * (ours.mission_min / its.mission_min - 1) for ours, its in pairs]
    yield quantity(f"{_NAIVE_TIME}_share", "longer mission", "percent"), shares


def _with_slow_calls(log: CellResult, slow: CellResult) -> CellResult:
    """The thesis's estimate: the mission with equal servers, with the delays on s2 of the slow one."""
    longer_s = log.s2_calls * (slow.s2_call_s - log.s2_call_s)
    return log._replace(
        mission_min=log.mission_min + longer_s / 60, service_delay_s=log.service_delay_s + longer_s
    )


_ROUNDED_AWAY = 0.5  # percent that a printed gain may be from that of the printed times


class Key(NamedTuple):
    """What a printed figure is of."""

    experiment: str
    setup: str
    quantity: str


class PrintedFigure(NamedTuple):
    """One figure, and where it is printed."""

    key: Key
    value: float
    unit: str
    source: str


def printed_figures() -> dict[tuple[str, str, str], float]:
    """The thesis's figures by experiment, set-up and quantity; of two for one, its table's."""
    return {figure.key: figure.value for figure in reversed(_printed())}


def contradictions() -> Iterator[str]:
    """Where the thesis prints two figures of one thing, or a gain that its own times do not make."""
    figures, sources = printed_figures(), {figure.key: figure.source for figure in reversed(_printed())}
    for figure in _printed():
        where = f"{figure.key.experiment}, {figure.key.setup}"
        ruling = figures[figure.key]
        if figure.value != ruling:
            what = figure.key.quantity.replace("_", " ")
            source = sources[figure.key]
            yield (
                f"{where}: {what} is {ruling:g} {figure.unit} in {source}, {figure.value:g} in {figure.source}"
            )
        elif figure.key.quantity == _GAIN.name:
            local, offloading = (
                figures[figure.key._replace(quantity=quantity)]
                for quantity in (LOCAL_ONLY.name, OFFLOADING.name)
            )
            own = 100 * (1 - offloading / local)
            if abs(own - figure.value) > _ROUNDED_AWAY:
                yield (
                    f"{where}: {figure.source} prints a gain of {figure.value:g} %; "
                    f"its own times, {offloading:g} instead of {local:g} min, make {own:.1f} %"
                )


@lru_cache
def _printed() -> tuple[PrintedFigure, ...]:
    text = (files("upwash.lab.reproduction") / "thesis" / "printed.csv").read_text(encoding="utf-8")
    figures = []
    for row in csv.DictReader(text.splitlines()):
        key = Key(row["experiment"], row["setup"], row["quantity"])
        figures.append(PrintedFigure(key, float(row["value"]), row["unit"], row["source"]))
    return tuple(figures)
