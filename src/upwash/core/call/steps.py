"""What the machine of calls takes in from the program, and what it has the program do."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

from msgspec import Struct

from upwash.core.operation import Operation
from upwash.core.selection.commands import Effect
from upwash.core.selection.events import RemoteCallCut

if TYPE_CHECKING:
    from upwash.core.call.attempts import Attempt, Computing
    from upwash.core.call.call import Call


class Asked(Struct, frozen=True):
    """The mission's call; `size_bytes` gives the size of its request as an operation.

    The log has its `waypoint` where several calls may be open. An `urgent` call comes before others. A call `once`
    runs on the drone alone, and `on_servers` on servers alone, `within_s` if that is set.
    """

    operation: Operation
    size_bytes: Callable[[Operation], int] = lambda _: 0
    waypoint: int | None = None
    urgent: bool = False
    once: bool = False
    on_servers: bool = False
    within_s: float | None = None


# --- events in ----------------------------------------------------------------------------------------------


class Made(Struct, frozen=True):
    """The mission makes the call."""

    call: Call


class Waited(Struct, frozen=True):
    """The mission waits for the last answer of the call, at rest."""

    call: Call


class Enough(Struct, frozen=True):
    """The mission needs no better answer of the call, or no answer."""

    call: Call


class Abandoned(Struct, frozen=True):
    """The mission has ended in the call."""

    call: Call


class Replied(Struct, frozen=True):
    """The server replied, perhaps that the service `raised`; `queued_s` and `queue_s` are of other drones' calls."""

    attempt: Attempt
    size_bytes: int
    raised: str = ""
    queued_s: float = 0.0
    queue_s: float = 0.0


class TurnedAway(Struct, frozen=True):
    """The server did not begin the call, as others of `queue_s` come first."""

    attempt: Attempt
    why: str
    queue_s: float


class SlotLost(Struct, frozen=True):
    """The server does not serve the drone any more."""

    attempt: Attempt
    why: str


class Failed(Struct, frozen=True):
    """The attempt got no usable answer: `cut` at its deadline, or else the server was perhaps `unreached`."""

    attempt: Attempt
    why: str
    cut: bool = False
    unreached: bool = False


class RequestReduced(Struct, frozen=True):
    """The part before sending has ended, with a request of that size; it `is_less`, or whole for the reason `why`."""

    attempt: Attempt
    size_bytes: int
    is_less: bool
    why: str = ""


class Computed(Struct, frozen=True):
    """The drone's own service replied, perhaps that it `raised`; or it `failed`."""

    computing: Computing
    raised: str = ""
    failed: bool = False


class EndWaiting(Struct, frozen=True):
    """No server will answer the calls that only servers compute."""

    why: str


class Recheck(Struct, frozen=True):
    """Each call is looked at, as time has passed or an event has come."""


MissionEvent: TypeAlias = Made | Waited | Enough | Abandoned | EndWaiting
CallEvent: TypeAlias = (
    MissionEvent | Replied | TurnedAway | SlotLost | Failed | RequestReduced | Computed | Recheck
)

# --- instructions out ---------------------------------------------------------------------------------------


class Reduce(Struct, frozen=True):
    """Have the part before sending make the attempt's request smaller."""

    attempt: Attempt


class Send(Struct, frozen=True):
    """Send the attempt's request; the server may begin it within `may_queue_s` and answer within `deadline_s`."""

    attempt: Attempt
    deadline_s: float
    may_queue_s: float


class Compute(Struct, frozen=True):
    """Have the drone's own service compute the call, which hangs after `timeout_s`."""

    computing: Computing
    timeout_s: float


class Stop(Struct, frozen=True):
    """Drop this work; the mission needs no answer of it."""

    work: Attempt | Computing


class Cut(Struct, frozen=True):
    """Tell the core, once the server turns out to be alive, that the deadline has cut the attempt."""

    attempt: Attempt
    event: RemoteCallCut


class Deny(Struct, frozen=True):
    """Tell the server that its service raised, and the drone's own did not."""

    attempt: Attempt


class Hear(Struct, frozen=True):
    """Tell the mission the first of two answers."""

    computing: Computing
    delay_s: float


class Answer(Struct, frozen=True):
    """The call is over with this answer, or with the failure of the drone's own service."""

    call: Call
    source: Attempt | Computing


class LeftUnanswered(Struct, frozen=True):
    """The call, which only servers compute, is over without an answer."""

    call: Call
    why: str


class LookAgain(Struct, frozen=True):
    """Consider servers again at once: a decision on a call has left one, and selects no other."""


Instruction: TypeAlias = (
    Reduce | Send | Compute | Stop | Cut | Deny | Hear | Answer | LeftUnanswered | LookAgain | Effect
)
