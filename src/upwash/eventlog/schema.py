"""The events of the log, each with its fields; on disk an event is one JSON object a line.

An event's name there is its class's in snake case, `t` its time in seconds since the log was opened. Positions are
relative to the mission's home. `VERSION` goes up with each change that the version before could not read: an event
that is new, a field that is renamed or that has no default. docs/event-log.md is made from this module.
"""

from __future__ import annotations

import functools
import operator
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Annotated, Literal, TypeAlias, TypeVar

import msgspec

from upwash.core.geo import Circle, GeoPosition, Position
from upwash.core.knowledge.coverage import MeasuredPlace
from upwash.core.knowledge.servers import State, Trigger
from upwash.core.selection.places import server_of
from upwash.core.vehicle.control import Owner

VERSION = 5  # of the log; logs of earlier releases have none
SEVERITIES = (
    "emergency",
    "alert",
    "critical",
    "error",
    "warning",
    "notice",
    "info",
    "debug",
)  # MAVLink's, from 0

_UNSTAMPED = float("nan")  # known by its identity: the time of an event that no journal has recorded yet
_Time: TypeAlias = Annotated[datetime, msgspec.Meta(tz=True)]

# A log is anybody's: what is larger than these is in no event, and no reader has to be ready for it.
LONGEST = 1e9  # of times and lengths, in seconds and metres: 31 years
LONGEST_TEXT = 10_000  # characters
MOST_ITEMS = 100_000  # of a list that has an entry for each waypoint or place
MOST_FEW = 1_000  # of any other list
MOST_NAMES = 10_000  # of servers, or operations
Number: TypeAlias = Annotated[float, msgspec.Meta(ge=-LONGEST, le=LONGEST)]
Rate: TypeAlias = Annotated[float, msgspec.Meta(ge=0, le=1e15)]
Parameter: TypeAlias = Annotated[float, msgspec.Meta(ge=-1e39, le=1e39)]  # of MAVLink: of 32 bits
Count: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=10**12)]
Index: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=MOST_ITEMS)]  # of a waypoint, or how many there are
Text: TypeAlias = Annotated[str, msgspec.Meta(max_length=LONGEST_TEXT)]
_Item = TypeVar("_Item")
_Few = Annotated[Sequence[_Item], msgspec.Meta(max_length=MOST_FEW)]
_Many = Annotated[Sequence[_Item], msgspec.Meta(max_length=MOST_ITEMS)]
_ByName = Annotated[Mapping[Text, _Item], msgspec.Meta(max_length=MOST_NAMES)]
_Map = Annotated[dict[Text, _Item], msgspec.Meta(max_length=MOST_FEW)]
_List = Annotated[list[_Item], msgspec.Meta(max_length=MOST_FEW)]
_Leaf: TypeAlias = bool | int | float | Text | None
_Twig: TypeAlias = _Leaf | _List[_Leaf] | _Map[_Leaf]
Branch: TypeAlias = _Leaf | _List[_Twig] | _Map[_Twig]
Message: TypeAlias = _Leaf | _List[Branch] | _Map[Branch]  # what a mission says: nested no deeper
_SafeEndAction: TypeAlias = Literal["return", "land", "hold", "disarm"]


def _snake_case(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


class Event(msgspec.Struct, frozen=True, kw_only=True, tag_field="event", tag=_snake_case):
    """Something that happened, at the second `t` of its log; docs/event-log.md has the fields of each kind.

    Whoever makes one leaves the time to the journal that records it.
    """

    t: Number = _UNSTAMPED

    @property
    def kind(self) -> str:
        """The event's name in the log."""
        return kind_of(type(self))

    @property
    def is_stamped(self) -> bool:
        """Whether it has a time."""
        return self.t is not _UNSTAMPED


def kind_of(event: type[Event]) -> str:
    """The name of such events in the log."""
    return str(event.__struct_config__.tag)


# --- the log ------------------------------------------------------------------------------------------------


class LogOpened(Event, frozen=True, kw_only=True):
    """The log of a flight begins, at that time of day; `version` is the version of this table."""

    time: _Time
    version: Count = 0


class LogResumed(Event, frozen=True, kw_only=True):
    """`--resume` took the flight up, at that time of day."""

    time: _Time
    version: Count = 0


class Simulated(Event, frozen=True, kw_only=True):
    """First line of `upwash simulate --log`: the scenario's file and the seed."""

    scenario: Text
    seed: int
    version: Count = 0


class EventsLost(Event, frozen=True, kw_only=True):
    """So many events could be kept neither on the disk, which was full, nor in memory."""

    count: Count


class Shortened(Event, frozen=True, kw_only=True):
    """An event of the kind `of` did not fit into the log, and why: a part of it stands before this, or nothing."""

    of: Text
    why: Text


# --- the mission --------------------------------------------------------------------------------------------


class Measured(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What is known of a server at a place: how often it was asked something there, and how often it answered.

    A call of each operation comes to `call_s`, with the drone's own computing where it was in vain. `goodput_bit_s`
    is that of the answered calls, computing included. The last time was so many flights ago.
    """

    east_m: Number
    north_m: Number
    tried: Count
    answered: Count
    call_s: _ByName[Number] = {}
    goodput_bit_s: Rate | None = None
    flights_ago: Count = 0

    @classmethod
    def of(cls, place: MeasuredPlace) -> Measured:
        """The place as the map has it."""
        goodput_bit_s = place.goodput_bit_s
        return cls(
            east_m=round(place.position.east_m, 1),
            north_m=round(place.position.north_m, 1),
            tried=place.tried,
            answered=place.answered,
            call_s={
                str(operation): round(call_s, 3)
                for operation in place.came_to_s
                if (call_s := place.call_s(operation)) is not None
            },
            goodput_bit_s=None if goodput_bit_s is None else round(goodput_bit_s),
            flights_ago=place.flights_ago,
        )


class Planned(Event, frozen=True, kw_only=True):
    """Home, the waypoints in metres east and north of it, the ranges of the servers, and whether calls are paced.

    The waypoints' altitudes are above home, and absent in logs that were written before there were any.
    With `mission.order`, the indices of the waypoints in the `order` in which they are flown, and why in that one.
    Of servers without a range, what earlier flights have `measured`.
    """

    home: GeoPosition | None = None
    waypoints_m: _Many[tuple[Number, Number]] = []
    altitudes_m: _Many[Number] = []
    ranges: _ByName[Circle] = {}
    paced: bool = False
    order: _Many[Index] = []
    order_why: Text = ""
    measured: _ByName[_Many[Measured]] = {}

    @property
    def has_servers(self) -> bool:
        """Whether there is any server that calls could run on."""
        return bool(self.ranges or self.measured)

    @property
    def way_m(self) -> Sequence[tuple[float, float]]:
        """The waypoints in the order in which they are flown."""
        return [self.waypoints_m[index] for index in self._flown_order]

    @property
    def way_altitudes_m(self) -> Sequence[float]:
        """Their altitudes in that order; empty where they are not known."""
        if len(self.altitudes_m) != len(self.waypoints_m):
            return ()
        return [self.altitudes_m[index] for index in self._flown_order]

    @property
    def _flown_order(self) -> Sequence[int]:
        given = range(len(self.waypoints_m))
        return self.order if sorted(self.order) == list(given) else given  # else none was asked for


class MissionStarted(Event, frozen=True, kw_only=True):
    """The drone, the policy, how many waypoints are planned, and those that were `done` when a flight is taken up."""

    drone: Text = ""
    policy: Text
    waypoints: Index = 0
    done: _Many[Index] = []


class Foreseen(Event, frozen=True, kw_only=True, omit_defaults=True):
    """When the mission was expected to be over before it took off, and at each waypoint of its order: `reached_s`.

    Where it is to finish by a given time, `lightest_s` is when it is over with every call lighter. All are seconds of
    the mission's time.
    """

    as_asked_s: Number
    lightest_s: Number | None = None
    finish_by_s: Number | None = None
    reached_s: _Many[Number] = []

    @property
    def fits(self) -> bool:
        """Whether it can be over in time."""
        return self.finish_by_s is None or (self.lightest_s or self.as_asked_s) <= self.finish_by_s


class MissionCompleted(Event, frozen=True, kw_only=True):
    """The mission was flown to its end, and every server left."""


class MissionEnded(Event, frozen=True, kw_only=True):
    """The mission ended early, and why."""

    why: Text


class Stopping(Event, frozen=True, kw_only=True):
    """The mission is to end early: by Ctrl-C, SIGTERM or the reserve."""

    why: Text


class Leg(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The drone sets off for a place; `waypoint` is its index, null for a place beside the plan.

    `back` where it comes back to a waypoint whose answer demands something, or whose call failed.
    """

    waypoint: Index | None
    east_m: Number
    north_m: Number
    back: bool = False


class Arrived(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The drone has arrived at the place that it set off for; there it first hovers for the plan's `hold_s`."""

    waypoint: Index | None
    east_m: Number
    north_m: Number
    hold_s: Number = 0.0


class Photo(Event, frozen=True, kw_only=True, omit_defaults=True):
    """A photo: its source, size in bytes, age when the mission got it, place, and its truth if it was rendered.

    Its place on the Earth in degrees (WGS 84), and above the sea, are absent where they were not known.
    """

    source: Text
    bytes: Count
    age_s: Number
    position: Position
    latitude_deg: Number | None = None
    longitude_deg: Number | None = None
    above_sea_m: Number | None = None
    truth: _Few[Branch] | None = None


class CallStarted(Event, frozen=True, kw_only=True):
    """The mission began a call at the waypoint, without waiting; its `call` event comes when it is over."""

    operation: Text
    waypoint: Index | None


class StayOrGo(Event, frozen=True, kw_only=True):
    """Whether the drone goes on before the answer of the waypoint is there, and why.

    `chance` is how likely an answer demands something, by the last ones. Going saves `saved_s` where it demands
    nothing, and loses `lost_s` where it does; null where nothing was reckoned.
    """

    waypoint: Index | None
    goes: bool
    why: Text
    chance: Number
    saved_s: Number | None = None
    lost_s: Number | None = None


class Demanded(Event, frozen=True, kw_only=True, omit_defaults=True):
    """An answer that arrived on the way has a demand at that waypoint, or the call `failed`, with the reason."""

    waypoint: Index | None
    failed: Text = ""


class TurnedBack(Event, frozen=True, kw_only=True):
    """An answer demands something at a waypoint that the drone has left, or its call failed: it flies back."""

    waypoint: Index | None
    position: Position


class AnswerTaken(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The mission has the answer of a waypoint, for which it `waited_s`; `failed` says why there is none.

    `demanded` says whether it demands something there.
    """

    waypoint: Index | None
    waited_s: Number
    demanded: bool = False
    failed: Text = ""


class Acted(Event, frozen=True, kw_only=True):
    """What an answer demanded at the waypoint is done."""

    waypoint: Index | None


class Notified(Event, frozen=True, kw_only=True):
    """What the user was told, and of which place."""

    message: Message
    at: Position


# --- the vehicle --------------------------------------------------------------------------------------------


class Control(Event, frozen=True, kw_only=True):
    """Who has the vehicle from now on (`program`, `pilot`, `fail-safe`, `unknown`), and why."""

    owner: Owner
    why: Text


class UnsignedPort(Event, frozen=True, kw_only=True):
    """Anyone who reaches the drone's `udpin` port can pose as the vehicle.

    See [signed messages](vehicle.md#signed-messages).
    """

    why: Text


class WaitingForVehicle(Event, frozen=True, kw_only=True):
    """The vehicle has not been heard for so long, and why; it is waited for within so many seconds in all."""

    why: Text
    waited_s: Number
    within_s: Number


class VehicleFound(Event, frozen=True, kw_only=True):
    """The vehicle that is followed from now on: its MAVLink ids, its firmware, and its type, such as `quadrotor`.

    `version` is the firmware's, null if the vehicle does not tell it.
    """

    system: Count
    component: Count
    firmware: Text
    type: Text
    version: Text | None = None


class LinkLost(Event, frozen=True, kw_only=True):
    """Nothing has been heard of the vehicle for so long."""

    silent_s: Number


class LinkRestored(Event, frozen=True, kw_only=True):
    """The vehicle is heard again, after so long."""

    silent_s: Number


class PositionDoubted(Event, frozen=True, kw_only=True):
    """The vehicle cannot be where it reports: its position jumped that far; 0 once it can be there again."""

    jumped_m: Number


class HomeMoved(Event, frozen=True, kw_only=True):
    """The vehicle's home was moved in the flight; `altitude_m` is above the ground below the take-off."""

    east_m: Number
    north_m: Number
    altitude_m: Number


LinkTroubleName: TypeAlias = Literal[
    "another-vehicle",
    "same-id",
    "another-program",
    "numbers",
    "rates",
    "capacity",
    "out-of-range",
    "defect",
    "flood",
]


class LinkTrouble(Event, frozen=True, kw_only=True):
    """What is wrong with the vehicle's link, or who else is on it; once for each, or at each tenfold."""

    about: LinkTroubleName
    why: Text


class VehicleSaid(Event, frozen=True, kw_only=True):
    """The vehicle's own words and their severity, 0 (emergency) to 7 (debug)."""

    severity: Annotated[int, msgspec.Meta(ge=0, lt=len(SEVERITIES))]
    text: Text


class VehicleSetting(Event, frozen=True, kw_only=True):
    """A parameter of the vehicle that the user should know before the flight, and why; null: it is not known."""

    name: Text
    value: Parameter | None
    advice: Text


class ArmingDelayed(Event, frozen=True, kw_only=True):
    """Why the vehicle cannot be armed yet, in its words, each time that changes."""

    reasons: _Few[Text]


class VehicleLimits(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The vehicle's home, the altitudes between which it may fly, and its fences by name, as read before arming."""

    home: Position | None
    highest_m: Number | None
    fences: _Few[Text]
    lowest_m: Number | None = None
    home_above_sea_m: Number | None = None


class SiteDoubt(Event, frozen=True, kw_only=True):
    """What a person should know before arming of where the mission is flown: nothing forbids it."""

    why: Text


class DeadManSet(Event, frozen=True, kw_only=True):
    """After how long a silence of the program the autopilot will do what."""

    silence_s: Number
    action: Literal["return", "land"]


class DeadManFailed(Event, frozen=True, kw_only=True):
    """Why the autopilot will not miss the program, where the flight was in the air already."""

    why: Text


class _AtPlace(Event, frozen=True, kw_only=True, omit_defaults=True):
    position: Position | None = None


class Arming(Event, frozen=True, kw_only=True):
    """The vehicle can be armed, and is told to start its motors."""


class Armed(_AtPlace, frozen=True, kw_only=True):
    """The motors run."""


class TakingOff(Event, frozen=True, kw_only=True):
    """The vehicle is told to climb to the altitude above home."""

    altitude_m: Number


class TookOff(_AtPlace, frozen=True, kw_only=True):
    """The vehicle has climbed to the altitude above home."""

    altitude_m: Number


class Holding(_AtPlace, frozen=True, kw_only=True):
    """The vehicle hovers, as the mission said."""


class Turned(Event, frozen=True, kw_only=True):
    """The vehicle's nose points there, clockwise from north, as the mission said; until the next leg."""

    heading_deg: Number


class PayloadCommanded(Event, frozen=True, kw_only=True):
    """The vehicle has accepted a MAVLink command of what it carries; null: a parameter that is left open."""

    number: Count
    name: Text
    parameters: _Few[Parameter | None]


class TextSent(Event, frozen=True, kw_only=True):
    """The mission's own words to whoever listens to the vehicle; severity as of `vehicle_said`."""

    severity: Annotated[int, msgspec.Meta(ge=0, lt=len(SEVERITIES))]
    text: Text


class Returning(_AtPlace, frozen=True, kw_only=True):
    """The mission has the vehicle return home and land."""


class Landing(_AtPlace, frozen=True, kw_only=True):
    """The mission has the vehicle land where it is."""


class Landed(_AtPlace, frozen=True, kw_only=True):
    """The vehicle is on the ground; without a position as a safe end."""


class Disarmed(_AtPlace, frozen=True, kw_only=True):
    """The motors stand; without a position as a safe end."""


class SafeEnd(Event, frozen=True, kw_only=True):
    """What is done to end a flight that cannot go on, and why it cannot."""

    action: _SafeEndAction
    why: Text


class SafeEndFailed(Event, frozen=True, kw_only=True):
    """The vehicle did not do it, and why; it is told again."""

    action: _SafeEndAction
    why: Text


class LeftHovering(Event, frozen=True, kw_only=True):
    """The vehicle hovers as a safe end, and nobody flies it."""


class LeftToPilot(Event, frozen=True, kw_only=True):
    """The program sends the vehicle nothing any more, and why."""

    why: Text


class Stood(Event, frozen=True, kw_only=True):
    """The vehicle, which was not the program's any more, stands."""

    position: Position


class FollowingEnded(Event, frozen=True, kw_only=True):
    """Why the log of a vehicle that was not the program's any more ends before it stands."""

    why: Text


class CoverageNotKept(Event, frozen=True, kw_only=True):
    """The coverage map could not be written: what this flight measured is in its log only."""

    why: Text


class BorderWatchFailed(Event, frozen=True, kw_only=True):
    """The vehicle is silent: until it is heard again, ranges are looked at once a period only."""

    why: Text


class Energy(Event, frozen=True, kw_only=True):
    """With `reserve_s`: the battery, its loss a second, the time to the landing, and what that needs and leaves.

    The landing is at home, or where the vehicle is with `on_failure = "land"`.

    Written when it is first known, after a change of the margin by more than 3 %, and each minute. `guessed` lists
    the vehicle's parameters that are not known; a usual value stands for each.
    """

    left_percent: Number
    rate_percent_s: Number
    home_s: Number
    needed_percent: Number
    floor_percent: Number
    margin_percent: Number
    guessed: _Few[Text] = []


class EnergyUsed(Event, frozen=True, kw_only=True, omit_defaults=True):
    """As a simulated mission with `[energy]` ends: what it has drawn, by part, and what the battery held when full.

    `flight_wh` is of the rotors while the drone moves, `hover_wh` while it rests in the air.
    """

    flight_wh: Number
    hover_wh: Number
    computing_wh: Number
    radio_wh: Number
    battery_wh: Number | None = None

    @property
    def total_wh(self) -> float:
        """Of all parts."""
        return round(self.flight_wh + self.hover_wh + self.computing_wh + self.radio_wh, 6)


class BatteryWatchFailed(Event, frozen=True, kw_only=True, omit_defaults=True):
    """No reserve is watched: the vehicle does not report its battery, or a defect has ended the watch.

    A defect ends the mission as the reserve does; its `trace` is for a bug report.
    """

    why: Text
    trace: Text = ""


class PositionReport(Event, frozen=True, kw_only=True, omit_defaults=True, tag="position", gc=False):
    """Where the drone is, every second (real flights), with what is known of its motion, battery and link.

    The heading is that of its nose, clockwise from north; `round_trip_s` is what the last question to the daemon of
    the `server` in use took. While the program brings it down, it is on the ground in `down_s`.
    """

    east_m: Number
    north_m: Number
    altitude_m: Number
    ground_speed_m_s: Number | None = None
    heading_deg: Number | None = None
    battery_percent: Number | None = None
    server: Text | None = None
    round_trip_s: Number | None = None
    down_s: Number | None = None


# --- servers ------------------------------------------------------------------------------------------------


class Step(Event, frozen=True, kw_only=True):
    """A server goes from one state into another; `check` numbers the drone's check, or probe, that it belongs to.

    With it the mean delays that are compared to select a server: of calls on the drone, and of those with each server
    that is in range.
    """

    server: Text
    before: State
    after: State
    why: Text = ""
    check: Count = 0
    local_mean_call_s: Number | None = None
    mean_call_s: _ByName[Number | None] = {}
    position: Position | None = None


class Selected(Step, frozen=True, kw_only=True):
    """The server is the one to use from now on, or the next: its check begins, whose number its calls name."""


class FoundStopped(Step, frozen=True, kw_only=True):
    """The daemon answers: it is available, but not all services run."""


class FoundRunning(Step, frozen=True, kw_only=True):
    """The daemon answers: it is available, and all services run."""


class Started(Step, frozen=True, kw_only=True):
    """The services were started, and calls may be sent."""


class CheckFailed(Step, frozen=True, kw_only=True):
    """The server could not be joined, did not answer in time, is unavailable, or could not start a service."""


class Deselected(Step, frozen=True, kw_only=True):
    """The server is left."""


class DeselectedAfterStart(Step, frozen=True, kw_only=True):
    """The server is left while its services are being started."""


class CallFailedInRange(Step, frozen=True, kw_only=True):
    """A call got no usable answer, in the server's range."""


class CallFailedOutOfRange(Step, frozen=True, kw_only=True):
    """A call got no usable answer, as the drone had left the server's range."""


class NetworkLost(Step, frozen=True, kw_only=True):
    """The server's network is no longer connected, though the drone is in range."""


class TurnOver(Step, frozen=True, kw_only=True):
    """The server gave the drone's slot to another drone; it is asked for one again, by a check of a new number."""


class NoSlot(Event, frozen=True, kw_only=True):
    """The server, which is being checked, serves as many drones as it can; so many wait, and the drone asks again."""

    server: Text
    check: Count
    waiting: Count


class LeftOut(Event, frozen=True, kw_only=True):
    """The server leaves a service alone that keeps failing there: the drone leaves the server out for as long."""

    server: str
    check: int
    pause_s: float
    why: str


class ServiceMoved(Event, frozen=True, kw_only=True):
    """The server, which is READY, has the service elsewhere now, as where its daemon was changed: calls go there."""

    server: Text
    check: Count
    service: Text


class PlaceMeasured(Event, frozen=True, kw_only=True):
    """A server without a range was asked something at a place, of which this is known now."""

    server: Text
    place: Measured


class BlacklistExpired(Step, frozen=True, kw_only=True):
    """The server has been left alone for long enough."""


class Probed(Step, frozen=True, kw_only=True):
    """The server, which had failed, gave a sign of life, but not all services run."""


class ProbedRunning(Step, frozen=True, kw_only=True):
    """The server, which had failed, gave a sign of life, and so did its services."""


class IdleExpired(Step, frozen=True, kw_only=True):
    """Unused for long, the services are no longer believed to run."""


class Prepared(Step, frozen=True, kw_only=True):
    """The next server is made ready by the one in use, its peer."""


class NotPrepared(Event, frozen=True, kw_only=True):
    """Why the server `by`, which is in use, does not have its peer `server` prepared."""

    server: Text
    by: Text
    why: Text


class Joined(Event, frozen=True, kw_only=True):
    """The server's network was just joined, for that check."""

    server: Text
    network: Text
    check: Count = 0


class LeftOver(Event, frozen=True, kw_only=True):
    """A network that was found joined, and left."""

    network: Text


class LeaveFailed(Event, frozen=True, kw_only=True):
    """A network that could not be left, and why."""

    network: Text
    why: Text


# --- calls --------------------------------------------------------------------------------------------------


class Decided(Event, frozen=True, kw_only=True, omit_defaults=True):
    """A call's decision: where it is to run, why, and every estimate that this was decided on, as it was then.

    `selected` is the server in use with its state and its `check`; `check_s` is what its check takes, of which
    `check_elapsed_s` are over. A `server` is to answer within `deadline_s`, or is waited for, `at_most_s`; `raced`
    where the drone computes the call too. A second decision follows where a server becomes of use while the drone is
    at the call.
    """

    operation: Text
    decision: Literal["local", "remote", "wait"]
    server: Text | None = None
    deadline_s: Number | None = None
    at_most_s: Number | None = None
    raced: bool = False
    why: Text
    local_s: Number | None
    selected: Text | None
    state: State | None
    check: Count | None = None
    remote_s: Number | None
    check_s: Number | None
    check_elapsed_s: Number | None
    position: Position


class Call(Event, frozen=True, kw_only=True, omit_defaults=True):
    """A call that is over: where it ran, why there, when it began, how long it took, and of that waited and onboard.

    `place` is a server's name, or `local` for the drone; `check` is the number of the server's selection, absent for
    the drone. `wait` is empty, `paid off` or `failed`. `hedged_s` is when the drone's own service started on it too,
    `queued_s` for how long that was busy with an earlier call, and `remote_fault` whether what a server said that it
    raised was `confirmed` or `denied` by the drone's own service. `at_s` is by the program's clock, not the log's.
    `operation` is what ran. Where that is lighter than what was `asked` for, the mission was expected to end at
    `forecast_s` of its time, later than `finish_by_s`.
    """

    operation: Text
    asked: Text = ""
    forecast_s: Number | None = None
    finish_by_s: Number | None = None
    place: Text
    check: Count | None = None
    decision: Text
    at_s: Number
    delay_s: Number
    waited_s: Number
    onboard_s: Number
    wait: Literal["", "paid off", "failed"]
    fell_back: bool
    hedged_s: Number | None = None
    queued_s: Number | None = None
    remote_fault: Literal["", "confirmed", "denied"] = ""

    @property
    def server(self) -> str | None:
        """The server that answered it; None where the drone did."""
        return server_of(self.place)


class Hedged(Event, frozen=True, kw_only=True):
    """The drone's own service starts on a call, after so long, that the server may answer until its new deadline."""

    server: Text
    check: Count = 0
    after_s: Number
    deadline_s: Number


class Dropped(Event, frozen=True, kw_only=True):
    """The answer to a call that came second, and from where."""

    operation: Text
    place: Text

    @property
    def server(self) -> str | None:
        """The server that it came from; None where it was the drone's own."""
        return server_of(self.place)


class RemoteRaised(Event, frozen=True, kw_only=True):
    """What a server says that the service raised in a call, which is then made on the drone."""

    server: Text
    check: Count = 0
    operation: Text
    raised: Text


class RemoteFailed(Event, frozen=True, kw_only=True):
    """A call to a server got no usable answer, or raised there and not on the drone; and why."""

    server: Text
    check: Count = 0
    why: Text


class LocalReady(Event, frozen=True, kw_only=True):
    """The service is ready on the drone."""

    service: Text


class LocalFailed(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The drone's own service failed in a call of the method, or could not be started again."""

    service: Text
    method: Text | None = None
    why: Text


class LocalEnded(Event, frozen=True, kw_only=True):
    """The drone's own service ended, and how; it is started again."""

    service: Text
    how: Text


class OffloadingFailed(Event, frozen=True, kw_only=True):
    """A defect in deciding: from now on every call runs on the drone; `trace` is for a bug report."""

    why: Text
    trace: Text


# --- the clock ----------------------------------------------------------------------------------------------


class WaitingForTheTime(Event, frozen=True, kw_only=True):
    """A certificate is not valid by this computer's clock, and the vehicle's GPS has no fix yet.

    See [a clock that is wrong](raspberry-pi.md#a-clock-that-is-wrong), for the next two as well.
    """

    why: Text


class ClockSet(Event, frozen=True, kw_only=True):
    """This computer's clock was set, from what it said before to what the vehicle's GPS says."""

    before: _Time
    after: _Time


class ClockDiffers(Event, frozen=True, kw_only=True):
    """This computer's clock and the vehicle's GPS differ, and why the clock was not set."""

    clock: Text
    gps: Text
    why: Text


def _leaves(cls: type[Event]) -> Iterator[type[Event]]:
    if not (below := cls.__subclasses__()):
        yield cls
    for each in below:
        yield from _leaves(each)


EVENTS: tuple[type[Event], ...] = tuple(_leaves(Event))  # in the order of this file
STEPS: Mapping[Trigger, type[Step]] = {
    Trigger(kind_of(each)): each for each in EVENTS if issubclass(each, Step)
}
DECODER: msgspec.json.Decoder[Event] = msgspec.json.Decoder(functools.reduce(operator.or_, EVENTS))
