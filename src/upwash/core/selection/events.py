"""Everything that happens to a drone's offloading, as values: what the drone's machine takes in."""

from __future__ import annotations

from msgspec import Struct

from upwash.core.geo import Position
from upwash.core.operation import Operation
from upwash.core.planning.legs import Pace
from upwash.core.vehicle.way_home import EnergyFacts


class SelectionEvent(Struct, frozen=True):
    """Something that happened."""


class Tick(SelectionEvent, frozen=True):
    """A period is over, or a border of a range was crossed: time to look again."""


class MissionBegun(SelectionEvent, frozen=True):
    """The mission's time begins: the vehicle is armed, or was found in the air. This is what it says of itself.

    `pace` is how it flies on average, None where that is not known.
    """

    vehicle: EnergyFacts
    pace: Pace | None = None


class CheckAnswered(SelectionEvent, frozen=True):
    """The daemon answered that the server is available, and whether all wanted services run.

    `peers` are the servers that it can have prepared; `waiting` drones queue for a slot.
    """

    check: int
    running: bool
    peers: tuple[str, ...] = ()
    waiting: int = 0


class SlotRefused(SelectionEvent, frozen=True):
    """The server is full and `waiting` drones queue; the drone asks again."""

    check: int
    waiting: int


class LeaseRenewed(SelectionEvent, frozen=True):
    """The server keeps its slot for the drone; `waiting` others queue."""

    check: int
    waiting: int


class SlotTaken(SelectionEvent, frozen=True):
    """The server, READY by that check, gave the drone's slot to another drone, perhaps `in_call`."""

    check: int
    why: str
    in_call: bool = False


class ServicesStarted(SelectionEvent, frozen=True):
    """The daemon started the services and gave their endpoints."""

    check: int


class ServerUnusable(SelectionEvent, frozen=True):
    """The server could not be joined, did not answer in time, is unavailable or could not start a service.

    The first two leave it `unreached`. If it leaves a service alone for `pause_s`, it is left out for as long.
    """

    check: int
    why: str
    unreached: bool = False
    pause_s: float = 0.0


class ProbePaused(SelectionEvent, frozen=True):
    """The probed server leaves a service alone for a pause, and is left out for as long."""

    check: int
    why: str
    pause_s: float


class ProbeAnswered(SelectionEvent, frozen=True):
    """A failed server answered, with all wanted services that run there; `running` if all do."""

    check: int
    running: bool


class ProbeUnanswered(SelectionEvent, frozen=True):
    """A failed server has not answered by the time of the next question."""

    check: int


class NetworkGone(SelectionEvent, frozen=True):
    """The network that was joined for the check is no longer connected."""

    check: int
    why: str


class PeerPrepared(SelectionEvent, frozen=True):
    """A server holds a slot and starts its services, as the daemon `by` has asked it to."""

    server: str
    by: str


class LocalCallEnded(SelectionEvent, frozen=True):
    """A call ran on the drone."""

    operation: Operation
    delay_s: float


class RemoteCallEnded(SelectionEvent, frozen=True):
    """A call ran on a server; `late` where the drone's own service had answered it before."""

    server: str
    operation: Operation
    delay_s: float
    late: bool = False


class RemoteCallFailed(SelectionEvent, frozen=True):
    """A call to a server got no usable answer, by that check; `late` after the drone's own answer."""

    server: str
    check: int
    why: str
    late: bool = False


class RemoteCallRaised(SelectionEvent, frozen=True):
    """A server reports an exception of the service; the drone repeats the call before it believes that."""

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


class RemoteCallCut(SelectionEvent, frozen=True):
    """The deadline cut a call after `waited_s` on a server that turned out to be alive: it is slow."""

    server: str
    operation: Operation
    waited_s: float


class Reached(SelectionEvent, frozen=True):
    """Whether a server without a range answered a call from that position, as far as its link is concerned.

    It answered, or was given up, after `delay_s`; request and reply have `size_bytes`.
    """

    server: str
    position: Position
    answered: bool
    operation: Operation
    delay_s: float
    size_bytes: int


class LegBegun(SelectionEvent, frozen=True):
    """The drone leaves for a place at that ground speed, None for the last; `back` if the calls there are over."""

    target: Position
    ground_speed_m_s: float | None
    back: bool = False


class LegEnded(SelectionEvent, frozen=True):
    """The drone is where its leg led to."""


class TargetUnknown(SelectionEvent, frozen=True):
    """Where the drone goes next is not known: it takes off, holds, returns or lands."""


class DescentBegun(SelectionEvent, frozen=True):
    """The drone begins to return or to land: the mission needs no server, unless it calls again."""


class NoMoreCalls(SelectionEvent, frozen=True):
    """No call will come any more."""
