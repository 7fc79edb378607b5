"""The drone's configuration, which is also a simulated scenario: that plus what is true in the world."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct
from msgspec.structs import replace

from upwash.config import values
from upwash.config.kept_maps import CoverageFile, DemandFile
from upwash.config.user import UserConfig
from upwash.config.world import EnergyConfig, EventConfig, FaultConfig, NoiseConfig, TruthConfig
from upwash.core.planning.order import SWEEPS
from upwash.core.policies.names import POLICIES, is_own
from upwash.core.selection.deadlines import AnswerDeadline
from upwash.core.selection.hedging import HedgeRule
from upwash.core.selection.recovery import Probing
from upwash.plans import FlightPlan, read_plan
from upwash.support.heat import Surroundings


class PlanFile(values.NamedFile):
    """A plan of a ground station, and the file that it was read from."""

    def __init__(self, file: Path, plan: FlightPlan | None = None) -> None:
        super().__init__(file)
        self.plan: FlightPlan = plan or read_plan(file)


FieldOfView = Annotated[float, Meta(ge=1, le=170, description="a number from 1 to 170, in degrees")]
AtLeastOneSecond = Annotated[float, Meta(ge=1, description="a number of at least 1, in seconds")]
DeadManSilence = Annotated[float, Meta(ge=5, le=600, description="a number from 5 to 600, in seconds")]
Policy = Annotated[
    str,
    Meta(
        pattern=rf"^({'|'.join(POLICIES)}|[^:]+:[A-Za-z_][A-Za-z_0-9]*)\Z",
        description=", ".join(['one of "local-only"', *(f'"{name}"' for name in sorted(POLICIES)[1:])])
        + ', or a class of your own, such as "mine.py:Class"',
    ),
]
PairInMetres = Annotated[tuple[float, float], Meta(description="a pair [east, north] in metres")]
PlacesInMetres = Annotated[
    tuple[PairInMetres, ...],
    Meta(min_length=1, description="pairs [east, north] in metres, at least one"),
]
SecondOfADay = Annotated[float, Meta(ge=0, le=86_400, description="a number from 0 to 86400, in seconds")]
SystemId = Annotated[int, Meta(ge=1, le=255, description="a whole number from 1 to 255")]
PhotoSize = Annotated[
    tuple[values.PixelCount, values.PixelCount],
    Meta(description="a pair [width, height] of whole numbers above 0, in pixels"),
]
Radios = Annotated[int, Meta(ge=1, le=2, description="1 or 2")]
PlanPath = Annotated[PlanFile, Meta(description="a plan's path, absolute or from this file's folder")]
FlightOrder = Annotated[
    Annotated[int, Meta(ge=0, lt=SWEEPS)] | Literal["given", "best-sweep", "by-index"],
    Meta(description=f'"given", "best-sweep", "by-index", or a number of a sweep from 0 to {SWEEPS - 1}'),
]
CoveragePath = Annotated[
    CoverageFile, Meta(description="a coverage map's path, absolute or from this file's folder")
]
DemandPath = Annotated[
    DemandFile, Meta(description="a path of a map of demands, absolute or from this file's folder")
]
SafeEnd = Literal["return", "hold", "land"]
Corner = Literal["top-left", "top-right", "bottom-left", "bottom-right"]


class GridConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Waypoints in rows, the bottom-left one at home, flown row by row from one corner."""

    columns: values.GridCount
    """Waypoints in a row."""
    rows: values.GridCount
    """Rows, to the north."""
    spacing_m: values.Positive
    """The distance between neighbouring waypoints, in metres."""
    start: Corner = "top-left"
    """The corner where the flight begins."""
    rows_alternate: bool = True
    """Whether every second row is flown backwards; false flies all rows in the same direction."""


class PhotosConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Photos that are taken in flight, along rows that the drone flies without stopping: [rows](rows.md)."""

    every_m: values.Positive | None = None
    """The distance along a row from one photo to the next, in metres; the first is at its start. This or `every_s` is
    needed, except with a plan, whose triggers have distances."""
    every_s: values.Positive | None = None
    """The time from one photo to the next at the speed of the row, in seconds, in place of `every_m`."""
    order: Literal["oldest", "newest"] = "oldest"
    """Which of the photos without an answer is computed next."""
    at_most: values.PhotoCount = 100
    """With this number of photos without an answer the drone stops and waits."""

    def step_m(self, ground_speed_m_s: float) -> float | None:
        """The distance from one photo to the next at that speed; None where a plan's triggers have it."""
        return self.every_m if self.every_s is None else self.every_s * ground_speed_m_s

    def __post_init__(self) -> None:
        if self.every_m is not None and self.every_s is not None:
            raise ValueError("every_m and every_s both say when the next photo is taken: give one of them")


class SecondLook(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The bundled mission flies to the objects that it finds, and takes a photo of each from lower down: [the second
    look](missions.md#a-second-look)."""

    altitude_m: values.Positive
    """The altitude of the photo above the ground at the object, in metres; without `camera.terrain` above home."""
    labels: values.Names = ()
    """The labels of the objects that are looked at again; default: all."""
    below_score: values.Share | None = None
    """Only objects whose best score is below this, or that have none."""

    def wants(self, label: str, score: float | None) -> bool:
        """Whether an object with that label and best score is looked at again."""
        is_sure = self.below_score is not None and score is not None and score >= self.below_score
        return not is_sure and (not self.labels or label in self.labels)


class MissionConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is flown."""

    program: values.Text = "survey"
    """The mission: the bundled `survey`, `path/to/file.py:function` or `package.module:function`."""
    mode: values.Text = "heavy"
    """Passed to a mission that has a parameter of this name; the profile key of the bundled one."""
    altitude_m: values.Positive = 20.0
    """The altitude of the take-off above home, in metres."""
    ground_speed_m_s: values.Positive = 4.0
    """The ground speed of legs, in metres per second; with `speed = "auto"` the highest one, 10 by default."""
    speed: Literal["given", "auto"] = "given"
    """`auto`: before take-off the drone chooses [the speed of its rows](rows.md#which-speed)."""
    home: values.HomeConfig | None = None
    """The place where east and north are 0; needed to fly."""
    grid: GridConfig | None = None
    """The waypoints as a grid; one of `grid`, `waypoints_m` and `plan` is needed."""
    waypoints_m: PlacesInMetres | None = None
    """The waypoints as pairs of metres east and north of home."""
    plan: PlanPath | None = None
    """The waypoints and the geofence of a [plan](missions.md#plans): QGroundControl's `.plan`, or `QGC WPL 110`."""
    photos: PhotosConfig | None = None
    """The rows of the grid, the legs 0, 2, 4 ... of `waypoints_m`, or those of the plan where it triggers the camera,
    are flown without stopping for photos."""
    action_s: values.NotNegative = 0.0
    """The duration of an action that an answer demands at its waypoint, in seconds. With 0 the bundled mission only
    tells answers of [rows](rows.md), and never turns back."""
    second_look: SecondLook | None = None
    """Objects that are found are looked at again from lower down."""
    order: FlightOrder = "given"
    """The order of the waypoints: [orders](missions.md#the-order-of-the-waypoints)."""
    reserve_percent: values.Percent | None = None
    """The mission ends early below this battery level."""
    reserve_s: values.NotNegative | None = None
    """The mission ends early if the way home would leave fewer seconds of flight: [the
    reserve](flight-ends.md#the-reserve)."""
    finish_by_s: values.Positive | None = None
    """The latest end of the mission, in seconds from arming: [lighter calls](calls.md#lighter-calls)."""
    lighter: values.KeysByKey = {}
    """The profile key for calls while the mission is late for `finish_by_s`."""

    @property
    def only_tells(self) -> bool:
        """Whether the bundled mission only tells the answers of its rows, as nothing is done at objects."""
        acts = self.action_s > 0 or self.second_look is not None
        return self.program == "survey" and self.photos is not None and not acts


class VehicleConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the vehicle flies: as a measured profile, or as these numbers say.

    Forecasts of a real flight go by them too. Where the file has none, they go by the firmware that was found.
    """

    profile: Literal["arducopter", "px4"] | None = None
    """A measured vehicle, in place of the next three."""
    acceleration_m_s2: values.Positive | None = None
    """Acceleration and braking, in m/s². A simulation without a profile: 1."""
    takeoff_s: values.NotNegative | None = None
    """From arming to the altitude, in seconds. A simulation without a profile: 10."""
    return_and_land_s: values.NotNegative = 16.0
    """From the last waypoint to the ground, in seconds."""
    endurance_s: values.Positive | None = None
    """Flight with a full battery, in seconds; a real flight's `reserve_s` and `upwash check` read it too."""
    track_csv: values.FilePath | None = None
    """Simulation: the [track of a flight](scenarios.md#measured-flights), which the vehicle flies as it was."""
    wind_csv: values.FilePath | None = None
    """Simulation: [measured wind](scenarios.md#measured-flights), which costs energy."""
    battery_csv: values.FilePath | None = None
    """Simulation: the [measured charge](scenarios.md#measured-flights) of the battery."""


class AutopilotConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a real vehicle is reached, and what it does when the mission fails."""

    connection: values.Text | None = None
    """`serial:DEVICE:BAUD`, `udpin:HOST:PORT`, `udpout:HOST:PORT` or `tcp:HOST:PORT`; needed to fly."""
    system: SystemId | None = None
    """The MAVLink system id of the vehicle to fly; absent: the only vehicle on the link."""
    found_within_s: values.Positive = 120.0
    """How long a flight waits for the vehicle's first message, in seconds; it may be switched on later."""
    signing_key: values.FilePath | None = None
    """The key with which all messages are signed; unsigned messages are ignored:
    [signing](vehicle.md#signed-messages)."""
    on_failure: SafeEnd = "return"
    """How a mission that cannot go on ends."""
    farthest_start_m: values.Positive = 500.0
    """The largest distance from the standing vehicle to the nearest waypoint, in metres."""
    link_patience_s: values.Positive = 120.0
    """The longest silence of the vehicle's link before the flight ends by `on_failure`, in seconds."""
    dead_man_s: DeadManSilence | None = None
    """The autopilot itself does what `on_failure` says after so long a silence of this program: [the dead
    man](vehicle.md#when-the-drones-computer-dies)."""
    arrival_distance_m: values.Positive = 1.0
    """Distance within which a waypoint counts as reached, in metres."""
    arrival_speed_m_s: values.Positive = 0.5
    """Speed below which a waypoint counts as reached, in metres per second."""


class NetworkConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How servers' networks are joined. A simulation models joining in any case."""

    kind: Literal["stand-in", "wired", "networkmanager"] = "wired"
    """`wired`: nothing is joined, as with LTE, 5G or a mesh; `networkmanager`: by
    [NetworkManager](networks.md); `stand-in`: by the drone's position, for the desk."""
    interfaces: Annotated[tuple[values.InterfaceName, ...], Meta(description="an array of interfaces")] = ()
    """The interfaces that NetworkManager may use to join networks."""
    radios: Radios = 1
    """With 2, the next server is checked while the present one is used; each radio has an interface."""
    coverage_map: CoveragePath | None = None
    """A file, kept between flights, with the measurements of servers without a range at each place."""


class CameraConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where photos come from: one source."""

    photo_s: values.NotNegative = 1.0
    """The time of a photo, in seconds; of a device the oldest that a photo may be beyond `latency_s`, at least 1."""
    folder: values.FilePath | None = None
    """A folder whose JPEG and PNG files are the photos, in turn."""
    device: values.VideoSource | None = None
    """A camera, a film, or GStreamer's pipeline."""
    topic: values.Text | None = None
    """A [ROS 2](ros.md) topic: of `sensor_msgs/CompressedImage` if its name ends in `compressed`, else of
    `sensor_msgs/Image`."""
    bag: values.FilePath | None = None
    """A ROS 2 bag, whose images are the photos, in turn; with `topic` those of that topic."""
    latency_s: values.NotNegative = 0.0
    """Delay from capture to arrival of a device's frame, in seconds: streams can lag by a second."""
    fov_deg: FieldOfView | None = None
    """The horizontal field of view, in degrees: with the lens known, [findings have places](findings.md)."""
    focal_px: values.Positive | None = None
    """In place of `fov_deg`: the focal length in pixels of the photo."""
    calibration: values.FilePath | None = None
    """In place of `fov_deg`: a calibration file, as OpenCV or ROS write it, with the lens's distortion too."""
    tilt_deg: values.Tilt = 90.0
    """How far below the horizon the camera of a level vehicle looks: 90 is straight down, 0 ahead."""
    yaw_deg: values.Turn = 0.0
    """How far right of the nose the camera looks."""
    photo_px: PhotoSize | None = None
    """The width and the height of a photo, in pixels, for [the overlap of photos](rows.md#which-speed)."""
    exposure_s: values.Positive | None = None
    """The exposure of a photo taken in flight, in seconds, such as 0.001, for the blur."""
    gimbal: bool = False
    """The camera hangs on a gimbal that keeps it level; `tilt_deg` and `yaw_deg` hold until it is pointed."""
    terrain: values.FilePath | None = None
    """The altitude of the ground: a GeoTIFF, SRTM tile or other grid that GDAL reads; without it the ground is level
    with home."""
    keep: values.FilePath | None = None
    """A folder where the photos are kept, with position, time and attitude as mapping programs read them.
    `{time}` in its name is the flight's start, in UTC: [kept photos](findings.md#kept-photos)."""
    park_seed: values.CountFromZero | None = None
    """Photos are rendered: the solar park of this seed, below the drone."""
    plug_in: values.Text | None = None
    """The name of a camera that a [plug-in](plug-ins.md) brings."""
    settings: values.ClassSettings = {}
    """What the camera of the plug-in takes."""


class RosConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The node of [`upwash ros`](ros.md)."""

    position: values.Text | None = None
    """The topic of the drone's place: of `sensor_msgs/NavSatFix`, as MAVROS has at `/mavros/global_position/global`,
    or below `/fmu/out/` of `px4_msgs/VehicleGlobalPosition`; needs `mission.home`."""
    at_most: values.PhotoCount = 1
    """How many photos wait for each service; with more the oldest is dropped, and the newest is computed next."""


_LEFT_ALONE_S = 60.0


class PolicyConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When calls are offloaded, and where to: [policies](policies.md)."""

    name: Policy = "look-ahead"
    """The rule that selects servers and places calls; a [policy of your own](own-policy.md) as `mine.py:Class`."""
    settings: values.ClassSettings = {}
    """The arguments of your own policy's class, by name."""
    gain_switch: values.Fraction = 0.25
    """The share of the local delay that a switch to another server must save."""
    gain_wait: values.Fraction = 0.25
    """The share of the local delay that waiting for a server must save."""
    gain_slot: values.Fraction = 0.25
    """The share of the local delay that a server must save if other drones wait for a slot."""
    period_s: values.Positive = 1.0
    """The time between two considerations of a better server, in seconds."""
    blacklist_s: AtLeastOneSecond | None = None
    """How long a failed server is not used, in seconds; in place of `probe`."""
    probe: Probing | None = None
    """A failed server is probed after these pauses; default of `look-ahead` and of your own policies."""
    idle_s: values.NotNegative = 180.0
    """How long the services of a server that was left are believed to run, in seconds."""
    retry_s: values.NotNegative = 300.0
    """The time until a server slower than the drone gets another chance, in seconds."""
    patient_first_call: bool = False
    """Whether a service's first call on a server may take as long as a local one."""
    hedge: HedgeRule | bool | None = None
    """Whether calls that a server answers late are computed on the drone too; `true`, `false` or a table; default:
    `true` with `look-ahead` and your own policies."""
    stay_or_go: Literal["stay", "go", "learn"] = "stay"
    """Whether the drone flies on before it has an answer: [answers that come later](calls.md)."""
    demand_map: DemandPath | None = None
    """A file, kept between flights, with the places of demands, for `stay_or_go`."""
    act_within_s: values.NotNegative | None = None
    """The longest time in seconds from an answer to [its later act](calls.md#when-the-drone-acts), as far as
    the drone can tell. 0: at once. Without the key the drone acts where the way gets least longer."""
    detour_s: values.NotNegative = 120.0
    """The longest stop, with the way there, for answers of [a service that only servers run](calls.md#only-servers);
    for others the longest way to a range where a resting drone has the answers sooner ([rows](rows.md)); 0: none."""
    most_loss: values.Fraction = 0.0
    """The largest `loss` of a part [before sending](calls.md#less-to-send) that may be used; 0: all is sent whole."""

    def __post_init__(self) -> None:
        if self.settings and not is_own(self.name):
            raise ValueError(
                f"settings are for a policy of your own, and {self.name} has none: leave them out"
            )
        if self.blacklist_s is not None and self.probe is not None:
            raise ValueError(
                "blacklist_s leaves a server that failed alone, and probe asks it again: give one of them"
            )

    @property
    def label(self) -> str:
        """The name as results have it: of an own policy's file without its folder."""
        file, colon, own = self.name.rpartition(":")
        return f"{Path(file).name}:{own}" if colon else self.name

    def under(self, name: str) -> PolicyConfig:
        """The same for the policy of that name, which has no other policy's settings."""
        return replace(self, name=name, settings=self.settings if name == self.name else {})

    @property
    def probing(self) -> Probing | None:
        """How a server that failed is probed; None where it is left alone for `left_alone_s`."""
        if self.blacklist_s is not None:
            return None
        return self.probe or (Probing() if self._is_of_today else None)

    @property
    def left_alone_s(self) -> float:
        """For how long a server that failed is left alone where it is not probed: 60 s, as in the thesis."""
        return _LEFT_ALONE_S if self.blacklist_s is None else self.blacklist_s

    @property
    def acts_within_s(self) -> float:
        """`act_within_s`; infinite without one."""
        return math.inf if self.act_within_s is None else self.act_within_s

    @property
    def hedging(self) -> HedgeRule | None:
        """How calls are hedged; None if they are not."""
        if isinstance(self.hedge, HedgeRule):
            return self.hedge
        wanted = self._is_of_today if self.hedge is None else self.hedge
        return HedgeRule() if wanted else None

    @property
    def _is_of_today(self) -> bool:
        return self.name == "look-ahead" or is_own(self.name)


class TwoAnswersConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The drone computes a first answer at once, and a server a better one: [two answers](calls.md#two-answers)."""

    first: values.Text
    """The profile key of the call that the drone computes at once; a server computes the call as asked for."""
    within_s: values.Positive
    """How long after the call the better answer counts, in seconds."""


class BeforeSendingConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the part of a service that makes requests smaller costs and loses; `upwash profile` measures it."""

    takes_s: values.NotNegative
    """Its time on the drone, in seconds."""
    request_bytes: values.Count
    """The mean size of a request afterwards, in bytes."""
    loss: values.FractionsByKey
    """The share of the answers that it costs, from 0 to 1: one number, or one for each profile key or method. An
    operation without one is sent whole."""
    settings: values.Settings | None = None
    """Arguments of its class's constructor."""


class ServiceConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A service that the mission calls, and what its calls cost on the drone."""

    name: values.Name
    """The service's name, as its class declares it."""
    program: values.ImportPath | None = None
    """The service's class, `path/to/file.py:Class` or `package.module:Class`; not needed for a bundled service."""
    command: values.Command = ()
    """A program and its arguments that compute the calls, in [any language](services.md#other-languages)."""
    request_bytes: values.Bytes = 425_000
    """The mean size of a request, in bytes."""
    reply_bytes: values.Bytes = 500
    """The mean size of a reply, in bytes."""
    max_reply_bytes: values.MessageBytes = 4_194_304
    """The largest reply of a server: a larger one is not received, and the drone computes the call."""
    local_call_s: values.SecondsOfEachKey
    """A call on the drone, in seconds; `upwash profile` measures it. A method may be a key too. Left out of
    [a service that only servers run](calls.md#only-servers)."""
    waiting_bytes: values.Bytes = 268_435_456
    """If only servers run it: the most that requests of waiting calls keep in memory, in bytes; beyond it the oldest
    ends without an answer."""
    local_first_extra_s: values.NotNegative = 0.0
    """How much longer the first call after a start takes, in seconds."""
    local_pace_s: values.SecondsByKey = {}
    """The least time of a call on the drone, in seconds: stands in for a slower computer."""
    local_joining_slowdown: values.SharesByKey = {}
    """Simulation: the share by which calls on the drone take longer while a network is joined."""
    deadline: AnswerDeadline | None = None
    """Its calls are answered in time with a probability, also by a second server: [deadlines](calls.md#deadlines)."""
    two_answers: TwoAnswersConfig | None = None
    """Its calls have a first answer of the drone, a better one of a server: [two answers](calls.md#two-answers)."""
    settings: values.Settings | None = None
    """Arguments of its class's constructor."""
    before_sending: BeforeSendingConfig | None = None
    """Its part that makes requests smaller before they are sent: [less to send](calls.md#less-to-send)."""


class ServerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An edge server, and what the drone believes of it before it has met it."""

    name: values.Name
    """The server's name, as in its certificate."""
    east_m: float | None = None
    """The server's place relative to home, in metres; or give `latitude_deg` and `longitude_deg`."""
    north_m: float | None = None
    """The server's place relative to home, in metres."""
    latitude_deg: values.Latitude | None = None
    """The server's place in degrees, instead of `east_m` and `north_m`."""
    longitude_deg: values.Longitude | None = None
    """The server's place in degrees, instead of `east_m` and `north_m`."""
    range_m: values.Range
    """The server's radio range, in metres; or `"measured"`: [servers without a
    range](networks.md#servers-without-a-range)."""
    network: values.Text
    """Its NetworkManager profile; default: the server's name. Servers of one network have the same:
    [deadlines](calls.md#deadlines)."""
    address: values.Text | None = None
    """The daemon's address, `host:port` or `unix:path`; or `mdns`: it is [found in its
    network](networks.md#addresses). Needed to fly."""
    bandwidth_bit_s: values.Positive | None = None
    """With `processing_s`: the first estimate of a call (equation 3.1) where `remote_call_s` is not given."""
    check_s: values.NotNegative = 11.5
    """From selecting it to the first call, with services to be started, in seconds."""
    check_running_s: values.NotNegative = 3.5
    """The same with services that run, in seconds."""
    processing_s: values.SecondsByService = {}
    """Computing a call there, in seconds."""
    remote_call_s: values.SecondsByService = {}
    """A call there from request to reply, in seconds: one number, by service, by profile key or both."""
    times_csv: values.FilePath | None = None
    """Measured times of calls there, which [deadlines](calls.md#deadlines) need: `operation,seconds`."""
    truth: TruthConfig = TruthConfig()
    """Simulation: how the server truly behaves."""

    @property
    def believed_range_m(self) -> float | None:
        """How far it is reached, in metres; None where calls measure that."""
        return None if self.range_m == "measured" else self.range_m


class FleetDroneConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Simulation: one of several drones; what it leaves out is as the file says for all."""

    name: values.Name
    """Of the drone."""
    departs_s: SecondOfADay = 0.0
    """When it begins, in seconds of the simulation."""
    vanishes_s: values.Positive | None = None
    """When its computer is gone, in seconds of the simulation."""
    grid: GridConfig | None = None
    """Its waypoints as a grid."""
    waypoints_m: PlacesInMetres | None = None
    """Its waypoints as pairs of metres east and north of home."""
    plan: PlanPath | None = None
    """Its waypoints as a plan."""
    local_call_s: values.SecondsByService = {}
    """A call on its computer, in seconds, by service and profile key."""
    policy: Policy | None = None
    """Its policy."""


class DroneConfig(
    Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    rename={"services": "service", "servers": "server", "faults": "fault", "drones": "drone"},
):
    """One drone: its mission, its services, the servers it may meet, and how it is simulated.

    A scenario may have several `drones`: `fleet_of` has a configuration for each of them.
    """

    name: values.Name = "drone"
    """As in the drone's certificate."""
    seed: int = 1
    """Simulation: the seed of all random numbers."""
    metrics: values.Text | None = None
    """The address at which Prometheus reads the metrics of a flight, `host:port`: [metrics](metrics.md)."""
    metrics_hosts: values.Names = ()
    """Further names of this computer that a Prometheus may use, such as `host.docker.internal`."""
    max_message_bytes: values.MessageBytes = 16_777_216
    """The largest request and result of a call on the drone's side."""
    start_timeout_s: values.Positive = values.START_TIMEOUT_S
    """A service that is not ready by then is given up, in seconds: one of the drone by `fly`, `check` and `profile`,
    one at a server by `check --servers` and `profile --server`. A daemon has the same key."""
    mission: MissionConfig
    vehicle: VehicleConfig = VehicleConfig()
    autopilot: AutopilotConfig = AutopilotConfig()
    network: NetworkConfig = NetworkConfig()
    keys: values.KeysConfig | None = None
    camera: CameraConfig = CameraConfig()
    ros: RosConfig = RosConfig()
    user: UserConfig = UserConfig()
    policy: PolicyConfig = PolicyConfig()
    services: Annotated[
        tuple[ServiceConfig, ...], Meta(description="tables that each begin with [[service]]")
    ] = ()
    servers: Annotated[
        tuple[ServerConfig, ...], Meta(description="tables that each begin with [[server]]")
    ] = ()
    heat: Surroundings | None = None
    energy: EnergyConfig | None = None
    event: EventConfig | None = None
    noise: NoiseConfig = NoiseConfig()
    faults: Annotated[tuple[FaultConfig, ...], Meta(description="tables that each begin with [[fault]]")] = ()
    drones: Annotated[
        tuple[FleetDroneConfig, ...], Meta(description="tables that each begin with [[drone]]")
    ] = ()


def unsigned_port(autopilot: AutopilotConfig) -> str:
    """A warning if other computers can send messages in the vehicle's name to the drone's port; else ""."""
    kind, _, place = (autopilot.connection or "").partition(":")
    if kind != "udpin" or autopilot.signing_key is not None or values.is_on_this_machine(place):
        return ""
    return (
        f"autopilot.connection = {autopilot.connection} listens to networks, and messages are not signed: who sends "
        "there before the vehicle does, or with its address, is taken for it. Listen on 127.0.0.1, or sign "
        "(autopilot.signing_key, made by `upwash keys --signing FILE`)"
    )
