"""Which of the autopilots on a link is followed, and who else is noticed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import AutopilotError, AutopilotNotHeard
from upwash.mavlink.signing import SignatureRefusal
from upwash.real.mavlink.arducopter import ARDUCOPTER
from upwash.real.mavlink.identity import Identity, first_heartbeat
from upwash.real.mavlink.news import VehicleNewsFeed
from upwash.real.mavlink.px4_firmware import PX4
from upwash.sim.loop import run_virtually

APM, PX, NONE = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_INVALID
QUAD, HEXA, PLANE = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_TYPE_HEXAROTOR, mavlink.MAV_TYPE_FIXED_WING


def from_(message: Any, system: int = 1, component: int = 1) -> Any:
    codec = mavlink.MAVLink(None, system, component)
    (read,) = mavlink.MAVLink(None).parse_buffer(bytes(message.pack(codec)))
    return read


def beat(system: int = 1, autopilot: int = APM, kind: int = QUAD, *, component: int = 1) -> Any:
    return from_(mavlink.MAVLink_heartbeat_message(kind, autopilot, 81, 4, 3, 3), system, component)


def position(boot_ms: int, system: int = 1) -> Any:
    return from_(mavlink.MAVLink_global_position_int_message(boot_ms, 1, 1, 1, 1, 0, 0, 0, 0), system)


def attitude(boot_ms: int) -> Any:
    return from_(mavlink.MAVLink_attitude_message(boot_ms, *(0.0,) * 6))


def system_time(boot_ms: int) -> Any:
    return from_(mavlink.MAVLink_system_time_message(0, boot_ms))


def local(boot_ms: int) -> Any:
    return from_(mavlink.MAVLink_local_position_ned_message(boot_ms, *(0.0,) * 6))


def version(uid: int) -> Any:
    numbers = [0] * 8
    return from_(
        mavlink.MAVLink_autopilot_version_message(0, 0, 0, 0, 0, numbers, numbers, numbers, 0, 0, uid)
    )


class Link:
    """An identity, and what it told."""

    def __init__(self, system: int | None = None) -> None:
        self.told: list[Any] = []
        news = VehicleNewsFeed()
        news.listen(self.told.append)
        self.identity = Identity([ARDUCOPTER, PX4], system=system, news=news)

    def hear(self, *messages: Any) -> list[bool]:
        """Which of them are believed to be the vehicle's."""
        believed = []
        for number, message in enumerate(messages):
            self.identity.meet(message)
            ours = (message.get_srcSystem(), message.get_srcComponent()) == self.identity.ids
            believed.append(ours and self.identity.believes(message, number / 10))
        return believed

    @property
    def kinds(self) -> list[str]:
        return [each.about for each in self.told]


def test_the_only_one_is_followed_whatever_else_has_heartbeats() -> None:
    link = Link()
    link.hear(
        beat(255, NONE, mavlink.MAV_TYPE_GCS, component=190),
        beat(255, APM, mavlink.MAV_TYPE_GCS),
        beat(1, NONE, mavlink.MAV_TYPE_GIMBAL, component=154),
        beat(1, NONE, mavlink.MAV_TYPE_CAMERA, component=100),
        beat(1, APM, QUAD, component=2),
        beat(9, mavlink.MAV_AUTOPILOT_GENERIC, QUAD),
        beat(10, APM, mavlink.MAV_TYPE_ANTENNA_TRACKER),
        beat(),
        beat(12, NONE, QUAD),
    )
    assert link.identity.ids == (1, 1)
    assert str(link.identity.vehicle) == "system 1, component 1 (ArduCopter quadrotor)"
    assert link.identity.doubt == ""
    assert link.told == []


@pytest.mark.parametrize("first", [1, 2])
@pytest.mark.parametrize("other", [beat(7), beat(7, PX, HEXA), beat(7, APM, PLANE)])
def test_of_two_vehicles_neither_is_flown_and_both_are_named(first: int, other: Any) -> None:
    link = Link()
    link.hear(*(beat(2), other) if first == 1 else (other, beat(2)))
    doubt = link.identity.doubt
    assert "system 2, component 1 (ArduCopter quadrotor)" in doubt
    assert "system 7, component 1 (" in doubt
    assert "system = 2 or system = 7 in [autopilot]" in doubt


def test_the_system_that_was_said_is_followed_whoever_is_heard_first() -> None:
    link = Link(system=1)
    assert link.hear(beat(2), beat(1, PX, HEXA), beat(2)) == [False, True, False]
    assert link.identity.ids == (1, 1)
    assert link.identity.firmware is PX4
    assert link.identity.doubt == ""
    assert link.told == []


def test_a_system_that_is_not_there_is_named_beside_those_that_are() -> None:
    link = Link(system=1)
    link.hear(beat(2), beat(3, PX, HEXA))
    assert link.identity.vehicle is None
    heard = link.identity.heard_instead("tcp:here:1")
    assert heard == "system 1 was not heard on tcp:here:1; heard: 2 (ArduCopter quadrotor), 3 (PX4 hexarotor)"


@pytest.mark.parametrize(
    "another",
    [
        beat(1, NONE, mavlink.MAV_TYPE_ONBOARD_CONTROLLER),
        beat(1, NONE, QUAD),
        beat(1, PX),
        beat(1, APM, PLANE),
        beat(1, APM, mavlink.MAV_TYPE_GCS),
    ],
)
def test_another_programs_heartbeats_with_the_vehicles_ids_say_nothing_of_it(another: Any) -> None:
    link = Link()
    assert link.hear(beat(), another, beat(), another) == [True, False, True, False]
    assert link.kinds == ["another-program"]
    assert "another program sends heartbeats with this vehicle's ids" in link.told[0].why
    assert link.identity.doubt == ""


def test_an_arducopter_that_boots_does_not_know_its_type_yet() -> None:
    link = Link()
    assert link.hear(beat(kind=mavlink.MAV_TYPE_GENERIC)) == [False]
    assert not link.identity.is_unflyable
    assert link.hear(beat(), beat(kind=mavlink.MAV_TYPE_GENERIC), beat()) == [True, False, True]
    assert link.told == []


def test_another_vehicle_that_comes_later_is_told_once() -> None:
    link = Link()
    met = [link.identity.meet(heard) for heard in (beat(), beat(2), beat(2), beat(3), beat())]
    assert met == [True, False, False, False, False]
    assert link.kinds == ["another-vehicle"]


def interleaved(*clocks: Callable[[int], int]) -> list[Any]:
    return [position(clock(time_ms)) for time_ms in range(0, 3000, 100) for clock in clocks]


def test_two_clocks_since_boot_are_two_vehicles() -> None:
    link = Link()
    link.hear(beat(), *interleaved(lambda ms: 600_000 + ms, lambda ms: 41_000 + ms))
    assert "two vehicles with system 1 are on the link (two clocks since boot)" in link.identity.doubt
    assert link.kinds == ["same-id"]


def test_a_simulated_clock_that_is_fast_and_whose_messages_come_late_is_one_vehicle() -> None:
    link = Link()
    fast = [position(10 * time_ms) for time_ms in range(0, 10_000, 100)]
    link.hear(beat(), *(message for pair in zip(fast[3:], fast, strict=False) for message in pair))
    assert link.identity.doubt == ""


def test_a_system_that_was_said_does_not_tell_two_vehicles_of_it_apart() -> None:
    link = Link(system=1)
    link.hear(beat(), version(7), version(7))
    assert link.identity.doubt == ""
    link.hear(version(8))
    assert "two serial numbers of hardware" in link.identity.doubt


@pytest.mark.parametrize("speed", [0.3, 1.0, 5.0])
def test_one_clock_that_restarts_is_one_vehicle(speed: float) -> None:
    link = Link()
    before = [
        kind(round((900_000 + ms) * speed)) for ms in range(0, 3000, 100) for kind in (position, attitude)
    ]
    late_ms = [ms - 200 * (ms % 300 == 0) for ms in range(400, 6000, 100)]
    after = [kind(round(ms * speed)) for ms in late_ms for kind in (position, attitude, system_time, local)]
    link.hear(beat(), *before, system_time(round(902_000 * speed)), local(round(902_500 * speed)), *after)
    assert link.identity.doubt == ""


class Silence:
    """A link on which nothing comes."""

    connection = "udp:1"
    refused: SignatureRefusal | None = None
    why_silent = ""


def wait_for_a_vehicle(
    link: Link, *, within_s: float, refused: SignatureRefusal | None = None
) -> tuple[AutopilotError, float, list[float]]:
    """The error of a wait in vain, after how many seconds, and when its reason was told."""
    told_s: list[float] = []

    async def wait() -> tuple[AutopilotError, float]:
        silence: Any = Silence()
        silence.refused = refused
        nothing = asyncio.get_running_loop().create_future()
        with pytest.raises(AutopilotError) as found:
            await first_heartbeat(
                silence,
                link.identity,
                lambda: asyncio.shield(nothing),
                within_s=within_s,
                waiting=lambda _, waited_s: told_s.append(waited_s),
            )
        return found.value, asyncio.get_running_loop().time()

    return *run_virtually(wait()), told_s


def test_a_wait_for_a_silent_vehicle_tells_why_from_time_to_time_and_ends() -> None:
    error, ended_s, told_s = wait_for_a_vehicle(Link(), within_s=40.0)
    assert (ended_s, told_s) == (40.0, [3.0, 18.0, 33.0])
    assert isinstance(error, AutopilotNotHeard)
    assert "no autopilot was heard on udp:1; 40 s were waited: check that it is powered" in str(error)


def test_no_longer_wait_is_made_for_a_vehicle_that_cannot_be_flown() -> None:
    link = Link()
    link.hear(beat(kind=PLANE))
    error, ended_s, _ = wait_for_a_vehicle(link, within_s=40.0)
    assert ended_s == 10.0
    assert not isinstance(error, AutopilotNotHeard)
    assert "nothing else came within 10 s" in str(error)
    error, ended_s, _ = wait_for_a_vehicle(link, within_s=7.0)
    assert ended_s == 7.0
    assert "nothing else came within 7 s" in str(error)


@pytest.mark.parametrize(
    "kind",
    [
        PLANE,
        mavlink.MAV_TYPE_HELICOPTER,
        mavlink.MAV_TYPE_COAXIAL,
        mavlink.MAV_TYPE_GENERIC_MULTIROTOR,
        mavlink.MAV_TYPE_VTOL_QUADROTOR,
    ],
)
@pytest.mark.parametrize("autopilot", [APM, PX])
def test_only_multicopters_that_their_type_names_are_flown(autopilot: int, kind: int) -> None:
    link = Link()
    link.hear(beat(1, autopilot, kind))
    assert link.identity.is_unflyable
    rule = "only multicopters with ArduCopter or PX4 can be flown, of a type that names three rotors or more"
    assert rule in link.identity.heard_instead("udp:1")


@pytest.mark.parametrize(
    "kind",
    [
        mavlink.MAV_TYPE_TRICOPTER,
        QUAD,
        HEXA,
        mavlink.MAV_TYPE_OCTOROTOR,
        mavlink.MAV_TYPE_DECAROTOR,
        mavlink.MAV_TYPE_DODECAROTOR,
    ],
)
def test_multicopters_are_flown_however_many_rotors_they_have(kind: int) -> None:
    link = Link()
    link.hear(beat(kind=kind))
    assert link.identity.ids == (1, 1)


@pytest.mark.parametrize(("system", "who"), [(None, "no autopilot was"), (1, "system 1 was not")])
def test_what_came_instead_of_the_vehicle_is_named(system: int | None, who: str) -> None:
    link = Link(system)
    radio = from_(mavlink.MAVLink_radio_status_message(0, 0, 0, 0, 0, 0, 0), 51, 68)
    link.hear(
        radio,
        beat(255, NONE, mavlink.MAV_TYPE_GCS, component=190),
        beat(1, NONE, mavlink.MAV_TYPE_GIMBAL, component=154),
    )
    error, _, _ = wait_for_a_vehicle(link, within_s=20.0)
    came = "system 51, component 68 (RADIO_STATUS), system 255, component 190 (gcs), system 1, component 154 (gimbal)"
    assert f"{who} heard on udp:1; heard: {came}; nothing else came within 20 s" in str(error)
    assert isinstance(error, AutopilotNotHeard)


@pytest.mark.parametrize("refused", [SignatureRefusal.UNSIGNED, SignatureRefusal.OTHER_KEY])
def test_no_longer_wait_is_made_for_a_vehicle_with_another_key(refused: SignatureRefusal) -> None:
    error, ended_s, _ = wait_for_a_vehicle(Link(), within_s=40.0, refused=refused)
    assert ended_s == 10.0
    assert f"an autopilot was heard on udp:1, and its messages {refused.value}" in str(error)
