"""What a mission left undone beside waypoints that it did not reach, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from upwash.eventlog.narration import spans
from upwash.eventlog.results import RunResult


def left_undone(result: RunResult) -> Iterator[str]:
    """A phrase for each kind: demands, failed calls, and answers that the mission did not look at."""
    if result.not_acted_on:
        one = len(result.not_acted_on) == 1
        answers = "the answer at" if one else "the answers at"
        yield f"not done: what {answers} {_places(result.not_acted_on)} {'demands' if one else 'demand'}"
    if result.failed_calls:
        calls = "the call" if len(result.failed_calls) == 1 else "the calls"
        yield f"{calls} at {_places(result.failed_calls)} failed, and the mission did nothing about it"
    if result.not_looked_at:
        answers = "the answer" if len(result.not_looked_at) == 1 else "the answers"
        yield f"not looked at: {answers} at {_places(result.not_looked_at)}"


def _places(waypoints: Sequence[int | None]) -> str:
    planned = [each for each in waypoints if each is not None]
    beside = ["a place beside the plan"] if len(planned) < len(waypoints) else []
    noun = "waypoint" if len(planned) == 1 else "waypoints"
    return " and ".join([*([f"{noun} {spans(planned)}"] if planned else []), *beside])
