"""The measured worlds as Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import msgspec
from bench.gains.kept import Kept
from bench.gains.shares import MeasuredWorld, measured_worlds

from upwash.support.confidence import Mean, mean_of

_UNCHANGED = "="
_LEAST_S = 0.05  # a difference that rounds to 0.0 s counts as none


class Flown(msgspec.Struct, frozen=True, kw_only=True):
    """How the kept missions were flown."""

    worlds: int
    seeds: int
    missions: int
    cores: int
    took_s: float


def tables(kept: Kept) -> str:
    """The results of the missions, one table after the other; the brief one comes first."""
    worlds = measured_worlds(kept.missions)
    made = (brief_table, share_table, step_table, time_table)
    return "\n\n".join(table(kept.variants, worlds) for table in made)


def share_table(variants: Sequence[str], worlds: Sequence[MeasuredWorld]) -> str:
    """The share of the possible gain in percent, by world and variant."""
    head = ("share of the possible gain, %", "possible, min", *variants[1:])
    return _table(
        head, ([_title(world), _minutes(world.possible_s), *_shares(world, variants)] for world in worlds)
    )


def step_table(variants: Sequence[str], worlds: Sequence[MeasuredWorld]) -> str:
    """Seconds that each step saves, by world."""
    head = ("shorter than one column before, s", *variants[1:])
    return _table(head, ([_title(world), *_steps(world, variants)] for world in worlds))


def time_table(variants: Sequence[str], worlds: Sequence[MeasuredWorld]) -> str:
    """Mission times in minutes, by world and variant."""
    head = ("mission, min", "bound", *variants)
    return _table(head, ([_title(world), *_times(world, variants)] for world in worlds))


def brief_table(variants: Sequence[str], worlds: Sequence[MeasuredWorld]) -> str:
    """Of each step: in how many worlds it surely gains, surely loses, or neither, and where most."""
    head = ("step", "gains", "loses", "neither", "changes nothing", "most gained", "most lost")
    return _table(head, (_brief(variant, worlds) for variant in variants[1:]))


def _shares(world: MeasuredWorld, variants: Sequence[str]) -> Iterator[str]:
    for variant in variants[1:]:
        if variant not in world.times_s:
            yield ""
        elif not world.changes(variant):
            yield _UNCHANGED
        else:
            share = world.share(variant)
            yield f"{100 * share.value:.1f} ± {100 * share.margin:.1f}"


def _steps(world: MeasuredWorld, variants: Sequence[str]) -> Iterator[str]:
    for variant in variants[1:]:
        if variant not in world.times_s:
            yield ""
        else:
            yield _seconds(world.step_s(variant)) if world.changes(variant) else _UNCHANGED


def _times(world: MeasuredWorld, variants: Sequence[str]) -> Iterator[str]:
    yield f"{mean_of(world.bounds_s).value / 60:.2f}"
    for variant in variants:
        yield _minutes(mean_of(world.times_s[variant])) if variant in world.times_s else ""


def _brief(variant: str, worlds: Iterable[MeasuredWorld]) -> Sequence[str]:
    flown = [world for world in worlds if variant in world.times_s]
    steps = {_title(world): world.step_s(variant) for world in flown if world.changes(variant)}
    gains = {title: step for title, step in steps.items() if step.value > max(step.margin, _LEAST_S)}
    loses = {title: step for title, step in steps.items() if -step.value > max(step.margin, _LEAST_S)}
    return (
        variant,
        str(len(gains)),
        str(len(loses)),
        str(len(steps) - len(gains) - len(loses)),
        str(len(flown) - len(steps)),
        _named(max(gains.items(), key=lambda each: each[1].value, default=None)),
        _named(min(loses.items(), key=lambda each: each[1].value, default=None)),
    )


def _named(step: tuple[str, Mean] | None) -> str:
    return "" if step is None else f"{_seconds(step[1])} s, {step[0]}"


def _title(world: MeasuredWorld) -> str:
    return f"{world.group}: {world.name}"


def _minutes(mean_s: Mean) -> str:
    return f"{mean_s.value / 60:.2f} ± {mean_s.margin / 60:.2f}"


def _seconds(mean_s: Mean) -> str:
    return f"{mean_s.value:+.1f} ± {mean_s.margin:.1f}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    first, *rest = (f"| {' | '.join(line)} |" for line in (head, *rows))
    return "\n".join((first, "|---" * len(head) + "|", *rest))
