"""The input of one trial, and its result."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

import msgspec

Scenario = Literal["none", "black-out", "killed", "stopped", "late"]
SCENARIOS: tuple[Scenario, ...] = get_args(Scenario)
FIGURES = "figures.json"


class Peer(msgspec.Struct, frozen=True, kw_only=True):
    """A client of the comparison; `policy` is the [policy] table for upwash, empty for defaults."""

    name: str  # as in the table's row
    module: str
    policy: str = ""


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """One trial: a peer's calls, with a fault in the middle of them."""

    peer: Peer
    python: str  # of the environment that has the peer
    scenario: Scenario
    local_s: float
    calls: int
    fault_s: float
    round: int
    folder: Path


def write_order(file: Path, order: Order) -> None:
    """Leaves it for the trial's own process."""
    file.write_bytes(msgspec.json.encode(order, enc_hook=str))


def read_order(file: Path) -> Order:
    """The order that was left there."""
    return msgspec.json.decode(file.read_bytes(), type=Order, dec_hook=lambda kind, value: kind(value))


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """The result of a trial. A fault by kill ends with the restart; readiness is the server's own report."""

    total_s: float  # from the first call to the end of the last
    longest_s: float
    raised: list[str]  # what reached the mission
    by_server: int  # answers
    by_drone: int
    server_computed: int  # computations begun
    drone_computed: int
    remote_s: float | None  # median delay of answers of the server before the fault
    back_s: float | None  # from the fault's end to the server's first answer after it
    back_after_ready_s: float | None


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """One trial with its figures, or with why it has none."""

    peer: str
    scenario: Scenario
    local_s: float
    round: int
    figures: Figures | None
    why: str = ""


class Comparison(msgspec.Struct, frozen=True, kw_only=True):
    """All measurements, with versions and the number of cores."""

    versions: dict[str, str]
    cores: int
    at_once: int
    calls: int
    fault_s: float
    took_s: float
    trials: list[Trial]
