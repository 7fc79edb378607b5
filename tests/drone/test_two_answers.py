"""Calls with a first answer of the drone, and a better one of a server by a deadline, on virtual time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.drone.test_pending import of
from tests.preflight.test_check import here
from tests.scenarios import fault, scenario, server

from upwash import Drone
from upwash.config.drone import DroneConfig
from upwash.drone.resumption import waypoints_done
from upwash.errors import ConfigError, UsageError
from upwash.eventlog import schema
from upwash.lab.bounds import bound_of
from upwash.lab.run import Run, simulate
from upwash.preflight.check import check, read_plan
from upwash.report.record import record_of
from upwash.services import Detector

# The drone answers in 1 s (light) or 10 s (heavy), the server in 4 s (heavy). A leg of 20 m takes 9 s.
TWO = {"first": "light", "within_s": 20.0}
NEAR = server(
    "s1",
    20.0,
    0.0,
    range_m=500.0,
    check_s=0.5,
    check_running_s=0.5,
    remote_call_s={"light": 0.5, "heavy": 4.0},
)
ROWS = {"photos": {"every_m": 20.0}}
MISSED = {"every": 1, "missed": {"light": 1.0}}  # only the better answers demand something
FALSE = {"probability": 0.0, "false_alarms": {"light": 1.0}}  # only the first ones do


def configured(
    *servers: dict[str, Any], two: dict[str, Any] | None = TWO, mode: str = "heavy", **tables: Any
) -> DroneConfig:
    service = {"name": "detector", "local_call_s": {"light": 1.0, "heavy": 10.0}}
    mission = {"mode": mode, "action_s": 2.0, **tables.pop("mission", {})}
    if two is not None:
        service["two_answers"] = two
    return scenario(*servers, **{"columns": 3, "rows": 1, "service": [service], "mission": mission, **tables})


def fly(*servers: dict[str, Any], **tables: Any) -> Run:
    run = simulate(configured(*servers, **tables))
    assert run.failure == "" and run.result.completed
    return run


def acted(run: Run) -> list[int]:
    return [event.waypoint for event in of(list(run.events), schema.Acted) if event.waypoint is not None]


def turned(run: Run) -> list[int | None]:
    return [event.waypoint for event in of(list(run.events), schema.TurnedBack)]


@pytest.mark.parametrize("mission", [{}, ROWS], ids=["stops", "rows"])
@pytest.mark.parametrize(
    ("event", "acts"),
    [({"every": 1}, True), (MISSED, True), (FALSE, True), ({"probability": 0.0}, False)],
    ids=["both", "better", "first", "none"],
)
def test_a_demand_of_either_answer_is_met_once_and_a_better_one_turns_the_drone_back(
    mission: dict[str, Any], event: dict[str, Any], acts: bool
) -> None:
    run = fly(NEAR, mission=mission, event=event)
    if event is FALSE and mission:  # the better answer is there before the drone is at its spot
        assert (turned(run), acted(run)) == ([0], [2])
    else:
        assert sorted(acted(run)) == ([0, 1, 2] if acts else [])
    if not mission:
        assert turned(run) == ([0, 1] if event is MISSED else [])  # the last one's is awaited at its waypoint
    firsts = of(list(run.events), schema.FirstAnswer)
    assert [first.delay_s for first in firsts] == [pytest.approx(1.0)] * 3
    assert len(run.result.calls) == 3


@pytest.mark.parametrize(("event", "told"), [(MISSED, 3), (FALSE, 0)], ids=["better", "first"])
def test_a_survey_that_tells_tells_the_better_answers(event: dict[str, Any], told: int) -> None:
    run = fly(NEAR, mission={**ROWS, "action_s": 0.0}, event=event)
    assert len(of(list(run.events), schema.Notified)) == told
    assert turned(run) == acted(run) == []


def test_a_drone_that_stays_waits_for_the_first_answer_alone() -> None:
    both, light = fly(NEAR), fly(two=None, mode="light")
    assert [(call.server, call.key) for call in both.result.calls] == [("s1", "heavy")] * 3
    last_s = 4.0 - 1.0  # it waits for the last better answer before the way home
    assert both.result.mission_time_s == pytest.approx(light.result.mission_time_s + last_s, abs=0.1)


def test_the_next_call_does_not_wait_for_a_better_answer_to_one_whose_act_was_put_off() -> None:
    grid = {"columns": 3, "rows": 1, "spacing_m": 40.0}
    mission = {"ground_speed_m_s": 12.0, "grid": grid}
    by_rules = {"policy": {"stay_or_go": "go"}, "vehicle": {"profile": "arducopter"}}
    run = fly(event={"every": 1}, mission=mission, **by_rules)
    assert [event.waypoint for event in of(list(run.events), schema.PutOff)] == [0, 1]
    assert acted(run) == [2, 1, 0]


@pytest.mark.parametrize("mission", [{}, ROWS], ids=["stops", "rows"])
def test_without_a_server_the_first_answer_counts_alone_and_nothing_waits(mission: dict[str, Any]) -> None:
    alone, light = fly(mission=mission), fly(two=None, mode="light", mission=mission)
    assert alone.result.mission_time_s == pytest.approx(light.result.mission_time_s)
    assert [(call.key, call.asked) for call in alone.result.calls] == [
        ("light", "detector.process_photo[heavy]")
    ] * 3
    assert (alone.result.totals.first_alone, alone.result.totals.lighter) == (3, 0)


@pytest.mark.parametrize("mission", [{}, ROWS], ids=["stops", "rows"])
@pytest.mark.parametrize("within_s", [5.0, 20.0])
def test_no_better_answer_counts_after_the_deadline(mission: dict[str, Any], within_s: float) -> None:
    stuck = fault("link:s1", "stuck", from_s=12.0)
    run = fly(NEAR, two={**TWO, "within_s": within_s}, faults=[stuck], mission=mission, event=MISSED)
    assert {call.key for call in run.result.calls} == {"light"} and acted(run) == []
    assert max(call.delay_s for call in run.result.calls) <= within_s + 0.01


def test_no_better_answer_is_asked_for_that_cannot_come_by_the_deadline() -> None:
    for within_s, asked in ((3.5, None), (4.5, "s1")):  # the server answers in 4 s
        run = fly(NEAR, two={**TWO, "within_s": within_s})
        assert {event.server for event in of(list(run.events), schema.Decided)} == {asked}
        assert not of(list(run.events), schema.RemoteFailed)  # the server is not blamed for the deadline


def test_a_server_that_becomes_ready_too_late_is_not_asked_for_a_better_answer() -> None:
    starting = {**NEAR, "check_s": 12.5, "check_running_s": 12.5}  # READY 1.5 s after the first call
    for within_s, asked in ((5.0, []), (6.0, ["for the better answer"])):
        run = fly(starting, two={**TWO, "within_s": within_s})
        assert [event.why for event in of(list(run.events), schema.Decided) if event.t == 12.5] == asked
        assert not of(list(run.events), schema.RemoteFailed)


@pytest.mark.parametrize("manner", ["stay", "go"])
@pytest.mark.parametrize("event", [MISSED, {"probability": 0.0}], ids=["better", "none"])
def test_the_forecast_and_the_least_time_count_the_first_answer(event: dict[str, Any], manner: str) -> None:
    config = configured(NEAR, event=event, policy={"stay_or_go": manner})
    run = simulate(config)
    least, took_s = bound_of(run, config), run.result.mission_time_s
    assert least is not None and least.free_s <= took_s + 1e-6
    (foreseen,) = of(list(run.events), schema.Foreseen)
    if event is not MISSED and manner == "stay":
        assert foreseen.as_asked_s == pytest.approx(
            took_s - 3.0, abs=1.0
        )  # the last better answer comes late


def test_a_server_that_is_sooner_than_the_drone_answers_alone() -> None:
    quick = {**NEAR, "remote_call_s": {"light": 0.5, "heavy": 0.7}}
    assert of(list(fly(quick).events), schema.FirstAnswer) == []
    failing = fly(quick, faults=[fault("s1", "garbage", from_s=5.0, to_s=14.0)])
    first = failing.result.calls[0]
    assert (first.server, first.key) == ("s1", "heavy"), "the server is tried again by the deadline"
    assert first.first_s is not None


def test_servers_are_chosen_for_the_calls_as_asked_for() -> None:
    slow = {
        **NEAR,
        "remote_call_s": {"light": 2.0, "heavy": 4.0},
    }  # slower for the first answers than the drone
    assert {call.server for call in fly(slow, columns=6).result.calls} == {"s1"}


def test_calls_that_ask_for_the_first_key_have_one_answer() -> None:
    run = fly(NEAR, mode="light")
    assert of(list(run.events), schema.FirstAnswer) == []
    assert {call.key for call in run.result.calls} == {"light"}


HEARD: list[Any] = []


def hears_both(drone: Drone) -> None:
    """Take both answers by hand, and make a call that waits for its last one."""
    detector = drone.service(Detector)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    drone.autopilot.goto(drone.plan[0])
    photo = drone.camera.take_photo()
    pending = drone.start(detector.process_photo, photo, mode="heavy")
    HEARD.append((len(pending.first()), pending.done()))
    HEARD.append((len(pending.result()), len(pending.first()), pending.done()))
    HEARD.append(len(detector.process_photo(photo, mode="heavy")))
    dropped = drone.start(detector.process_photo, photo, mode="heavy")
    dropped.first()
    dropped.cancel()
    HEARD.append(len(detector.process_photo(photo, mode="light")))
    drone.end_flight()
    drone.autopilot.disarm()


def test_a_mission_takes_the_first_answer_and_then_the_better_one() -> None:
    HEARD.clear()
    run = fly(NEAR, mission={"program": f"{__name__}:hears_both"}, event=MISSED)
    assert HEARD == [(0, False), (1, 1, True), 1, 0]
    dropped = run.result.calls[2]  # after its first answer
    assert [call.delay_s for call in run.result.calls[:2]] == [pytest.approx(4.0, abs=0.1)] * 2
    assert dropped.key == "light" and dropped.delay_s == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("mission", [{}, ROWS], ids=["stops", "rows"])
def test_a_crash_between_the_answers_has_the_photo_taken_again(mission: dict[str, Any]) -> None:
    run = fly(NEAR, mission=mission)
    config = scenario(NEAR, columns=3, rows=1, mission={"mode": "heavy", **mission})
    events = list(run.events)
    first = next(number for number, event in enumerate(events) if isinstance(event, schema.FirstAnswer))
    taken = next(number for number, event in enumerate(events) if isinstance(event, schema.AnswerTaken))
    assert 0 not in waypoints_done(events[: first + 1], config)
    after = next(n for n, event in enumerate(events) if n > taken and isinstance(event, schema.SetOff))
    assert 0 in waypoints_done(events[: after + 1], config)


@pytest.mark.parametrize(
    ("two", "says"),
    [
        ({"first": "tiny", "within_s": 9.0}, "unknown|heavy"),
        ({"first": "heavy", "within_s": 9.0}, "name the fastest"),
        ({"first": "light", "within_s": 0.5}, "give more"),
    ],
)
def test_two_answers_that_cannot_be_are_refused(two: dict[str, Any], says: str) -> None:
    with pytest.raises((ConfigError, UsageError), match=says):
        fly(NEAR, two=two)


def test_a_deadline_that_no_server_keeps_is_told_before_take_off_and_in_the_report(tmp_path: Path) -> None:
    names = [event.kind for event in fly(NEAR, two={**TWO, "within_s": 3.0}).events]
    assert names.index("no_better_answer") < names.index("mission_started")
    file = tmp_path / "mission.toml"
    file.write_text(
        'mission = { mode = "heavy", waypoints_m = [[0, 0], [20, 0]] }\n'
        '[[service]]\nname = "detector"\nlocal_call_s = { light = 1.0, heavy = 10.0 }\n'
        'two_answers = { first = "light", within_s = 3.0 }\n'
        '[[server]]\nname = "s1"\neast_m = 0.0\nnorth_m = 0.0\nrange_m = 100.0\n'
        "remote_call_s = { light = 0.5, heavy = 4.0 }\n"
    )
    found = check(read_plan(file), seeds=1, fly=here)
    assert [warning.kind for warning in found.warnings] == ["no-better-answer"]
    run = simulate(read_plan(file).config)
    ending = record_of(run.events, file).ending
    assert "within 3 s, the fastest takes 4 s" in " ".join(ending.cautions)
