"""What the drone-side machine is told: everything that happens to a drone's offloading, as values."""

from __future__ import annotations

from dataclasses import dataclass

from upwash.core.geo import Position
from upwash.core.operation import Operation
from upwash.core.planning.legs import Pace
from upwash.core.vehicle.way_home import EnergyFacts


@dataclass(frozen=True, slots=True)
class Tick:
    """A period is over, or a border of a range was crossed: time to look again."""


@dataclass(frozen=True, slots=True)
class MissionBegun:
    """The mission's time begins: the vehicle is armed, or was found in the air. This is what it says of itself.

    `pace` is how it flies on average, None where that is not known.
    """

    vehicle: EnergyFacts
    pace: Pace | None = None


@dataclass(frozen=True, slots=True)
class CheckAnswered:
    """The daemon answered that the server is available; whether all wanted services run there already.

    `peers` are the servers that it can have prepared. So many drones wait for a slot there.
    """

    check: int
    running: bool
    peers: tuple[str, ...] = ()
    waiting: int = 0


@dataclass(frozen=True, slots=True)
class SlotRefused:
    """The server serves as many drones as it can; so many wait for a slot, and the drone asks again."""

    check: int
    waiting: int


@dataclass(frozen=True, slots=True)
class LeaseRenewed:
    """The server keeps its slot for the drone; so many others wait for one."""

    check: int
    waiting: int


@dataclass(frozen=True, slots=True)
class SlotTaken:
    """The server, READY by that check, gave the drone's slot to another one; a call was refused for it, or none."""

    check: int
    why: str
    in_call: bool = False


@dataclass(frozen=True, slots=True)
class ServicesStarted:
    """The daemon started the services and gave their endpoints."""

    check: int


@dataclass(frozen=True, slots=True)
class ServerUnusable:
    """The server could not be joined, did not answer in time, is unavailable or could not start a service.

    The first two leave it `unreached`. Where it leaves a service alone for a pause, it is left out for as long.
    """

    check: int
    why: str
    unreached: bool = False
    pause_s: float = 0.0


@dataclass(frozen=True, slots=True)
class ProbePaused:
    """The server that is probed leaves a service alone for a pause, and is left out for as long."""

    check: int
    why: str
    pause_s: float


@dataclass(frozen=True, slots=True)
class ProbeAnswered:
    """A server that had failed gave a sign of life, it and the wanted services that run there, or not all do."""

    check: int
    running: bool


@dataclass(frozen=True, slots=True)
class ProbeUnanswered:
    """A server that had failed has given no sign of life until the next question is due."""

    check: int


@dataclass(frozen=True, slots=True)
class NetworkGone:
    """The network that was joined for the check is no longer connected."""

    check: int
    why: str


@dataclass(frozen=True, slots=True)
class PeerPrepared:
    """A server holds a slot and starts its services, as the daemon `by` has asked it to."""

    server: str
    by: str


@dataclass(frozen=True, slots=True)
class LocalCallEnded:
    """A call ran on the drone."""

    operation: Operation
    delay_s: float


@dataclass(frozen=True, slots=True)
class RemoteCallEnded:
    """A call ran on a server; `late` where the drone's own service had answered it before."""

    server: str
    operation: Operation
    delay_s: float
    late: bool = False


@dataclass(frozen=True, slots=True)
class RemoteCallFailed:
    """A call to a server got no usable answer; `check` is the check that made the server READY.

    `late` where the drone's own service had answered it before.
    """

    server: str
    check: int
    why: str
    late: bool = False


@dataclass(frozen=True, slots=True)
class RemoteCallRaised:
    """A server says that the service raised in a call, which is made on the drone before that is believed."""

    server: str
    why: str


@dataclass(frozen=True, slots=True)
class RemoteFaultTested:
    """A call that raised on a server, as that says, was made on the drone; `confirmed` where it raised there too.

    `check` is the check that made the server READY, and `delay_s` how long it took to say so.
    """

    server: str
    check: int
    operation: Operation
    delay_s: float
    why: str
    confirmed: bool


@dataclass(frozen=True, slots=True)
class RemoteCallCut:
    """A call was cut off by its deadline after `waited_s`, on a server that turned out to be alive: it is slow."""

    server: str
    operation: Operation
    waited_s: float


@dataclass(frozen=True, slots=True)
class Reached:
    """Whether a server without a range answered a call from that position, as far as its link is concerned.

    It answered, or was given up, after `delay_s`; request and reply have so many bytes.
    """

    server: str
    position: Position
    answered: bool
    operation: Operation
    delay_s: float
    size_bytes: int


@dataclass(frozen=True, slots=True)
class LegBegun:
    """The drone leaves for a place, at that ground speed; None for the one it flew at before.

    It goes `back` to a waypoint whose calls are over.
    """

    target: Position
    ground_speed_m_s: float | None
    back: bool = False


@dataclass(frozen=True, slots=True)
class LegEnded:
    """The drone is where its leg led to."""


@dataclass(frozen=True, slots=True)
class TargetUnknown:
    """Where the drone goes next is not known: it takes off, holds, returns or lands."""


@dataclass(frozen=True, slots=True)
class DescentBegun:
    """The drone begins to return or to land: the mission needs no server, unless it calls again."""


@dataclass(frozen=True, slots=True)
class NoMoreCalls:
    """No call will come any more."""


Event = (
    Tick
    | MissionBegun
    | CheckAnswered
    | SlotRefused
    | LeaseRenewed
    | SlotTaken
    | ServicesStarted
    | ServerUnusable
    | ProbePaused
    | ProbeAnswered
    | ProbeUnanswered
    | NetworkGone
    | PeerPrepared
    | LocalCallEnded
    | RemoteCallEnded
    | RemoteCallFailed
    | RemoteCallRaised
    | RemoteFaultTested
    | RemoteCallCut
    | Reached
    | LegBegun
    | LegEnded
    | TargetUnknown
    | DescentBegun
    | NoMoreCalls
)
