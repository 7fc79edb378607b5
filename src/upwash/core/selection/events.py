"""The events that `Selection.handle` takes."""

from __future__ import annotations

from msgspec import Struct

from upwash.core.geo import Position, Via
from upwash.core.operation import Operation
from upwash.core.planning.legs import Pace
from upwash.core.vehicle.way_home import EnergyFacts


class SelectionEvent(Struct, frozen=True):
    """The base of the events."""


class Tick(SelectionEvent, frozen=True):
    """A period is over, or a border of a range was crossed: the selection is considered again."""


class MissionBegun(SelectionEvent, frozen=True):
    """The mission's time begins: the vehicle is armed, or was found in the air.

    `vehicle` has its battery stages and way home; `pace` how it flies on average, None if unknown.
    """

    vehicle: EnergyFacts
    pace: Pace | None = None


class RadioEvent(SelectionEvent, frozen=True):
    """The base of a radio's reports on a server; `check` is the number of the check or probe."""

    check: int


class CheckAnswered(RadioEvent, frozen=True):
    """The daemon answered that the server is available, and whether all services of the mission run.

    `peers` are the servers that it can have prepared; `waiting` drones queue for a slot.
    """

    running: bool
    peers: tuple[str, ...] = ()
    waiting: int = 0


class SlotRefused(RadioEvent, frozen=True):
    """The server is full and `waiting` drones queue; the drone asks again."""

    waiting: int


class LeaseRenewed(RadioEvent, frozen=True):
    """The server keeps the drone's slot; `waiting` other drones queue."""

    waiting: int


class SlotTaken(RadioEvent, frozen=True):
    """The server, READY since that check, gave the drone's slot to another drone; `in_call` if during a call."""

    why: str
    in_call: bool = False


class ServicesStarted(RadioEvent, frozen=True):
    """The daemon started the services and gave their endpoints."""


class ServerUnusable(RadioEvent, frozen=True):
    """The server could not be joined, did not answer in time, is unavailable or could not start a service.

    In the first two cases it is `unreached`. If a service keeps failing there, the server is not used for `pause_s`;
    that ends a probe too.
    """

    why: str
    unreached: bool = False
    pause_s: float = 0.0


class ProbeAnswered(RadioEvent, frozen=True):
    """A failed server and its running services answered a probe; `running` if all services run."""

    running: bool


class ProbeUnanswered(RadioEvent, frozen=True):
    """A failed server has not answered a probe by the time of the next."""


class NetworkGone(RadioEvent, frozen=True):
    """The network that was joined for the check is no longer connected."""

    why: str


class PeerPrepared(SelectionEvent, frozen=True):
    """A server holds a slot and starts its services, at the request of the server `by`."""

    server: str
    by: str


class CallWaits(SelectionEvent, frozen=True):
    """A call that only servers compute waits for one; `again` if a server failed in it."""

    operation: Operation
    again: bool = False


class CallOver(SelectionEvent, frozen=True):
    """A call that only servers compute is over, with an answer or without one."""

    operation: Operation


class LocalCallEnded(SelectionEvent, frozen=True):
    """A call ran on the drone; the first of two answers as another operation than the call `asked` for."""

    operation: Operation
    delay_s: float
    asked: Operation | None = None


class PartFailed(SelectionEvent, frozen=True):
    """The part of a service before sending gave no smaller request."""

    service: str


class RemoteCallEnded(SelectionEvent, frozen=True):
    """A call ran on a server; `late` if the drone's own service had answered before.

    With `less` its request was made smaller before, which is part of the delay; another part are the `queued_s` that
    it waited for calls of other drones. A new call would have `queue_s` of these before it.
    """

    server: str
    operation: Operation
    delay_s: float
    late: bool = False
    less: bool = False
    queued_s: float = 0.0
    queue_s: float = 0.0


class RemoteCallQueued(SelectionEvent, frozen=True):
    """The server did not begin a call in `waited_s`: others of `queue_s` come first. The server has not failed."""

    server: str
    why: str
    waited_s: float
    queue_s: float
    late: bool = False


class RemoteCallFailed(SelectionEvent, frozen=True):
    """A call to the server, READY since that check, got no usable answer; `late` after the drone's own answer."""

    server: str
    check: int
    why: str
    late: bool = False


class RemoteCallRaised(SelectionEvent, frozen=True):
    """A server reports an exception of the service; the drone repeats the call to confirm it."""

    server: str
    why: str


class RemoteFaultTested(SelectionEvent, frozen=True):
    """The drone repeated a call whose exception a server reported; `confirmed` if it raised there too.

    `check` made the server READY, and the report took `delay_s`.
    """

    server: str
    check: int
    operation: Operation
    delay_s: float
    why: str
    confirmed: bool
    less: bool = False


class RemoteCallCut(SelectionEvent, frozen=True):
    """The deadline cut a call after `waited_s` on a server that turned out to be alive: it is slow."""

    server: str
    operation: Operation
    waited_s: float
    less: bool = False


class Reached(SelectionEvent, frozen=True):
    """A call to a server without a range, made at that position: whether any answer came, an exception included.

    The call was answered, or given up, after `delay_s`; request and reply have `size_bytes`.
    """

    server: str
    position: Position
    answered: bool
    operation: Operation
    delay_s: float
    size_bytes: int
    less: bool = False


class LegBegun(SelectionEvent, frozen=True):
    """The drone leaves for a place; speed None means as before; `back` if the calls there are over.

    On its way there it flies to each place of `via`, the first of them now.
    """

    target: Position
    ground_speed_m_s: float | None
    back: bool = False
    via: tuple[Via, ...] = ()


class LegEnded(SelectionEvent, frozen=True):
    """The drone has arrived at its target."""


class TargetUnknown(SelectionEvent, frozen=True):
    """The drone's next target is unknown: it takes off, holds, returns or lands."""


class DescentBegun(SelectionEvent, frozen=True):
    """The drone begins to return or to land: the mission needs no server, unless it calls again."""


class NoMoreCalls(SelectionEvent, frozen=True):
    """No call will come any more."""
