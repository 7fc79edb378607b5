"""The ports: what the programs need from the world.

`real/` provides each port with things, `sim/` with models. The programs in `drone/` and `server/` cannot tell which
they got. All actions are coroutines on the program's event loop and may be cancelled; all times are seconds.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from socket import socket
from typing import Literal, Protocol, TypeAlias

from upwash.core.admission.limits import NO_LIMITS, Limits
from upwash.core.camera.lens import Lens
from upwash.core.geo import Circle, EarthPosition, Position, Velocity
from upwash.core.knowledge.supplies import Supplies
from upwash.core.planning.legs import Pace
from upwash.core.vehicle.control import Control
from upwash.core.vehicle.geofence import Fence
from upwash.core.vehicle.return_place import NO_RALLY_POINTS, RallyPoints
from upwash.core.vehicle.telemetry import Telemetry
from upwash.core.vehicle.way_home import EnergyFacts
from upwash.eventlog import schema
from upwash.eventlog.results import RunResult
from upwash.support.heat import Surroundings

VehicleNews: TypeAlias = (
    Control
    | schema.VehicleSaid
    | schema.AutopilotPhoto
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
    """The names of a vehicle's parameters for its fence and its way home."""

    highest: str = "its ceiling"
    lowest: str = "its floor"
    margin: str = "its margin"
    returns_at: str = "its return altitude"


@dataclass(frozen=True, slots=True)
class VehicleLimits:
    """The vehicle's home, its own fence and its rally points, relative to the mission's home.

    `home` and `home_above_sea_m` are None while the vehicle does not report them. At the altitudes `highest_m` and
    `lowest_m`, above home, the fence is breached; None without the limit. The vehicle may overshoot by `margin_m`.
    `returns_at_m` is the least altitude of its way home, above home. `names` has the vehicle's parameter for each,
    for messages. `untold` are parameters of the fence that the vehicle did not report.
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
    rally: RallyPoints = NO_RALLY_POINTS


DeadManAction: TypeAlias = Literal["return", "land"]
ComingDown: TypeAlias = Literal["return", "land"]


class DeadMan(Protocol):
    """A switch in the autopilot that returns or lands a vehicle whose program has fallen silent.

    It acts only in flight and in the program's own mode. Each method raises AutopilotError if it fails.
    """

    async def missing(self) -> str:
        """Why the switch cannot be used, with the remedy; "" if it is ready."""

    async def install(self) -> str:
        """Installs the switch in the autopilot of a claimed, standing vehicle; returns what is left to do by hand."""

    async def watch(self, *, silence_s: float, action: DeadManAction) -> None:
        """Arms the switch: it acts after the program is silent for `silence_s`. Returns once the vehicle confirms it.

        The order holds until `release`, confirmed or not, while the vehicle is the program's.
        """

    async def release(self) -> None:
        """Releases the switch, so that it ignores silence. Returns once it confirms, or does not answer."""


class Whereabouts(Protocol):
    """Where the drone is."""

    @property
    def position(self) -> Position:
        """Where the vehicle is by its last report, relative to the mission's home."""

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns when the vehicle next enters or leaves any of the circles; AutopilotLost if it falls silent."""


class Autopilot(Whereabouts, Protocol):
    """A vehicle that can be flown. An action returns when it is complete, or raises AutopilotError.

    No action sends a command unless the program has the vehicle: from `claim` on, until a report shows another owner
    (`core.vehicle.control`). AutopilotOverruled then.
    """

    @property
    def position_is_sure(self) -> bool:
        """Whether the reported position can be true, and the vehicle is sure of it; no arrival counts otherwise."""

    @property
    def earth_position(self) -> EarthPosition | None:
        """The last known place on the Earth, altitude above the sea, and GPS time; None if the place is unknown."""

    @property
    def stopping_place(self) -> Position:
        """The position where the vehicle would come to rest if it braked now."""

    @property
    def telemetry(self) -> Telemetry:
        """The vehicle's last reports that a mission may read."""

    @property
    def wind(self) -> Velocity | None:
        """The wind over the ground, as last reported; None if not reported."""

    @property
    def energy(self) -> EnergyFacts:
        """The battery's low stages and the way home, as the vehicle reports them."""

    @property
    def pace(self) -> Pace | None:
        """How the average vehicle of this kind flies; None if the kind is unknown."""

    @property
    def control(self) -> Control:
        """The vehicle's owner, by its last report."""

    @property
    def dead_man(self) -> DeadMan:
        """The switch that returns or lands the vehicle when the program falls silent."""

    @property
    def armed(self) -> bool:
        """Whether the motors run, by the last report."""

    @property
    def stands(self) -> bool:
        """Whether the vehicle stands on the ground, by the last report."""

    def listen(self, hear: Callable[[VehicleNews], None]) -> None:
        """Calls `hear` with all news of the vehicle, and first with the news since it was connected."""

    async def in_the_air(self) -> bool:
        """Whether the vehicle flies."""

    async def claim(self, *, resumes: bool, ordered: ComingDown | None = None) -> None:
        """Claims the vehicle; it must be disarmed or, if the program `resumes`, in the program's own mode.

        `ordered` is how an earlier run of the program ordered the vehicle to come down, as its last order.

        Raises AutopilotOverruled otherwise, and for a vehicle that this program has lost before.
        """

    async def stood(self) -> None:
        """Waits until the vehicle stands disarmed, with any owner; AutopilotLost if it falls silent."""

    async def limits(self) -> VehicleLimits:
        """The vehicle's home, its own fence and its rally points."""

    async def ready(self) -> None:
        """Waits until the vehicle can be armed; raises AutopilotRefused, with its reasons, if that takes too long."""

    async def arm(self) -> None:
        """Starts the motors."""

    async def takeoff(self, altitude_m: float) -> None:
        """Climbs to the altitude above home; returns when it is reached."""

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the ground speed of the following legs, in metres per second."""

    async def goto(self, position: Position) -> None:
        """Flies to the position; returns on arrival, at rest."""

    async def turn_to(self, heading_deg: float) -> None:
        """Turns the hovering vehicle's nose to a heading, clockwise from north, until the next leg."""

    async def command(self, number: int, name: str, parameters: Sequence[float]) -> None:
        """Sends a MAVLink command to a payload; returns once it is accepted."""

    def say(self, severity: int, text: str) -> None:
        """Sends a text to ground stations, of severity 0 (emergency) to 7 (debug), without a confirmation."""

    async def hold(self) -> None:
        """Stops the vehicle; returns when it hovers."""

    async def return_home_and_land(self) -> None:
        """Flies back to the vehicle's home or rally point and lands; returns on touchdown.

        A vehicle whose return ends in a hover is not landed: the verb goes on until it fails.
        """

    async def land(self) -> None:
        """Lands where the vehicle is; returns on touchdown."""

    async def disarm(self) -> None:
        """Stops the motors; refused by the vehicle in flight."""

    async def close(self) -> None:
        """Gives up the connection to the vehicle; the vehicle is left as it is."""


class Network(Protocol):
    """A radio: one network joined at a time."""

    async def join(self, network: str, *, timeout_s: float) -> None:
        """Joins the network of that name; raises NetworkError with the reason, at the latest after `timeout_s`."""

    async def lost(self) -> str:
        """Waits until the joined network is no longer connected, and returns why; it must still be left."""

    async def leave(self) -> None:
        """Leaves the joined network, if any."""


class Link(Protocol):
    """A connection to one address over which requests are sent."""

    @property
    def is_far(self) -> bool:
        """Whether connecting may take longer than a call's deadline; the drone then first waits for an answer."""

    async def request(
        self, path: str, body: bytes, *, timeout_s: float, may_queue_s: float | None = None
    ) -> bytes:
        """Sends one request and returns its reply; raises LinkError. Cancelling it tells the other side.

        An instance need not begin a call after `may_queue_s`; None: the call waits as long as its caller.
        """

    async def close(self) -> None:
        """Closes the connection at once; every request under way fails."""


Finder = Callable[[str], Awaitable[str]]  # the address of the server of that name; raises Unreachable


class Dialer(Protocol):
    """Opens links."""

    def dial(self, address: str, *, server: str) -> Link:
        """A link to the address that trusts only `server`; connects when first used."""


@dataclass(frozen=True, slots=True)
class OtherClock:
    """The time of a photo by its camera's clock, and of its arrival by this computer's own, in UTC."""

    camera: datetime
    own: datetime


@dataclass(frozen=True, slots=True)
class Photo:
    """One photo as a JPEG.

    `captured_s` is its time by the event loop's clock, `source` names its origin. For a rendered photo `truth` lists
    what it shows, for a log; `lens` is None if it is unknown. With an `other_clock` the photo counts as taken when it
    came.
    """

    jpeg: bytes
    captured_s: float
    source: str
    truth: Sequence[object] | None = None
    lens: Lens | None = None
    other_clock: OtherClock | None = None


@dataclass(frozen=True, slots=True)
class KeptPhoto:
    """A photo with what its file says of it.

    `angles_deg` are yaw, pitch and roll as mapping programs count them, `errors_m` the standard errors of the place
    to the sides and in altitude. None stands for what is unknown.
    """

    jpeg: bytes
    source: str
    earth: EarthPosition | None = None
    angles_deg: tuple[float, float, float] | None = None
    errors_m: tuple[float, float] | None = None


class Camera(Protocol):
    """The drone's camera."""

    async def take_photo(self, at: Position) -> Photo:
        """Takes and returns one photo; `at` is the drone's position. Raises CameraError."""


class Album(Protocol):
    """Keeps the photos of a flight."""

    async def keep(self, photo: KeptPhoto) -> str:
        """Keeps the photo and returns the name of its file; raises NotWritten."""


class Computer(Protocol):
    """What the program has left of the computer that it runs on."""

    def left(self) -> Supplies:
        """What is left now; infinite where the system does not tell."""

    async def may_have_changed(self) -> None:
        """Return when it is worth looking again."""


class Notifier(Protocol):
    """Sends messages to the drone's user."""

    async def notify(self, message: object, at: Position, photo: int | None = None) -> None:
        """Sends the user a message about a finding at a position, on the photo of that number, None for the last."""


class Journal(Protocol):
    """The event log: what happened, in order, never lost."""

    def record(self, event: schema.Event) -> None:
        """Adds one event, stamped with the time."""


@dataclass(frozen=True, slots=True)
class Program:
    """A service class by its import path, and plain values, such as JSON has, for its constructor.

    If there is a `command`, that program, in any language, computes the calls.
    """

    path: str
    settings: Mapping[str, object] = field(default_factory=dict)
    command: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class InstanceSpec:
    """The instance to start: a service's program, for one server of a daemon."""

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
    devices: tuple[str, ...] = ()  # of the machine, which it may use
    before: str = ""  # the service before whose requests it runs, on the drone

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
        """Lets the instance answer only these drones, given by `Client.key`; returns when it confirms.

        Of `finishing` drones it answers the calls that have arrived.
        """

    async def drain(self, why: str) -> None:
        """Has every further call refused for that reason; returns when no call is under way."""

    async def health(self) -> None:
        """Waits for the instance's next sign of life; raises InstanceError if it is gone."""

    async def exited(self) -> str:
        """Waits for the end of the instance, and returns how it ended."""

    async def stop(self) -> None:
        """Ends the instance and everything it started; returns when it is gone."""


Outcome: TypeAlias = Literal["value", "raised", "dropped"]


@dataclass(frozen=True, slots=True)
class AnsweredCall:
    """A call of the drone with that `Client.key` that an instance has ended.

    After its arrival it queued for `queued_s`, and was computed for `took_s`. A dropped call has no answer.
    """

    drone: str
    method: str
    queued_s: float
    took_s: float
    outcome: Outcome = "value"


Answered = Callable[[AnsweredCall], None]


def ignored(_call: AnsweredCall) -> None:
    """Does nothing, for callers that need no report of calls."""


class Runtime(Protocol):
    """Starts service instances: processes, containers, or models of them."""

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> Instance:
        """Returns when the instance is ready to serve; raises InstanceError.

        Calls `called(drone)` when a call of the admitted drone with that `Client.key` begins, and `answered(call)` at
        its end. Both are reports of the instance, which a service may forge.
        """


@dataclass(frozen=True, slots=True)
class Handed:
    """The instance's ends: its control line, its output, and its socket for callers if it does not listen itself."""

    control: socket
    output: socket
    outside: socket | None


class ServiceProcess(Protocol):
    """What runs an instance: a group of processes, or a container."""

    async def ended(self) -> int:
        """Waits for the end of the first process, and returns its exit code; negative for a signal."""

    async def end(self) -> None:
        """End the first process and all that it started; returns when they are gone."""


class Engine(Protocol):
    """What a plug-in's instances run in, such as containers; it translates, and decides nothing."""

    @property
    def enforces(self) -> Collection[str]:
        """The limits of a spec that hold: of `memory_bytes`, `processes`, `disk_bytes` and `cpus`."""

    @property
    def is_apart(self) -> bool:
        """Whether an instance has files of its own, /tmp too; otherwise it must see this machine's."""

    async def run(self, spec: InstanceSpec, command: Sequence[str], handed: Handed) -> ServiceProcess:
        """Starts the command of an instance, which inherits `control` and `outside` under the same numbers.

        What it prints goes to `output`. It may use `spec.devices`, and no more than `spec.limits`. Raises any error.
        """

    async def close(self) -> None:
        """Gives the engine up, once no instance runs."""


class LoggedRun(Protocol):
    """One run of a log, as the export of a plug-in gets it."""

    @property
    def name(self) -> str:
        """The shortest name that tells the log from the others."""

    @property
    def events(self) -> Iterable[schema.Event]:
        """The events of the run; each pass reads them again."""

    @property
    def result(self) -> RunResult:
        """Its times, calls and end."""


# The content of a file of these runs; the path is the folder of their photos.
Export = Callable[[Sequence[LoggedRun], Path | None], bytes]
