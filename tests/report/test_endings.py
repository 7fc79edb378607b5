"""The first thing that a report says is how the flight ended, in red where a person had to act."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest
from tests.events import line
from tests.report.pages import Told, arrivals, log_of, of_class, parsed, text

COMPLETED: Told = (60.0, "mission_completed", {})
CALL = {"operation": "detector.count", "place": "local", "decision": "none near"}


def told(log: Path, style: str) -> str:
    return " ".join(text(block) for block in of_class(parsed(log), style))


def test_a_flight_in_which_all_went_well_has_no_block(tmp_path: Path) -> None:
    page = parsed(log_of(tmp_path / "well.jsonl", *arrivals(0, 1, 2, 3), COMPLETED))
    assert not of_class(page, "notice")
    assert "The mission was completed, 4 of 4 waypoints reached." in text(page)


@pytest.mark.parametrize(
    ("event", "said"),
    [
        (("left_hovering", {}), "From 0:49 on: The vehicle hovers where it is, and nobody flies it. Take over"),
        (
            ("safe_end", {"action": "land", "why": "the mission raised ValueError"}),
            "From 0:49 on: The flight cannot go on, landing where it is: the mission raised ValueError.",
        ),
        (
            ("safe_end_failed", {"action": "land", "why": "mute"}),
            "From 0:49 on: The vehicle does not obey (landing where it is): mute.",
        ),
        (("control", {"owner": "pilot", "why": "LOITER"}), "From 0:49 on: The pilot has the vehicle: LOITER."),
        (("control", {"owner": "fail-safe", "why": "RTL"}), "From 0:49 on: A fail-safe has the vehicle: RTL."),
        (("left_to_pilot", {"why": "mute"}), "From 0:49 on: Nothing is sent to the vehicle any more: mute."),
        (("following_ended", {"why": "mute"}), "From 0:49 on: The log ends before the vehicle stands: mute."),
        (("mission_ended", {"why": "Ctrl-C"}), "At 0:49: The mission ended early: Ctrl-C."),
        (("stopping", {"why": "the reserve"}), "From 0:49 to 0:59: The mission is being ended: the reserve."),
        (("link_lost", {"silent_s": 3.0}), "From 0:49 on: The vehicle is not heard any more."),
        (
            ("vehicle_said", {"severity": 2, "text": "Battery failsafe"}),
            "At 0:49: The vehicle says: Battery failsafe (critical).",
        ),
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
    assert "2 of 4 waypoints reached, left undone: 1, 3." in told(log, "urgent")


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
    assert "s2 never became ready: no answer within 5 s." in told(log, "urgent")
    assert not told(log, "caution"), "told once"


def test_what_went_wrong_is_told_with_its_number_in_the_amber_block(tmp_path: Path) -> None:
    ready = {"server": "s1", "before": "CHECK", "after": "READY"}
    log = log_of(
        tmp_path / "rough.jsonl",
        *arrivals(0, 1, 2, 3),
        (40.0, "started", ready), failed(41.0, "s1"), (43.0, "started", ready), failed(45.0, "s1"),
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
        "From 0:46 to 0:47: The vehicle is not heard any more. Be ready to take over.",
        "From 0:48 on: The battery is not watched: no report.",
        "2 times at 0:48: The vehicle says: Battery low (error).",
        "2 times from 0:40 to 0:59: s1 is not used: no answer within 5 s.",
        "From 0:45 on: 1 call fell back to the drone: a server gave no usable answer, or the drone left its range.",
    ]


def test_a_block_has_a_bounded_number_of_sentences(tmp_path: Path) -> None:
    said = [(30.0, "vehicle_said", {"severity": 3, "text": f"trouble {number}"}) for number in range(1000)]
    log = log_of(tmp_path / "much.jsonl", *arrivals(0, 1, 2, 3), *said, COMPLETED)
    (block,) = of_class(parsed(log), "caution")
    assert len(block[1]) == 21
    assert text(block[1][-1]) == "And 180 more: the event log tells all."


def urgent(folder: Path, *events: Told) -> Sequence[str]:
    (block,) = of_class(parsed(log_of(folder / "ill.jsonl", *arrivals(0, 1, 2, 3), *events)), "urgent")
    return [text(item) for item in block[1]]


def test_each_act_of_a_flight_that_went_wrong_is_told_with_its_time_in_their_order(tmp_path: Path) -> None:
    said = urgent(
        tmp_path,
        (30.0, "vehicle_said", {"severity": 2, "text": "EKF variance"}),
        (31.0, "safe_end", {"action": "return", "why": "the link was lost"}),
        (35.0, "safe_end", {"action": "land", "why": "it did not return"}),
        (40.0, "control", {"owner": "pilot", "why": "LOITER"}),
        (41.0, "mission_ended", {"why": "mission: the pilot has the vehicle"}),
        (50.0, "control", {"owner": "fail-safe", "why": "RTL"}),
        (60.0, "landed", {}),
    )
    assert [each.partition(". ")[0].rstrip(".") for each in said] == [
        "From 0:30 to 0:34: The flight cannot go on, returning to land: the link was lost",
        "From 0:34 to 0:39: The flight cannot go on, landing where it is: it did not return",
        "From 0:39 to 0:49: The pilot has the vehicle: LOITER",
        "At 0:40: The mission ended early: the pilot has the vehicle",
        "From 0:49 to 0:59: A fail-safe has the vehicle: RTL",
        "At 0:29: The vehicle says: EKF variance (critical)",
    ]


def test_what_a_person_had_to_do_is_told_though_a_pilot_did_it(tmp_path: Path) -> None:
    hovers: Told = (30.0, "left_hovering", {})
    said = urgent(tmp_path, hovers, (40.0, "control", {"owner": "pilot", "why": "LOITER"}))
    assert said[0].endswith("nobody flies it. Take over with the remote control.")


def test_the_link_that_was_lost_often_is_told_once_with_the_longest_silence(tmp_path: Path) -> None:
    lost = [
        (20.0 + t, kind, {"silent_s": 3.0})
        for t, kind in [(0, "link_lost"), (2, "link_restored"), (5, "link_lost"), (12, "link_restored")]
    ]
    log = log_of(tmp_path / "silent.jsonl", *arrivals(0, 1, 2, 3), *lost, COMPLETED)
    assert "2 times from 0:19 to 0:31, at the longest for 7.0 s: The vehicle is not heard" in told(
        log, "caution"
    )
    assert not told(log, "urgent")


def test_what_was_known_before_the_mission_began_has_no_time_of_it(tmp_path: Path) -> None:
    guessed: Told = (0.5, "vehicle_setting", {"name": "RTL_ALT", "value": None, "advice": "15 m are guessed"})
    delays: list[Told] = [(0.6, "arming_delayed", {"reasons": ["GPS"]}), (0.7, "armed", {})]
    log = log_of(tmp_path / "early.jsonl", *arrivals(0, 1, 2, 3), COMPLETED)
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(
        b"".join([lines[0], *(line(kind, t, **facts) for t, kind, facts in (guessed, *delays)), *lines[1:]])
    )
    assert "From the start on: The vehicle's RTL_ALT is not known" in told(log, "caution")
    assert "Before the start: The vehicle cannot be armed yet: GPS." in told(log, "caution")
