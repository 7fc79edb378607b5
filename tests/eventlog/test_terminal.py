"""What a person sees of a flight while it lasts."""

from __future__ import annotations

import io
from collections.abc import Iterable

import pytest
from rich.console import Console
from tests.events import event

from upwash.eventlog.narration import Narrator
from upwash.eventlog.notices import Notices
from upwash.eventlog.schema import EVENTS, Event, kind_of
from upwash.eventlog.terminal import FlightProgress

STARTED = event("mission_started", 0.4, policy="look-ahead", waypoints=4)
PLACE = {"east_m": 0.0, "north_m": 0.0}


def waiting(t: float, *reasons: str) -> Event:
    return event("arming_delayed", t, reasons=reasons)


def reports(until_s: int) -> list[Event]:
    return [event("position", float(t), **PLACE, altitude_m=0.0) for t in range(1, until_s)]


def lines(events: Iterable[Event]) -> list[str]:
    """What is printed where no terminal is, without the times."""
    output = io.StringIO()
    with FlightProgress(["s1"], 4, Console(file=output, width=300)) as progress:
        for each in sorted(events, key=lambda each: each.t):
            progress.follow(each)
    return [line[10:].strip() for line in output.getvalue().splitlines()]


@pytest.mark.parametrize("kind", [kind_of(cls) for cls in EVENTS])
def test_every_event_can_be_told(kind: str) -> None:
    """The sentences and notices name fields of the events in templates, which mypy does not read."""
    sentence = Narrator().tell(event(kind, 1.0))
    notices = list(Notices().take(event(kind, 1.0)))
    assert "{" not in f"{sentence.text if sentence else ''}{[notice.cause for notice in notices]}"
    assert all(notice.rank >= 0 for notice in notices)


def test_a_line_before_the_mission_began_has_the_logs_seconds_in_brackets() -> None:
    output = io.StringIO()
    with FlightProgress(["s1"], 4, Console(file=output, width=300)) as progress:
        for each in (
            STARTED,
            waiting(1.0, "GPS"),
            event("armed", 3.0),
            event("took_off", 5.5, altitude_m=20),
        ):
            progress.follow(each)
    times = [line[:10].strip() for line in output.getvalue().splitlines()]
    assert times == ["[0:00]", "[0:01]", "0:00", "0:02"]


def test_on_rows_a_call_is_told_at_its_own_photo_and_stops_are_told() -> None:
    call = {"operation": "o", "place": "s1", "decision": "server ready"}
    said = lines(
        [
            STARTED,
            event("arrived", 1.0, waypoint=1, passing=True, **PLACE),
            event("leg", 1.5, waypoint=2, **PLACE),
            event("call", 2.0, waypoint=1, delay_s=0.4, **call),
            event("call", 3.0, waypoint=0, delay_s=9.0, queued_s=8.6, **call),
            event("photos_wait", 4.0, waiting=2),
        ]
    )
    assert said[1:] == [
        "■ waypoint 1: o on s1, 0.40 s",
        "■ waypoint 0: o on s1, 9.00 s, 8.6 s of that in line",
        "stopping on the row: 2 photos without an answer",
    ]


def head(events: Iterable[Event]) -> str:
    """The last line of the picture that a terminal shows in the end."""
    console = Console(file=io.StringIO(), width=300, force_terminal=True, color_system=None)
    progress = FlightProgress(["s1"], 4, console)
    for each in events:
        progress.follow(each)
    with console.capture() as captured:
        console.print(progress._picture())
    return captured.get().splitlines()[-1]


def test_the_number_of_open_answers_is_shown() -> None:
    begun = [event("call_started", 2.0, operation="o", waypoint=number) for number in (0, 1)]
    leg = event("leg", 1.5, waypoint=2, **PLACE)
    assert head([STARTED, leg, *begun]).startswith("flying to waypoint 2 · 2 answers open · 0 of 4")
    over = [event("call", 3.0 + number, operation="o", waypoint=number) for number in (0, 1)]
    assert head([STARTED, leg, *begun, *over]).startswith("flying to waypoint 2 · 0 of 4")


def test_a_vehicle_that_cannot_be_armed_is_waited_for_with_its_reasons() -> None:
    said = lines([STARTED, waiting(1.0), waiting(1.5, "GPS 1: Bad fix"), event("arming", 3.0)])
    assert said[1:] == [
        "waiting until the vehicle can be armed: the vehicle does not say why yet",
        "waiting until the vehicle can be armed: GPS 1: Bad fix",
        "arming",
    ]


def test_without_a_terminal_the_wait_is_told_again_every_ten_seconds() -> None:
    said = lines([STARTED, waiting(1.5, "GPS 1: Bad fix"), *reports(30), event("arming", 30.0), *reports(60)])
    assert said[2:] == [
        "still waiting until the vehicle can be armed, for 10 s: GPS 1: Bad fix",
        "still waiting until the vehicle can be armed, for 20 s: GPS 1: Bad fix",
        "arming",
    ]


@pytest.mark.parametrize(
    ("then", "shown"),
    [
        (reports(9), "waiting until the vehicle can be armed for 7 s · "),
        ([event("arming", 9.0)], "arming · "),
        ([event("arming", 9.0), event("armed", 9.5)], "armed · "),
        ([event("arming", 9.0), event("taking_off", 9.5, altitude_m=20.0)], "climbing to 20 m · "),
    ],
)
def test_a_terminals_picture_says_what_the_drone_is_doing(then: list[Event], shown: str) -> None:
    assert head([STARTED, waiting(1.0, "GPS 1: Bad fix"), *then]).startswith(shown)


def test_the_altitude_is_shown_while_it_climbs() -> None:
    climbs = [event("taking_off", 9.0, altitude_m=20.0), event("position", 12.0, **PLACE, altitude_m=13.2)]
    assert head([STARTED, *climbs]).endswith("13 m up")


def test_what_the_reserve_guesses_is_beside_what_it_reckons() -> None:
    numbers = {
        "left_percent": 59.0,
        "rate_percent_s": 0.08,
        "home_s": 45.0,
        "needed_percent": 4.0,
        "floor_percent": 2.0,
        "margin_percent": 53.0,
    }
    said = lines(
        [
            event(
                "vehicle_setting", 0.1, name="RTL_ALT", value=None, advice="the vehicle has no such parameter"
            ),
            event("energy", 0.2, **numbers),
            event("energy", 0.3, **numbers, guessed=["RTL_ALT", "LAND_SPEED"]),
        ]
    )
    assert said == [
        "the vehicle's RTL_ALT is not known: the vehicle has no such parameter",
        "battery 59 %, 0:45 to the landing, 53 % to spare",
        "battery 59 %, 0:45 to the landing, 53 % to spare (guessed: RTL_ALT, LAND_SPEED are not known)",
    ]


def test_the_way_down_counts_down() -> None:
    coming = [
        event("returning", 100.0),
        *(event("position", 100.0 + t, **PLACE, altitude_m=9.0, down_s=40.0 - t) for t in range(1, 40)),
        event("landed", 140.0),
    ]
    assert lines([STARTED, *coming])[1:] == [
        "returning home to land",
        *(f"returning: on the ground in 0:{left_s}" for left_s in (30, 20, 10)),
        "landed",
    ]
    assert head([STARTED, *coming[:12]]).startswith("returning · on the ground in 0:29 · ")
    assert head([STARTED, *coming, event("position", 141.0, **PLACE, altitude_m=0.0)]).startswith("landed · ")


def test_who_has_the_vehicle_is_said_once() -> None:
    taken = "the pilot has the vehicle: the vehicle is in mode LOITER"
    said = lines(
        [
            STARTED,
            event("control", 10.0, owner="pilot", why="the vehicle is in mode LOITER"),
            event(
                "left_to_pilot", 10.0, why=f"{taken}; the log continues until the vehicle stands, or Ctrl-C"
            ),
            event("mission_ended", 30.0, why=f"mission: {taken}"),
        ]
    )
    assert said[1:] == [
        f"{taken}; nothing is sent to it any more",
        "the log continues until the vehicle stands, or Ctrl-C",
        f"mission ended: {taken}",
    ]


def test_the_version_of_a_vehicle_is_told() -> None:
    found = {"system": 3, "component": 1, "firmware": "ArduCopter", "type": "quadrotor"}
    said = lines(
        [event("vehicle_found", 0.1, **found, version="4.6.2"), event("vehicle_found", 0.2, **found)]
    )
    assert said == [
        "the vehicle is system 3, component 1 (ArduCopter 4.6.2, quadrotor)",
        "the vehicle is system 3, component 1 (ArduCopter of an unknown version, quadrotor)",
    ]


def test_what_the_mission_tells_of_a_call_joins_its_line_and_a_silent_call_has_one_alone() -> None:
    call = {"operation": "detector.process_photo[heavy]", "place": "s1", "decision": "server ready"}
    told = [
        {"label": label, "left_px": 1, "top_px": 1, "width_px": 2, "height_px": 2}
        for label in ("hot-spot", "broken-module", "hot-spot")
    ]
    said = lines(
        [
            STARTED,
            event("arrived", 10.0, waypoint=0, **PLACE),
            event("call", 10.6, delay_s=0.6, **call),
            event("notified", 10.61, message=told, at=PLACE),
            event("arrived", 20.0, waypoint=1, **PLACE),
            event("call", 20.6, delay_s=0.6, **{**call, "place": "local"}),
            event("position", 21.5, **PLACE, altitude_m=10.0),
            event("notified", 22.0, message="late", at=PLACE),
            event("call", 22.0, delay_s=0.6, **call),
        ]
    )
    assert said == [
        "mission started, policy look-ahead; ● drone  ■ s1",
        "■ waypoint 0: detector (heavy) on s1, 0.60 s · 2 hot-spots, 1 broken module",
        "● waypoint 1: detector (heavy) on the drone, 0.60 s",
        "told the user: late",
        "■ waypoint 1: detector (heavy) on s1, 0.60 s",
    ]


def test_the_time_left_is_the_forecasts_and_later_by_what_the_drone_is_late() -> None:
    foreseen = event("foreseen", 0.5, as_asked_s=100.0, reached_s=[10.0, 20.0])
    armed = event("armed", 1.0)
    assert head([STARTED, foreseen, armed, *reports(6)]).endswith("about 1:36 left")
    arrived = event("arrived", 26.0, waypoint=1, **PLACE)  # at 25 s of the mission
    assert head([STARTED, foreseen, armed, arrived]).endswith("about 1:20 left")
    down = event("position", 90.0, **PLACE, altitude_m=9.0, down_s=7.0)
    assert head([STARTED, foreseen, armed, arrived, down]).endswith("about 0:07 left")


def test_a_server_that_another_one_prepared_is_told_in_words() -> None:
    prepared = event("prepared", 1.0, server="s1", before="AVL", after="AVL-R", why="by s2")
    assert lines([prepared]) == ["s1 is running, not joined: prepared by s2"]
