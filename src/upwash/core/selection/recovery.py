"""When a failed server is probed, when calls go there again, and what such calls may cost.

Laws:
- a failed server in range is probed, if a radio is free: first after a pause that grows with its latest failures,
  then after pauses that grow from `first_s` to `longest_s`;
- after its first failure it is left alone for the first pause only; after the k-th further failure for
  2 ** (k - 1) s, at most 10 s; a minute after that its failures are forgotten;
- until a server answers an operation sooner than the drone would, its calls there are trials: the drone's own service
  computes them too, from the start, so that they cost no time; and no call waits for its check;
- a server has one trial at a time; after a slow trial the next waits for a 30th of the time for which the server has
  been slow, at most 10 s.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Annotated

from msgspec import Meta, Struct

from upwash.core.operation import Operation

REST_S = 10.0  # how long a failed server out of range is left alone
_LONGEST_PAUSE_S = 10.0
_WELL_S = 60.0
_GROWTH = 1.25
_SLOW_SHARE = 30
_LONGEST_BETWEEN_TRIALS_S = 10.0
Pause = Annotated[float, Meta(ge=0.2, le=60, description="a number from 0.2 to 60, in seconds")]


class Probing(Struct, frozen=True, forbid_unknown_fields=True):
    """The pauses between questions to a server that failed: the first one, and the longest."""

    first_s: Pause = 0.5
    """The first pause, in seconds."""
    longest_s: Pause = 1.0
    """The longest pause, in seconds."""

    def __post_init__(self) -> None:
        if self.first_s > self.longest_s:
            raise ValueError(f"first_s is {self.first_s}, and longest_s only {self.longest_s}: pauses grow")

    def pauses_s(self, *, alone_s: float = 0.0) -> Iterator[float]:
        """The seconds to wait before each probe; before the first at least `alone_s`."""
        pause_s = self.first_s
        yield max(alone_s, pause_s)
        while True:
            yield pause_s
            pause_s = min(self.longest_s, _GROWTH * pause_s)


class ServerFailures(Struct, frozen=True):
    """The latest failures of a server."""

    count: int = 0
    last_s: float = -math.inf

    def after(self, now_s: float) -> ServerFailures:
        """The failures with one more at `now_s`; old ones are forgotten."""
        forgotten = now_s - self.last_s > self.alone_s + _WELL_S
        return ServerFailures(1 if forgotten else self.count + 1, now_s)

    @property
    def alone_s(self) -> float:
        """How long the server is left alone after the last failure, in seconds."""
        return min(2.0 ** (self.count - 2), _LONGEST_PAUSE_S) if self.count > 1 else 0.0


class _Doubt(Struct, frozen=True):
    """An operation whose last call on a server failed, or was slower than on the drone."""

    since_s: float
    last_s: float


class Recovery:
    """The failures of one drone's servers, and the trial calls that are due; without probing nothing is in doubt."""

    def __init__(self, probing: Probing | None) -> None:
        self.probing = probing
        self.trials: set[str] = set()  # servers that are at one
        self._failures: dict[str, ServerFailures] = {}
        self._doubts: dict[str, dict[Operation, _Doubt]] = {}

    def failed(
        self, server: str, operations: Iterable[Operation], *, counts: bool = True, now_s: float
    ) -> None:
        """Note that the server failed: the operations are in doubt there; if it `counts`, pauses grow."""
        if counts:
            self._failures[server] = self._failures.get(server, ServerFailures()).after(now_s)
        self.trials.discard(server)
        for operation in operations:
            self._doubt(server, operation, now_s)

    def answered(
        self, server: str, operation: Operation, delay_s: float, *, local_s: float, now_s: float
    ) -> None:
        """Note that a call was answered: one faster than the drone ends the doubt, a slower one renews it."""
        self.trials.discard(server)
        if delay_s < local_s:
            self._doubts.get(server, {}).pop(operation, None)
        else:
            self._doubt(server, operation, now_s)

    def in_doubt(self, server: str, operation: Operation | None = None) -> bool:
        """Whether a call of the operation, or of any operation if None, would be a trial on the server."""
        doubts = self._doubts.get(server, {})
        return operation in doubts if operation is not None else bool(doubts)

    def trial_due_s(self, server: str, operation: Operation) -> float:
        """The time from which the operation may be tried there; minus infinity if it is not in doubt."""
        if server in self.trials:
            return math.inf
        if (doubt := self._doubts.get(server, {}).get(operation)) is None:
            return -math.inf
        slow_s = doubt.last_s - doubt.since_s
        return doubt.last_s + min(slow_s / _SLOW_SHARE, _LONGEST_BETWEEN_TRIALS_S)

    def alone_s(self, server: str, *, now_s: float) -> float:
        """For how many seconds more the server is left alone."""
        failures = self._failures.get(server, ServerFailures())
        return max(0.0, failures.last_s + failures.alone_s - now_s)

    def _doubt(self, server: str, operation: Operation, now_s: float) -> None:
        if self.probing is None:
            return
        doubts = self._doubts.setdefault(server, {})
        known = doubts.get(operation)
        doubts[operation] = _Doubt(known.since_s if known else now_s, now_s)
