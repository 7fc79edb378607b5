"""What each part leaves in bench/results, and the text of its table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.baselines import tables
from bench.baselines.knowing import Known
from bench.baselines.manners import COPIES, LEAST, REPLICATED
from bench.baselines.reserving import Shared
from bench.gains.kept import Missions, read
from bench.results import FOLDER
from msgspec import Struct, convert

PARTS = ("named", "speeds", "drawn", "clients", "knowing", "reserving")


class Measured(Struct, frozen=True, kw_only=True):
    """How much was flown; and the figures of a part that keeps no missions."""

    seeds: int
    worlds: int
    missions: int
    cores: int
    took_s: float
    figures: Any = None


def file_of(part: str) -> Path:
    """The missions of a part."""
    return FOLDER / f"baselines_{part}.csv"


def flights_of(missions: Sequence[Missions]) -> int:
    """How many missions were flown: bounds, and what was replayed, were not."""
    computed = (LEAST, COPIES, REPLICATED)
    return sum(not name.startswith(computed) for each in missions for name in each.times_s)


def shown(part: str, measured: Measured, missions: Sequence[Missions] | None = None) -> str:
    """The part's table, of these missions or of those that are kept."""
    if part == "knowing":
        known = convert(measured.figures, list[Known])
        head, *rows = tables.by_knowledge(known)
        return f"{tables.in_markdown(head, rows)}\n\n{tables.worst_regrets(known)}"
    if part == "reserving":
        shared = convert(measured.figures, list[Shared])
        return tables.in_markdown(tables.SHARED_HEAD, tables.by_sharing(shared))
    worlds = tables.worlds_of(read(file_of(part)).missions if missions is None else missions)
    if part == "drawn":
        lost = tables.lost_most(worlds)
        table = tables.in_markdown(tables.DRAWN_HEAD, tables.by_share(worlds))
        return f"{table}\n\nMost lost by servers, with each side flown well: {lost or 'nowhere'}."
    if part == "clients":
        return tables.in_markdown(tables.CLIENTS_HEAD, tables.by_client(worlds))
    return tables.in_markdown(tables.MANNERS_HEAD, tables.by_manner(worlds))
