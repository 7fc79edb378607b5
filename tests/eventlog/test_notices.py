"""What a person has to act on or should know, from the event that begins it to the one that ends it."""

from __future__ import annotations

import pytest
from tests.events import event

from upwash.eventlog.notices import Level, Notice, Notices
from upwash.eventlog.schema import Event


def held(*events: Event) -> dict[str, Notice]:
    """What holds after these events, by its key."""
    notices, now = Notices(), dict[str, Notice]()
    for each in events:
        for notice in notices.take(each):
            if notice.cause:
                now[notice.key] = notice
            else:
                assert now.pop(notice.key, None) is not None, "only what was told is over"
    return now


def test_a_version_that_is_not_known_is_a_caution() -> None:
    found = {"system": 1, "component": 1, "firmware": "PX4", "type": "quadrotor"}
    now = held(event("vehicle_found", 1.0, **found))
    assert now["version"].cause == "The vehicle does not tell the version of its PX4"
    assert held(event("vehicle_found", 1.0, **found, version="1.16.1")) == {}


def test_a_parameter_that_is_not_known_is_a_caution() -> None:
    now = held(event("vehicle_setting", 1.0, name="RTL_ALT", value=None, advice="15 m are guessed"))
    assert now["setting RTL_ALT"].cause == "The vehicle's RTL_ALT is not known: 15 m are guessed"
    assert now["setting RTL_ALT"].level is Level.CAUTION


def test_a_vehicle_that_nobody_flies_is_an_alarm_until_somebody_does() -> None:
    hovering = [
        event("safe_end", 5.0, action="hold", why="it did not arrive"),
        event("left_hovering", 6.0),
        event("mission_ended", 6.0, why="it did not arrive"),
    ]
    now = held(*hovering)
    assert {key: notice.level for key, notice in now.items()} == {
        "hovering": Level.ALARM,
        "ended": Level.ALARM,
    }
    assert "nobody flies it" in now["hovering"].cause
    assert now["hovering"].action == "Take over with the remote control."
    taken = held(*hovering, event("control", 9.0, owner="pilot", why="mode LOITER"))
    assert set(taken) == {"ended", "control"}
    assert taken["control"].cause == "The pilot has the vehicle: mode LOITER"


@pytest.mark.parametrize(
    ("begins", "ends", "key", "level"),
    [
        (event("link_lost", silent_s=3.0), event("link_restored", silent_s=9.0), "link", Level.ALARM),
        (event("control", owner="fail-safe", why="battery"), event("control", owner="program", why="mode GUIDED"),
         "control", Level.ALARM),
        (event("safe_end", action="land", why="x"), event("landed"), "safe end", Level.ALARM),
        (event("stopping", why="Ctrl-C"), event("mission_completed"), "stopping", Level.ALARM),
        (event("arming_delayed", reasons=["PreArm: GPS"]), event("armed"), "arming", Level.CAUTION),
        (event("call_failed_in_range", server="s1", after="BLACKLISTED", why="no answer"),
         event("blacklist_expired", server="s1", after="AVL"), "server s1", Level.CAUTION),
    ],
)  # fmt: skip
def test_what_begins_holds_until_it_is_over(begins: Event, ends: Event, key: str, level: Level) -> None:
    assert {each: notice.level for each, notice in held(begins).items()} == {key: level}
    assert held(begins, ends) == {}
    assert held(ends) == {}, "what never began is not told to be over"


def test_a_safe_end_that_failed_asks_for_the_remote_control() -> None:
    events = [
        event("safe_end", action="return", why="the link was lost"),
        event("safe_end_failed", action="return", why="refused"),
    ]
    assert held(*events)["safe end"].action == "Take over with the remote control."


def test_calls_that_fell_back_are_counted() -> None:
    assert held(event("call", fell_back=False)) == {}
    now = held(*[event("call", fell_back=True)] * 3)
    assert now["fallbacks"].cause.startswith("3 calls fell back")


def test_the_newest_warnings_of_the_vehicle_are_told_and_nothing_milder() -> None:
    said = [event("vehicle_said", severity=4, text=f"warning {number}") for number in range(5)]
    now = held(event("vehicle_said", severity=5, text="a notice"), *said)
    assert sorted(notice.cause for notice in now.values()) == [
        f"The vehicle says: warning {number} (warning)" for number in (2, 3, 4)
    ]


def test_a_flight_that_is_taken_up_again_has_not_ended() -> None:
    ended = [event("left_hovering"), event("mission_ended", why="x")]
    assert held(*ended, event("log_resumed")) == {}
