"""Calls in line for two lanes, and the built-in rule for these: earliest completion.

The other lane gets through the line from its front, from when it is free. A free lane takes the first call that it
would answer before the other lane does. So neither lane idles beside a call that it would answer sooner.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Literal

from msgspec import Struct

from upwash.core.operation import Operation


class WaitingCall(Struct, frozen=True):
    """A call in line: since when it waits, and its seconds on the drone and at the server in use.

    `local_s` and `remote_s` are infinite where the call does not run, or not now. The mission waits for an `urgent`
    call. The drone's answer to a call with `two_answers` is the first of two.
    """

    operation: Operation
    waited_s: float
    local_s: float
    remote_s: float
    urgent: bool = False
    two_answers: bool = False


class Lane(Struct, frozen=True):
    """A lane, which computes one call at a time, and the seconds until it is expected to be free.

    A lane that is longer held than expected is not free, and has 0 s. A call that is sent to a server now waits
    `queue_s` for calls of other drones; the latest calls there waited `usual_wait_s` in the mean.
    """

    is_free: bool
    free_in_s: float = 0.0
    queue_s: float = 0.0
    usual_wait_s: float = 0.0


class Line(Struct, frozen=True):
    """The calls in line, the first one first, and the lanes of the drone and of the server in use.

    `server` is None where no server is selected. At least one lane is free.
    """

    calls: Sequence[WaitingCall]
    drone: Lane
    server: Lane | None = None


class Take(Struct, frozen=True):
    """The number of a call in line, from 0 on, and the lane that takes it now."""

    call: int
    lane: Literal["drone", "server"]


def earliest(line: Line) -> Take | None:
    """The call that a free lane takes by earliest completion; None if the free lanes take none."""
    calls, drone, server = line.calls, line.drone, line.server
    if server is not None and server.is_free:
        at_server = [(server.queue_s + call.remote_s, call.local_s) for call in calls]
        taken = first_taken(at_server, other_in_s=drone.free_in_s)
        if taken is not None and not (
            taken and calls[taken].two_answers
        ):  # those before it want a better answer
            return Take(taken, "server")
    if not drone.is_free:
        return None
    wait_s, free_in_s = (server.usual_wait_s, max(server.free_in_s, server.queue_s)) if server else (0.0, 0.0)
    on_drone = [(call.local_s, wait_s + call.remote_s) for call in calls]
    taken = first_taken(on_drone, other_in_s=free_in_s, in_ties=True)
    return None if taken is None else Take(taken, "drone")


def first_taken(
    line: Iterable[tuple[float, float]], *, other_in_s: float, in_ties: bool = False
) -> int | None:
    """The number of the call that a free lane takes; None if it takes none.

    `line` has the seconds of each call in both lanes, its own first; infinite where the call does not run. The other
    lane is free `other_in_s` from now. With `in_ties` the lane also takes a call that both answer at one time.
    """
    for number, (own_s, other_s) in enumerate(line):
        other_end_s = other_in_s + other_s
        if own_s < other_end_s or (in_ties and own_s == other_end_s < math.inf):
            return number
        if other_s < math.inf:
            other_in_s = other_end_s
    return None
