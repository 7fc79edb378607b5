"""What the programs need from the world.

`real/` provides each of these with things, `sim/` with models. The programs in `drone.py` and `server.py`
cannot tell which they got. All verbs are coroutines on the program's event loop and may be cancelled; all
times are seconds.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeAlias

from upwash.core.admission.limits import NO_LIMITS, Limits
from upwash.core.geo import Circle, EarthPosition, Position, Velocity
from upwash.core.planning.legs import Pace
from upwash.core.vehicle.control import Control
from upwash.core.vehicle.geofence import Fence
from upwash.core.vehicle.telemetry import Telemetry
from upwash.core.vehicle.way_home import EnergyFacts
from upwash.eventlog import schema
from upwash.support.heat import Surroundings

VehicleNews: TypeAlias = (
    Control
    | schema.VehicleSaid
    | schema.ArmingDelayed
    | schema.VehicleSetting
    | schema.LinkLost
    | schema.LinkRestored
    | schema.LinkTrouble
    | schema.PositionDoubted
    | schema.HomeMoved
)  # all but the first as the log has them


@dataclass(frozen=True, slots=True)
class FenceNames:
    """What a vehicle calls the parameters of its fence and of its way home."""

    highest: str = "its ceiling"
    lowest: str = "its floor"
    margin: str = "its margin"
    returns_at: str = "its return altitude"


@dataclass(frozen=True, slots=True)
class VehicleLimits:
    """Where the vehicle returns to and what its own fence allows, relative to the mission's home.

    `home` and `home_above_sea_m` are None while the vehicle does not say. `highest_m` and `lowest_m` are
    altitudes above home: there its fence is breached. None where its fence has no such border.
    A vehicle may overshoot by `margin_m`. `returns_at_m` is the altitude above home that its way home has at least.
    `names` has the vehicle's parameter behind each of these, for messages. `untold` are parameters of its fence
    that the vehicle did not tell.
    """

    home: Position | None = None
    fences: Sequence[Fence] = ()
    highest_m: float | None = None
    lowest_m: float | None = None
    margin_m: float = 0.0
    returns_at_m: float = 0.0
    home_above_sea_m: float | None = None
    names: FenceNames = FenceNames()
    untold: Sequence[str] = ()


DeadManAction: TypeAlias = Literal["return", "land"]


class DeadMan(Protocol):
    """What brings a vehicle down whose program has fallen silent: it runs in the autopilot.

    It acts in flight in the program's own mode alone. Each verb raises AutopilotError where it cannot be done.
    """

    async def missing(self) -> str:
        """What it lacks to watch, and the remedy; empty where it is ready."""

    async def install(self) -> str:
        """Puts it into the autopilot of a vehicle that is claimed and stands; returns what is left to do by hand."""

    async def watch(self, *, silence_s: float, action: DeadManAction) -> None:
        """Has it act after so long a silence of the program; returns once it says that it will.

        The wish stands until `release`, confirmed or not, while the vehicle is the program's.
        """

    async def release(self) -> None:
        """Says goodbye: it is not to miss the program any more. Returns once it says so, or does not answer."""


class Autopilot(Protocol):
    """A vehicle that can be flown. Each verb returns when it is true, and raises AutopilotError otherwise.

    No verb sends a command unless the vehicle is the program's, which it is from `claim` on until a report says
    otherwise (`core.control`); AutopilotOverruled then.
    """

    @property
    def position(self) -> Position:
        """The last known position, relative to the mission's home."""

    @property
    def earth_position(self) -> EarthPosition | None:
        """The same on the Earth, above the sea, at the time of its GPS; None where the place is not known."""

    @property
    def battery_percent(self) -> float | None:
        """The battery's charge in percent, as last reported; None if the vehicle does not report it."""

    @property
    def velocity(self) -> Velocity | None:
        """How it moves over the ground, as last reported; None where the vehicle does not say."""

    @property
    def stopping_place(self) -> Position:
        """Where it would come to rest if it braked now."""

    @property
    def heading_deg(self) -> float | None:
        """Where its nose points, clockwise from north, as last reported; None where the vehicle does not say."""

    @property
    def telemetry(self) -> Telemetry:
        """All that a mission may read of its last reports."""

    @property
    def wind(self) -> Velocity | None:
        """How the air moves over the ground, as last reported; None where the vehicle does not say."""

    @property
    def energy(self) -> EnergyFacts:
        """What the vehicle says of its battery's stages and of its way home."""

    @property
    def pace(self) -> Pace | None:
        """How it flies on average, by what it is; None where it does not say."""

    @property
    def control(self) -> Control:
        """Who has the vehicle, by its last report."""

    @property
    def dead_man(self) -> DeadMan:
        """What brings it down when the program falls silent."""

    @property
    def armed(self) -> bool:
        """Whether its motors run, by its last report."""

    @property
    def stands(self) -> bool:
        """Whether it stands on the ground, by its last report."""

    def listen(self, hear: Callable[[VehicleNews], None]) -> None:
        """Has `hear` called with all news of the vehicle, and first with those since it was connected."""

    async def in_the_air(self) -> bool:
        """Whether the vehicle flies."""

    async def claim(self, *, resumes: bool) -> None:
        """Takes the vehicle for the program: one that is disarmed or, where it `resumes`, in the program's own mode.

        AutopilotOverruled for any other, and for one that was lost to somebody since this program began.
        """

    async def stood(self) -> None:
        """Returns once the vehicle stands disarmed, whoever flies it; AutopilotLost if it falls silent."""

    async def limits(self) -> VehicleLimits:
        """What the vehicle says of its home and its fence."""

    async def ready(self) -> None:
        """Returns once the vehicle can be armed; AutopilotRefused has its reasons where that takes too long."""

    async def arm(self) -> None:
        """Starts the motors."""

    async def takeoff(self, altitude_m: float) -> None:
        """Climbs to the altitude above home; returns when it is reached."""

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the ground speed of the following legs, in metres per second."""

    async def goto(self, position: Position) -> None:
        """Flies to the position; returns on arrival, at rest."""

    async def turn_to(self, heading_deg: float) -> None:
        """Turns its nose there where it hovers, clockwise from north; the next leg has a heading of its own."""

    async def command(self, number: int, name: str, parameters: Sequence[float]) -> None:
        """Sends a MAVLink command of what it carries; returns once it is accepted."""

    def say(self, severity: int, text: str) -> None:
        """Sends words to whoever listens to the vehicle, of severity 0 (emergency) to 7 (debug), unconfirmed."""

    async def hold(self) -> None:
        """Stops and hovers where it is."""

    async def return_home_and_land(self) -> None:
        """Flies back to the vehicle's home and lands; returns on touchdown."""

    async def land(self) -> None:
        """Lands where the vehicle is; returns on touchdown."""

    async def disarm(self) -> None:
        """Stops the motors; refused by the vehicle in flight."""

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns when the vehicle next enters or leaves any of the circles; AutopilotLost if it falls silent."""

    async def close(self) -> None:
        """Gives up the connection to the vehicle; the vehicle is left as it is."""


class Network(Protocol):
    """A radio: one network joined at a time."""

    async def join(self, network: str, *, timeout_s: float) -> None:
        """Joins the pre-loaded network of that name; raises NetworkError, with the reason, by the timeout."""

    async def lost(self) -> str:
        """Returns why, once the network that is joined is no longer connected; it is still to be left."""

    async def leave(self) -> None:
        """Leaves the joined network, if any."""


class Link(Protocol):
    """A connection to one address over which requests are sent."""

    @property
    def is_far(self) -> bool:
        """Whether connecting may take longer than a call has time for: then a sign of life is waited for first."""

    async def request(self, path: str, body: bytes, *, timeout_s: float) -> bytes:
        """Sends one request and returns its reply; raises LinkError. Cancelling it tells the other side."""

    async def close(self) -> None:
        """Closes the connection at once; every request under way fails."""


Finder = Callable[[str], Awaitable[str]]  # the address of the server of that name; raises Unreachable


class Dialer(Protocol):
    """Opens links."""

    def dial(self, address: str, *, server: str) -> Link:
        """A link to the address, where only `server` is believed; connects when first used."""


@dataclass(frozen=True, slots=True)
class Photo:
    """One JPEG, and what is known of it.

    `captured_s` is by the event loop's clock, `source` says where it came from. Where it was rendered, `truth`
    holds what is on it, for a log.
    """

    jpeg: bytes
    captured_s: float
    source: str
    truth: Sequence[object] | None = None


class Camera(Protocol):
    """The drone's camera."""

    async def take_photo(self, at: Position) -> Photo:
        """Shoots and returns one photo; `at` is where the drone is. Raises CameraError."""


class Notifier(Protocol):
    """The way to the drone's user."""

    async def notify(self, message: object, at: Position) -> None:
        """Tells the user about something found at a position."""


class Journal(Protocol):
    """The event log: what happened, in order, never lost."""

    def record(self, event: schema.Event) -> None:
        """Adds one event, stamped with the time."""


@dataclass(frozen=True, slots=True)
class Program:
    """A service class by its import path, and plain values, such as JSON has, for its constructor.

    Where there is a `command`, that program computes the calls, in whatever language it is written.
    """

    path: str
    settings: Mapping[str, object] = field(default_factory=dict)
    command: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class InstanceSpec:
    """What to start: a service's program, for one of a daemon's server identities."""

    server: str
    service: str
    program: Program
    pace_s: Mapping[str, float] = field(default_factory=dict)  # least time a call takes, by profile key
    start_pace_s: float = 0.0  # least time a start takes
    heats: Surroundings | None = None  # of a computer that gets hot: paced calls take longer then
    methods: frozenset[str] = (
        frozenset()
    )  # that it declares, as far as known: answers of others are not believed
    limits: Limits = NO_LIMITS

    @property
    def name(self) -> str:
        """The instance's name in logs: `detector@s1`."""
        return f"{self.service}@{self.server}"


class Instance(Protocol):
    """A service that runs and can be called."""

    @property
    def endpoint(self) -> str:
        """The address to dial."""

    async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None:
        """Has only these drones, known by `Client.key`, get an answer; returns when that is so.

        Those that are `finishing` get one to the calls that have arrived.
        """

    async def drain(self, why: str) -> None:
        """Has every further call refused for that reason; returns when none is under way any more."""

    async def health(self) -> None:
        """Returns at its next sign of life; raises InstanceError where there will be none."""

    async def exited(self) -> str:
        """Returns how the instance ended, when it does."""

    async def stop(self) -> None:
        """Ends the instance and everything it started; returns when it is gone."""


Outcome: TypeAlias = Literal["value", "raised", "dropped"]


@dataclass(frozen=True, slots=True)
class AnsweredCall:
    """A call that an instance has ended, of a drone known by `Client.key`.

    It was there as a whole for `queued_s` before its turn came, and from then on took `took_s`. A dropped call
    has no answer.
    """

    drone: str
    method: str
    queued_s: float
    took_s: float
    outcome: Outcome = "value"


Answered = Callable[[AnsweredCall], None]


def ignored(_call: AnsweredCall) -> None:
    """Nobody wants to know what calls take."""


class Runtime(Protocol):
    """Starts service instances: processes, containers, or models of them."""

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> Instance:
        """Returns when the instance is ready to serve; raises InstanceError.

        `called(drone)` when a call of a drone begins that is admitted, known by `Client.key`, `answered(call)` at the
        end of each such call. Both are the instance's word, which a service may forge.
        """
