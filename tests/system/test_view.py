"""The page of `upwash view` and `--live`, in a browser: played back, side by side, on a phone, in the dark."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from tests.events import line
from tests.maps import folder_with, tiles_around
from tests.programs import upwash
from tests.scenarios import scenario
from tests.system.browser import NEEDED, Browser, view_of
from tests.waiting import wait_for

from upwash.cli.main import main
from upwash.eventlog import log as event_log
from upwash.eventlog import schema
from upwash.eventlog.narration import STATE_WORDS
from upwash.eventlog.reasons import explained_calls
from upwash.lab.run import simulate
from upwash.report.record import Record, read_records
from upwash.support.text import clock

pytestmark = NEEDED

SCENARIOS = Path(__file__).parents[2] / "scenarios"
HOSTILE = "</title><img src=x onerror=alert(1)><script>alert(1)</script>"


@pytest.fixture(scope="module")
def one(logs: tuple[Path, Path]) -> Iterator[str]:
    """The address of a page about one flight."""
    with view_of(logs[0]) as address:
        yield address


@pytest.fixture(scope="module")
def two(logs: tuple[Path, Path]) -> Iterator[str]:
    """The address of a page about two flights."""
    with view_of(*logs) as address:
        yield address


def opened(page: Browser, address: str, *, width: int = 1280, scheme: str = "light") -> None:
    """Opens the page, and waits until all of the flights is there."""
    page.open(address, width=width, scheme=scheme)
    page.wait_until(lambda: page.text(".summary"))
    page.drawn()


def calls_until(record: Record, at_s: float) -> int:
    return sum(call.at_s + call.delay_s <= at_s + 1e-6 for call in record.calls)


# --- played back ----------------------------------------------------------------------------------------------


def test_any_moment_of_a_flight_is_shown_as_the_log_has_it(
    page: Browser, one: str, logs: tuple[Path, Path]
) -> None:
    (record,) = read_records(logs[:1])
    opened(page, one)
    page.open_tab("why")
    for at_s in (900.0, 100.0, 1300.0, 0.0, record.result.mission_time_s):
        page.seek(round(at_s, 1))
        calls = calls_until(record, round(at_s, 1))
        table = page.rows(".calls-table")
        assert [row[4] for row in table] == [f"{call.delay_s:.2f} s" for call in record.calls[:calls]]
        label = page.find(".lanes canvas").get_attribute("aria-label") or ""
        assert f"{calls} calls" in label
        for server, state, *_ in page.rows(".servers"):
            stretches = record.stretches[server]
            (now,) = [
                stretch.state for stretch in stretches
                if stretch.from_s <= round(at_s, 1) + 1e-6 and (
                    round(at_s, 1) + 1e-6 < stretch.to_s or stretch is stretches[-1]
                )
            ]  # fmt: skip
            assert state.startswith(STATE_WORDS[now])
    assert page.errors() == []
    assert page.elsewhere(one) == []


def test_a_call_has_its_like_under_another_policy_beside_it(
    page: Browser, two: str, logs: tuple[Path, Path]
) -> None:
    ours, theirs = read_records(logs)
    opened(page, two)
    number = 41
    call = ours.calls[number]
    page.seek(round(call.at_s + call.delay_s + 0.1, 1))
    other = theirs.calls[number]
    name = f"{theirs.result.policy} ({theirs.name})"
    assert f"{name}: drone, {other.delay_s:.1f} s" in page.text(".others")


def test_a_drone_that_turns_back_for_an_answer_is_shown_to(page: Browser, tmp_path: Path) -> None:
    policy = {"name": "local-only", "stay_or_go": "go", "act_within_s": 0.0}
    run = simulate(scenario(policy=policy, event={"every": 6, "offset": 2}))
    turned_s = next(event.t for event in run.events if event.kind == "turned_back")
    log = tmp_path / "going.jsonl"
    log.write_bytes(run.log())
    with view_of(log) as address:
        opened(page, address)
        page.open_tab("why")
        page.seek(round(turned_s + 1.0, 1))
        assert page.text(".doing") == "flying back to waypoint 2"
        assert "gone on before 3 answers, turned back for 1, " in page.text(".totals")
        assert page.text(".now h3").endswith("at waypoint 2")
        assert [row[0] for row in page.rows(".calls-table")] == ["0", "1", "2"]
        page.seek(round(turned_s + 11.0, 1))
        assert "at waypoint 2" in page.text(".photos")  # the photo that the user is told of
        assert page.errors() == []


def test_on_rows_the_open_answers_are_shown_and_what_became_of_each(page: Browser, tmp_path: Path) -> None:
    rows = scenario(
        mission={"photos": {"every_m": 20.0, "at_most": 4}},
        policy={"name": "local-only"},
        event={"every": 100, "offset": 99},
    )
    run = simulate(rows)
    waits_s = next(event.t for event in run.events if event.kind == "photos_wait")
    ended_s = [event.t for event in run.events if event.kind == "call"]
    log = tmp_path / "rows.jsonl"
    log.write_bytes(run.log())
    with view_of(log) as address:
        opened(page, address)
        page.seek(round(waits_s + 0.5, 1))
        assert page.text(".doing") == "waiting for answers"
        assert "4 answers open" in page.text(".says")
        assert "Its answer is not there." in page.text(".photos")
        page.seek(round(ended_s[2] + 0.1, 1))
        assert re.match(
            r"computing on the drone, 0\.\d of about .*; photo at 0:\d\d$", page.text(".now .course")
        )
        page.seek(round(ended_s[-1] + 0.1, 1))
        course = page.text(".now .course")
        assert re.match(r"photo at \d:\d\d, \d+\.\d s in line, answer at \d:\d\d$", course)
        assert page.errors() == []


def test_a_flight_plays_on_its_own_from_the_beginning_to_the_end(
    page: Browser, one: str, logs: tuple[Path, Path]
) -> None:
    (record,) = read_records(logs[:1])
    minutes, seconds = divmod(int(record.result.mission_time_s), 60)
    opened(page, one)
    page.find("#speed").send_keys("100")
    page.click("#play")
    page.wait_until(lambda: 0 < page.moment() < 1400)
    assert page.text("#play") == "Pause"
    page.wait_until(lambda: page.text("#play") == "Play")
    assert page.text("#clock") == f"{minutes}:{seconds:02} / {minutes}:{seconds:02}"
    assert "mission completed" in page.text(".doing")


def test_the_bar_tells_the_call_of_a_drone_that_stands_and_none_while_it_flies_on(
    page: Browser, tmp_path: Path
) -> None:
    """One call of a mission that need not wait for its answers: the drone stands at first, and then goes on."""
    log = tmp_path / "standing.jsonl"
    decided = {"decision": "remote", "server": "s1", "deadline_s": 3.9, "selected": "s1", "raced": True}
    log.write_bytes(
        line("planned", 0.0, waypoints_m=[(0, 0), (20, 0)])
        + line("mission_started", 0.0, policy="x", waypoints=2)
        + line("arrived", 1.0, waypoint=0)
        + line("call_started", 2.0, operation="a.b", waypoint=0)
        + line("decided", 2.0, operation="a.b", waypoint=0, local_s=6.0, remote_s=1.0, **decided)
        + line("leg", 6.0, waypoint=1, east_m=20.0)
        + line("position", 7.0, east_m=5.0)
        + line("landed", 9.0) + line("mission_completed", 9.0)
    )  # fmt: skip
    with view_of(log) as address:
        page.open(address)
        page.wait_until(lambda: page.text("#clock").endswith("0:09"))
        page.seek(5.1)
        assert (
            page.text(".says p")
            == "PROGRAM calling s1, 3.1 of at most 3.9\N{NO-BREAK SPACE}s, also on the drone"
        )
        page.seek(6.5)
        assert page.text(".doing") == "flying to waypoint 1"
        assert "1 answer open" in page.text(".says")


def test_the_buttons_go_from_call_to_call(page: Browser, one: str, logs: tuple[Path, Path]) -> None:
    (record,) = read_records(logs[:1])
    ends = [call.at_s + call.delay_s for call in record.calls]
    opened(page, one)
    page.seek(0.0)
    for end in ends[:3]:
        page.click("#next")
        page.wait_for_moment(round(end, 1))
    assert f"waypoint {record.calls[2].waypoint}" in page.text(".now h3")
    page.click("#previous")
    page.wait_for_moment(round(ends[1], 1))


def test_a_waypoint_can_be_gone_to(page: Browser, one: str, logs: tuple[Path, Path]) -> None:
    (record,) = read_records(logs[:1])
    opened(page, one)
    page.find("#waypoint").send_keys("42", Keys.ENTER)
    (call,) = [call for call in record.calls if call.waypoint == 42]
    page.wait_for_moment(round(call.at_s + call.delay_s, 1))


def test_the_lanes_tell_of_a_moment_and_a_click_goes_there(page: Browser, one: str) -> None:
    opened(page, one)
    lanes = page.find("#time")
    from_the_top = 54 - lanes.size["height"] // 2  # the lane of calls is twice as high as that of s1
    ActionChains(page.driver).move_to_element_with_offset(lanes, 0, from_the_top).click().perform()
    page.wait_until(lambda: re.fullmatch(r"\d+:\d\d s1.*: .+", page.text("#lanes .tip")))
    minutes, seconds = page.text("#lanes .tip").split(" ")[0].split(":")
    page.wait_until(lambda: abs(page.moment() - 60 * int(minutes) - int(seconds)) < 1.5)


def turn_wheel(page: Browser, selector: str, *, ctrl: bool = False) -> None:
    """Turns the wheel over the middle of that element, and waits for what the page makes of it."""
    x, y = page.each(
        selector, "((box) => [box.x + box.width / 2, box.y + box.height / 2])(each.getBoundingClientRect())"
    )[0]
    turned = {"type": "mouseWheel", "x": x, "y": y, "deltaX": 0, "deltaY": 100, "modifiers": 2 if ctrl else 0}
    page.driver.execute_cdp_cmd("Input.dispatchMouseEvent", turned)
    page.drawn()


def scrolled_past(page: Browser, before_px: float) -> bool:
    return bool(page.run("return scrollY > arguments[0]", before_px))


def scale_of(page: Browser) -> str:
    return page.text(".leaflet-control-scale-line")


def test_the_wheel_scrolls_a_report_over_the_map_and_the_lanes_and_zooms_after_a_click(
    page: Browser, logs: tuple[Path, Path], tmp_path: Path
) -> None:
    report = tmp_path / "report.html"
    assert main(["report", str(logs[0]), "-o", str(report)]) == 0
    opened(page, report.as_uri())
    for figure in (".map", "#lanes"):
        page.run("scrollTo(0, 0)")
        turn_wheel(page, figure)
        page.wait_until(partial(scrolled_past, page, 0))
        assert page.find(f"{figure} ~ .hint, {figure} > .hint").is_displayed(), "which says how to zoom"
    page.run("scrollTo(0, 0)")
    page.click(".map")
    before_px, scale = page.run("return scrollY"), scale_of(page)
    turn_wheel(page, ".map")
    page.wait_until(lambda: scale_of(page) != scale)
    assert page.run("return scrollY") == before_px
    assert not page.find(".map ~ .hint").is_displayed()


def test_the_wheel_zooms_the_map_of_a_page_that_does_not_scroll(page: Browser, one: str) -> None:
    opened(page, one)
    for ctrl in (True, False):
        scale = scale_of(page)
        turn_wheel(page, ".map", ctrl=ctrl)
        page.wait_until(lambda: scale_of(page) != scale)  # noqa: B023 - it is called before the next


def test_the_estimates_and_the_decision_are_told_in_words(
    page: Browser, one: str, logs: tuple[Path, Path]
) -> None:
    (record,) = read_records(logs[:1])
    waited = next(call for call in record.calls if call.wait)
    opened(page, one)
    page.seek(round(waited.at_s + waited.waited_s / 2, 1))
    assert "Call under way" in page.text(".now h3")
    so_far = f"{waited.waited_s / 2:.1f}"[:-1]
    assert f", {so_far}" in page.text(".course")
    assert page.text(".cause").startswith("Waits for s")
    assert "expected: " in page.text(".reasons")
    assert "decided: wait for" in page.text(".reasons")
    page.seek(round(waited.at_s + waited.delay_s + 0.1, 1))
    sentence, *particulars = explained_calls(record.events)[record.calls.index(waited)].reasons
    assert page.text(".cause") == sentence
    assert all(particular in page.text(".reasons") for particular in particulars)


def test_two_flights_are_on_one_map_at_the_same_second_with_their_difference(
    page: Browser, two: str, logs: tuple[Path, Path]
) -> None:
    records = read_records(logs)
    opened(page, two)
    page.seek(1000.0)
    for key, record in zip("12", records, strict=True):
        page.find("body").send_keys(key)
        page.drawn()
        assert f"{calls_until(record, 1000.0)} calls" in page.text(".totals")
        assert page.text(".of-now h2").endswith(record.name)
    assert len(page.all(".map")) == 1 and len(page.all(".drone")) == 2
    reached = min(sum(call.at_s <= 1000.0 for call in record.calls) for record in records)
    apart_s = records[1].calls[reached - 1].at_s - records[0].calls[reached - 1].at_s
    assert page.text("#apart") == f"without is {clock(apart_s)} behind with"
    page.find("body").send_keys("1")
    assert page.errors() == []
    page.seek(2000.0)
    assert "mission completed" in page.text(".doing"), "the shorter one is over"
    assert page.text(".aside").startswith(f"with · {clock(records[0].result.mission_time_s)} · ")


# --- at a glance --------------------------------------------------------------------------------------------

STUCK = """
[autopilot]
on_failure = "hold"

[[fault]]
target = "autopilot"
kind = "stuck"
from_s = 40.0
"""


@pytest.mark.parametrize("width", [390, 1400])
def test_of_ten_servers_with_long_names_each_has_its_number_and_its_state_in_sight(
    page: Browser, tmp_path: Path, width: int
) -> None:
    names = [f"edge-server-on-the-roof-of-building-{number}" for number in range(1, 11)]
    ranges = {
        name: {"centre": {"east_m": 40.0 * index, "north_m": 0.0, "altitude_m": 0.0}, "radius_m": 50.0}
        for index, name in enumerate(names)
    }
    failed = {"server": names[9], "before": "CHECK", "after": "BLACKLISTED", "why": "no answer in 2.8 s"}
    log = tmp_path / "ten.jsonl"
    log.write_bytes(
        line("planned", 0.0, waypoints_m=[[0, 0], [360, 0]], ranges=ranges)
        + line("mission_started", 1.0, policy="look-ahead", waypoints=2)
        + line("position", 2.0, east_m=0.0, north_m=0.0, altitude_m=20.0)
        + line("check_failed", 3.0, **failed)
        + line("mission_ended", 6.0, why="")
    )
    with view_of(log) as address:
        opened(page, address, width=width)
        page.open_tab("servers")
        assert page.each(".servers tbody th", "each.title") == names
        for shown in (".servers tbody th", ".chip"):
            numbers = page.each(shown, "each.textContent.match(/[0-9]+/)[0]")
            assert numbers == [str(number) for number in range(1, 11)]
        assert page.rows(".servers")[9][1].startswith("left alone")
        right = "Math.round({}.getBoundingClientRect().right)"
        for border in ("each.closest('td')", "each.closest('.scroll')"):
            assert all(page.each(".servers .state", f"{right.format('each')} <= {right.format(border)}")), (
                border
            )


@pytest.fixture(scope="module")
def stuck(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a page about a flight whose vehicle stops on its way, and is left hovering."""
    folder = tmp_path_factory.mktemp("stuck")
    (folder / "stuck.toml").write_text((SCENARIOS / "demonstration.toml").read_text() + STUCK)
    log = folder / "stuck.jsonl"
    assert upwash("simulate", folder / "stuck.toml", "--log", log).returncode == 1
    with view_of(log) as address:
        yield address


def test_an_alarm_stands_above_everything_from_its_moment_on(page: Browser, stuck: str) -> None:
    opened(page, stuck)
    said = page.text("#alarms")
    assert "nobody flies it" in said
    assert "Take over with the remote control." in said
    assert "Since 1:45" in said
    assert page.driver.title == "ALARM · NOBODY · stuck"
    assert page.find("#alarms").get_attribute("role") == "alert"
    assert page.violations() == []
    page.run("window.scrollTo(0, document.body.scrollHeight)")
    page.drawn()
    assert page.run("return document.getElementById('alarms').getBoundingClientRect().top") >= 0
    page.seek(60.0)
    assert not page.find("#alarms").is_displayed(), "nothing was wrong then"
    assert page.driver.title == "PROGRAM · stuck"


def test_the_result_is_not_told_before_the_end(page: Browser, one: str) -> None:
    opened(page, one)
    assert page.find(".summary").is_displayed()
    page.seek(700.0)
    assert not page.find(".summary").is_displayed()


def vehicle_in(page: Browser) -> dict[str, str]:
    """What is told of the vehicle, by its name."""
    shown = page.each(
        ".tiles > div:not([hidden])", "['dt', 'dd'].map((part) => each.querySelector(part).textContent)"
    )
    return dict(shown)


def test_the_bar_and_the_outlook_tell_how_far_the_flight_is(
    page: Browser, one: str, logs: tuple[Path, Path]
) -> None:
    opened(page, one)
    (record,) = read_records([logs[0]])
    page.seek(700.0)
    assert page.text(".who") == "PROGRAM"
    (reached,) = re.findall(r"(\d+) of 121 waypoints reached", page.text(".aside"))
    assert int(reached) - calls_until(record, 700.0) in (0, 1)
    assert page.find(".bar").rect["height"] == 64
    assert vehicle_in(page) == {"motors": "armed"}, "a simulated log tells no more"
    (expected,) = re.findall(r"over at (\d+:\d\d), ", page.text(".outlook"))
    assert clocked(expected) == pytest.approx(record.result.mission_time_s, rel=0.05)
    page.seek(0.0)
    assert "0 of 121 waypoints reached" in page.text(".aside")


def clocked(text: str) -> int:
    minutes, seconds = text.split(":")
    return 60 * int(minutes) + int(seconds)


def test_the_outlook_tells_how_late_the_flight_is_and_why(
    page: Browser, tmp_path: Path, logs: tuple[Path, Path]
) -> None:
    """The same mission with s2 switched off: it was expected to end as the one where s2 serves."""
    (forecast,) = (event for event in event_log.read(logs[0]) if isinstance(event, schema.Foreseen))
    scenario_file, log = tmp_path / "late.toml", tmp_path / "late.jsonl"
    off = '\n[[fault]]\ntarget = "s2"\nkind = "off"\n'
    scenario_file.write_text((SCENARIOS / "thesis.toml").read_text() + off)
    assert upwash("simulate", scenario_file, "--log", log).returncode == 0
    (record,) = read_records([log])
    late_s = record.result.mission_time_s - forecast.as_asked_s
    with view_of(log) as address:
        opened(page, address)
        assert f"{int(late_s) // 60}:{int(late_s) % 60:02d} late: s2 failed" in page.text(".outlook")
        page.seek(20.0)
        assert "as forecast" in page.text(".outlook")


def test_a_flight_on_rows_is_late_by_its_turns_back(page: Browser, tmp_path: Path) -> None:
    rows = scenario(
        mission={"photos": {"every_m": 20.0}, "action_s": 2.0},
        policy={"act_within_s": 0.0},
        event={"every": 6, "offset": 2},
    )
    run, log = simulate(rows), tmp_path / "rows.jsonl"
    log.write_bytes(run.log())
    with view_of(log) as address:
        opened(page, address)
        turns = run.result.totals.turns_back
        assert turns > 1 and page.text(".outlook").endswith(f" late: turned back {turns} times")


def test_keys_play_and_move_anywhere_on_the_page(page: Browser, one: str) -> None:
    opened(page, one)
    body = page.find("body")
    page.seek(100.0)
    for key, at_s in ((Keys.ARROW_LEFT, 95.0), (Keys.ARROW_RIGHT, 100.0), (Keys.HOME, 0.0)):
        body.send_keys(key)
        page.wait_for_moment(at_s)
    body.send_keys(Keys.SPACE)
    page.wait_until(lambda: page.text("#play") == "Pause")
    body.send_keys(Keys.SPACE)
    page.wait_until(lambda: page.text("#play") == "Play")


def test_on_a_phone_the_controls_are_one_row_that_fingers_hit(page: Browser, one: str) -> None:
    opened(page, one, width=390)
    assert page.find("#controls").rect["height"] <= 64
    assert page.too_small("button, select, summary, input, .leaflet-bar a", least_px=44) == []


def test_the_slider_ends_at_the_end_of_the_flight(page: Browser, tmp_path: Path) -> None:
    log = tmp_path / "short.jsonl"
    here = {"east_m": 0.0, "north_m": 0.0, "altitude_m": 0.0}
    began = line("mission_started", 0.0, policy="x", waypoints=1) + line("arrived", 3.0, waypoint=0, **here)
    log.write_bytes(began + line("landed", 6.04, position=here) + line("mission_completed", 6.04))
    with view_of(log) as address:
        opened(page, address)
        page.seek(1.0)
        assert page.text(".who") == "PROGRAM"
        page.seek(6.0)
        assert page.text(".who") == "LANDED"


def test_the_map_fits_above_the_controls_beneath_an_alarm(page: Browser, stuck: str) -> None:
    page.open(stuck, width=1400, height=900)
    page.wait_until(lambda: page.text(".summary"))
    page.drawn()
    bottom, top = (page.find(part).rect for part in (".map", "#controls"))
    assert bottom["y"] + bottom["height"] <= top["y"]


# --- for everybody ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [390, 800])
def test_on_a_narrow_screen_nothing_is_cut_off(page: Browser, two: str, width: int) -> None:
    opened(page, two, width=width)
    assert page.width() <= width
    wider = page.each(
        "main *", "!each.closest('.scroll, .map') && each.getBoundingClientRect().right > innerWidth + 0.5"
    )
    assert not any(wider)
    assert page.too_small("button, select, summary, input") == [], "fingers are broad"


def test_the_colours_follow_the_system_while_the_page_is_open(page: Browser, one: str) -> None:
    opened(page, one)

    def darkness() -> list[int]:
        """Of the page, and the channel sums of the darkest and the lightest pixel of the lanes' names."""
        return list(
            page.run(
                "const canvas = document.querySelector('.lanes canvas'), width = 92 * devicePixelRatio;"
                "const data = canvas.getContext('2d').getImageData(0, 0, width, canvas.height).data;"
                "let most = 0, least = 765;"
                "for (let i = 0; i < data.length; i += 4) if (data[i + 3] > 250) {"
                "  const sum = data[i] + data[i + 1] + data[i + 2];"
                "  most = Math.max(most, sum); least = Math.min(least, sum); }"
                "const paper = getComputedStyle(document.body).backgroundColor;"
                "return [Number(paper === 'rgb(255, 255, 255)'), least, most]"
            )
        )

    assert darkness()[0] == 1
    light_least = darkness()[1]
    page.prefer("dark")
    wait_for(
        lambda: darkness()[0] == 0 and darkness()[1] > light_least, seen=lambda: (light_least, darkness())
    )
    assert darkness()[2] > 600, "light ink on dark paper"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_axe_finds_nothing_wrong(page: Browser, two: str, width: int, scheme: str) -> None:
    opened(page, two, width=width, scheme=scheme)
    for at_s, tab in ((1000.0, "flights"), (2800.0, "now"), (2800.0, "why"), (2800.0, "servers")):
        page.open_tab(tab)
        page.seek(at_s)
        assert page.violations() == []


def test_the_keyboard_reaches_and_moves_everything(page: Browser, one: str) -> None:
    opened(page, one)
    page.open_tab("why")
    page.run("document.activeElement.blur()")
    reached = set()
    for _ in range(24):
        page.driver.switch_to.active_element.send_keys(Keys.TAB)
        reached.add(
            page.run(
                "const a = document.activeElement; return a.id || a.className || a.tagName.toLowerCase()"
            )
        )
    controls = {"previous", "play", "next", "time", "speed"}
    regions = {
        "skip",
        "leaflet-control-zoom-in",
        "fit leaflet-control",
        "tab-why",
        "scroll many",
        "scroll lines",
    }
    assert controls | regions <= reached
    assert any("leaflet-container" in each for each in reached)
    page.seek(100.0)
    page.find("#time").send_keys(Keys.ARROW_LEFT)
    page.wait_for_moment(95.0)
    page.find("#play").send_keys(Keys.SPACE)
    page.wait_until(lambda: page.text("#play") == "Pause")


def test_what_a_log_says_is_never_markup(page: Browser, tmp_path: Path) -> None:
    here = {"east_m": 3.0, "north_m": 4.0, "altitude_m": 20.0}
    box = {"left_px": 1.0, "top_px": 1.0, "width_px": 9.0, "height_px": 9.0, "label": HOSTILE, "score": 0.5}
    ranges = {HOSTILE: {"centre": here, "radius_m": 5}}
    log = tmp_path / "hostile.jsonl"
    log.write_bytes(
        line("planned", 0.0, waypoints_m=[[0, 0]], ranges=ranges)
        + line("mission_started", 1.0, policy=HOSTILE, waypoints=1)
        + line("selected", 2.0, server=HOSTILE, before="AVL", after="CHECK", why=HOSTILE)
        + line("photo", 3.0, source=HOSTILE, position=here)
        + line("call", 4.0, operation=HOSTILE, place=HOSTILE, decision=HOSTILE, at_s=1.0, delay_s=1.0)
        + line("notified", 5.0, message=[box], at=here)
        + line("mission_ended", 6.0, why=HOSTILE)
    )
    with view_of(log) as address:
        opened(page, address)
        page.open_tab("why")
        assert page.each(".servers tbody th", "each.title") == [HOSTILE]
        page.wait_until(lambda: HOSTILE in page.text(".calls-table"))
        assert (
            page.run("return document.querySelectorAll('main img:not(.photo img), main script').length") == 0
        )
        assert page.errors() == []


class TileServer(ThreadingHTTPServer):
    """One green pixel wherever it is asked, and what it was asked."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), TileHandler)
        self.asked: list[str] = []


class TileHandler(BaseHTTPRequestHandler):
    server: TileServer

    def do_GET(self) -> None:
        self.server.asked.append(self.path)
        self.send_response(200)
        self.send_header("Content-Type", "image/svg+xml")
        self.end_headers()
        self.wfile.write(
            b'<svg xmlns="http://www.w3.org/2000/svg"><rect width="9" height="9" fill="green"/></svg>'
        )

    def log_message(self, *_: object) -> None:
        """Says nothing."""


@pytest.fixture
def tiles() -> Iterator[TileServer]:
    with TileServer() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def test_map_tiles_are_loaded_where_they_are_asked_for(
    page: Browser, logs: tuple[Path, Path], tiles: TileServer
) -> None:
    url = f"http://127.0.0.1:{tiles.server_port}/{{z}}/{{x}}/{{y}}.svg"
    with view_of(logs[0], "--tiles", url, "--credit", "Maps: the test") as address:
        opened(page, address)
        page.wait_until(lambda: page.all(".leaflet-tile-loaded"))
        assert page.text(".readout") == "Maps: the test"
        ActionChains(page.driver).move_to_element(page.find(".map")).perform()
        page.wait_until(lambda: page.text(".readout").startswith("pointer: 100 m east, 100 m north"))
        assert "Maps: the test" in page.text(".readout")
        (latitude,) = re.findall(r"(39\.\d+)°", page.text(".readout"))
        zoom, x, y = (int(part) for part in re.findall(r"\d+", tiles.asked[0]))
        assert x == pytest.approx((22.95 + 180) / 360 * 2**zoom, abs=3)
        assert y == pytest.approx(0.38086 * 2**zoom, abs=3), "39.37 degrees north, in Web Mercator"
        pixel_deg = 360 / 256 / 2**zoom * math.cos(math.radians(39.37))
        assert float(latitude) == pytest.approx(39.3675, abs=pixel_deg / 2 + 1e-7), (
            "the pointer is on a pixel"
        )
        assert page.errors() == []


def test_map_tiles_of_a_folder_are_served_and_lie_in_a_report(
    page: Browser, logs: tuple[Path, Path], tmp_path: Path
) -> None:
    folder = folder_with(tiles_around(39.3666, 22.95, range(14, 20)), tmp_path / "map")
    tiles = "[...document.querySelectorAll('.leaflet-tile')]"
    shown = f"return {tiles}.filter((tile) => tile.naturalWidth).map((tile) => tile.src)"
    with view_of(logs[0], "--tiles", folder) as address:
        opened(page, address)
        page.wait_until(lambda: any("/tiles/" in source for source in page.run(shown)))
        assert page.errors() == []
    made = tmp_path / "report.html"
    assert main(["report", str(logs[0]), "-o", str(made), "--tiles", str(folder)]) == 0
    page.open(made.as_uri())
    page.wait_until(lambda: any(source.startswith("data:image/png") for source in page.run(shown)))
    assert page.errors() == []
