"""What a mission does with its vehicle beside flying: headings, telemetry, payloads, words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from tests.drone.test_safe_ends import fly as fly_safely
from tests.drone.test_safe_ends import scenario

from upwash.config.drone_file import read_drone_config
from upwash.errors import AutopilotRefused
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate
from upwash.sim.autopilot import ModelAutopilot

SCENARIO = """
[mission]
program = "mission.py:fly"
ground_speed_m_s = 5.0
waypoints_m = [[0, 50]]
"""
MISSION = """
def fly(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(10.0)
    {}
    drone.autopilot.return_home_and_land()
"""


def fly(folder: Path, *statements: str) -> Run:
    (folder / "mission.py").write_text(MISSION.format("\n    ".join(statements)))
    (folder / "scenario.toml").write_text(SCENARIO)
    return simulate(read_drone_config(folder / "scenario.toml"))


def test_a_mission_turns_the_vehicle_and_reads_how_it_flies(tmp_path: Path) -> None:
    run = fly(
        tmp_path,
        "autopilot = drone.autopilot",
        "assert autopilot.telemetry.heading_deg is None",
        "autopilot.turn_to(130)",
        "told = autopilot.telemetry",
        "assert (told.heading_deg, told.attitude.yaw_deg, told.gps.kind) == (130, 130, '3d')",
        "assert told.armed and told.mode == 'GUIDED' and told.position.altitude_m == 10",
        "assert (told.ground_speed_m_s, told.climb_m_s) == (0, 0)",
        "assert autopilot.goto(drone.plan[0])",
        "assert autopilot.telemetry.heading_deg is None",
    )
    assert run.failure == ""
    (turned,) = (event for event in run.events if isinstance(event, schema.Turned))
    assert turned.heading_deg == 130
    took_off = next(event for event in run.events if isinstance(event, schema.TookOff))
    assert turned.t - took_off.t == pytest.approx(130 / 65)  # as fast as a recorded vehicle turns


def test_a_mission_sets_the_speed_of_its_legs_and_holds(tmp_path: Path) -> None:
    run = fly(
        tmp_path,
        "autopilot = drone.autopilot",
        "assert autopilot.ground_speed_m_s is None",
        "autopilot.goto(drone.plan[0])",
        "autopilot.set_ground_speed(2.5)",
        "assert autopilot.ground_speed_m_s == 2.5",
        "from upwash import Position",
        "autopilot.goto(Position(0.0, 0.0, 10.0))",
        "autopilot.hold()",
    )
    assert run.failure == ""
    arrived, slowly = (event for event in run.events if isinstance(event, schema.Arrived))
    took_off = next(event for event in run.events if isinstance(event, schema.TookOff))
    assert slowly.t - arrived.t > 1.5 * (arrived.t - took_off.t)
    assert [event.t for event in run.events if isinstance(event, schema.Holding)] == [slowly.t]


def test_what_is_done_with_a_payload_is_in_the_log(tmp_path: Path) -> None:
    run = fly(
        tmp_path,
        "drone.payload.point_gimbal(pitch_deg=-90)",
        "drone.payload.trigger_camera()",
        "drone.payload.command(183, 9, 1500)",
        "drone.autopilot.send_text('two hot spots', severity='warning')",
    )
    assert run.failure == ""
    done = [event for event in run.events if isinstance(event, schema.PayloadCommanded)]
    assert [event.name for event in done] == [
        "DO_GIMBAL_MANAGER_PITCHYAW",
        "DO_DIGICAM_CONTROL",
        "DO_SET_SERVO",
    ]
    assert done[0].parameters == [-90.0, 0.0, None, None]
    assert done[1].parameters == [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]
    (sent,) = (event for event in run.events if isinstance(event, schema.TextSent))
    assert (sent.severity, sent.text) == (4, "two hot spots")


def test_a_command_that_the_vehicle_refuses_ends_the_mission_and_is_not_logged() -> None:
    class Bare(ModelAutopilot):
        async def command(self, number: int, name: str, parameters: Sequence[float]) -> None:
            assert (number, parameters) == (183, (9, 1500))
            raise AutopilotRefused(name, "there is no servo")

    scene, error = fly_safely(scenario(), lambda drone: drone.payload.command(183, 9, 1500), autopilot=Bare)
    assert isinstance(error, AutopilotRefused) and "there is no servo" in str(error)
    assert not scene.events("payload_commanded")


@pytest.mark.parametrize(
    "shoot",
    ["drone.payload.trigger_camera()", "drone.payload.command(2000)", "drone.payload.command(203, 0, 0)"],
)
def test_a_camera_gets_no_second_trigger_while_its_shutter_may_be_held(tmp_path: Path, shoot: str) -> None:
    run = fly(tmp_path, shoot, shoot, "drone.payload.command(183, 9, 1500)", shoot)
    assert run.failure == ""
    times_s = [event.t for event in run.events if isinstance(event, schema.PayloadCommanded)]
    assert times_s[1] - times_s[0] == pytest.approx(0.5, abs=0.01)
    assert times_s[2] - times_s[1] < 0.01  # a servo does not wait
    assert times_s[3] - times_s[1] == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("drone.payload.command(400, 1)", "MAVLink command 400 is not sent"),  # arms
        ("drone.payload.command(176, 1, 4)", "MAVLink command 176 is not sent"),  # changes the mode
        ("drone.payload.command(16)", "MAVLink command 16 is not sent"),  # flies to a waypoint
        ("drone.payload.command(183, *range(8))", "8 parameters, and a command has at most 7"),
        ("drone.payload.point_gimbal(pitch_deg=-91)", "pitch_deg is -91: give degrees from -90 to 90"),
        ("drone.payload.point_gimbal(pitch_deg=float('nan'))", "pitch_deg is nan"),
        (
            "drone.payload.point_gimbal(pitch_deg=0, yaw_deg=180.5)",
            "yaw_deg is 180.5: give degrees from -180 to 180",
        ),
        ("drone.autopilot.turn_to(361)", "heading_deg is 361: give degrees from 0 to 360"),
        ("drone.autopilot.send_text('ä' * 101)", "202 bytes: give a text of 1 to 200 bytes"),
        ("drone.autopilot.send_text('')", "0 bytes: give a text"),
        ("drone.autopilot.send_text('hot', severity='hot')", "no severity 'hot'"),
    ],
)
def test_what_cannot_be_is_refused_and_the_drone_comes_home(
    tmp_path: Path, statement: str, said: str
) -> None:
    run = fly(tmp_path, statement)
    assert said in run.failure
    assert any(isinstance(event, schema.Landed) for event in run.events)
    assert not any(isinstance(event, schema.PayloadCommanded) for event in run.events)


def test_a_mission_that_has_landed_may_leave_the_motors_to_the_program(tmp_path: Path) -> None:
    run = fly(tmp_path, "drone.autopilot.hover(1)")  # and returns and lands, and no more
    assert run.failure == ""
    kinds = [event.kind for event in run.events]
    assert "safe_end" not in kinds, "nothing ended early"
    assert kinds[-3:].count("disarmed") == 1


def test_a_mission_that_stops_the_motors_itself_does_so_at_once(tmp_path: Path) -> None:
    run = fly(
        tmp_path,
        "drone.autopilot.land()",
        "drone.autopilot.disarm()",
        "assert not drone.autopilot.telemetry.armed",
        "return",
    )
    assert run.failure == ""
    assert [event.kind for event in run.events].count("disarmed") == 1
