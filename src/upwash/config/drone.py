"""The drone's configuration, which is also a simulated scenario: that plus what is true in the world."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta, Struct

from upwash.config.values import (
    Bytes,
    Count,
    CountFromZero,
    FilePath,
    FlightOrder,
    Fraction,
    GridCount,
    ImportPath,
    InterfaceName,
    KeysByKey,
    KeysConfig,
    Latitude,
    Longitude,
    MessageBytes,
    Name,
    Names,
    NotNegative,
    Percent,
    PlanPath,
    Positive,
    Quantile,
    SecondsByKey,
    SecondsByService,
    SecondsOfEachKey,
    Seed,
    Settings,
    Share,
    SharesByKey,
    Slots,
    Text,
    TurnSeconds,
    VideoSource,
    is_on_this_machine,
)

Pause = Annotated[float, Meta(ge=0.2, le=60, description="a number from 0.2 to 60, in seconds")]
AtLeastOneSecond = Annotated[float, Meta(ge=1, description="a number of at least 1, in seconds")]
DeadManSilence = Annotated[float, Meta(ge=5, le=600, description="a number from 5 to 600, in seconds")]
Level = Annotated[float, Meta(ge=0, lt=100, description="a number from 0 to below 100, in percent")]
PairInMetres = Annotated[tuple[float, float], Meta(description="a pair [east, north] in metres")]
PlacesInMetres = Annotated[
    tuple[PairInMetres, ...],
    Meta(min_length=1, description="pairs [east, north] in metres, at least one"),
]
SecondOfADay = Annotated[float, Meta(ge=0, le=86_400, description="a number from 0 to 86400, in seconds")]
Radios = Annotated[int, Meta(ge=1, le=2, description="1 or 2")]
PolicyName = Literal["local-only", "opportunistic", "location-aware", "look-ahead"]
SafeEnd = Literal["return", "hold", "land"]
Lie = Literal["elsewhere", "unwanted", "oversized", "lease", "types", "faults", "control"]
Corner = Literal["top-left", "top-right", "bottom-left", "bottom-right"]
RADIOS = ("fixed", "disc54", "disc12")  # or a csv file of goodput by distance


class HomeConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The place on the Earth where east and north are 0."""

    latitude_deg: Latitude
    longitude_deg: Longitude


class GridConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Waypoints in rows, the bottom-left one at home, flown row by row from one corner."""

    columns: GridCount
    rows: GridCount
    spacing_m: Positive
    start: Corner = "top-left"
    rows_alternate: bool = True


class MissionConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is flown: a program (bundled, or `/a/file.py:function`) over a grid, a list of waypoints or a plan.

    What an answer demands at its waypoint takes the bundled program `action_s`.
    They are flown in the given `order`, in that of one of their sweeps, or in the one that is best by forecast.
    The drone ends the mission early below `reserve_percent` of its battery, and where the way home would leave less
    than `reserve_s` seconds of flight. Where it would not be over `finish_by_s` after arming, calls run under the
    profile key that `lighter` has for theirs.
    """

    program: Text = "survey"
    mode: Text = "heavy"
    altitude_m: Positive = 20.0
    ground_speed_m_s: Positive = 4.0
    home: HomeConfig | None = None
    grid: GridConfig | None = None
    waypoints_m: PlacesInMetres | None = None
    plan: PlanPath | None = None
    action_s: NotNegative = 0.0
    order: FlightOrder = "given"
    reserve_percent: Percent | None = None
    reserve_s: NotNegative | None = None
    finish_by_s: Positive | None = None
    lighter: KeysByKey = {}


class VehicleConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the simulated vehicle flies: as these numbers say, or as a measured profile.

    Its battery is empty `endurance_s` after take-off; without that it reports none. A real one's battery is not
    believed to last longer either.
    """

    profile: Literal["arducopter", "px4"] | None = None
    acceleration_m_s2: Positive = 1.0
    takeoff_s: NotNegative = 10.0
    return_and_land_s: NotNegative = 16.0
    endurance_s: Positive | None = None


class AutopilotConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How a real vehicle is reached, a MAVLink connection string, and what it does when the mission fails.

    A mission is refused that begins more than `farthest_start_m` from where the vehicle stands, and goes on after a
    silence of the vehicle's link of at most `link_patience_s`. With `dead_man_s` the autopilot itself does what
    `on_failure` says once it has not heard this program for so long. With the key in `signing_key` all messages are
    signed, both ways, and no other is believed.
    """

    connection: Text | None = None
    signing_key: FilePath | None = None
    on_failure: SafeEnd = "return"
    farthest_start_m: Positive = 500.0
    link_patience_s: Positive = 120.0
    dead_man_s: DeadManSilence | None = None
    arrival_distance_m: Positive = 1.0
    arrival_speed_m_s: Positive = 0.5


class NetworkConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How servers' networks are joined: not at all, by NetworkManager, or modelled by the drone's position.

    Without joining, servers are reached over whatever network the computer has; a simulation models joining always.
    NetworkManager joins them on these interfaces, and on no other. With two radios, which have an interface each, the
    next server is checked while the one before is still used.
    """

    kind: Literal["stand-in", "wired", "networkmanager"] = "wired"
    interfaces: Annotated[tuple[InterfaceName, ...], Meta(description="an array of interfaces")] = ()
    radios: Radios = 1


class CameraConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where photos come from, one of three, and how long one takes.

    They are the files of a folder, a video device's (its number, or a URL), or rendered from a solar park's seed.
    """

    photo_s: NotNegative = 1.0
    folder: FilePath | None = None
    device: VideoSource | None = None
    park_seed: Seed | None = None


_LEFT_ALONE_S = 60.0


class HedgeConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When the drone's own service starts on a remote call that is late, and the share of extra work it may do."""

    after: Quantile = "p95"
    budget: Share = 0.1

    @property
    def quantile(self) -> float:
        """`after` as a fraction."""
        return int(self.after[1:]) / 100


class ProbeConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The pauses between questions to a server that failed: the first one, and the longest."""

    first_s: Pause = 0.5
    longest_s: Pause = 1.0

    def __post_init__(self) -> None:
        if self.first_s > self.longest_s:
            raise ValueError(f"first_s is {self.first_s}, and longest_s only {self.longest_s}: pauses grow")


class PolicyConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When to offload, and where to.

    A server that fails is left alone for `blacklist_s`, or probed; where neither key is given look-ahead probes, and
    the thesis's policies leave it alone for 60 s. Where `hedge` is not given look-ahead hedges, and they do not.
    """

    name: PolicyName = "look-ahead"
    gain_switch: Fraction = 0.25
    gain_wait: Fraction = 0.25
    gain_slot: Fraction = 0.25
    period_s: Positive = 1.0
    blacklist_s: AtLeastOneSecond | None = None
    probe: ProbeConfig | None = None
    idle_s: NotNegative = 180.0
    retry_s: NotNegative = 300.0
    patient_first_call: bool = False
    hedge: HedgeConfig | bool | None = None
    stay_or_go: Literal["stay", "go", "learn"] = "stay"

    def __post_init__(self) -> None:
        if self.blacklist_s is not None and self.probe is not None:
            raise ValueError(
                "blacklist_s leaves a server that failed alone, and probe asks it again: give one of them"
            )

    @property
    def probing(self) -> ProbeConfig | None:
        """How a server that failed is probed; None where it is left alone for `left_alone_s`."""
        if self.blacklist_s is not None:
            return None
        return self.probe or (ProbeConfig() if self.name == "look-ahead" else None)

    @property
    def left_alone_s(self) -> float:
        """For how long a server that failed is left alone where it is not probed: 60 s, as in the thesis."""
        return _LEFT_ALONE_S if self.blacklist_s is None else self.blacklist_s

    @property
    def hedging(self) -> HedgeConfig | None:
        """How calls are hedged, where they are."""
        if isinstance(self.hedge, HedgeConfig):
            return self.hedge
        wanted = self.name == "look-ahead" if self.hedge is None else self.hedge
        return HedgeConfig() if wanted else None


class ServiceConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A service of the mission; a map's key is a profile key, "" for a service without any.

    Without a `program` it is the bundled service of that name. `local_pace_s` is the least time a local
    call takes: on the desk it stands in for the drone's slower computer. `local_joining_slowdown` is by what share
    simulated local calls are slower while a network is being joined. `settings` is what its constructor gets.
    """

    name: Name
    program: ImportPath | None = None
    request_bytes: Bytes = 425_000
    reply_bytes: Bytes = 500
    local_call_s: SecondsOfEachKey
    local_first_extra_s: NotNegative = 0.0
    local_pace_s: SecondsByKey = {}
    local_joining_slowdown: SharesByKey = {}
    settings: Settings | None = None


class TruthConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the file says is true of a simulated server; see `server_truth` for what it leaves out."""

    join_s: NotNegative | None = None
    leave_s: NotNegative = 0.0
    start_s: NotNegative | None = None
    processing_s: SecondsByService = {}
    remote_call_s: SecondsByService = {}
    first_extra_s: NotNegative = 0.0
    radio: Text = "fixed"
    slots: Slots = "auto"
    lanes: Count | None = None
    turn_s: TurnSeconds | None = None
    images: Names | None = None
    peers: Names = ()


class ServerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the drone believes of a server before it has met it; times by service and profile key."""

    name: Name
    east_m: float | None = None
    north_m: float | None = None
    latitude_deg: Latitude | None = None
    longitude_deg: Longitude | None = None
    range_m: Positive
    network: Text
    address: Text | None = None
    bandwidth_bit_s: Positive | None = None
    check_s: NotNegative = 11.5
    check_running_s: NotNegative = 3.5
    processing_s: SecondsByService = {}
    remote_call_s: SecondsByService = {}
    truth: TruthConfig = TruthConfig()


class EventConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """At which waypoints of a simulation an answer demands something: regularly, or each with a probability.

    Regularly these are the waypoints i with `i % every == offset`.
    """

    every: Count | None = None
    offset: CountFromZero = 0
    probability: Fraction | None = None

    def __post_init__(self) -> None:
        if (self.every is None) == (self.probability is None):
            raise ValueError("give one of every (with an offset) and probability")
        if self.every is not None and self.offset >= self.every:
            raise ValueError(
                f"offset is {self.offset}, and every {self.every}: give one from 0 to {self.every - 1}"
            )


class HeatConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the drone's computer gets hot: the air around it, and the power that a call adds."""

    ambient_c: float = 44.0
    load_w: NotNegative = 4.0


class EnergyConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the simulated drone draws, and how much its battery holds; `sim.energy` has the model and its sources.

    Hovering takes `hover_w`, of which the blades' own drag is `blade_share` and the rest holds the drone up;
    `drag_at_10_m_s_w` is what the air's resistance adds at 10 m/s. A computer draws `computer_idle_w`, and
    `computer_load_w` more in a call: by default 4 W, or what `[heat]` says. Each radio draws `radio_idle_w`, and
    `radio_transfer_w` more while it transfers. The battery is full at the start, and endless without `battery_wh`. At
    `failsafe_percent` the vehicle lands by itself where it is (0: it does not), and with an empty one it falls.
    """

    battery_wh: Positive | None = None
    failsafe_percent: Level = 5.0
    hover_w: Positive = 168.5
    blade_share: Fraction = 0.474
    tip_speed_m_s: Positive = 120.0
    induced_speed_m_s: Positive = 4.03
    drag_at_10_m_s_w: NotNegative = 9.24
    computer_idle_w: NotNegative = 2.7
    computer_load_w: NotNegative | None = None
    radio_idle_w: NotNegative = 0.8
    radio_transfer_w: NotNegative = 0.5


class NoiseConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Relative standard deviations of simulated times."""

    call: NotNegative = 0.0
    leg: NotNegative = 0.0
    join: NotNegative = 0.0
    start: NotNegative = 0.0


class FaultConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Something that goes wrong for a while: at a server, at a link ("link:s1") or at the autopilot.

    `lie` is what a server that is "lying" lies about.
    """

    target: Text
    kind: Literal[
        "off", "stuck", "slow", "garbage", "wrong", "lying", "flapping", "full", "crash", "pilot", "fail-safe"
    ]
    lie: Lie = "elsewhere"
    from_s: NotNegative = 0.0
    to_s: NotNegative = math.inf
    extra_s: NotNegative = 5.0


class FleetDroneConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of several drones of a simulated world; what it leaves out is as the file says for all of them.

    It departs and vanishes at these seconds of the simulation: from `vanishes_s` on its computer is gone. What its
    own computer needs for a call is by service and profile key.
    """

    name: Name
    departs_s: SecondOfADay = 0.0
    vanishes_s: Positive | None = None
    grid: GridConfig | None = None
    waypoints_m: PlacesInMetres | None = None
    plan: PlanPath | None = None
    local_call_s: SecondsByService = {}
    policy: PolicyName | None = None


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

    name: Name = "drone"
    seed: int = 1
    metrics: Text | None = None
    max_message_bytes: MessageBytes = 16_777_216
    mission: MissionConfig
    vehicle: VehicleConfig = VehicleConfig()
    autopilot: AutopilotConfig = AutopilotConfig()
    network: NetworkConfig = NetworkConfig()
    keys: KeysConfig | None = None
    camera: CameraConfig = CameraConfig()
    policy: PolicyConfig = PolicyConfig()
    services: Annotated[
        tuple[ServiceConfig, ...], Meta(description="tables that each begin with [[service]]")
    ] = ()
    servers: Annotated[
        tuple[ServerConfig, ...], Meta(description="tables that each begin with [[server]]")
    ] = ()
    heat: HeatConfig | None = None
    energy: EnergyConfig | None = None
    event: EventConfig | None = None
    noise: NoiseConfig = NoiseConfig()
    faults: Annotated[tuple[FaultConfig, ...], Meta(description="tables that each begin with [[fault]]")] = ()
    drones: Annotated[
        tuple[FleetDroneConfig, ...], Meta(description="tables that each begin with [[drone]]")
    ] = ()


def unsigned_port(autopilot: AutopilotConfig) -> str:
    """What anyone can do who reaches the port that the vehicle's messages come to; "" where that is nobody."""
    kind, _, place = (autopilot.connection or "").partition(":")
    if kind != "udpin" or autopilot.signing_key is not None or is_on_this_machine(place):
        return ""
    return (
        f"autopilot.connection = {autopilot.connection} listens to networks, and messages are not signed: who sends "
        "there before the vehicle does, or with its address, is taken for it. Listen on 127.0.0.1, or sign "
        "(autopilot.signing_key, made by `upwash keys --signing FILE`)"
    )
