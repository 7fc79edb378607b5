"""What the page is told of a flight: one fact at a time, each with its second of the log, as JSON."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from upwash.eventlog.objects import Outline


def _kind(name: str) -> str:
    return name.removesuffix("Fact").lower()


class Fact(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="fact", tag=_kind):
    """Something that the page shows from `at_s` on, until a later fact takes its place."""

    at_s: float


class PlanFact(Fact, frozen=True):
    """The waypoints in the order of the flight; `ranges` has [east, north, radius] of each server, in metres.

    `home` is its latitude and longitude, and `metres_per_degree` the lengths there, eastwards and northwards.
    """

    waypoints_m: Sequence[tuple[float, float]]
    ranges: dict[str, tuple[float, float, float]]
    home: tuple[float, float] | None
    metres_per_degree: tuple[float, float] | None


class OpenedFact(Fact, frozen=True):
    """The time of day at which the log began, in seconds since 1970; simulated logs have none."""

    epoch_s: float


class BeganFact(Fact, frozen=True):
    """The mission began, from which its time is counted."""

    policy: str
    drone: str = ""


class FirmwareFact(Fact, frozen=True):
    """Which vehicle the program flies: the firmware's name and version, and the vehicle's type."""

    name: str
    type: str
    version: str | None = None


class ForecastFact(Fact, frozen=True):
    """When the mission was expected to be over, and at each of its last waypoints, in the mission's seconds.

    Where it is to `finish_by_s`, it may use lighter calls; with all of them lighter it was expected to be over after
    `lightest_s`.
    """

    ends_s: float
    reached_s: Sequence[float]
    lightest_s: float | None = None
    finish_by_s: float | None = None


class HomeFact(Fact, frozen=True):
    """Where the vehicle returns to."""

    east_m: float
    north_m: float


class FixFact(Fact, frozen=True, gc=False):
    """Where the drone is; and its speed, heading, battery and link to the server in use, where those are told too.

    While the program brings it down, it is on the ground in `down_s`.
    """

    east_m: float
    north_m: float
    altitude_m: float
    ground_speed_m_s: float | None = None
    heading_deg: float | None = None
    battery_percent: float | None = None
    server: str | None = None
    round_trip_s: float | None = None
    down_s: float | None = None


class NoticeFact(Fact, frozen=True):
    """What a person has to act on (`level` alarm) or should know (caution) from now on, under a key.

    Without a `cause` what held under the key is over. `action` is what a person can do. It began at `since_s`, for
    the time that `times` says. Of several, that with the lowest `rank` is the most urgent.
    """

    key: str
    level: str
    cause: str
    action: str
    rank: int
    since_s: float
    times: int = 1


class DoingFact(Fact, frozen=True):
    """What the drone does from now on, and how many waypoints it has reached.

    `who` has the vehicle, in a word that people read at a distance, with a `tone` that has a colour. It `stands` at a
    place, for a photo or a call.
    """

    words: str
    reached: int
    who: str
    tone: str
    stands: bool = False


class VehicleFact(Fact, frozen=True):
    """The vehicle's own mode, whether its motors may run, and its receiver's fix, each absent if not in the log."""

    mode: str = ""
    armed: bool | None = None
    gps: str | None = None
    satellites: int | None = None


class StagesFact(Fact, frozen=True):
    """At how much of its battery the vehicle itself calls it low or critical."""

    low_percent: float | None = None
    critical_percent: float | None = None


class StepFact(Fact, frozen=True):
    """A server came into a state, in the word that people read."""

    server: str
    state: str
    tone: str
    why: str


class Estimate(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a call was expected to take at a place, "local" for the drone, after a wait for it."""

    place: str
    call_s: float
    wait_s: float = 0.0


class DecisionFact(Fact, frozen=True):
    """Where the call of that `number`, counted from 0, is from now on, with why, in sentences, and the estimates.

    The call began at `began_s`. What is `doing` is done since `from_s`, for `at most` or `about` `limit_s`; it is
    `also_local` if the drone computes the call too. Without `words` no call is under way.
    """

    number: int
    waypoint: int | None
    operation: str = ""
    words: Sequence[str] = ()
    estimates: Sequence[Estimate] = ()
    began_s: float = 0.0
    from_s: float = 0.0
    doing: str = ""
    bound: str = ""
    limit_s: float | None = None
    also_local: bool = False


class CallFact(Fact, frozen=True):
    """A call ended; `words` say why it ran where it ran, and `east_m`, `north_m` where the drone made it.

    It was in line for `queued_s`. It took `lost_s` longer than was expected of the best place, as the `estimates`
    were when it began.
    """

    operation: str
    waypoint: int | None
    place: str
    delay_s: float
    waited_s: float
    wait: str
    words: Sequence[str]
    estimates: Sequence[Estimate]
    lost_s: float
    east_m: float | None
    north_m: float | None
    queued_s: float = 0.0


class AmendedFact(Fact, frozen=True):
    """New words about an earlier call, whose `number` counts from 0: a later event told more."""

    number: int
    words: Sequence[str]


class StartedFact(Fact, frozen=True):
    """The mission began a call at the waypoint without waiting; its answer is open until the call ends, or fails."""

    waypoint: int | None


class BesideFact(Fact, frozen=True):
    """What keeps the drone off its way from now on: "detour" for demands, "wait" for answers; "" once it flies on."""

    kind: str


class GoingFact(Fact, frozen=True):
    """The drone goes on before the answer of the waypoint is there; `words` say why."""

    waypoint: int | None
    words: str


class TurnFact(Fact, frozen=True):
    """The drone turns back from here to the waypoint, for its answer."""

    waypoint: int | None
    east_m: float
    north_m: float


class MeasuredFact(Fact, frozen=True):
    """A server without a range was asked something here, on this flight or before; such a share was answered."""

    server: str
    east_m: float
    north_m: float
    answered: float


class AnswerFact(Fact, frozen=True):
    """The mission has the answer of a waypoint, or no answer will come. The call hid `hidden_s` of its delay."""

    waypoint: int | None
    hidden_s: float = 0.0


class ShotFact(Fact, frozen=True):
    """A photo was taken; `kept` says whether it can be had, by its `number`. `truth` is what a rendered one shows.

    `footprint_m` has the photo's corners on the ground, east and north, clockwise from the upper left.
    """

    number: int
    waypoint: int | None
    source: str
    kept: bool
    truth: Sequence[Outline] | None
    footprint_m: Sequence[tuple[float, float]] | None = None


class ToldFact(Fact, frozen=True):
    """One object in a message to the user, with its box on the photo numbered `photo`; or a message without boxes.

    `pictured` says whether the box can be had as a picture. `waypoint` is None before the first.
    """

    what: str
    waypoint: int | None
    east_m: float
    north_m: float
    score: float | None = None
    box: Outline | None = None
    photo: int | None = None
    pictured: bool = False


class SaidFact(Fact, frozen=True):
    """A line for the journal."""

    words: str
    tone: str


class EndedFact(Fact, frozen=True):
    """The mission is over."""

    completed: bool
