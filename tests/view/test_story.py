"""What a page is told of a flight is what its log says, whenever it is asked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import pytest

from upwash import event_log
from upwash.cli import main
from upwash.report.record import Record, read_records
from upwash.view import facts
from upwash.view.facts import Fact
from upwash.view.story import Story

SCENARIOS = Path(__file__).parents[2] / "scenarios"
HERE = {"east_m": 3.0, "north_m": 4.0, "altitude_m": 20.0}
STARTED = {"t": 2.0, "event": "mission_started", "policy": "location-aware", "waypoints": 2}
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


def tell(events: Iterable[Mapping[str, Any]]) -> list[Fact]:
    story = Story(lambda source: source.startswith("park"))
    return [fact for event in events for fact in story.take(event)]


def those(kind: type[OneFact], told: Iterable[Fact]) -> list[OneFact]:
    return [fact for fact in told if isinstance(fact, kind)]


def test_each_call_is_told_as_the_report_tells_it(told: list[Fact], record: Record) -> None:
    calls = those(facts.Call, told)
    assert [(call.waypoint, call.place, call.delay_s, call.waited_s) for call in calls] == [
        (call.waypoint, call.place, call.delay_s, call.waited_s) for call in record.result.calls
    ]
    assert [call.words for call in calls] == [call.reasons for call in record.calls]
    assert [call.at_s - call.delay_s for call in calls] == pytest.approx(
        [call.at_s for call in record.result.calls]
    )


def test_the_states_of_the_servers_are_those_of_the_report(told: list[Fact], record: Record) -> None:
    for server, stretches in record.stretches.items():
        steps = [
            (step.at_s, step.state, step.why) for step in those(facts.Step, told) if step.server == server
        ]
        begun = [(each.from_s, each.state, each.why) for each in stretches if each.from_s > 0]
        assert [step for step in steps if step in begun] == begun, "and some that lasted no time at all"


def test_the_plan_is_told_with_the_ranges_as_circles(told: list[Fact], record: Record) -> None:
    (plan,) = those(facts.Plan, told)
    assert plan.waypoints_m == record.plan.waypoints_m
    area = record.plan.ranges["s1"]
    assert plan.ranges["s1"] == (area.centre.east_m, area.centre.north_m, area.radius_m)
    assert plan.metres_per_degree == pytest.approx((86_200, 111_000), rel=0.01)


def test_a_drone_that_reports_no_positions_stays_where_it_calls_until_it_sets_off(told: list[Fact]) -> None:
    fixes = those(facts.Fix, told)
    call = those(facts.Call, told)[5]
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
    decided = [event for event in event_log.read(log) if event["event"] == "decided"]
    for decision, event in zip(those(facts.Decision, told), decided, strict=True):
        assert f"{event['local_s']:.2f} s" in decision.words[0]
        assert event["why"] in decision.words[1]


def test_a_program_that_takes_a_flight_up_again_knows_no_states() -> None:
    told = tell(
        [
            STARTED,
            {
                "t": 3.0,
                "event": "selected",
                "server": "s1",
                "before": "AVL",
                "after": "CHECK",
                "why": "fastest",
            },
            {"t": 7.0, "event": "log_resumed", "time": "2026-01-01T00:00:07+00:00"},
            {**STARTED, "t": 8.0, "done": [0]},
        ]
    )
    assert [(step.at_s, step.state) for step in those(facts.Step, told)] == [(3.0, "CHECK"), (7.0, "AVL")]
    assert [began.at_s for began in those(facts.Began, told)] == [2.0], "its time goes on"


def test_photos_are_numbered_and_their_boxes_told() -> None:
    photo = {"event": "photo", "source": "park 2", "position": HERE, "truth": [BOX]}
    told = tell(
        [
            {"t": 1.0, "event": "log_opened", "time": "2026-01-01T00:00:00+00:00"},
            {"t": 2.0, **photo},
            {"t": 3.0, "event": "notified", "message": [{**BOX, "score": 0.9}], "at": HERE},
            {"t": 4.0, "event": "notified", "message": "the battery is low", "at": HERE},
            {"t": 5.0, **photo, "source": "/dev/video0"},
        ]
    )
    shots, (boxes, words) = those(facts.Shot, told), those(facts.Told, told)
    assert [(shot.number, shot.kept, len(shot.truth or ())) for shot in shots] == [
        (0, True, 1),
        (1, False, 1),
    ]
    assert b"score" not in msgspec.json.encode(shots[0]), "the truth has none"
    assert [(box.label, box.score) for box in boxes.boxes] == [("hot-spot", 0.9)]
    assert (words.words, list(words.boxes)) == ("the battery is low", [])


@pytest.mark.parametrize(
    "event",
    [
        {"t": 1.0, "event": "planned", "ranges": 7},
        {"t": 1.0, "event": "call", "place": "local"},
        {"t": 1.0, "event": "selected", "server": "s1", "before": "AVL", "after": "ASLEEP", "why": ""},
        {"t": 1.0, "event": "position", "east_m": "far", "north_m": 0.0, "altitude_m": 0.0},
        {"t": 1.0, "event": "log_opened", "time": "noon"},
    ],
)
def test_events_that_no_version_wrote_are_not_told(event: dict[str, Any]) -> None:
    with pytest.raises((KeyError, TypeError, ValueError)):
        tell([event])


def test_reasons_are_told_in_seconds_of_the_mission() -> None:
    call = {
        "event": "call", "operation": "detector.count", "place": "local", "decision": "", "delay_s": 2.0,
        "waited_s": 0.0, "wait": "", "fell_back": False,
    }  # fmt: skip
    step = {"event": "selected", "server": "s1", "before": "AVL", "after": "CHECK", "why": "fastest"}
    (told,) = those(facts.Call, tell([STARTED, {"t": 5.0, **step}, {"t": 9.0, **call}]))
    assert told.words == ["at 3.0 s s1 was selected: fastest"]
