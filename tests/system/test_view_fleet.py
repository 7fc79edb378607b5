"""The page of `upwash view` about several drones: one map, one clock, a list, and one drone in focus."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from tests.events import line
from tests.system.browser import NEEDED, Browser, view_of

from upwash.core.geo import GeoPosition, LocalFrame, Position

pytestmark = NEEDED

APART_S = 4  # the mission of each drone begins so long after that of the one before
BEGAN_S = 2.0  # of each log
WAYPOINTS = 5
HOME = GeoPosition(39.3666, 22.9507)
NORTH_M = 100.0  # of the others' home the third drone has its own
OPERATION = "detector.count"


def call(at_s: float, place: str, delay_s: float) -> bytes:
    return line("call", at_s, operation=OPERATION, place=place, delay_s=delay_s)


def flight(number: int, *, day: int = 1) -> bytes:
    """The log of the drone of that number: a waypoint each 4 s, with a call on the drone at the first, then on s1."""
    south_m = NORTH_M if number == 3 else 0.0
    home = LocalFrame(HOME).geo(Position(0.0, south_m))
    here = {"north_m": 10.0 * number - south_m, "altitude_m": 10.0}
    centre = {"east_m": 50.0, "north_m": 20.0 - south_m, "altitude_m": 0.0}
    selected = {"server": "s1", "before": "AVL", "after": "CHECK", "why": "fastest"}
    text = line("log_opened", 0.0, time=f"2026-01-0{day}T00:00:{APART_S * number:02}+00:00", version=2)
    text += line(
        "planned",
        0.0,
        home={"latitude_deg": home.latitude_deg, "longitude_deg": home.longitude_deg},
        waypoints_m=[[25.0 * each, here["north_m"]] for each in range(WAYPOINTS)],
        ranges={"s1": {"centre": centre, "radius_m": 40.0}},
    )
    text += line(
        "mission_started", BEGAN_S, drone=f"drone-{number}", policy="look-ahead", waypoints=WAYPOINTS
    )
    for each in range(WAYPOINTS):
        at_s = BEGAN_S + 4 * each
        text += line("leg", at_s, waypoint=each, east_m=25.0 * each, north_m=here["north_m"])
        text += line("position", at_s, east_m=25.0 * each, battery_percent=90.0 - number - each, **here)
        text += line("arrived", at_s, waypoint=each, east_m=25.0 * each, north_m=here["north_m"])
        text += call(at_s + 2, "local", 2.0) if each == 0 else call(at_s + 0.5, "s1", 0.5)
        if each == 0:
            text += line("selected", at_s + 2.5, **selected)
            text += line(
                "started", at_s + 3.5, **{**selected, "before": "CHECK", "after": "READY", "why": ""}
            )
    text += line("landed", BEGAN_S + 20) + line("mission_completed", BEGAN_S + 20 + number)
    return text


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a page about three drones."""
    folder = tmp_path_factory.mktemp("logs")
    logs = [folder / f"drone-{number}.jsonl" for number in (1, 2, 3)]
    for number, log in enumerate(logs, start=1):
        log.write_bytes(flight(number))
    with view_of(*logs) as address:
        yield address


def opened(page: Browser, address: str, *, width: int = 1280, scheme: str = "light") -> None:
    """Opens the page, and waits until all of the flights is there, and drawn."""
    page.open(address, width=width, scheme=scheme)
    page.wait_until(
        lambda: page.text(".of-drones [role=status]") and not page.text("#clock").endswith("0:00")
    )


def in_focus(page: Browser) -> str:
    """The name of the drone whose details are to be seen."""
    return page.text(".of-now h2").split()[-1]


def listed(page: Browser) -> list[list[str]]:
    """What the list says of each drone: its name, state and battery, what it does, and how far it is."""
    parts = "[...each.querySelectorAll('button, .state, .percent, p')].map((part) => part.textContent.trim())"
    return page.each(".drones li", parts)


def on_the_map(page: Browser) -> list[tuple[float, float]]:
    """Where each drone's mark is in the window, all at one time."""
    middle = "((box) => [box.x + box.width / 2, box.y + box.height / 2])(each.getBoundingClientRect())"
    return [(x, y) for number in (1, 2, 3) for x, y in page.each(f".drone.drone-{number}", middle)]


def test_every_drone_is_listed_at_the_same_moment_of_one_clock(page: Browser, fleet: str) -> None:
    opened(page, fleet)
    assert " / 0:31 · " in page.text("#clock"), "to the end of the last mission, and the time of day"
    page.seek(6.8)
    far = [
        "2 of 5 waypoints · s1 ready · 2 calls, 1 on servers · 1.5 s saved",
        "1 of 5 waypoints · s1 joining · 1 call, 0 on servers · 0.0 s saved",
        "0 of 5 waypoints · no server · 0 calls, 0 on servers",
    ]
    assert listed(page) == [
        ["1 drone-1", "PROGRAM", "88 %", "at waypoint 1", far[0]],
        ["2 drone-2", "PROGRAM", "88 %", "at waypoint 0", far[1]],
        ["3 drone-3", "WAITING", "", "starting the services of the drone", far[2]],
    ]
    chips = "[...each.children].map((part) => part.textContent)"
    assert page.each(".chips button", chips)[1] == ["2", "drone-2", "PROGRAM", "88 %"]
    assert [element.text for element in page.all(".users .badge")] == ["1", "2"], "who uses s1"
    assert "checking" in (page.all(".users .badge")[1].get_attribute("class") or "")
    page.seek(31.0)
    assert (
        page.text(".of-drones [role=status]")
        == "3 of 3 missions were completed: in 0:22 on average, 0:23 at most."
    )
    assert page.errors() == []
    assert page.elsewhere(fleet) == []


def test_drones_that_have_homes_of_their_own_are_at_their_places_on_one_map(
    page: Browser, fleet: str
) -> None:
    opened(page, fleet)
    page.seek(31.0)
    (x1, y1), (x2, y2), (x3, y3) = on_the_map(page)
    assert x1 == pytest.approx(x2, abs=2) and x2 == pytest.approx(x3, abs=2)
    assert y1 - y2 == pytest.approx(y2 - y3, abs=2), "10 m each, although the third one counts from elsewhere"
    assert y1 - y2 > 10


def test_a_drone_is_looked_at_by_click_by_number_and_on_the_map(page: Browser, fleet: str) -> None:
    opened(page, fleet)
    page.seek(20.0)
    assert in_focus(page) == "drone-1"
    page.all(".drones button")[1].click()
    page.wait_until(lambda: in_focus(page) == "drone-2")
    pressed = [element.get_attribute("aria-pressed") for element in page.all(".drones button")]
    assert pressed == ["false", "true", "false"]
    ActionChains(page.driver).send_keys("3").perform()
    page.wait_until(lambda: in_focus(page) == "drone-3")
    assert "drone-3" in (page.find(".lanes canvas").get_attribute("aria-label") or "")
    ActionChains(page.driver).send_keys("9").perform()
    page.find(".drone.drone-1").click()
    page.wait_until(lambda: in_focus(page) == "drone-1")
    page.find("#speed").send_keys("2")
    assert page.run("return document.getElementById('speed').value") == "2"
    assert in_focus(page) == "drone-1", "that was for the speed"
    assert page.errors() == []


def test_a_click_on_another_drones_finding_shows_that_drone_and_its_photo(
    page: Browser, tmp_path: Path
) -> None:
    logs = [tmp_path / f"drone-{number}.jsonl" for number in (1, 2, 3)]
    for number, log in enumerate(logs, start=1):
        at = {"east_m": 100.0, "north_m": 10.0 * number, "altitude_m": 10.0}
        box = {"left_px": 9.0, "top_px": 9.0, "width_px": 90.0, "height_px": 90.0, "label": f"crack {number}"}
        *before, landed, completed = flight(number).splitlines(keepends=True)
        found = [
            line("photo", BEGAN_S + 17, source="park 2", position=at),
            line("notified", BEGAN_S + 18, message=[box], at=at),
        ]
        log.write_bytes(b"".join([*before, *found, landed, completed]))
    with view_of(*logs) as address:
        opened(page, address)
        assert in_focus(page) == "drone-1"
        page.open_tab("findings")
        assert page.each(".finds .number", "each.textContent") == ["1", "2", "3"]
        page.click(".finds li:nth-child(2) button")
        page.wait_until(lambda: in_focus(page) == "drone-2")
        page.drawn()
        assert page.text(".finds [aria-current] .number") == "2"
        said = page.text(".photos p")
        assert said.startswith("Photo 1, at waypoint 4.")
        assert said.endswith("Finding 2: crack 2.")
        assert page.moment() == APART_S + 18, "the second drone's, by the clock of all"
        page.open_tab("now")
        page.wait_until(
            lambda: [each.text for each in page.all(".boxes text") if each.is_displayed()] == ["2 crack 2"]
        )
        assert page.errors() == []


def test_the_bar_of_a_fleet_has_the_worst_state_whichever_drone_is_in_focus(
    page: Browser, tmp_path: Path
) -> None:
    """The first drone flies on, a pilot takes the second, and a fail-safe the third, whose battery is low."""
    logs = [tmp_path / f"drone-{number}.jsonl" for number in (1, 2, 3)]
    taken = [b"", line("control", 10.0, owner="pilot"), line("control", 6.0, owner="fail-safe")]
    low = line("vehicle_limits", 1.0, low_percent=90.0, critical_percent=10.0)
    for number, (log, control) in enumerate(zip(logs, taken, strict=True), start=1):
        flown = _not_over(flight(number)).replace(b'"landed"', b'"unknown"')
        events = sorted((flown + control + low).splitlines(keepends=True), key=_time)
        log.write_bytes(b"".join(events))
    with view_of(*logs) as address:
        page.open(address)
        page.wait_until(lambda: len(listed(page)) == 3 and not page.text("#clock").endswith("0:00"))
        page.seek(15.0)
        for key in "123":
            page.find("body").send_keys(key)
            page.drawn()
            assert page.text(".who") == "3 drones:"
            assert (
                page.text(".doing").replace("\N{NO-BREAK SPACE}", " ") == "1 FAIL-SAFE · 1 PILOT · 1 PROGRAM"
            )
            assert "alarm" in (page.find(".bar").get_attribute("class") or "")
            assert page.text(".aside").startswith(f"drone-{key} · ")
        for part in (".drones", ".chips"):
            chips = page.each(f"{part} .state", "[each.textContent, each.classList[1]]")
            assert chips == [["PROGRAM", "program"], ["PILOT", "person"], ["FAIL-SAFE", "alarm"]]
            assert page.each(f"{part} .percent", "each.classList.contains('low')") == [True] * 3
        assert page.violations() == []


def _time(event: bytes) -> float:
    return float(json.loads(event)["t"])


def test_the_buttons_go_through_the_calls_of_the_drone_in_focus(page: Browser, fleet: str) -> None:
    opened(page, fleet)
    ActionChains(page.driver).send_keys("2").perform()
    page.seek(0.0)
    ends = []
    for _ in range(3):
        before = page.text("#clock")
        page.click("#next")
        page.wait_until(lambda: page.text("#clock") != before)  # noqa: B023 - it is called before the next
        ends.append(page.moment())
    assert ends == [APART_S + 2.0, APART_S + 4.5, APART_S + 8.5]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_is_cut_off_and_axe_finds_nothing_wrong(
    page: Browser, fleet: str, width: int, scheme: str
) -> None:
    opened(page, fleet, width=width, scheme=scheme)
    for at_s in (7.0, 31.0):
        page.seek(at_s)
        assert page.violations() == []
        assert page.width() <= width
    assert page.too_small("button") == [], "fingers are broad"


def test_the_keyboard_reaches_every_drone(page: Browser, fleet: str) -> None:
    opened(page, fleet)
    page.find(".fit").send_keys("")  # the map's last button, before the chips
    for name in ("drone-1", "drone-2", "drone-3"):
        ActionChains(page.driver).send_keys(Keys.TAB).perform()
        assert name in page.driver.switch_to.active_element.text
    ActionChains(page.driver).send_keys(Keys.ENTER).perform()
    page.wait_until(lambda: in_focus(page) == "drone-3")


def test_flights_of_different_days_begin_at_the_same_moment(page: Browser, tmp_path: Path) -> None:
    logs = [tmp_path / f"drone-{number}.jsonl" for number in (1, 2, 3)]
    for number, log in enumerate(logs, start=1):
        log.write_bytes(flight(number, day=number))
    with view_of(*logs) as address:
        opened(page, address)
        assert page.text("#clock").endswith(" / 0:23")
        page.seek(1.0)
        assert [row[1:4:2] for row in listed(page)] == [["PROGRAM", "at waypoint 0"]] * 3


def test_flights_that_have_yet_to_begin_are_shown_as_they_go_on(page: Browser, tmp_path: Path) -> None:
    logs = [tmp_path / f"drone-{number}.jsonl" for number in (1, 2)]
    for log in logs:
        log.touch()
    with view_of(*logs) as address:
        page.open(address)
        page.wait_until(lambda: len(listed(page)) == 2)
        logs[0].write_bytes(_not_over(today(flight(1))))
        page.wait_until(lambda: listed(page)[0][4].startswith("5 of 5"))
        assert listed(page)[1][1:4:2] == ["WAITING", "waiting for the log to begin"]
        assert page.text("#mode") not in {"", "playback"}, "the first goes on"
        logs[1].write_bytes(today(flight(2)))
        page.wait_until(lambda: listed(page)[1][4].startswith("5 of 5"))
        assert " / 0:26 · " in page.text("#clock")
        assert page.errors() == []


def today(log: bytes) -> bytes:
    """The same flight, within the last minute."""
    return log.replace(b"2026-01-01T00:00", datetime.now(UTC).strftime("%Y-%m-%dT%H:%M").encode())


def _not_over(log: bytes) -> bytes:
    return log[: log.index(b'{"event":"landed"')]


def test_an_old_log_without_an_end_is_no_flight_without_news(page: Browser, tmp_path: Path) -> None:
    (tmp_path / "old.jsonl").write_bytes(_not_over(flight(1)))
    with view_of(tmp_path / "old.jsonl") as address:
        page.open(address)
        page.wait_until(lambda: page.text("#mode"))
        assert page.text("#mode") == "playback"
        assert "No news" not in page.text("#alarms")


def test_the_last_state_of_a_flight_without_news_is_not_told_as_its_state_now(
    page: Browser, tmp_path: Path
) -> None:
    ago = datetime.now(UTC) - timedelta(minutes=5)
    log = _not_over(flight(1)).replace(b"2026-01-01T00:00:04", ago.strftime("%Y-%m-%dT%H:%M:%S").encode())
    (tmp_path / "silent.jsonl").write_bytes(log)
    with view_of(tmp_path / "silent.jsonl") as address:
        page.open(address)
        page.wait_until(lambda: page.text(".who") == "NO NEWS")
        assert "alarm" in (page.find(".bar").get_attribute("class") or "")
        assert page.text(".aside") == "last heard at 0:16: PROGRAM · at waypoint 4"
        assert page.text(".was") == "PROGRAM"
        (tile,) = page.each(".tiles > div:not([hidden])", "[each.className, each.textContent]")
        assert tile[0] == "old" and re.fullmatch(r"battery 4:\d\d ago85 %", tile[1])
        struck = page.find(".tiles .old dd").value_of_css_property("text-decoration-line")
        assert struck == page.find(".was").value_of_css_property("text-decoration-line") == "line-through"
        assert not page.text(".outlook"), "nobody knows when it is over"
        assert "No news of the flight for 4:4" in page.text("#alarms")
        page.seek(1.0)
        assert page.text(".who") == "PROGRAM"
