"""What a run's calls took and which states its servers were in, as numbers that viewers of recordings plot."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec

from upwash.core.knowledge.servers import State
from upwash.report.record import Record

STATE_NUMBERS = {state: number for number, state in enumerate(State)}


class PlottedCall(msgspec.Struct, frozen=True):
    """A service call that has ended; `place` is `drone` or a server."""

    waypoint: int | None
    operation: str
    place: str
    delay_s: float
    waited_s: float
    fell_back: bool


class PlottedState(msgspec.Struct, frozen=True):
    """The state that a server is in from now on, in letters and as a number, and why it came into it."""

    state: str
    state_number: int
    why: str


Plotted = PlottedCall | PlottedState


def schema_of(kind: type[Plotted]) -> dict[str, Any]:
    """The JSON schema of such messages."""
    (described,), components = msgspec.json.schema_components([kind])
    name = described["$ref"].rpartition("/")[2]
    return dict(components[name])


def plotted_calls(record: Record) -> Iterator[tuple[float, PlottedCall]]:
    """Each call, at the second of the mission at which it ended."""
    for call in record.calls:
        facts = call.waypoint, call.operation, call.server or "drone", call.delay_s, call.waited_s
        yield call.at_s + call.delay_s, PlottedCall(*facts, call.fell_back)


def plotted_states(record: Record) -> Iterator[tuple[str, float, PlottedState]]:
    """Each state of each server, at the second at which it began; the last one also as the log ends."""
    for server, stretches in record.stretches.items():
        moments_s = [*(stretch.from_s for stretch in stretches), *(last.to_s for last in stretches[-1:])]
        for at_s, stretch in zip(moments_s, [*stretches, *stretches[-1:]], strict=True):
            yield server, at_s, PlottedState(str(stretch.state), STATE_NUMBERS[stretch.state], stretch.why)
