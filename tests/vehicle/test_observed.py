"""The stand-in beside what a real ArduCopter was seen to do, figure by figure (data/README.md)."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from typing import Any

import pytest
from bench.flights import OBSERVED, READ_S, SETTINGS, Flight, measured, rows
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.vehicle.direct import directly_linked

from upwash.core.geo import Position, ground_distance_m
from upwash.sim.loop import run_virtually
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.firmware import ArduCopterFirmware
from upwash.vehicle.ardupilot.settings import CopterMode, VehicleSettings
from upwash.vehicle.body.copter import FaultKind, LandedState, Result, VehicleFault


def close_to(quantity: str, *, fineness: float = 0.0) -> Any:
    return pytest.approx(OBSERVED[quantity], rel=0.05, abs=max(fineness, 0.05 * OBSERVED[quantity]))


def test_it_flies_and_returns_in_the_recorded_times() -> None:
    for quantity, value in measured():
        fineness = 0.1 if quantity.startswith("overshoot") else 0.0
        assert value == close_to(quantity, fineness=fineness), quantity


def test_it_creeps_back_to_its_target() -> None:
    flight = Flight()
    flight.fly(Position(60.0, 0.0, 10.0), at_m_s=5.0)
    flight.wait(10.0)
    assert flight.place.east_m == pytest.approx(60.0, abs=0.1)


def test_a_take_off_lifts_after_arming_however_late_it_is_told() -> None:
    for told_after_s, quantity in (0.5, "lifts off after arming"), (6.0, "lifts off after a late command"):
        copter = Copter(SETTINGS, now_s=0.0)
        copter.change_mode(0.0, CopterMode.GUIDED)
        copter.arm(0.0)
        copter.take_off(told_after_s, 10.0)
        lifts_s = next(tenth / 10 for tenth in range(300) if copter.flying(tenth / 10))
        counts_from_s = 0.0 if told_after_s < 1 else told_after_s
        assert lifts_s - counts_from_s == close_to(quantity, fineness=0.11)


@pytest.mark.parametrize("altitude_m", [10, 12])
def test_take_offs(altitude_m: float) -> None:
    copter = Copter(SETTINGS, now_s=0.0)
    copter.change_mode(0.0, CopterMode.GUIDED)
    copter.arm(0.0)
    copter.take_off(0.0, altitude_m)
    states = [copter.landed_state(tenth / 10) for tenth in range(300)]
    up_s = (states.index(LandedState.IN_AIR) - states.index(LandedState.TAKEOFF)) / 10
    assert up_s == close_to(f"take-off to {altitude_m} m")


@pytest.mark.parametrize(("altitude_m", "away_m"), [(10, 20), (10, 40), (10, 60), (15, 10)])
def test_returns(altitude_m: float, away_m: float) -> None:
    flight = Flight(altitude_m)
    flight.fly(Position(0.0, away_m, altitude_m), at_m_s=5.0)
    flight.wait(10.0)
    flight.copter.change_mode(flight.now_s, CopterMode.RTL)
    begun_s, name = flight.now_s, f"return from {altitude_m} m high and {away_m} m away"
    flight.until(lambda: flight.copter.landed_state(flight.now_s) is LandedState.LANDING)
    assert flight.now_s - begun_s == close_to(f"{name}: descends")
    flight.until_landed()
    down_s = flight.now_s
    assert down_s - begun_s == close_to(f"{name}: touches down")
    flight.until(lambda: flight.copter.landed_state(flight.now_s) is LandedState.ON_GROUND)
    assert flight.now_s - down_s == close_to("touchdown to on ground", fineness=0.11)
    flight.until(lambda: not flight.copter.armed(flight.now_s))
    assert flight.now_s - down_s == close_to("touchdown to disarmed", fineness=0.11)
    assert flight.said[-1][1:] == (6, "Disarming motors")
    assert ground_distance_m(flight.place, Position(0.0, 0.0)) < 0.01


def test_a_landing() -> None:
    flight = Flight()
    flight.wait(10.0)
    flight.copter.change_mode(flight.now_s, CopterMode.LAND)
    assert flight.until_landed() == close_to("landing from 10 m", fineness=2.9)


def test_a_hold_in_flight_runs_on_and_comes_back() -> None:
    flight = Flight()
    flight.copter.steer(flight.now_s, Position(60.0, 0.0, 10.0))
    flight.copter.change_speed(flight.now_s, 5.0)
    flight.until(lambda: flight.speed_m_s >= 4.9)
    here = flight.place
    flight.copter.steer(flight.now_s, here)
    flight.wait(2.5)
    assert flight.place.east_m - here.east_m == close_to("hold at 4.9 m/s runs on")
    flight.wait(6.0)
    assert flight.arrived(here)


def test_a_speed_changes_in_flight_without_a_stop() -> None:
    flight, target = Flight(), Position(60.0, 0.0, 10.0)
    begun_s = flight.now_s
    flight.copter.steer(flight.now_s, target)
    slowest_m_s = 9.0
    for at_s, speed_m_s in (0.0, 5.0), (4.9, 2.5), (10.0, 6.0):
        flight.wait(begun_s + at_s - flight.now_s)
        slowest_m_s = min(slowest_m_s, flight.speed_m_s) if at_s else slowest_m_s
        flight.copter.change_speed(flight.now_s, speed_m_s)
    flight.until(lambda: flight.arrived(target))
    assert flight.now_s - begun_s == close_to("leg 60 m at 5 then 2.5 then 6 m/s")
    assert slowest_m_s > 2.3


def test_a_target_changes_in_flight_without_a_stop() -> None:
    flight = Flight()
    flight.fly(Position(60.0, 20.0, 10.0), at_m_s=6.0)
    flight.wait(10.0)
    flight.copter.steer(flight.now_s, Position(20.0, 20.0, 10.0))
    flight.wait(4.0)
    assert flight.place.east_m == pytest.approx(45.6, abs=0.8)
    target = Position(40.0, 50.0, 10.0)
    begun_s = flight.now_s
    flight.copter.steer(flight.now_s, target)
    slowest_m_s = 9.0
    while flight.now_s < begun_s + 6.0:
        flight.wait(READ_S)
        slowest_m_s = min(slowest_m_s, flight.speed_m_s)
    flight.until(lambda: flight.arrived(target))
    assert flight.now_s - begun_s == close_to("new target at right angles in flight")
    assert slowest_m_s > 3.0


def test_a_row_that_begins_as_it_arrives_runs_beside_its_line_at_first() -> None:
    flight = Flight()
    flight.fly(Position(0.0, 20.0, 10.0), at_m_s=8.0)  # the next target is sent as it arrives, below 0.5 m/s
    flight.copter.steer(flight.now_s, Position(200.0, 20.0, 10.0))
    off_m = []
    while flight.place.east_m < 20.0:
        flight.wait(READ_S)
        off_m.append(flight.place.north_m - 20.0)
    assert 0.4 < max(off_m) < 0.7, "a real one 0.57 m"
    assert 0.0 < off_m[-1] < 0.35, "a real one 0.3 m"


def test_it_turns_its_nose_in_time() -> None:
    flight = Flight()
    flight.copter.steer(flight.now_s, Position(60.0, 0.0, 10.0))
    turn_s = flight.until(lambda: flight.copter.heading_deg(flight.now_s) > 89)
    assert turn_s == close_to("turn by 90 degrees", fineness=0.2)
    flight.copter.change_mode(flight.now_s + 20.0, CopterMode.RTL)
    flight.wait(40.0)
    assert flight.copter.heading_deg(flight.now_s) == pytest.approx(90.0, abs=1.0)


def test_without_a_take_off_it_disarms() -> None:
    copter = Copter(SETTINGS, now_s=0.0)
    copter.arm(0.0)
    armed_s = next(tenth / 10 for tenth in range(300) if not copter.armed(tenth / 10))
    assert armed_s == close_to("disarms without a take-off")


def test_without_gps_it_lands_where_it_is() -> None:
    flight = Flight()
    flight.copter.fail(FaultKind.GPS, flight.now_s)
    lost_s = flight.now_s
    lands_s = flight.until(lambda: flight.copter.mode is CopterMode.LAND)
    assert lands_s == close_to("lands without GPS")
    assert flight.copter.critical()
    assert flight.copter.ekf_flags(flight.now_s) == 37
    flight.copter.change_mode(flight.now_s, CopterMode.RTL)
    assert [(text.severity, text.words) for text in flight.copter.said()] == [
        (4, "Mode change to RTL failed: requires position")
    ]
    assert flight.until_landed() == close_to("lands without GPS from 10 m: touches down")
    told = [(round(at_s - lost_s), severity, words) for at_s, severity, words in flight.said if at_s > lost_s]
    assert told == [
        (8, 2, "EKF variance"),
        (8, 2, "EKF Failsafe: changed to LAND Mode"),
        (15, 4, "EKF3 IMU0 stopped aiding"),
        (15, 4, "EKF3 IMU1 stopped aiding"),
        (22, 4, "SmartRTL deactivated: bad position"),
    ]
    assert flight.copter.ekf_flags(flight.now_s) == 167


@pytest.mark.parametrize(
    ("action", "mode"), [(0, CopterMode.GUIDED), (1, CopterMode.LAND), (2, CopterMode.RTL)]
)
def test_a_low_battery(action: float, mode: CopterMode) -> None:
    flight = Flight(settings=replace(SETTINGS, parameters={"BATT_FS_LOW_ACT": action}))
    flight.copter.fail(FaultKind.BATTERY, flight.now_s)
    assert flight.until(flight.copter.critical) == close_to("battery fail-safe")
    assert flight.copter.mode is mode
    words = [text for _, severity, text in flight.said if severity == 4]
    assert words[0].startswith("Battery 1 is low 10.00V used ")
    assert words[1:] == (["Battery Failsafe"] if action else [])
    if action:
        flight.until(lambda: not flight.copter.armed(flight.now_s))
        flight.wait(3.0)
        assert [text for _, _, text in flight.said[-2:]] == [
            "PreArm: Battery 1 low voltage failsafe",
            "PreArm: Battery failsafe",
        ]
        assert flight.copter.critical()


def test_a_radio_and_a_ground_station_out_of_reach() -> None:
    flight = Flight()
    flight.copter.fail(FaultKind.RADIO, flight.now_s)
    assert flight.until(lambda: flight.copter.mode is CopterMode.RTL) == close_to(
        "radio fail-safe", fineness=0.11
    )
    assert flight.said[-1][1:] == (4, "Radio Failsafe")
    flight = Flight(settings=replace(SETTINGS, parameters={"FS_GCS_ENABLE": 1}))
    flight.copter.hear_ground_station(flight.now_s)
    assert flight.until(lambda: flight.copter.mode is CopterMode.RTL) == close_to("ground station fail-safe")
    assert flight.said[-1][1:] == (4, "GCS Failsafe")
    assert flight.copter.critical()


def test_a_glitch_moves_it_unseen() -> None:
    flight = Flight(settings=replace(SETTINGS, faults=(VehicleFault(FaultKind.GLITCH, 30.0, 45.0),)))
    flight.wait(30.0 - flight.now_s)
    target = Position(20.0, 0.0, 10.0)
    flight.copter.steer(flight.now_s, target)
    jumps_s = flight.until(lambda: flight.place.north_m > 40.0)
    assert jumps_s == close_to("glitch is believed")
    assert flight.copter.ekf_flags(flight.now_s) == 33599
    flight.wait(45.0 - flight.now_s)
    flight.until(lambda: flight.place.north_m < -10.0)
    flight.until(lambda: flight.arrived(target))
    flight.until(lambda: flight.said[-1][2] == "Glitch cleared")
    assert flight.said[-1][0] - 45.0 == close_to("glitch is cleared")
    assert [(severity, words) for at_s, severity, words in flight.said if at_s > 30.0] == [
        (2, "EKF3 lane switch 1"),
        (4, "EKF primary changed:1"),
        (2, "EKF3 lane switch 0"),
        (4, "EKF primary changed:0"),
        (2, "GPS Glitch or Compass error"),
        (2, "EKF3 lane switch 1"),
        (4, "EKF primary changed:1"),
        (2, "EKF3 lane switch 0"),
        (4, "EKF primary changed:0"),
        (2, "EKF3 lane switch 1"),
        (4, "EKF primary changed:1"),
        (2, "EKF3 lane switch 0"),
        (4, "EKF primary changed:0"),
        (2, "Glitch cleared"),
    ]


@pytest.mark.parametrize(("size_m", "cleared_s"), [(55.66, 20.0), (30.0, 12.0)])
def test_a_glitch_that_lasts_counts_as_over_while_gps_is_still_off(size_m: float, cleared_s: float) -> None:
    settings = replace(
        SETTINGS,
        faults=(VehicleFault(FaultKind.GLITCH, 30.0, 80.0),),
        glitch_m=size_m,
        glitch_cleared_after_s=cleared_s,
    )
    flight = Flight(settings=settings)
    flight.wait(30.0 - flight.now_s)
    before_m = flight.place.north_m

    def flags() -> int:
        return flight.copter.ekf_flags(flight.now_s)

    flight.until(lambda: flight.place.north_m > before_m + 0.9 * size_m)
    assert flags() == 33599
    flight.until(lambda: flight.said[-1][2] == "Glitch cleared")
    assert flight.said[-1][0] - 30.0 == pytest.approx(cleared_s, abs=0.3)
    assert flags() == 831
    flight.wait(80.5 - flight.now_s)
    assert flags() == 831  # the second jump is not noticed yet
    flight.wait(82.0 - flight.now_s)
    assert flags() == 33599
    assert flight.said[-1][2] == "GPS Glitch or Compass error"
    flight.until(lambda: flight.said[-1][2] == "Glitch cleared")
    assert flight.said[-1][0] - 80.0 == pytest.approx(20.0, abs=0.3)
    assert flags() == 831


def test_a_glitch_may_never_count_as_over() -> None:
    settings = replace(
        SETTINGS, faults=(VehicleFault(FaultKind.GLITCH, 30.0, 90.0),), glitch_cleared_after_s=math.inf
    )
    flight = Flight(settings=settings)
    flight.wait(89.0 - flight.now_s)
    assert flight.copter.ekf_flags(flight.now_s) == 33599
    assert "Glitch cleared" not in [words for _, _, words in flight.said]


def test_a_height_fence_sends_it_home() -> None:
    fenced = replace(SETTINGS, parameters={"FENCE_ENABLE": 1, "FENCE_TYPE": 3, "FENCE_ALT_MAX": 8})
    copter = Copter(fenced, now_s=0.0)
    copter.change_mode(0.0, CopterMode.GUIDED)
    copter.arm(0.0)
    copter.take_off(0.0, 10.0)
    said, tenth = [], 0
    while copter.mode is CopterMode.GUIDED:
        tenth += 1
        copter.notice(tenth / 10)
        said = [text.words for text in copter.said()]
    assert copter.position(tenth / 10).altitude_m == pytest.approx(8.1, abs=0.3)
    assert said == ["Max Alt fence breached", "Manual recovery started"]
    assert (copter.fence.breach, copter.fence.breaches) == (2, 1)
    assert not copter.critical()


def test_it_says_what_a_real_one_said_at_boot() -> None:
    recorded = [(float(row["at_s"]), int(row["severity"]), row["text"]) for row in rows("boot.csv")]

    async def booted() -> list[tuple[float, int, str]]:
        clock = asyncio.get_running_loop().time
        heard: list[tuple[float, int, str]] = []

        def hear(message: Any) -> None:
            if message.get_type() == "STATUSTEXT":
                heard.append((clock() - begun_s, message.severity, message.text))

        begun_s = clock()
        async with directly_linked(VehicleSettings(home=SETTINGS.home), hear) as (vehicle, say):
            await asyncio.sleep(40.0)
            say(mavlink.MAVLink_set_mode_message(1, 1, int(CopterMode.GUIDED)))
            assert isinstance(vehicle.firmware, ArduCopterFirmware)
            while not vehicle.firmware.copter.armed(vehicle.now_s()):
                say(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
                await asyncio.sleep(2.0)
        return heard

    said = [each for each in run_virtually(booted()) if not each[2].startswith(("Arm:", "PreArm"))]
    assert [each[1:] for each in said] == [each[1:] for each in recorded]
    for (at_s, _, _), (recorded_s, _, _) in zip(said, recorded, strict=True):
        assert at_s == pytest.approx(recorded_s, abs=max(0.4, 0.05 * recorded_s))


@pytest.mark.parametrize("row", rows("refusals.csv"), ids=lambda row: f"{row['source']} at {row['at_s']} s")
def test_it_refuses_to_arm_with_the_words_of_a_real_one(row: dict[str, str]) -> None:
    faults = {"prearm_no_gps": FaultKind.GPS, "prearm_compass": FaultKind.COMPASS}
    fenced = {"FENCE_ENABLE": 1.0, "FENCE_RADIUS": 30.0} if row["source"] == "target_outside_fence" else {}
    settings = VehicleSettings(
        home=SETTINGS.home,
        faults=(VehicleFault(faults[row["source"]]),) if row["source"] in faults else (),
        parameters=fenced,
    )
    copter = Copter(settings, now_s=0.0)
    at_s = float(row["at_s"])
    for tick in range(round(at_s * 5)):
        copter.notice(tick / 5)
    copter.change_mode(at_s, CopterMode.GUIDED)
    copter.said()
    assert copter.arm(at_s) is Result.FAILED
    refusal = copter.said()
    assert [text.words for text in refusal] == row["texts"].split("; ")
    assert {text.severity for text in refusal} == {2}
    assert not copter.armable(at_s)


def test_it_complains_twice_a_minute() -> None:
    copter = Copter(VehicleSettings(home=SETTINGS.home, faults=(VehicleFault(FaultKind.GPS),)), now_s=0.0)
    told_s = []
    for tenth in range(1300):
        copter.notice(tenth / 10)
        told_s += [tenth / 10 for text in copter.said() if text.words == "PreArm: GPS 1: Bad fix"]
    assert told_s == pytest.approx([30.4, 61.4, 92.4, 123.4], abs=0.2)
    assert not copter.critical()
