"""The events of the log, each with its fields; on disk an event is one JSON object a line.

The name of an event in the log is its class's name in snake case; `t` is its time in seconds since the log was
opened. Positions are relative to the mission's home. `VERSION` rises with each change that the version before could
not read: a new event, a renamed field, a field without a default. docs/event-log.md is made from this module.
"""

from __future__ import annotations

import functools
import operator
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Annotated, Literal, TypeAlias, TypeVar

import msgspec

from upwash.core.camera.georeference import PhotoGeometry
from upwash.core.geo import Circle, GeoPosition, Position, rounded
from upwash.core.knowledge.coverage import MeasuredPlace
from upwash.core.knowledge.servers import State, Trigger
from upwash.core.knowledge.supplies import Supply
from upwash.core.operation import server_of
from upwash.core.vehicle.control import Owner
from upwash.core.vehicle.telemetry import FixKind

VERSION = 6  # of the log; logs of earlier releases have none
# MAVLink's, from 0
SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")

_UNSTAMPED = float("nan")  # known by its identity: the time of an event that no journal has recorded yet
_Time: TypeAlias = Annotated[datetime, msgspec.Meta(tz=True)]

# Logs come from strangers too. These bounds hold for every event, so that readers need no others.
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
    """An event of a flight at second `t` of its log; docs/event-log.md lists the fields of each kind.

    The journal that records an event sets its time.
    """

    t: Number = _UNSTAMPED

    @property
    def kind(self) -> str:
        """The event's name in the log."""
        return kind_of(type(self))

    @property
    def is_stamped(self) -> bool:
        """Whether a journal has set the time."""
        return self.t is not _UNSTAMPED


def kind_of(event: type[Event]) -> str:
    """The name of a kind of event in the log."""
    return str(event.__struct_config__.tag)


class _Explained(Event, frozen=True, kw_only=True):
    why: Text


# --- the log ------------------------------------------------------------------------------------------------


class LogOpened(Event, frozen=True, kw_only=True):
    """The log of a flight begins at this date and time, written by this version of upwash and git commit, if known.

    `version` is the version of the log's format.
    """

    time: _Time
    version: Count = 0
    upwash: Text = ""
    commit: Text = ""


class LogResumed(Event, frozen=True, kw_only=True):
    """`--resume` resumed the flight at this date and time."""

    time: _Time
    version: Count = 0


class Simulated(Event, frozen=True, kw_only=True):
    """First line of `upwash simulate --log`: the scenario's file and the seed, and what the file said, as JSON.

    `upwash` and `commit` are those of `log_opened`. The configuration lacks what may have secrets: where findings are
    handed over, keys, and the camera's device.
    """

    scenario: Text
    seed: int
    version: Count = 0
    upwash: Text = ""
    commit: Text = ""
    configuration: Annotated[str, msgspec.Meta(max_length=4_000_000)] = ""


class EventsLost(Event, frozen=True, kw_only=True):
    """`count` events are lost: the disk was full, and so was the buffer in memory."""

    count: Count


class Shortened(Event, frozen=True, kw_only=True):
    """An event of the kind `of` exceeded a bound of the log; the line before may have a part of it."""

    of: Text
    why: Text


# --- the mission --------------------------------------------------------------------------------------------


class MeasuredRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The measurements of a server at a place: requests `tried` there, and requests `answered`.

    `call_s` is the mean delay of a call by operation; a failed call counts with the onboard computation that replaced
    it. `goodput_bit_s` is the goodput of the answered calls, computing time included. `flights_ago` is the age of the
    last measurement.
    """

    east_m: Number
    north_m: Number
    tried: Count
    answered: Count
    call_s: _ByName[Number] = {}
    goodput_bit_s: Rate | None = None
    flights_ago: Count = 0

    @classmethod
    def of(cls, place: MeasuredPlace) -> MeasuredRecord:
        """The measurements of a place of the coverage map."""
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
    """Home, the waypoints in metres east and north of home, the ranges of the servers, and whether calls are paced.

    Altitudes are above home; logs of early releases have none. With `mission.order`, `order` has the indices of the
    waypoints as the drone flies them, and `order_why` the reason. `measured` has what earlier flights measured of
    servers without a range.
    """

    home: GeoPosition | None = None
    waypoints_m: _Many[tuple[Number, Number]] = []
    altitudes_m: _Many[Number] = []
    ranges: _ByName[Circle] = {}
    paced: bool = False
    order: _Many[Index] = []
    order_why: Text = ""
    measured: _ByName[_Many[MeasuredRecord]] = {}

    @property
    def has_servers(self) -> bool:
        """Whether a call could run on a server."""
        return bool(self.ranges or self.measured)

    @property
    def way_m(self) -> Sequence[tuple[float, float]]:
        """The waypoints in the order of the flight."""
        return [self.waypoints_m[index] for index in self._flown_order]

    @property
    def way_altitudes_m(self) -> Sequence[float]:
        """The altitudes in the order of the flight; empty if they are unknown."""
        if len(self.altitudes_m) != len(self.waypoints_m):
            return ()
        return [self.altitudes_m[index] for index in self._flown_order]

    @property
    def _flown_order(self) -> Sequence[int]:
        given = range(len(self.waypoints_m))
        return self.order if sorted(self.order) == list(given) else given


class SpeedChosen(Event, frozen=True, kw_only=True):
    """The ground speed by `mission.speed = "auto"`, and why."""

    ground_speed_m_s: Number
    why: Text


class NoBetterAnswer(_Explained, frozen=True, kw_only=True):
    """Before take-off: no server is expected to give the second of two answers by its deadline."""


class DeadlinePromised(Event, frozen=True, kw_only=True):
    """Before take-off: calls of the operation are answered `within_s` with the probability `expected` at least.

    `expected` is a lower bound with a confidence of 95 %, `asked` the configured probability, and `extra` the
    expected share of calls that a second server gets too. With a second server `expected` holds for servers that are
    late independently of each other.
    """

    operation: Text
    within_s: Number
    asked: Number
    expected: Number
    extra: Number


class MissionStarted(Event, frozen=True, kw_only=True):
    """The drone, the policy, the number of planned waypoints, and in a resumed flight the indices already `done`."""

    drone: Text = ""
    policy: Text
    waypoints: Index = 0
    done: _Many[Index] = []


class Foreseen(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The forecast before take-off: the end of the mission, and the arrival at each waypoint (`reached_s`).

    With `finish_by`, `lightest_s` is the end of the mission with every call in its lighter mode. All are seconds of
    the mission's time.
    """

    as_asked_s: Number
    lightest_s: Number | None = None
    finish_by_s: Number | None = None
    reached_s: _Many[Number] = []

    @property
    def fits(self) -> bool:
        """Whether the mission can end in time."""
        return self.finish_by_s is None or (self.lightest_s or self.as_asked_s) <= self.finish_by_s


class MissionCompleted(Event, frozen=True, kw_only=True):
    """The mission was flown to its end, and the drone left every server."""


class MissionEnded(_Explained, frozen=True, kw_only=True):
    """The mission ended early, and why."""


class Stopping(_Explained, frozen=True, kw_only=True):
    """Ctrl-C, SIGTERM or the reserve ends the mission early."""


class SetOff(Event, frozen=True, kw_only=True, omit_defaults=True, tag="leg"):
    """The drone sets off for a place; `waypoint` is its index, null for a place beside the plan.

    With `back` the drone returns to a waypoint because its answer demands an action or its call failed.
    """

    waypoint: Index | None
    east_m: Number
    north_m: Number
    back: bool = False


class Arrived(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The drone has arrived where it set off for, and first hovers there for the plan's `hold_s`.

    With `passing` it flies on along its row.
    """

    waypoint: Index | None
    east_m: Number
    north_m: Number
    hold_s: Number = 0.0
    passing: bool = False


class PhotosWait(Event, frozen=True, kw_only=True):
    """The drone stops on its row, as `waiting` photos have no answer; it flies on when there are fewer."""

    waiting: Count


class PhotoTaken(Event, frozen=True, kw_only=True, omit_defaults=True, tag="photo"):
    """A photo: its source, size in bytes, age on delivery, place, and for a rendered photo the true objects in it.

    The place in degrees (WGS 84) and the altitude above the sea are absent if they are unknown. `geometry` decides
    where what the photo shows lies on the ground; absent for a camera whose lens is unknown. With an
    `object`, by its number in `demanded`, the photo was taken while the mission acted there: it is the second look.
    """

    source: Text
    bytes: Count
    age_s: Number
    position: Position
    latitude_deg: Number | None = None
    longitude_deg: Number | None = None
    above_sea_m: Number | None = None
    geometry: PhotoGeometry | None = None
    truth: _Few[Branch] | None = None
    object: Count | None = None


class AutopilotPhoto(Event, frozen=True, kw_only=True, omit_defaults=True):
    """A photo of a camera at the autopilot, by the autopilot's report: the camera, the photo's number, and its place.

    The photo stays on that camera. The place is that of the vehicle at the shutter; absent if it was unknown.
    `taken` is the time by the autopilot's GPS, absent without one.
    """

    camera: Count
    number: Count
    position: Position | None = None
    latitude_deg: Number | None = None
    longitude_deg: Number | None = None
    above_sea_m: Number | None = None
    taken: _Time | None = None


class PhotoPlaceDoubted(Event, frozen=True, kw_only=True):
    """The camera's own place cannot be true, or the drone's could not be written; further ones are not logged."""

    source: Text
    why: Text


class CameraClockDiffers(Event, frozen=True, kw_only=True):
    """A photo's time by its camera's clock, `behind_s` behind this computer's, or ahead of it if negative.

    Photos of that camera count as taken when they come. Further ones are not logged.
    """

    source: Text
    camera: _Time
    clock: _Time
    behind_s: Number


class PhotosNotKept(Event, frozen=True, kw_only=True):
    """A photo could not be kept in `camera.keep`; the flight goes on, and further failures are not logged."""

    why: Text


class CallStarted(Event, frozen=True, kw_only=True):
    """The mission began a call at the waypoint, without waiting; its `call` event comes when it is over."""

    operation: Text
    waypoint: Index | None


class FirstAnswer(Event, frozen=True, kw_only=True):
    """The mission hears the first answer of a call with two, `delay_s` after the call, by the drone as `operation`.

    The event `call` tells where the better answer came from, or that none came by the deadline.
    """

    waypoint: Index | None
    operation: Text
    delay_s: Number


class Unanswered(_Explained, frozen=True, kw_only=True):
    """A call that only servers compute ended without an answer, and why.

    The mission made it at `at_s` of the log, and allowed `within_s`; null if it may wait until the drone has landed.
    """

    waypoint: Index | None
    operation: Text
    at_s: Number
    waited_s: Number
    within_s: Number | None = None


class SoughtAnswers(Event, frozen=True, kw_only=True):
    """The drone stops for `waiting` calls at a place where a server can answer them.

    For calls that only servers compute it is the last such place of its way, or lies beside the way home. For others
    it lies where they are answered sooner than where the drone rests. The way is `extra_s` longer.
    """

    waiting: Count
    position: Position
    extra_s: Number


class StayOrGo(Event, frozen=True, kw_only=True):
    """Whether the drone leaves the waypoint before the answer arrives, and why.

    `chance` is the probability that an answer demands an action, estimated from the last answers. Leaving saves
    `saved_s` if the answer demands nothing, and loses `lost_s` if it does; both are null if they were not computed.
    """

    waypoint: Index | None
    goes: bool
    why: Text
    chance: Number
    saved_s: Number | None = None
    lost_s: Number | None = None


class FoundRecord(msgspec.Struct, frozen=True, omit_defaults=True):
    """An object on the ground that photos of the flight show: its number in the flight, label, score and place.

    `variance_m2` is that of the place: east's, east with north's, and north's; `apart_m` is the standard error of the
    place against others of its photo. All three are absent for an object without a place.
    """

    number: Count
    label: Text
    score: Number | None = None
    place: Position | None = None
    variance_m2: tuple[Number, Number, Number] | None = None
    apart_m: Number | None = None


class Demanded(Event, frozen=True, kw_only=True, omit_defaults=True):
    """An answer that arrived later demands an action at its waypoint, or its call `failed` for that reason.

    With an `object` the action is at the place of that object, which the answer shows. The object has a `number` in
    the flight, a `label`, and as far as known a `score` and a `place` on the ground.
    """

    waypoint: Index | None
    failed: Text = ""
    object: FoundRecord | None = None


class TurnedBack(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The drone flies back to a waypoint because its answer demands an action there or its call failed.

    With an `object`, given by its number, it flies to the place of that object, and not to the waypoint.
    """

    waypoint: Index | None
    position: Position
    object: Count | None = None


class PutOff(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The drone puts the action at a waypoint off, as the way gets `extra_s` longer then, and `at_once_s` at once.

    The action begins in `in_s` at the earliest. With an `object`, given by its number, it is at that object's place.
    """

    waypoint: Index | None
    extra_s: Number
    at_once_s: Number
    in_s: Number
    object: Count | None = None


class AnswerTaken(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The mission takes the answer of a waypoint after it `waited_s` for the answer; `failed` is why there is none.

    `demanded` tells whether the answer demands an action at the waypoint.
    """

    waypoint: Index | None
    waited_s: Number
    demanded: bool = False
    failed: Text = ""


class Acted(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The mission has done what the answer demanded at the waypoint.

    With an `object` it has done that at the place of the object, and has the answers to the photos taken there.
    """

    waypoint: Index | None
    object: FoundRecord | None = None


class NotActed(Event, frozen=True, kw_only=True):
    """An action at the place of an object, given by its number, is left out, and why."""

    waypoint: Index | None
    object: Count
    why: Text


class Notified(Event, frozen=True, kw_only=True, omit_defaults=True):
    """A message to the user, and the place that it is about.

    `photo` is the photo that it is about, by its number since the program began, counted from 0; absent for the last.
    """

    message: Message
    at: Position
    photo: Index | None = None


# --- the vehicle --------------------------------------------------------------------------------------------


class ControlChanged(Event, frozen=True, kw_only=True, tag="control"):
    """Who has the vehicle from now on, and why.

    The owners are `program`, `pilot`, `ground station`, `fail-safe`, `unknown`, and `earlier run`: the vehicle comes
    down as an earlier run of the program commanded.
    """

    owner: Owner
    why: Text


class UnsignedPort(_Explained, frozen=True, kw_only=True):
    """Anyone who reaches the drone's `udpin` port can pose as the vehicle.

    See [signed messages](vehicle.md#signed-messages).
    """


class WaitingForVehicle(Event, frozen=True, kw_only=True):
    """No message of the vehicle for `waited_s`, and why; the program waits for at most `within_s`."""

    why: Text
    waited_s: Number
    within_s: Number


class VehicleFound(Event, frozen=True, kw_only=True):
    """The vehicle that the program flies: its MAVLink ids, its firmware, and its type, such as `quadrotor`.

    `version` is the firmware's; null if the vehicle does not report it.
    """

    system: Count
    component: Count
    firmware: Text
    type: Text
    version: Text | None = None


class LinkLost(Event, frozen=True, kw_only=True):
    """No message of the vehicle has arrived for `silent_s`."""

    silent_s: Number


class LinkRestored(Event, frozen=True, kw_only=True):
    """A message of the vehicle has arrived after `silent_s`."""

    silent_s: Number


class PositionDoubted(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The reported position jumped by `jumped_m`, farther than the vehicle can fly, or the vehicle is `unsure` of it.

    With neither the position is plausible again.
    """

    jumped_m: Number
    unsure: bool = False


class HomeMoved(Event, frozen=True, kw_only=True):
    """The vehicle's home was moved in the flight; `altitude_m` is above the ground below the take-off."""

    east_m: Number
    north_m: Number
    altitude_m: Number

    @classmethod
    def of(cls, home: Position) -> HomeMoved:
        """The event of a home that is there now, to the centimetre."""
        there = rounded(home)
        return cls(east_m=there.east_m, north_m=there.north_m, altitude_m=there.altitude_m)


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
    """A trouble of the vehicle's link, or another party on it; logged at its 1st, 10th, 100th time, and so on."""

    about: LinkTroubleName
    why: Text


class VehicleSaid(Event, frozen=True, kw_only=True):
    """A text message of the vehicle and its severity, 0 (emergency) to 7 (debug)."""

    severity: Annotated[int, msgspec.Meta(ge=0, lt=len(SEVERITIES))]
    text: Text


class VehicleSetting(Event, frozen=True, kw_only=True):
    """A parameter of the vehicle that the user should know before the flight, and why; null if unknown."""

    name: Text
    value: Parameter | None
    advice: Text


class ArmingDelayed(Event, frozen=True, kw_only=True):
    """The vehicle's reasons why it cannot be armed yet; logged when they change."""

    reasons: _Few[Text]


class LimitsRead(Event, frozen=True, kw_only=True, omit_defaults=True, tag="vehicle_limits"):
    """The vehicle's home and rally points, the altitudes between which it may fly, and its fences by name.

    They are read before arming.

    At `low_percent` and `critical_percent` of its battery the vehicle itself warns or acts; absent where unknown.
    """

    home: Position | None
    highest_m: Number | None
    fences: _Few[Text]
    lowest_m: Number | None = None
    home_above_sea_m: Number | None = None
    low_percent: Number | None = None
    critical_percent: Number | None = None
    rally: _Few[Position] = []


class SiteDoubt(_Explained, frozen=True, kw_only=True):
    """A warning before arming about the place of the mission; the mission may begin all the same."""


class DeadManSet(Event, frozen=True, kw_only=True):
    """The autopilot does `action` after `silence_s` without a message of the program."""

    silence_s: Number
    action: Literal["return", "land"]


class DeadManFailed(_Explained, frozen=True, kw_only=True):
    """Why the autopilot does not act on a silence of the program, in a flight that was in the air already."""


class _AtPlace(Event, frozen=True, kw_only=True, omit_defaults=True):
    position: Position | None = None


class Arming(Event, frozen=True, kw_only=True):
    """The vehicle can be armed; the program commands it to start its motors."""


class Armed(_AtPlace, frozen=True, kw_only=True):
    """The motors run."""


class TakingOff(Event, frozen=True, kw_only=True):
    """The program commands the vehicle to climb to the altitude above home."""

    altitude_m: Number


class TookOff(_AtPlace, frozen=True, kw_only=True):
    """The vehicle has climbed to the altitude above home."""

    altitude_m: Number


class Holding(_AtPlace, frozen=True, kw_only=True):
    """The vehicle hovers, as the mission commanded."""


class Turned(Event, frozen=True, kw_only=True):
    """The vehicle has turned its nose to `heading_deg`, clockwise from north, until the next leg."""

    heading_deg: Number


class PayloadCommanded(Event, frozen=True, kw_only=True):
    """The vehicle has accepted a MAVLink command for its payload; null stands for an unset parameter."""

    number: Count
    name: Text
    parameters: _Few[Parameter | None]


class TextSent(Event, frozen=True, kw_only=True):
    """A text message of the mission to the ground stations; severity as in `vehicle_said`."""

    severity: Annotated[int, msgspec.Meta(ge=0, lt=len(SEVERITIES))]
    text: Text


class Returning(_AtPlace, frozen=True, kw_only=True):
    """The mission commands the vehicle to return home and land."""


class Landing(_AtPlace, frozen=True, kw_only=True):
    """The mission commands the vehicle to land where it is."""


class Landed(_AtPlace, frozen=True, kw_only=True):
    """The vehicle is on the ground, `from_home_m` from its home, and `at` its home or one of its rally points.

    Both are absent in doubt of the reported position.
    """

    at: Text = ""
    from_home_m: Number | None = None


class ReturnHovers(_Explained, frozen=True, kw_only=True):
    """A return hovers at its end for longer than it may, or than the reserve allows; the program lands it there."""

    position: Position


class NoNearer(Event, frozen=True, kw_only=True):
    """A return has not brought the vehicle nearer to its end for `for_s`, as in strong wind; repeated each minute."""

    to: Text
    away_m: Number
    for_s: Number


class ReserveOnTheWayDown(_Explained, frozen=True, kw_only=True):
    """The battery has reached the reserve on the way down, and why; a vehicle that hovers is landed at once."""


class Disarmed(_AtPlace, frozen=True, kw_only=True):
    """The motors have stopped; after a safe end there is no position."""


class SafeEnd(Event, frozen=True, kw_only=True):
    """The action that ends a flight that cannot go on, and why it cannot."""

    action: _SafeEndAction
    why: Text


class SafeEndFailed(Event, frozen=True, kw_only=True):
    """The vehicle did not carry out the safe end, and why; the program commands it again."""

    action: _SafeEndAction
    why: Text


class LeftHovering(Event, frozen=True, kw_only=True):
    """The safe end leaves the vehicle hovering; a pilot must take over."""


class LeftToPilot(_Explained, frozen=True, kw_only=True):
    """The program stops sending commands to the vehicle, and why."""


class Stood(Event, frozen=True, kw_only=True):
    """A vehicle that another party had taken over is on the ground."""

    position: Position


class FollowingEnded(_Explained, frozen=True, kw_only=True):
    """Why the log ends before a vehicle that another party had taken over is on the ground."""


class SupplyChanged(Event, frozen=True, kw_only=True):
    """A supply of the drone's computer is scarce from now on, or no more, and what is `left`.

    Files and threads are those that the program may add; memory and disk are in bytes.
    While files, threads or memory are scarce, no server is dialled. While the disk is scarce, no photo is kept, and
    positions are logged each 10 s.
    """

    supply: Supply
    left: Count
    scarce: bool


class CoverageNotKept(_Explained, frozen=True, kw_only=True):
    """The coverage map could not be written; only the log has this flight's measurements."""


class DemandsNotKept(_Explained, frozen=True, kw_only=True):
    """The map of demands could not be written: `policy.demand_map` is as before the flight."""


class HandoverTrouble(Event, frozen=True, kw_only=True, omit_defaults=True):
    """A program or address of `[user]` does not take findings, and why; without a reason it takes them again."""

    to: Text
    why: Text = ""


class HandoverFailed(_Explained, frozen=True, kw_only=True):
    """At the flight's end, how many findings were not handed over to a program or address of `[user]`, and why."""

    to: Text
    count: Count


class BorderWatchFailed(_Explained, frozen=True, kw_only=True):
    """The vehicle is silent; until its next message the program checks ranges only once a period."""


class Energy(Event, frozen=True, kw_only=True):
    """With `reserve_s`: the battery, its loss a second, the time to the landing, the charge needed, and the margin.

    The landing is at home, or with `on_failure = "land"` below the vehicle. Logged when first known, after a change
    of the margin by more than 3 %, and once a minute. `guessed` lists the vehicle's unknown parameters: the estimate
    takes usual values for them. `battery` is the number of the battery with the least margin, of several batteries.
    """

    left_percent: Number
    rate_percent_s: Number
    home_s: Number
    needed_percent: Number
    floor_percent: Number
    margin_percent: Number
    guessed: _Few[Text] = []
    battery: Count | None = None


class EnergyUsed(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The energy that a simulated mission with `[energy]` has drawn, by consumer, and the capacity of the battery.

    `flight_wh` is drawn by the rotors while the drone moves, `hover_wh` while it hovers.
    """

    flight_wh: Number
    hover_wh: Number
    computing_wh: Number
    radio_wh: Number
    battery_wh: Number | None = None

    @property
    def total_wh(self) -> float:
        """The sum over all consumers."""
        return round(self.flight_wh + self.hover_wh + self.computing_wh + self.radio_wh, 6)


class BatteryWatchFailed(Event, frozen=True, kw_only=True, omit_defaults=True):
    """Nothing watches a battery: the vehicle does not report its charge, or a defect ended the watch of the reserve.

    A defect ends the mission as the reserve does; `trace` is for a bug report.
    """

    why: Text
    trace: Text = ""


class PositionReport(Event, frozen=True, kw_only=True, omit_defaults=True, tag="position", gc=False):
    """The position of the drone once a second (real flights), with its motion, battery and link as far as known.

    The heading is clockwise from north. `battery_percent` is the charge of the lowest battery, `battery` its number
    if there are several. `round_trip_s` is the delay of the last request to the daemon of the `server` in use. While
    the program brings the vehicle down, `down_s` is the time to the ground. `mode` is the autopilot's own name, `gps`
    the receiver's fix, with the number of `satellites` in use. The wind is where the air moves to.
    """

    east_m: Number
    north_m: Number
    altitude_m: Number
    ground_speed_m_s: Number | None = None
    heading_deg: Number | None = None
    battery_percent: Number | None = None
    battery: Count | None = None
    server: Text | None = None
    round_trip_s: Number | None = None
    down_s: Number | None = None
    mode: Text | None = None
    armed: bool | None = None
    gps: FixKind | None = None
    satellites: Count | None = None
    wind_east_m_s: Number | None = None
    wind_north_m_s: Number | None = None


# --- servers ------------------------------------------------------------------------------------------------


class ServerStep(Event, frozen=True, kw_only=True):
    """A server changes its state; `check` is the number of the drone's check or probe.

    The mean delays are those that a selection compares: of calls on the drone, and of calls on servers in range.
    """

    server: Text
    before: State
    after: State
    why: Text = ""
    check: Count = 0
    local_mean_call_s: Number | None = None
    mean_call_s: _ByName[Number | None] = {}
    position: Position | None = None


class Selected(ServerStep, frozen=True, kw_only=True):
    """The drone selects the server, for now or as the next one: its check begins. Calls name the check."""


class FoundStopped(ServerStep, frozen=True, kw_only=True):
    """The daemon answers: the server is available, but not all services run."""


class FoundRunning(ServerStep, frozen=True, kw_only=True):
    """The daemon answers: the server is available, and all services run."""


class Started(ServerStep, frozen=True, kw_only=True):
    """The services were started, and calls may be sent."""


class CheckFailed(ServerStep, frozen=True, kw_only=True):
    """The check failed: no network, no answer in time, an unavailable server, or a service that did not start."""


class Deselected(ServerStep, frozen=True, kw_only=True):
    """The drone leaves the server."""


class DeselectedAfterStart(ServerStep, frozen=True, kw_only=True):
    """The drone leaves the server while its services start."""


class CallFailedInRange(ServerStep, frozen=True, kw_only=True):
    """A call in the server's range got no usable answer."""


class CallFailedOutOfRange(ServerStep, frozen=True, kw_only=True):
    """A call got no usable answer because the drone had left the server's range."""


class NetworkLost(ServerStep, frozen=True, kw_only=True):
    """The drone is in the server's range, and the server's network is disconnected."""


class TurnOver(ServerStep, frozen=True, kw_only=True):
    """The server gave the drone's slot to another drone; the drone requests a slot again, by a new check."""


class NoSlot(Event, frozen=True, kw_only=True):
    """The server has no free slot; `waiting` drones queue, this drone included, and this drone asks again."""

    server: Text
    check: Count
    waiting: Count


class LeftOut(Event, frozen=True, kw_only=True):
    """A service keeps failing on the server, which pauses it; the drone ignores the server for `pause_s`."""

    server: str
    check: int
    pause_s: float
    why: str


class ServiceMoved(Event, frozen=True, kw_only=True):
    """A READY server has moved the service to another address, for instance on a reload; calls follow it."""

    server: Text
    check: Count
    service: Text


class PlaceMeasured(Event, frozen=True, kw_only=True):
    """A new measurement of a server without a range, and all measurements at that place."""

    server: Text
    place: MeasuredRecord


class BlacklistExpired(ServerStep, frozen=True, kw_only=True):
    """The blacklisting of the server is over."""


class Probed(ServerStep, frozen=True, kw_only=True):
    """A server that had failed answered a probe; not all of its services run."""


class ProbedRunning(ServerStep, frozen=True, kw_only=True):
    """A server that had failed answered a probe, and all of its services run."""


class IdleExpired(ServerStep, frozen=True, kw_only=True):
    """The services were unused for so long that the server may have stopped them."""


class Prepared(ServerStep, frozen=True, kw_only=True):
    """The server in use prepares the next server, its peer, for the drone."""


class NotPrepared(Event, frozen=True, kw_only=True):
    """Why the server in use, `by`, does not prepare its peer `server`."""

    server: Text
    by: Text
    why: Text


class Joined(Event, frozen=True, kw_only=True):
    """The drone joined the server's network for a check."""

    server: Text
    network: Text
    check: Count = 0


class LeftOver(Event, frozen=True, kw_only=True):
    """The drone left a network that an earlier program had joined."""

    network: Text


class LeaveFailed(Event, frozen=True, kw_only=True):
    """The drone could not leave a network, and why."""

    network: Text
    why: Text


# --- calls --------------------------------------------------------------------------------------------------


class Decided(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The decision where a call runs, why, and all its inputs at that moment.

    `selected` is the server in use with its state and its `check`; `check_s` is how long the check should take and
    `check_elapsed_s` its age. `server` must answer within `deadline_s`; a wait lasts `at_most_s`. With `raced` the
    drone computes the call too. A second decision follows if a server becomes usable during an onboard call.
    `waypoint` is where the mission began the call, if several may be open at the same time. Where a part may run
    before sending, `remote_s` is the shorter of `whole_s`, with the request sent whole, and `less_s`. Before
    `remote_s` a call may have to wait `queue_s` for calls of other drones.
    """

    waypoint: Index | None = None
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
    whole_s: Number | None = None
    less_s: Number | None = None
    queue_s: Number | None = None
    position: Position


class Call(Event, frozen=True, kw_only=True, omit_defaults=True):
    """A call has ended: its place, the reason, its begin and delay, and the shares of waiting and onboard computing.

    `place` is a server's name, or `local` for the drone; `check` is the number of the server's selection, absent for
    the drone. `wait` is empty, `paid off` or `failed`. `hedged_s` is when the drone's own service joined the call,
    `second_s` when a second server did, if a server answered,
    and `queued_s` how long earlier calls kept its place busy. `waypoint` is where the mission began the call, if
    several may be open at the same time. `remote_fault` is `confirmed` or `denied` if the
    server reported an exception and the drone's own service repeated the call. `at_s` is by the program's clock, not
    the log's. `operation` is what ran. If a heavier operation was `asked` for, the mission would have ended at
    `forecast_s` of its time, later than `finish_by_s`. Of a call with two answers the first one was there after
    `first_s`; if no better one came by the deadline, `operation` is that of the first. A part before sending took
    `part_s`, and made the `whole_bytes` of the request to `sent_bytes`; requests of simulations are a few bytes.
    """

    waypoint: Index | None = None
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
    second_s: Number | None = None
    queued_s: Number | None = None
    first_s: Number | None = None
    remote_fault: Literal["", "confirmed", "denied"] = ""
    whole_bytes: Count | None = None
    sent_bytes: Count | None = None
    part_s: Number | None = None

    @property
    def server(self) -> str | None:
        """The server that answered; None if the drone did."""
        return server_of(self.place)


class Hedged(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The drone's own service joins a remote call after `after_s`; the server may answer until `deadline_s`.

    `waypoint` is that of the call, if several calls may be open at the same time.
    """

    waypoint: Index | None = None
    server: Text
    check: Count = 0
    after_s: Number
    deadline_s: Number


class Preferred(Event, frozen=True, kw_only=True):
    """From now on calls go first to this server; the other READY server is kept for late calls."""

    server: Text
    check: Count = 0
    why: Text


class Seconded(Event, frozen=True, kw_only=True, omit_defaults=True):
    """A call that the server has not answered `after_s` after its begin is sent to the `second` server too.

    The second one, READY since `check`, may answer for `deadline_s`. `waypoint` is that of the call, if several calls
    may be open at the same time.
    """

    waypoint: Index | None = None
    operation: Text
    server: Text
    second: Text
    check: Count = 0
    after_s: Number
    deadline_s: Number


class Dropped(Event, frozen=True, kw_only=True):
    """The second answer of a call that was computed at two places was dropped; `place` is its origin."""

    operation: Text
    place: Text

    @property
    def server(self) -> str | None:
        """The server that gave the answer; None if the drone did."""
        return server_of(self.place)


class SentWhole(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The part before sending failed: the call is sent whole, or the drone computes it if no time is left for that.

    `given_up` if the part is not tried again in this flight.
    """

    operation: Text
    why: Text
    given_up: bool = False

    @property
    def then(self) -> str:
        """What follows, as the end of a sentence; empty if the part is tried again."""
        return "; from now on all is sent whole" if self.given_up else ""


class RemoteRaised(Event, frozen=True, kw_only=True):
    """The exception that a server reports for a call; the drone's own service repeats the call."""

    server: Text
    check: Count = 0
    operation: Text
    raised: Text


class RemoteFailed(Event, frozen=True, kw_only=True):
    """Why a remote call got no usable answer; or it raised on the server and not on the drone."""

    server: Text
    check: Count = 0
    why: Text


class RemoteQueued(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The server did not begin a call in `waited_s`: other calls of `queue_s` come first. The server has not failed.

    `waypoint` is where the mission began the call, if several may be open at the same time.
    """

    waypoint: Index | None = None
    server: Text
    check: Count = 0
    waited_s: Number
    queue_s: Number
    why: Text


class LocalReady(Event, frozen=True, kw_only=True):
    """The service is ready on the drone."""

    service: Text


class LocalFailed(Event, frozen=True, kw_only=True, omit_defaults=True):
    """The drone's own service failed in a call of `method`, or could not be restarted."""

    service: Text
    method: Text | None = None
    why: Text


class LocalEnded(Event, frozen=True, kw_only=True):
    """The drone's own service ended, and how; the program restarts it."""

    service: Text
    how: Text


class OffloadingFailed(Event, frozen=True, kw_only=True):
    """A defect ended offloading: from now on every call runs on the drone; `trace` is for a bug report."""

    why: Text
    trace: Text


# --- the clock ----------------------------------------------------------------------------------------------


class WaitingForTheTime(_Explained, frozen=True, kw_only=True):
    """A certificate is not valid by this computer's clock, and the vehicle's GPS has no fix yet.

    See [a clock that is wrong](small-computers.md#a-clock-that-is-wrong), for the next two as well.
    """


class ClockSet(Event, frozen=True, kw_only=True):
    """The program set this computer's clock by the vehicle's GPS."""

    before: _Time
    after: _Time


class ClockDiffers(Event, frozen=True, kw_only=True):
    """This computer's clock differs from the vehicle's GPS, and why the program did not set the clock."""

    clock: Text
    gps: Text
    why: Text


def _leaves(cls: type[Event]) -> Iterator[type[Event]]:
    if not (kinds := cls.__subclasses__()):
        yield cls
    for kind in kinds:
        yield from _leaves(kind)


EVENTS: tuple[type[Event], ...] = tuple(_leaves(Event))  # in the order of this file
STEPS: Mapping[Trigger, type[ServerStep]] = {
    Trigger(kind_of(kind)): kind for kind in EVENTS if issubclass(kind, ServerStep)
}
DECODER: msgspec.json.Decoder[Event] = msgspec.json.Decoder(functools.reduce(operator.or_, EVENTS))
