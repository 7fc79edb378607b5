"""What a person has to act on or should know, how urgent it is, and what begins and ends it."""

from __future__ import annotations

import pytest
from tests.events import event

from upwash.eventlog.narration import Narrator, Tone
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


def ranked(*events: Event) -> list[str]:
    """What holds after these events, the most urgent first."""
    return [notice.about for notice in sorted(held(*events).values(), key=lambda notice: notice.rank)]


def said(t: float, text: str, severity: int = 4) -> Event:
    return event("vehicle_said", t, severity=severity, text=text)


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
    assert ranked(*hovering) == ["hovering", "ended"]
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
        (event("call_failed_in_range", server="s1", after="BLACKLISTED"), event("mission_completed"), "server s1",
         Level.CAUTION),
        (event("control", owner="unknown", why="x"), event("stood"), "control", Level.ALARM),
        (said(1.0, "PreArm: Compass", 2), event("armed", 2.0), "prearm PreArm: Compass", Level.CAUTION),
        (said(1.0, "EKF variance", 2), event("landed", 2.0), "critical EKF variance", Level.ALARM),
        (said(1.0, "GPS glitch"), event("position", 62.0), "said GPS glitch", Level.CAUTION),
    ],
)  # fmt: skip
def test_what_begins_holds_until_it_is_over(begins: Event, ends: Event, key: str, level: Level) -> None:
    assert {each: notice.level for each, notice in held(begins).items()} == {key: level}
    assert key not in held(begins, ends)
    assert held(ends) == {}, "what never began is not told to be over"


def test_a_safe_end_that_failed_asks_for_the_remote_control_before_all() -> None:
    events = [
        event("link_lost", silent_s=3.0),
        event("safe_end", action="return", why="the link was lost"),
        event("safe_end_failed", action="return", why="refused"),
        event("call_failed_in_range", server="s1", after="BLACKLISTED"),
    ]
    assert ranked(*events) == ["disobeys", "link", "safe end", "server"]
    assert held(*events)["disobeys"].action == "Take over with the remote control."


@pytest.mark.parametrize("owner", ["pilot", "ground station"])
def test_who_flies_is_not_asked_to_take_over(owner: str) -> None:
    taken = event("control", 2.0, owner=owner, why="the vehicle is in mode LOITER")
    before = [
        event("link_lost", 1.0, silent_s=3.0),
        event("left_hovering", 1.0),
        event("safe_end_failed", 1.0, why="refused"),
        event("call_failed_in_range", 1.0, server="s1", after="BLACKLISTED"),
    ]
    after = [
        event("left_to_pilot", 3.0, why="the pilot has the vehicle"),
        event("link_lost", 4.0, silent_s=3.0),
    ]
    for events in ([*before, taken], [taken, *after], [*before, taken, *after]):
        now = held(*events)
        assert set(now) == {"link", "control"} if len(events) > 1 else {"control"}
        assert not [notice for notice in now.values() if "ake over" in notice.action]
    assert held(*before)["link"].action == "Be ready to take over."


def test_the_mode_that_a_pilot_has_left_is_not_told_any_more() -> None:
    events = [
        event("control", 1.0, owner="pilot", why="the vehicle is in mode LOITER"),
        event(
            "left_to_pilot",
            1.0,
            why="the pilot has the vehicle: the vehicle is in mode LOITER; the log continues",
        ),
        event("control", 9.0, owner="pilot", why="the vehicle is in mode LAND"),
    ]
    assert {notice.cause for notice in held(*events).values()} == {
        "The pilot has the vehicle: the vehicle is in mode LAND"
    }


def test_a_mission_that_ended_early_alarms_until_the_vehicle_stands() -> None:
    events = [event("armed"), event("mission_ended", why="x")]
    assert held(*events)["ended"].level is Level.ALARM
    assert held(*events, event("disarmed"))["ended"].level is Level.CAUTION
    assert (
        held(event("armed"), event("landed"), event("mission_ended", why="x"))["ended"].level is Level.CAUTION
    )


def test_what_repeats_is_counted_and_keeps_when_it_began() -> None:
    now = held(
        said(1.0, "GPS glitch"), said(2.0, "Bad compass"), said(40.0, "GPS glitch"), said(70.0, "GPS glitch")
    )
    (glitch,) = now.values()
    assert (glitch.cause, glitch.times, glitch.since_s) == ("The vehicle says: GPS glitch (warning)", 3, 1.0)
    fails = event("call_failed_in_range", server="s1", after="BLACKLISTED")
    again = held(fails, fails, event("blacklist_expired", server="s1", after="AVL"), fails)
    assert again["server s1"].times == 2, "it failed twice, however often that was told"


def test_calls_that_fell_back_are_counted() -> None:
    assert held(event("call", fell_back=False)) == {}
    now = held(*[event("call", fell_back=True)] * 3)
    assert now["fallbacks"].cause.startswith("3 calls fell back")


def test_the_newest_warnings_of_the_vehicle_are_told_and_nothing_milder() -> None:
    warnings = [said(number, f"warning {number}") for number in range(5)]
    now = held(said(0.0, "a notice", 5), *warnings)
    assert sorted(notice.cause for notice in now.values()) == [
        f"The vehicle says: warning {number} (warning)" for number in (2, 3, 4)
    ]


def test_a_reason_not_to_arm_is_told_once() -> None:
    said_so, delayed = (
        said(1.0, "PreArm: Compass", 2),
        event("arming_delayed", 2.0, reasons=["PreArm: Compass"]),
    )
    assert set(held(said_so, delayed)) == set(held(delayed, said_so)) == {"arming"}


def test_a_flight_that_is_taken_up_again_has_not_ended() -> None:
    ended = [event("left_hovering"), event("mission_ended", why="x")]
    assert held(*ended, event("log_resumed")) == {}


def test_findings_that_do_not_arrive_are_a_caution_until_they_do() -> None:
    trouble = event("handover_trouble", 5.0, to="the webhook at h", why="no answer within 10 s")
    now = held(trouble)
    assert now["handover the webhook at h"].cause == (
        "Findings do not arrive at the webhook at h: no answer within 10 s"
    )
    assert held(trouble, event("handover_trouble", 9.0, to="the webhook at h", why="")) == {}
    failed = event(
        "handover_failed", 9.0, to="the webhook at h", count=1, why="1 left at the end: no network"
    )
    (notice,) = held(trouble, failed).values()
    assert notice.cause == "Not handed over to the webhook at h: 1 finding, 1 left at the end: no network"
    assert "upwash report LOG --findings" in notice.action


def test_a_service_of_the_drone_that_ended_is_a_caution_until_it_is_ready_again() -> None:
    ended, ready = event("local_ended", service="d", how="SIGKILL"), event("local_ready", service="d")
    assert held(ended)["local d"].cause == "The service d on the drone ended (SIGKILL), and is started again"
    assert held(ended, ready) == {}
    assert held(ended, ready, ended)["local d"].times == 2


def test_lost_events_are_counted() -> None:
    now = held(event("events_lost", count=3), event("events_lost", count=5))
    assert now["events"].cause == "8 events of the log could not be kept"


def test_a_server_is_named_once_though_its_reason_begins_with_its_name() -> None:
    now = held(event("call_failed_in_range", server="s1", after="BLACKLISTED", why="s1: no answer"))
    assert now["server s1"].cause == "s1 is not used: no answer"


def test_the_terminal_says_what_a_notice_says_and_asks_no_pilot_to_take_over() -> None:
    lost = event("link_lost", 3.0, silent_s=3.0)
    narrator = Narrator()
    said = narrator.tell(lost)
    assert said is not None and said.tone is Tone.ALARM
    assert said.text == "the vehicle is not heard any more. Be ready to take over"
    narrator.tell(event("control", 4.0, owner="pilot", why="LOITER"))
    again = narrator.tell(lost)
    assert again is not None and again.text == "the vehicle is not heard any more"
