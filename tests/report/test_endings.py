"""The first thing that a report says is how the flight ended, in red where a person had to act."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from tests.report.pages import Told, arrivals, log_of, of_class, parsed, text

from upwash.eventlog.narration import WAS_LEFT_HOVERING

COMPLETED: Told = (60.0, "mission_completed", {})
CALL = {"operation": "detector.count", "place": "local", "decision": "none near"}


def told(log: Path, style: str) -> str:
    return " ".join(text(block) for block in of_class(parsed(log), style))


def test_a_flight_in_which_all_went_well_has_no_block(tmp_path: Path) -> None:
    page = parsed(log_of(tmp_path / "well.jsonl", *arrivals(0, 1, 2, 3), COMPLETED))
    assert not of_class(page, "notice")
    assert "The mission was completed, all 4 waypoints reached." in text(page)


@pytest.mark.parametrize(
    ("event", "said"),
    [
        (("left_hovering", {}), WAS_LEFT_HOVERING),
        (
            ("safe_end", {"action": "land", "why": "the mission raised ValueError"}),
            "At 0:49 the flight was ended early by landing where it is: the mission raised ValueError.",
        ),
        (("safe_end_failed", {"action": "land", "why": "mute"}), "did not obey (landing where it is): mute."),
        (("control", {"owner": "pilot", "why": "LOITER"}), "From 0:49 on the pilot had the vehicle: LOITER."),
        (("control", {"owner": "fail-safe", "why": "RTL"}), "From 0:49 on a fail-safe had the vehicle: RTL."),
        (("mission_ended", {"why": "Ctrl-C"}), "The mission ended early, at 0:49: Ctrl-C."),
        (("stopping", {"why": "the reserve"}), "At 0:49 the mission was stopped: the reserve."),
    ],
)  # fmt: skip
def test_what_a_person_has_to_know_is_in_the_red_block(
    tmp_path: Path, event: tuple[str, Mapping[str, object]], said: str
) -> None:
    kind, facts = event
    log = log_of(tmp_path / "ill.jsonl", *arrivals(0, 1, 2, 3), (50.0, kind, facts), COMPLETED)
    assert said in told(log, "urgent")
    assert not told(log, "caution")


def test_the_program_that_has_the_vehicle_is_no_alarm(tmp_path: Path) -> None:
    control = (1.5, "control", {"owner": "program", "why": "it was disarmed"})
    log = log_of(tmp_path / "well.jsonl", control, *arrivals(0, 1, 2, 3), COMPLETED)
    assert not told(log, "notice")


def test_waypoints_that_were_left_undone_are_named(tmp_path: Path) -> None:
    log = log_of(tmp_path / "short.jsonl", *arrivals(0, 2), (50.0, "mission_ended", {"why": "Ctrl-C"}))
    assert "2 of 4 waypoints left undone: 1, 3." in told(log, "urgent")


def test_a_log_without_an_end_says_so(tmp_path: Path) -> None:
    log = log_of(tmp_path / "torn.jsonl", *arrivals(0, 1, 2, 3))
    assert "The log ends before the mission does" in told(log, "urgent")
    again = log_of(
        tmp_path / "again.jsonl", (9.0, "mission_ended", {"why": "Ctrl-C"}), (11.0, "log_resumed", {}),
        *arrivals(0, 1, 2, 3),
    )  # fmt: skip
    assert "The log ends before the mission does" in told(again, "urgent")


def failed(t: float, server: str) -> Told:
    why = f"{server}: no answer within 5 s"
    return t, "check_failed", {"server": server, "before": "CHECK", "after": "BLACKLISTED", "why": why}


def test_a_server_that_never_became_ready_is_named_with_why(tmp_path: Path) -> None:
    log = log_of(tmp_path / "ill.jsonl", *arrivals(0, 1, 2, 3), failed(50.0, "s2"), COMPLETED)
    assert "The server s2 never became ready: no answer within 5 s." in told(log, "urgent")


def test_what_went_wrong_is_told_with_its_number_in_the_amber_block(tmp_path: Path) -> None:
    ready = {"server": "s1", "before": "CHECK", "after": "READY"}
    log = log_of(
        tmp_path / "rough.jsonl",
        *arrivals(0, 1, 2, 3),
        (40.0, "started", ready), failed(41.0, "s1"), failed(45.0, "s1"),
        (46.0, "call", CALL | {"fell_back": True}),
        (47.0, "link_lost", {"silent_s": 2.0}), (48.0, "link_restored", {"silent_s": 5.5}),
        *[(49.0, "vehicle_said", {"severity": 3, "text": "Battery low"})] * 2,
        (49.0, "vehicle_said", {"severity": 6, "text": "EKF3 is using GPS"}),
        (49.5, "battery_watch_failed", {"why": "no report"}),
        COMPLETED,
    )  # fmt: skip
    assert not told(log, "urgent")
    (block,) = of_class(parsed(log), "caution")
    assert [text(item) for item in block[1]] == [
        "1 call fell back to the drone: a server gave no usable answer, or the drone left its range.",
        "The server s1 was blacklisted 2 times, last at 0:44: no answer within 5 s.",
        "The vehicle fell silent once, at the longest for 5.5 s.",
        "The vehicle said: Battery low (error) (2 times).",
        "Battery watch failed: no report.",
    ]


def test_a_block_has_a_bounded_number_of_sentences(tmp_path: Path) -> None:
    said = [(30.0, "vehicle_said", {"severity": 3, "text": f"trouble {number}"}) for number in range(1000)]
    log = log_of(tmp_path / "much.jsonl", *arrivals(0, 1, 2, 3), *said, COMPLETED)
    (block,) = of_class(parsed(log), "caution")
    assert len(block[1]) == 13
    assert text(block[1][-1]) == "And 188 more, which the event log tells."
