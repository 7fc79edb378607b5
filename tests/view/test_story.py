"""What a page is told of a flight is what its log says, whenever it is asked."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import msgspec
import pytest
from tests.events import event
from tests.scenarios import scenario as survey

from upwash.cli.main import main
from upwash.eventlog import log as event_log
from upwash.eventlog import schema
from upwash.eventlog.narration import STATE_WORDS
from upwash.eventlog.reasons import explained_calls
from upwash.eventlog.schema import Event
from upwash.lab.run import simulate
from upwash.report.record import Record, read_records
from upwash.view import facts
from upwash.view.facts import Fact
from upwash.view.news import News

SCENARIOS = Path(__file__).parents[2] / "scenarios"
HERE = {"east_m": 3.0, "north_m": 4.0, "altitude_m": 20.0}
STARTED = event("mission_started", 2.0, policy="location-aware", waypoints=2)
BOX = {"left_px": 1.0, "top_px": 2.0, "width_px": 3.0, "height_px": 4.0, "label": "hot-spot"}
OneFact = TypeVar("OneFact", bound=Fact)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("logs") / "thesis.jsonl"
    assert main(["simulate", str(SCENARIOS / "thesis.toml"), "--log", str(file)]) == 0
    return file


@pytest.fixture(scope="module")
def told(log: Path) -> list[Fact]:
    return tell(event_log.read(log))


@pytest.fixture(scope="module")
def record(log: Path) -> Record:
    (record,) = read_records([log])
    return record


def tell(events: Iterable[Event]) -> list[Fact]:
    story = News(lambda source: source.startswith("park"))
    return [fact for event in events for fact in story.take(event)]


def those(kind: type[OneFact], told: Iterable[Fact]) -> list[OneFact]:
    return [fact for fact in told if isinstance(fact, kind)]


def test_the_forecast_is_told_as_the_mission_begins(told: list[Fact], record: Record) -> None:
    (forecast,) = those(facts.ForecastFact, told)
    assert forecast.ends_s == pytest.approx(record.result.mission_time_s, rel=0.02)
    assert len(forecast.reached_s) == 121
    reached_s = [call.at_s for call in record.calls]
    assert forecast.reached_s == pytest.approx(reached_s, abs=0.03 * forecast.ends_s)
    assert forecast.finish_by_s is None


def test_each_call_is_told_as_the_report_tells_it(told: list[Fact], record: Record) -> None:
    calls = those(facts.CallFact, told)
    assert [(call.waypoint, call.place, call.delay_s, call.waited_s) for call in calls] == [
        (call.waypoint, call.place, call.delay_s, call.waited_s) for call in record.result.calls
    ]
    assert [call.words for call in calls] == [text.reasons for text in explained_calls(record.events)]
    assert [call.at_s - call.delay_s for call in calls] == pytest.approx(
        [call.at_s for call in record.result.calls]
    )


def test_the_states_of_the_servers_are_those_of_the_report(told: list[Fact], record: Record) -> None:
    for server, stretches in record.stretches.items():
        steps = [
            (step.at_s, step.state, step.why) for step in those(facts.StepFact, told) if step.server == server
        ]
        begun = [
            (stretch.from_s, STATE_WORDS[stretch.state], stretch.why)
            for stretch in stretches
            if stretch.from_s > 0
        ]
        assert [step for step in steps if step in begun] == begun, "and some that lasted no time at all"


def test_the_plan_is_told_with_the_ranges_as_circles(told: list[Fact], record: Record) -> None:
    (plan,) = those(facts.PlanFact, told)
    assert plan.waypoints_m == record.plan.waypoints_m
    area = record.plan.ranges["s1"]
    assert plan.ranges["s1"] == (area.centre.east_m, area.centre.north_m, area.radius_m)
    assert plan.metres_per_degree == pytest.approx((86_200, 111_000), rel=0.01)


def test_a_drone_that_reports_no_positions_stays_where_it_calls_until_it_sets_off(told: list[Fact]) -> None:
    fixes = those(facts.FixFact, told)
    call = those(facts.CallFact, told)[5]
    at_the_end = [fix for fix in fixes if fix.at_s <= call.at_s][-1]
    setting_off = next(fix for fix in fixes if fix.at_s >= call.at_s)
    assert (at_the_end.east_m, at_the_end.north_m) == (setting_off.east_m, setting_off.north_m)
    assert setting_off.at_s == call.at_s
    landed = (fixes[-1].east_m, fixes[-1].north_m, fixes[-1].altitude_m)
    assert landed == (0.0, 200.0, 0.0), "where a simulated flight takes off"


def test_every_fact_comes_in_the_order_of_time(told: list[Fact]) -> None:
    times = [fact.at_s for fact in told]
    assert times == sorted(times)


def test_what_is_decided_is_told_with_its_estimates(told: list[Fact], log: Path) -> None:
    decided = [each for each in event_log.read(log) if isinstance(each, schema.Decided)]
    for decision, each in zip(those(facts.DecisionFact, told), decided, strict=True):
        assert f"{each.local_s:.2f} s" in decision.words[1]
        assert each.selected is None or each.why in decision.words[2]
        assert decision.doing.endswith(each.server or "computing on the drone")
        assert decision.limit_s == (each.deadline_s or each.at_most_s or each.local_s)


def test_a_program_that_takes_a_flight_up_again_knows_no_states() -> None:
    told = tell(
        [
            STARTED,
            event("selected", 3.0, server="s1", before="AVL", after="CHECK", why="fastest"),
            event("log_resumed", 7.0, time="2026-01-01T00:00:07+00:00"),
            event("mission_started", 8.0, policy="location-aware", waypoints=2, done=[0]),
        ]
    )
    assert [(step.at_s, step.state) for step in those(facts.StepFact, told)] == [
        (3.0, "joining"),
        (7.0, "not joined"),
    ]
    assert [began.at_s for began in those(facts.BeganFact, told)] == [2.0], "its time goes on"


def test_a_battery_is_told_where_it_is_known() -> None:
    place = {"east_m": 3.0, "north_m": 4.0, "altitude_m": 20.0}
    told = tell(
        [
            event("position", 3.0, **place, battery_percent=91.5),
            event("position", 5.0, **place),
        ]
    )
    first, second = (msgspec.json.decode(msgspec.json.encode(fix)) for fix in those(facts.FixFact, told))
    assert first["battery_percent"] == 91.5
    assert "battery_percent" not in second


def test_photos_are_numbered_and_their_boxes_told() -> None:
    photo = {"position": HERE, "truth": [BOX]}
    told = tell(
        [
            event("log_opened", 1.0, time="2026-01-01T00:00:00+00:00"),
            event("photo", 2.0, source="park 2", **photo),
            event("notified", 3.0, message=[{**BOX, "score": 0.9}], at=HERE),
            event("notified", 4.0, message="the battery is low", at=HERE),
            event("notified", 4.0, message={"row": 7.5}, at=HERE),
            event("photo", 5.0, source="/dev/video0", **photo),
        ]
    )
    shots, (boxes, code) = those(facts.ShotFact, told), those(facts.ToldFact, told)
    assert [(shot.number, shot.kept, len(shot.truth or ())) for shot in shots] == [
        (0, True, 1),
        (1, False, 1),
    ]
    assert b"score" not in msgspec.json.encode(shots[0]), "the truth has none"
    assert (boxes.what, boxes.score, boxes.photo, boxes.pictured) == ("hot-spot", 0.9, 0, True)
    assert (code.what, code.box, code.pictured) == ("row 7.5", None, False)
    assert "the battery is low" in " ".join(said.words for said in those(facts.SaidFact, told))


def test_reasons_are_told_in_seconds_of_the_mission() -> None:
    step = event("selected", 5.0, server="s1", before="AVL", after="CHECK", why="fastest")
    call = event("call", 9.0, operation="detector.count", place="local", delay_s=2.0)
    (told,) = those(facts.CallFact, tell([STARTED, step, call]))
    assert told.words == ["Ran on the drone in 2.00 s.", "at 0:03 s1 was selected: fastest"]


AT_S1 = {"selected": "s1", "state": "READY", "local_s": 10.0, "remote_s": 0.7, "position": HERE}


def test_a_call_in_trouble_is_told_anew_with_what_it_may_take_from_when() -> None:
    planned = event("planned", 1.0, ranges={"s1": {"centre": HERE, "radius_m": 50.0}})
    ready = event("started", 4.0, server="s1", before="CHECK", after="READY")
    asked = {"decision": "remote", "server": "s1", "deadline_s": 2.8, "why": "server ready"}
    told = tell(
        [
            planned,
            STARTED,
            ready,
            event("decided", 10.0, operation="detector.count", **asked, **AT_S1),
            event("hedged", 10.6, server="s1", after_s=0.6, deadline_s=10.6),
            event("remote_failed", 12.0, server="s1", why="s1 does not answer"),
            event("call", 20.6, operation="detector.count", place="local", delay_s=10.6, fell_back=True),
            event("remote_failed", 30.0, server="s1", why="s1 does not answer"),
        ]
    )
    assert [
        (
            course.at_s,
            course.from_s,
            course.began_s,
            course.doing,
            course.limit_s,
            course.also_local,
            course.words[0],
        )
        for course in those(facts.DecisionFact, told)
    ] == [
        (10.0, 10.0, 10.0, "calling s1", 2.8, False, "Runs on s1, ready since 0:02."),
        (
            10.6,
            10.0,
            10.0,
            "calling s1",
            10.6,
            True,
            "Runs on s1 and on the drone, as s1 had not answered after 0.60 s.",
        ),
        (
            12.0,
            10.6,
            10.0,
            "s1 failed, computing on the drone",
            10.0,
            False,
            "Runs on the drone because s1 gave no answer.",
        ),
    ]
    (call,) = those(facts.CallFact, told)
    assert [(estimate.place, estimate.call_s) for estimate in call.estimates] == [
        ("local", 10.0),
        ("s1", 0.7),
    ]
    assert call.lost_s == pytest.approx(9.9)


def test_a_sentence_is_told_anew_as_soon_as_it_is_known_until_when_a_server_was_left_alone() -> None:
    failed = event(
        "check_failed", 4.0, server="s1", before="CHECK", after="BLACKLISTED", why="s1 does not answer"
    )
    planned = event("planned", 1.0, ranges={"s1": {"centre": HERE, "radius_m": 50.0}})
    local = {"decision": "local", "why": "no server selected", **AT_S1, "selected": None, "state": None}
    told = tell(
        [
            planned,
            STARTED,
            failed,
            event("decided", 10.0, operation="detector.count", **local),
            event("call", 20.0, operation="detector.count", place="local", delay_s=10.0),
            event("blacklist_expired", 64.0, server="s1", before="BLACKLISTED", after="AVL"),
        ]
    )
    (call,), (amended,) = those(facts.CallFact, told), those(facts.AmendedFact, told)
    assert call.words[0].endswith("because s1, in range, was left alone since 0:02 after no answer.")
    assert amended.number == 0
    assert amended.words[0].endswith("because s1, in range, was left alone until 1:02 after no answer.")


# --- a drone that goes on before answers are there --------------------------------------------------------------


@pytest.fixture(scope="module")
def going() -> list[Fact]:
    policy = {"name": "local-only", "stay_or_go": "go", "act_within_s": 0.0}
    run = simulate(survey(policy=policy, event={"every": 6, "offset": 2}))
    return tell(run.events)


def test_a_call_that_is_answered_on_the_way_is_told_at_its_waypoint(going: list[Fact]) -> None:
    (plan,) = those(facts.PlanFact, going)
    calls = those(facts.CallFact, going)
    assert [call.waypoint for call in calls] == list(range(18))
    assert [(call.east_m, call.north_m) for call in calls] == plan.waypoints_m
    assert [each.waypoint for each in those(facts.DecisionFact, going)] == list(range(18))


def test_the_way_back_is_told_and_that_answers_were_open(going: list[Fact]) -> None:
    assert [turn.waypoint for turn in those(facts.TurnFact, going)] == [2, 8, 14]
    back = [doing.words for doing in those(facts.DoingFact, going) if "back" in doing.words]
    assert back == [f"flying back to waypoint {waypoint}" for waypoint in (2, 8, 14)]
    assert [each.waypoint for each in those(facts.GoingFact, going)] == list(range(17))
    hidden_s = [each.hidden_s for each in those(facts.AnswerFact, going)]
    assert hidden_s == pytest.approx([*[10.0] * 17, 0.0])


# --- a drone that flies rows ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rows() -> list[Fact]:
    photos = {"every_m": 20.0, "at_most": 3}
    run = simulate(
        survey(
            mission={"photos": photos, "action_s": 0.1},
            policy={"name": "local-only"},
            event={"every": 6, "offset": 2},
        )
    )
    return tell(run.events)


def test_on_rows_an_answer_is_open_from_its_photo_until_its_call_is_over(rows: list[Fact]) -> None:
    photographed_s = {shot.waypoint: shot.at_s for shot in those(facts.ShotFact, rows)}
    assert {begun.waypoint: begun.at_s for begun in those(facts.StartedFact, rows)} == photographed_s
    calls = those(facts.CallFact, rows)
    assert {call.waypoint: call.at_s - call.delay_s for call in calls} == pytest.approx(photographed_s)
    assert max(call.queued_s for call in calls) > 5.0
    hidden_s = sum(answer.hidden_s for answer in those(facts.AnswerFact, rows))
    assert hidden_s > 0.5 * sum(call.delay_s for call in calls)


def test_on_rows_detours_and_waits_are_told_and_what_it_computes_meanwhile(rows: list[Fact]) -> None:
    kinds = [beside.kind for beside in those(facts.BesideFact, rows)]
    assert kinds.count("detour") == len({turn.at_s for turn in those(facts.TurnFact, rows)}) == 3
    assert "wait" in kinds and kinds[-1] == ""
    assert any(
        doing.words == "waiting for answers" and doing.stands for doing in those(facts.DoingFact, rows)
    )
    assert not any(doing.stands for doing in those(facts.DoingFact, rows) if doing.words.startswith("flying"))
    decisions = [decision for decision in those(facts.DecisionFact, rows) if decision.words]
    assert [decision.waypoint for decision in decisions] == list(range(18))


def test_while_one_of_two_calls_goes_on_it_is_the_one_under_way() -> None:
    there = {**AT_S1, "server": "s1", "decision": "remote", "deadline_s": 3.0, "state": "READY"}
    alone = {**AT_S1, "selected": None, "state": None, "decision": "local", "why": "no server selected"}
    told = tell(
        [
            STARTED,
            event("decided", 10.0, operation="detector.count", waypoint=0, **alone),
            event("decided", 11.0, operation="detector.count", waypoint=1, **there),
            event("call", 11.5, operation="detector.count", waypoint=1, place="s1", delay_s=0.5),
        ]
    )
    under_way = [(each.waypoint, each.doing, each.number) for each in those(facts.DecisionFact, told)]
    assert under_way == [
        (0, "computing on the drone", 0),
        (1, "calling s1", 0),
        (0, "computing on the drone", 1),
    ]


def test_what_the_user_is_told_late_is_of_the_photo_of_that_waypoint(going: list[Fact]) -> None:
    numbers = [told.photo for told in those(facts.ToldFact, going)]
    waypoints = [those(facts.ShotFact, going)[number].waypoint for number in numbers if number is not None]
    assert waypoints == [2, 8, 14]
    assert [told.waypoint for told in those(facts.ToldFact, going)] == [2, 8, 14]


def test_what_the_user_is_told_is_of_the_waypoint_where_the_drone_is_and_of_the_place_that_is_named() -> None:
    there = {"east_m": 7.0, "north_m": 8.0, "altitude_m": 0.0}
    first, second = those(
        facts.ToldFact,
        tell(
            [
                STARTED,
                event("notified", 3.0, message={"dust": 0.5}, at=HERE),
                event("arrived", 4.0, waypoint=0, east_m=3.0, north_m=4.0),
                event("notified", 5.0, message={"dirt": 0.5}, at=there),
            ]
        ),
    )
    assert (first.waypoint, first.east_m, first.north_m) == (None, 3.0, 4.0)
    assert (second.waypoint, second.east_m, second.north_m) == (0, 7.0, 8.0)
