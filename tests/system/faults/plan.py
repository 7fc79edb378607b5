"""What goes wrong in a flight, and at which moments of it: everything from one seed."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import Literal

What = Literal["dark", "down", "loss", "kill", "freeze", "restart", "garbage", "nothing"]
Target = Literal["link", "daemon", "instance", "onboard", "drone"]
Moment = Literal["call", "check", "between", "onboard call"]

LONG_S = 30.0
BLACK_OUTS_S = (1.0, 5.0, LONG_S)
LOSSES_PERCENT = (1, 5, 20)
_DELAY_S = 0.4  # about as long as a call to a server takes, or a check


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong, `delay_s` after a moment of the flight that comes after a waypoint's arrival."""

    what: What
    target: Target
    server: str
    moment: Moment
    after_waypoint: int
    delay_s: float
    lasts_s: float
    percent: int = 100

    def __str__(self) -> str:
        whose = self.target if self.target in ("onboard", "drone") else f"{self.target} of {self.server}"
        how_much = f" {self.percent} %" if self.what == "loss" else ""
        when = "between calls" if self.moment == "between" else f"{self.delay_s:.2f} s into a {self.moment}"
        how_long = "" if self.what in ("kill", "restart") else f", for {self.lasts_s:.1f} s"
        return f"{self.what}{how_much}: {whose}, {when} after waypoint {self.after_waypoint}{how_long}"


def draw(seed: int) -> tuple[Fault, ...]:
    """The faults of one flight, one after the other; nine seeds in a row have every black-out at every moment."""
    chance = Random(seed)
    lasts_s = BLACK_OUTS_S[seed % 3]
    moments: tuple[Moment, ...] = ("call", "check", "between")
    black_out = Fault(
        what=chance.choice(("dark", "down")),
        target="link",
        server="s1",
        moment=moments[seed // 3 % 3],
        after_waypoint=2,
        delay_s=chance.uniform(0.0, _DELAY_S),
        lasts_s=lasts_s,
    )
    return (
        _of_a_process(chance, "s1", after_waypoint=1),
        black_out,
        _of_a_peer(chance, seed),
        *([] if lasts_s == LONG_S else [_of_a_process(chance, "s1", after_waypoint=7)]),
        _of_a_process(chance, "s2", after_waypoint=12),
    )


def _of_a_peer(chance: Random, seed: int) -> Fault:
    """A link that loses frames, or a stranger in the daemon's place."""
    kind = seed % (len(LOSSES_PERCENT) + 2)
    delay_s = chance.uniform(0.0, _DELAY_S)
    if kind < len(LOSSES_PERCENT):
        return Fault(
            "loss", "link", "s1", "between", 4, delay_s, chance.uniform(4.0, 10.0), LOSSES_PERCENT[kind]
        )
    what: What = "garbage" if kind == len(LOSSES_PERCENT) else "nothing"
    return Fault(what, "daemon", "s1", "call", 4, delay_s, chance.uniform(3.0, 8.0))


def _of_a_process(chance: Random, server: str, *, after_waypoint: int) -> Fault:
    target: Target = chance.choice(("daemon", "instance", "onboard", "drone"))
    whats: dict[Target, tuple[What, ...]] = {"daemon": ("kill", "freeze", "restart")}
    what = chance.choice(whats.get(target, ("kill", "freeze")))
    moments: tuple[Moment, ...] = ("call", "between")
    if server == "s2":  # which the drone has yet to meet
        moments = ("check", "onboard call") if target in ("onboard", "drone") else ("check", "call")
    lasts_s = chance.uniform(0.5, 4.0)
    return Fault(
        what, target, server, chance.choice(moments), after_waypoint, chance.uniform(0.0, _DELAY_S), lasts_s
    )
