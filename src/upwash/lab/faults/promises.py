"""The promises of docs/promises.md, tested over what one simulated flight left behind.

A promise's check yields what breaks it, the first breach first. It goes by the drone's event log, by what an
observer saw of drones and servers (`observer.py`), and by the same mission flown without servers. The checks stand in
modules by what they are about; history.py is what all of them read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum

import msgspec

from upwash.lab.faults.call_promises import answers, bounded_calls, one_answer, truthful_errors
from upwash.lab.faults.deadline_promises import two_servers
from upwash.lab.faults.flight_promises import (
    arrived_truly,
    autonomy,
    named_truly,
    no_harm,
    pilot_wins,
    vehicle_first,
)
from upwash.lab.faults.history import Breach, History, asks_servers
from upwash.lab.faults.landing_promises import landings
from upwash.lab.faults.object_promises import one_act_each
from upwash.lab.faults.row_promises import on_the_move
from upwash.lab.faults.selection_promises import in_range, one_selection, recovered, respect
from upwash.lab.faults.sending_promises import less_to_send
from upwash.lab.faults.server_promises import admission, replaced, turns, unswayed
from upwash.lab.faults.waiting_promises import only_servers

__all__ = ["CHECKS", "Broken", "History", "Promise", "broken_promises"]


class Promise(IntEnum):
    """The promises that a simulated flight can break, by their numbers."""

    AUTONOMY = 1
    BOUNDED_CALLS = 2
    ONE_ANSWER = 3
    TRUTHFUL_ERRORS = 4
    ONE_SELECTION = 5
    RANGE = 6
    RESPECT = 7
    NO_HARM = 8
    REPRODUCIBLE = 9
    ADMISSION = 11
    VEHICLE_FIRST = 13
    PILOT_WINS = 14
    LIARS = 15
    RECOVERY = 17
    TURNS = 18
    ANSWERS = 19
    ARRIVALS = 20
    WHO_ACTED = 21
    REPLACED = 22
    ON_THE_MOVE = 23
    ONLY_SERVERS = 24
    LESS_TO_SEND = 25
    TWO_SERVERS = 26
    LANDINGS = 27
    OBJECTS = 28

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


CHECKS: Mapping[Promise, Callable[[History], Iterator[Breach]]] = {
    Promise.AUTONOMY: autonomy,
    Promise.BOUNDED_CALLS: bounded_calls,
    Promise.ONE_ANSWER: one_answer,
    Promise.TRUTHFUL_ERRORS: truthful_errors,
    Promise.ONE_SELECTION: one_selection,
    Promise.RANGE: in_range,
    Promise.RESPECT: respect,
    Promise.NO_HARM: no_harm,
    Promise.ADMISSION: admission,
    Promise.VEHICLE_FIRST: vehicle_first,
    Promise.PILOT_WINS: pilot_wins,
    Promise.LIARS: unswayed,
    Promise.RECOVERY: recovered,
    Promise.TURNS: turns,
    Promise.ANSWERS: answers,
    Promise.ARRIVALS: arrived_truly,
    Promise.WHO_ACTED: named_truly,
    Promise.REPLACED: replaced,
    Promise.ON_THE_MOVE: on_the_move,
    Promise.ONLY_SERVERS: only_servers,
    Promise.LESS_TO_SEND: less_to_send,
    Promise.TWO_SERVERS: two_servers,
    Promise.LANDINGS: landings,
    Promise.OBJECTS: one_act_each,
}
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
        if asks_servers(history.config) and promise in _OF_CALLS_ON_THE_DRONE:
            continue
        for event, why in check(history):
            found.append(Broken(promise, seed, msgspec.to_builtins(event), why))
            break
    return found
