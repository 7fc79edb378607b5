"""The promises of docs/promises.md, tested over what one simulated flight left behind.

A promise's check yields what breaks it, the first breach first. It goes by the drone's event log, by what an
observer saw of drones and servers (`observer.py`), and by the same mission flown without servers. The checks stand in
modules by what they are about; history.py is what all of them read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeAlias

import msgspec

from upwash.lab.faults.call_promises import answers, bounded_calls, one_answer, truthful_errors
from upwash.lab.faults.flight_promises import (
    arrived_truly,
    autonomy,
    named_truly,
    no_harm,
    pilot_wins,
    vehicle_first,
)
from upwash.lab.faults.history import Breach, History
from upwash.lab.faults.landing_promises import landings
from upwash.lab.faults.object_promises import one_act_each
from upwash.lab.faults.row_promises import on_the_move
from upwash.lab.faults.selection_promises import in_range, one_selection, recovered, respect
from upwash.lab.faults.sending_promises import less_to_send, two_servers
from upwash.lab.faults.server_promises import admission, replaced, turns, unswayed
from upwash.lab.faults.waiting_promises import only_servers

__all__ = ["CHECKS", "Broken", "History", "Promise", "broken_promises"]

Check: TypeAlias = Callable[[History], Iterator[Breach]]


class Promise(IntEnum):
    """The promises that a simulated flight can break, by their numbers, each with its check."""

    check: Check | None

    AUTONOMY = 1, autonomy
    BOUNDED_CALLS = 2, bounded_calls
    ONE_ANSWER = 3, one_answer
    TRUTHFUL_ERRORS = 4, truthful_errors
    ONE_SELECTION = 5, one_selection
    RANGE = 6, in_range
    RESPECT = 7, respect
    NO_HARM = 8, no_harm
    REPRODUCIBLE = 9, None  # campaign.py flies the world twice
    ADMISSION = 11, admission
    VEHICLE_FIRST = 13, vehicle_first
    PILOT_WINS = 14, pilot_wins
    LIARS = 15, unswayed
    RECOVERY = 17, recovered
    TURNS = 18, turns
    ANSWERS = 19, answers
    ARRIVALS = 20, arrived_truly
    WHO_ACTED = 21, named_truly
    REPLACED = 22, replaced
    ON_THE_MOVE = 23, on_the_move
    ONLY_SERVERS = 24, only_servers
    LESS_TO_SEND = 25, less_to_send
    TWO_SERVERS = 26, two_servers
    LANDINGS = 27, landings
    OBJECTS = 28, one_act_each

    def __new__(cls, number: int, check: Check | None = None) -> Promise:
        """The promise of that number."""
        promise = int.__new__(cls, number)
        promise._value_, promise.check = number, check
        return promise

    def __str__(self) -> str:
        return f"promise {self.value} ({self.name.lower().replace('_', ' ')})"


@dataclass(frozen=True, slots=True)
class Broken:
    """A promise that a flight broke, in the world of that seed.

    `event` is the first bad event, as a log or an observer has it; None if there is no single one.
    """

    promise: Promise
    seed: int
    event: Mapping[str, object] | None
    why: str


CHECKS: Mapping[Promise, Check] = {promise: promise.check for promise in Promise if promise.check}
_OF_CALLS_ON_THE_DRONE = {  # what calls of services that only servers run need not keep
    Promise.BOUNDED_CALLS,
    Promise.ONE_ANSWER,
    Promise.TRUTHFUL_ERRORS,
    Promise.NO_HARM,
    Promise.RECOVERY,
    Promise.ANSWERS,
    Promise.ON_THE_MOVE,
}


def broken_promises(history: History, *, seed: int) -> list[Broken]:
    """The promises that the flight in the world of that seed broke, each by its first breach."""
    found = []
    for promise, check in CHECKS.items():
        if history.asks_servers and promise in _OF_CALLS_ON_THE_DRONE:
            continue
        for event, why in check(history):
            found.append(Broken(promise, seed, msgspec.to_builtins(event), why))
            break
    return found
