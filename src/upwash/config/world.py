"""What is true of a simulated world, and what goes wrong in it: the tables that only simulations read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal

from msgspec import Meta, Struct

from upwash.config import values
from upwash.core.geo import Circle, Position

Level = Annotated[float, Meta(ge=0, lt=100, description="a number from 0 to below 100, in percent")]
ShiftInMetres = Annotated[
    tuple[float, float, float], Meta(description="three numbers [east, north, up] in metres")
]
Lie = Literal["elsewhere", "unwanted", "oversized", "lease", "types", "faults", "control"]
FaultKind = Literal[
    "off", "stuck", "slow", "garbage", "wrong", "lying", "flapping", "full", "crash",
    "power-cut", "hung", "poisoned", "unstartable",
    "pilot", "fail-safe", "diverted", "home", "jump", "restart", "impostor",
    "hovers", "rally", "battery", "files", "threads", "memory", "disk",
]  # fmt: skip
RADIOS = ("fixed", "disc54", "disc12")  # or a csv file of goodput by distance


class TruthConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is true of a simulated server; what is left out is as believed."""

    join_s: values.NotNegative | None = None
    """Joining its network, in seconds; default: `check_running_s`."""
    leave_s: values.NotNegative = 0.0
    """Leaving its network, in seconds: meanwhile the radio joins no other."""
    start_s: values.NotNegative | None = None
    """Starting a service, in seconds; default: `check_s` less `check_running_s`."""
    processing_s: values.SecondsByService = {}
    """The part of `remote_call_s` that keeps an instance busy, in seconds; default: all of it."""
    remote_call_s: values.SecondsByService = {}
    """A call, in seconds."""
    first_extra_s: values.NotNegative = 0.0
    """How much longer the first call after a start takes, in seconds."""
    range_m: values.Positive | None = None
    """The true range, in metres; default: as believed, or everywhere if that is `"measured"`."""
    radio: values.Text = "fixed"
    """Goodput by distance: `fixed`, `disc54`, `disc12` or a csv file."""
    goodput_csv: values.FilePath | None = None
    """Measured goodput, in place of `radio`: [traces](scenarios.md#measured-traces)."""
    service_csv: values.FilePath | None = None
    """Measured times of computing, in place of `processing_s`: [traces](scenarios.md#measured-traces)."""
    slots: values.Slots = "auto"
    """Drones that the server serves at a time."""
    lanes: values.Count | None = None
    """Calls that an instance computes at a time; default: as its service declares."""
    turn_s: values.TurnSeconds | None = None
    """The shortest time that a drone keeps its slot while others wait, in seconds."""
    images: values.Names | None = None
    """The services that it can start; default: all."""
    peers: values.Names = ()
    """Servers that this server can announce a drone to."""


class EventAreaConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Simulation: a circle with a share of demanding answers of its own."""

    east_m: float
    """Its centre, in metres east of home."""
    north_m: float
    """Its centre, in metres north of home."""
    radius_m: values.Positive
    """Its radius, in metres."""
    probability: values.Fraction
    """The probability at each waypoint in it."""

    @property
    def circle(self) -> Circle:
        """The area."""
        return Circle(Position(self.east_m, self.north_m), self.radius_m)


class ObjectConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Simulation: an object on the ground, which photos show where it lies."""

    label: values.Text
    """What it is."""
    east_m: float
    """Its place, in metres east of home."""
    north_m: float
    """Its place, in metres north of home."""


class EventConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Simulation: the waypoints whose answers demand an action."""

    every: values.Count | None = None
    """At the waypoints i with `i % every == offset`."""
    offset: values.CountFromZero = 0
    """See `every`."""
    probability: values.Fraction | None = None
    """At each waypoint with this probability, in place of `every`."""
    areas: Annotated[tuple[EventAreaConfig, ...], Meta(description="tables, each a circle")] = ()
    """Circles with a probability of their own; in several at the same time, the first counts."""
    objects: Annotated[tuple[ObjectConfig, ...], Meta(description="tables, each an object")] = ()
    """Objects on level ground, in place of `every` and `probability`. The camera looks straight down, north up, and
    each photo has an error of its own, as GPS has one."""
    missed: values.SharesByKey = {}
    """The share of these waypoints where calls see nothing: [two answers](calls.md#two-answers)."""
    false_alarms: values.SharesByKey = {}
    """The share of other waypoints where calls demand an action too."""

    def mistakes(self, *, demands: bool) -> Mapping[str, float]:
        """The chance of a mistake by profile key, at a waypoint whose answer `demands` an action, or at another."""
        return self.missed if demands else self.false_alarms

    def chance(self, place: Position) -> float:
        """The probability of a demand at a place, where no waypoint is counted."""
        around = (area for area in self.areas if area.circle.contains(place))
        area = next(around, None)
        return (self.probability if area is None else area.probability) or 0.0

    def __post_init__(self) -> None:
        if self.areas and self.probability is None:
            raise ValueError("areas go with a probability outside them: give it, in place of every")
        if [self.every is None, self.probability is None, not self.objects].count(False) != 1:
            raise ValueError("give one of every (with an offset), probability and objects")
        if self.every is not None and self.offset >= self.every:
            raise ValueError(
                f"offset is {self.offset}, and every {self.every}: give one from 0 to {self.every - 1}"
            )


class EnergyConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the simulated drone draws from its battery: [the model](scenarios.md#energy)."""

    battery_wh: values.Positive | None = None
    """The energy of a full battery, in watt-hours; default: endless."""
    failsafe_percent: Level = 5.0
    """The level at which the vehicle lands by itself; 0: never."""
    hover_w: values.Positive = 168.5
    """The power of the rotors in hover, in watts."""
    blade_share: values.Fraction = 0.474
    """The share of `hover_w` that overcomes the drag of the blades."""
    tip_speed_m_s: values.Positive = 120.0
    """The speed of the blades' tips, in metres per second."""
    induced_speed_m_s: values.Positive = 4.03
    """The speed of the air below the rotors in hover, in metres per second."""
    drag_at_10_m_s_w: values.NotNegative = 9.24
    """The power that the air's resistance adds at 10 m/s, in watts."""
    computer_idle_w: values.NotNegative = 2.7
    """The power of the computer without a call, in watts."""
    computer_load_w: values.NotNegative | None = None
    """The power that a call adds, in watts; default: 4, or `heat.load_w`."""
    radio_idle_w: values.NotNegative = 0.8
    """The power of each radio, in watts."""
    radio_transfer_w: values.NotNegative = 0.5
    """The power that a transfer adds, in watts."""


class NoiseConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Simulation: relative standard deviations of times; without them every seed gives the same run."""

    call: values.NotNegative = 0.0
    """Noise on the delays of calls."""
    leg: values.NotNegative = 0.0
    """Noise on the durations of legs."""
    join: values.NotNegative = 0.0
    """Noise on the durations of joins."""
    start: values.NotNegative = 0.0
    """Noise on the starts of services."""


class FaultConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Simulation: a disturbance that lasts for a while: [faults](faults.md)."""

    target: values.Text
    """A server's name, `link:` and a server's name, `autopilot`, or `computer`: the drone's."""
    kind: FaultKind
    """The kind of the fault."""
    lie: Lie = "elsewhere"
    """The subject of the lies of a server that is `lying`."""
    from_s: values.NotNegative = 0.0
    """When it begins, in seconds."""
    to_s: values.NotNegative = math.inf
    """When it ends, in seconds."""
    extra_s: values.NotNegative = 5.0
    """The extra time of each answer or leg while the target is `slow`, in seconds."""
    lasts_s: values.Positive = 300.0
    """How long the second battery of the fault `battery` lasts in flight, in seconds."""
    moved_m: ShiftInMetres = (40.0, 30.0, 0.0)
    """The way of `diverted`, `home` and `jump`, and from the start to a `rally` point: metres east, north and up."""
