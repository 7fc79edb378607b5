"""What the page of `upwash view` draws: the map, the photo with what was found on it, and the marks of calls."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from tests.events import line
from tests.system.browser import NEEDED, Browser, view_of

pytestmark = NEEDED

WAYPOINTS = [(0.0, 0.0), (40.0, 0.0), (80.0, 0.0), (84.0, 0.0), (120.0, 0.0)]
WIDTH_PX, HEIGHT_PX = 800, 600
AT_THE_BORDERS = [
    (0, 0, 40, 30),
    (770, 0, 30, 30),
    (760, 580, 40, 20),
    (-20, 590, 60, 30),
    (400, 300, 20, 20),
]
END_S = 50.0
COUNT, DIRT = "detector.count", "gauge.dirt"


def found(boxes: Sequence[tuple[int, int, int, int]], label: str) -> list[dict[str, object]]:
    names = ("left_px", "top_px", "width_px", "height_px")
    return [{**dict(zip(names, box, strict=True)), "label": label, "score": 0.87} for box in boxes]


def range_of(east_m: float, north_m: float, radius_m: float = 60.0) -> dict[str, object]:
    return {"centre": {"east_m": east_m, "north_m": north_m, "altitude_m": 0.0}, "radius_m": radius_m}


def flight() -> bytes:
    """A log of a waypoint each 10 s, with two calls at each; s1 and s2 are at nearly the same place, s3 is used."""
    text = line("log_opened", 0.0, time="2026-01-01T00:00:00+00:00", version=2)
    ranges = {"s1": range_of(40.0, 40.0), "s2": range_of(41.0, 40.0), "s3": range_of(90.0, -50.0)}
    home = {"latitude_deg": 39.3666, "longitude_deg": 22.9507}
    text += line("planned", 0.0, home=home, waypoints_m=WAYPOINTS, ranges=ranges)
    text += line("mission_started", 0.0, drone="d", policy="look-ahead", waypoints=len(WAYPOINTS))
    for waypoint, (east_m, north_m) in enumerate(WAYPOINTS):
        at_s = 10.0 * waypoint
        here = {"east_m": east_m, "north_m": north_m, "altitude_m": 10.0}
        place = "s3" if waypoint > 1 else "local"
        if waypoint == 2:
            step = {"server": "s3", "before": "AVL", "after": "CHECK", "why": "fastest"}
            text += line("selected", at_s - 5, **step)
            text += line("started", at_s - 4, **{**step, "before": "CHECK", "after": "READY"})
        text += line("position", at_s, **here)
        text += line("arrived", at_s, waypoint=waypoint, east_m=east_m, north_m=north_m)
        text += line("photo", at_s, source=f"{waypoint}.jpg", position=here)
        text += line("call", at_s + 1, operation=COUNT, place=place, delay_s=1.0)
        text += line("call", at_s + 2, operation=DIRT, place=place, delay_s=1.0)
        if waypoint in {1, 3}:
            boxes = AT_THE_BORDERS if waypoint == 3 else AT_THE_BORDERS[-1:]
            message = found(boxes, "hot-spot with quite a long name")
            text += line("notified", at_s + 3, message=message, at=here)
        text += line("position", at_s + 4, **here)
    return text + line("mission_completed", END_S)


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a page about the flight, with its photos."""
    cv2, np = pytest.importorskip("cv2"), pytest.importorskip("numpy")
    folder = tmp_path_factory.mktemp("logs")
    (folder / "flight.jsonl").write_bytes(flight())
    jpeg = cv2.imencode(".jpg", np.full((HEIGHT_PX, WIDTH_PX, 3), 90, np.uint8))[1].tobytes()
    for waypoint in range(len(WAYPOINTS)):
        (folder / f"{waypoint}.jpg").write_bytes(jpeg)
    with view_of(folder / "flight.jsonl", "--photos", folder) as address:
        yield address


def opened(page: Browser, address: str, at_s: float, *, width: int = 1400, **window: Any) -> None:
    """Opens the page at that second of the mission."""
    page.open(address, width=width, **window)
    page.wait_until(lambda: page.run("return document.getElementById('time').max") == "50.0")
    page.seek(at_s)


def boxes(page: Browser, selector: str) -> list[tuple[float, float, float, float]]:
    """Where the elements are in the window: left, top, right and bottom of each."""
    sides = "((box) => [box.left, box.top, box.right, box.bottom])(each.getBoundingClientRect())"
    return [(left, top, right, bottom) for left, top, right, bottom in page.each(selector, sides)]


def overlap(one: tuple[float, float, float, float], other: tuple[float, float, float, float]) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


# --- where things are -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (1920, 1080)])
def test_the_map_the_photo_and_the_lanes_are_in_the_first_view(
    page: Browser, one: str, width: int, height: int
) -> None:
    opened(page, one, 34.0, width=width, height=height)
    page.wait_until(lambda: boxes(page, ".photo")[0][2] > 0)  # a hidden element has no sides
    (map_box,), (photo,) = boxes(page, ".map"), boxes(page, ".photo")
    assert map_box[2] <= photo[0]
    (controls,), (lanes,) = boxes(page, "#controls"), boxes(page, "#lanes")
    assert max(map_box[3], photo[3]) <= controls[1], (map_box, photo, controls)
    assert lanes[3] <= height and not page.run("return document.documentElement.scrollHeight > innerHeight")


def test_on_a_phone_what_is_beside_the_map_slides_up_over_it(page: Browser, one: str) -> None:
    opened(page, one, 34.0, width=390, height=844)
    parts = ["#bar", "#notices", ".map-frame", ".tabs", "#controls", "#lanes"]
    tops = [boxes(page, part)[0][1] for part in parts]
    assert tops == sorted(tops)
    assert not any(page.each(".panel", "each.checkVisibility()"))
    before = [boxes(page, part) for part in parts]
    for name in ("now", "findings", "servers", "why"):
        page.open_tab(name)
        (panel,), (tabs,), (notices,) = (
            boxes(page, f".of-{name}"),
            boxes(page, ".tabs"),
            boxes(page, "#notices"),
        )
        assert notices[3] <= panel[1] and panel[3] <= tabs[1] + 1
        assert [boxes(page, part) for part in parts] == before
        assert page.width() <= 390
        assert page.too_small("button, select, summary, input, .leaflet-bar a", least_px=44) == []
        assert page.violations() == []
    page.click("#tab-why")
    page.drawn()
    assert not any(page.each(".panel", "each.checkVisibility()"))


def test_a_key_hides_what_is_beside_the_map_and_shows_it_again(page: Browser, one: str) -> None:
    opened(page, one, 34.0)
    page.open_tab("servers")
    (narrow,) = boxes(page, ".map")
    page.find("body").send_keys("d")
    page.wait_until(lambda: boxes(page, ".map")[0][2] == 1400)
    assert narrow[2] < 1100
    page.find("body").send_keys("d")
    page.wait_until(lambda: boxes(page, ".map") == [narrow])
    assert page.find(".of-servers").is_displayed()


def test_a_link_leads_to_a_moment_and_the_address_names_the_one_that_is_shown(
    page: Browser, one: str
) -> None:
    page.open(f"{one}#t=0:13")
    page.wait_until(lambda: page.text("#clock").startswith("0:13"))
    page.run("location.hash = '#t=33'")
    page.wait_until(lambda: page.text("#clock").startswith("0:33"))
    page.seek(21.0)
    page.wait_until(lambda: page.run("return location.hash") == "#t=0:21")


def test_the_arrows_go_from_tab_to_tab(page: Browser, one: str) -> None:
    opened(page, one, 34.0)
    page.find("#tab-now").send_keys(Keys.ARROW_RIGHT)
    assert page.find(".of-findings").is_displayed()
    assert page.driver.switch_to.active_element.get_attribute("id") == "tab-findings"
    assert page.each("[role=tab]", "each.tabIndex") == [-1, 0, -1, -1], "Tab goes to one of them"


def test_the_focus_goes_from_part_to_part_and_is_covered_by_none(page: Browser, one: str) -> None:
    opened(page, one, 34.0)
    page.run("document.getElementById('tab-findings').click()")  # which leaves the focus where it is
    order: list[str | None] = []
    while (now := page.driver.switch_to.active_element).tag_name != "body" or not order:
        now.send_keys(Keys.TAB)
        part, is_seen = page.run(
            "const { activeElement: now } = document, { left, top } = now.getBoundingClientRect();"
            "const parts = ['.skip', '.map-frame', '.tabs', '.panel', '#controls', '#lanes'];"
            "const seen = document.elementFromPoint(left + 10, Math.max(1, top + 10));"
            "return [parts.find((part) => now.closest(part)), now.contains(seen) || seen?.contains(now)]"
        )
        assert is_seen, f"{part}: {now.get_attribute('class')}"
        order.append(part)
    parts = list(dict.fromkeys(filter(None, order)))
    assert parts == [".skip", ".map-frame", ".tabs", ".panel", "#controls", "#lanes"]
    assert len(order) < 35, "of the list of findings it goes to one"


# --- the photo and the findings -----------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [390, 1400])
def test_the_labels_of_boxes_stay_within_the_photo_and_cover_no_other(
    page: Browser, one: str, width: int
) -> None:
    opened(page, one, 34.0, width=width)
    page.open_tab("now")
    page.wait_until(lambda: len(page.all(".boxes text")) == len(AT_THE_BORDERS))
    labels, (photo,) = boxes(page, ".boxes text"), boxes(page, ".photo")
    for number, label in enumerate(labels):
        assert photo[0] <= label[0] + 0.5 and label[2] <= photo[2] + 0.5, label
        assert photo[1] <= label[1] + 0.5 and label[3] <= photo[3] + 0.5, label
        assert not any(overlap(label, other) for other in labels[:number]), number
    assert {element.text.split()[0] for element in page.all(".boxes text")} == set("23456"), "as in the list"


LABEL = "hot-spot with quite a long name"


def current(page: Browser) -> str:
    """The number of the finding that is looked at, as the list has it."""
    return page.text(".finds [aria-current] .number")


def test_everything_that_was_found_is_listed_and_leads_to_its_moment(page: Browser, one: str) -> None:
    opened(page, one, 0.0)
    assert page.text(".sentence") == f"{1 + len(AT_THE_BORDERS)} {LABEL}s"
    page.open_tab("findings")
    assert page.each(".finds li", "each.textContent")[:2] == [
        f"1 {LABEL} 87 %waypoint 1 · 0:13",
        f"2 {LABEL} 87 %waypoint 3 · 0:33",
    ], "what is found later is not on top"
    assert current(page) == "", "nothing was found by then"
    assert len(page.all(".finds .later")) == 6
    first, second, third, *_ = page.all(".finds button")
    first.click()
    page.wait_until(lambda: page.text("#clock").startswith("0:13"))
    page.drawn()
    assert page.text(".photos p").startswith("Photo 2, at waypoint 1, ")
    assert f"Finding 1: {LABEL} 87 %." in page.text(".photos p")
    assert current(page) == "1"
    second.send_keys("\n")
    page.wait_until(lambda: page.text("#clock").startswith("0:33"))
    page.drawn()
    assert page.text(".photos p").startswith("Photo 4, at waypoint 3, ")
    assert current(page) == "2"
    third.click()
    page.wait_until(lambda: current(page) == "3")
    page.seek(40.0)
    assert current(page) == "3", "while its message is the last"


def test_findings_have_pictures_and_the_one_that_is_selected_a_larger_one(page: Browser, one: str) -> None:
    opened(page, one, 34.0)
    page.open_tab("findings")
    page.wait_until(lambda: page.each(".thumb img", "each.naturalWidth > 0").count(True) >= 4)
    assert set(page.each(".thumb", "each.getBoundingClientRect().width")) == {72}
    page.find("body").send_keys("n")
    page.wait_until(lambda: page.each(".crop img", "each.naturalWidth > 0") == [True])
    assert page.find(".crop").rect["width"] == 100
    assert page.errors() == []


def test_findings_are_sorted_and_filtered_in_the_list_and_on_the_map(page: Browser, tmp_path: Path) -> None:
    log = tmp_path / "scores.jsonl"
    box = dict(zip(("left_px", "top_px", "width_px", "height_px"), AT_THE_BORDERS[-1], strict=True))
    scores = {"soiling": 0.9, "hot-spot": 0.3, "broken-module": 0.7}
    text = line("planned", 0.0, waypoints_m=[(0.0, 0.0), (90.0, 0.0)])
    text += line("mission_started", 0.0, policy="x", waypoints=2)
    for number, (label, score) in enumerate(scores.items()):
        at = {"east_m": 40.0 * number, "north_m": 0.0, "altitude_m": 10.0}
        text += line("photo", 10.0 * number, source=f"{number}.jpg", position=at)
        text += line("notified", 10.0 * number + 1, message=[{**box, "label": label, "score": score}], at=at)
    log.write_bytes(text + line("mission_completed", END_S))

    def numbers() -> list[str]:
        page.drawn()
        return page.each(".finds .number", "each.textContent")

    def choose(name: str, value: str) -> list[str]:
        page.run(
            "const field = document.querySelector(`.choice [aria-label^='${arguments[0]}'], .choice input`);"
            "field.value = arguments[1]; field.dispatchEvent(new Event('change', { bubbles: true }));",
            name,
            value,
        )
        return numbers()

    with view_of(log) as address:
        opened(page, address, END_S)
        page.open_tab("findings")
        assert numbers() == ["1", "2", "3"]
        page.find("body").send_keys("s")
        assert numbers() == ["1", "3", "2"], "the surest first"
        page.find("body").send_keys("s")
        assert numbers() == ["2", "3", "1"]
        before = inked(page)
        assert choose("at least", "50") == ["3", "1"]
        assert "2 of 3 shown" in page.text(".choice")
        assert inked(page) < before, "the others are not on the map"
        assert choose("Label", "broken module") == ["3"], "which people call so"
        for key in "nr":
            ActionChains(page.driver).send_keys(key).perform()
            page.drawn()
        page.wait_until(lambda: numbers() == [])
        assert choose("Review", "rejected") == ["3"]
        assert choose("Label", "any label") == ["3"]
        assert choose("Review", "all of them") == ["3", "1"]
        assert page.violations() == []


def test_a_click_on_the_photo_shows_a_finding_in_the_list(page: Browser, one: str) -> None:
    opened(page, one, 34.0)
    page.wait_until(lambda: len(page.all(".boxes .found")) == len(AT_THE_BORDERS))
    assert current(page) == "6", "the last"
    page.run("document.querySelector('.boxes .found').dispatchEvent(new MouseEvent('click'))")
    page.wait_until(lambda: current(page) == "2")
    page.wait_until(lambda: page.all(".boxes .found.current"))
    assert page.each(".boxes .found", "each.classList.contains('current')") == [True, *[False] * 4]


def test_a_click_on_a_number_on_the_map_shows_that_finding(page: Browser, one: str) -> None:
    opened(page, one, 34.0)
    page.drawn()
    assert current(page) == "6", "the last"
    page.run(
        "const map = document.querySelector('.map'); const frame = map.getBoundingClientRect();"
        "const act = (kind, clientX, clientY) => "
        "map.dispatchEvent(new MouseEvent(kind, { clientX, clientY, bubbles: true }));"
        "for (let x = frame.left; x < frame.right; x += 4) for (let y = frame.top; y < frame.bottom; y += 4) {"
        "  act('mousemove', x, y); if (map.classList.contains('on-finding')) return act('click', x, y); }"
    )  # the most western one
    page.wait_until(lambda: current(page) == "1")
    assert page.text("#clock").startswith("0:13")


def test_where_something_was_found_has_its_number_on_the_map(page: Browser, one: str) -> None:
    opened(page, one, 12.9)
    before = inked(page)
    page.seek(13.1)
    assert inked(page) > before + 30


def arranged(page: Browser, places: Sequence[tuple[float, float]]) -> list[dict[str, Any] | None]:
    """What the map draws for a finding at each of these places, in pixels; None for a dot alone."""
    return list(
        page.run(
            "const { Pills } = modules['pills.js']; const pills = new Pills();"
            "const placed = arguments[0].map(([x, y], no) => [{ no, at_s: no }, { x, y }]); pills.arrange([placed]);"
            "return placed.map(([finding]) => {"
            "  const [{ move, words }] = pills.signsOf(finding, false, Infinity);"
            "  return words === '' ? null : { move, words: String(words) }; })",
            places,
        )
    )


def test_a_finding_with_room_around_it_has_its_number_in_its_place(page: Browser, one: str) -> None:
    page.open(one)
    far_apart = [(30.0 * number, 50.0) for number in range(4)]
    assert [sign and sign["move"] for sign in arranged(page, far_apart)] == [[0, 0]] * 4


def test_a_number_that_had_to_move_stays_near_its_place_and_covers_no_other(page: Browser, one: str) -> None:
    page.open(one)
    row = [(12.0 * number, 50.0) for number in range(6)]
    signs = [sign for sign in arranged(page, row) if sign]
    assert [sign["words"] for sign in signs] == list("012345")
    middles = [(x + sign["move"][0], y + sign["move"][1]) for (x, y), sign in zip(row, signs, strict=True)]
    assert all(abs(sign["move"][0]) <= 45 and abs(sign["move"][1]) <= 36 for sign in signs)
    numbers = [(x - 8, y - 8, x + 8, y + 8) for x, y in middles]
    assert not any(overlap(here, other) for here in numbers for other in numbers if here is not other)


def test_where_too_many_lie_close_together_one_count_stands_for_all(page: Browser, one: str) -> None:
    page.open(one)
    crowd = [(5.0 + 3 * (number % 5), 5.0 + 3 * (number // 5)) for number in range(17)]
    signs = arranged(page, [*crowd, (300.0, 300.0)])
    assert [sign and sign["words"] for sign in signs] == ["\N{MULTIPLICATION SIGN}17", *[None] * 16, "17"]


def test_findings_can_be_downloaded(page: Browser, one: str) -> None:
    opened(page, one, 34.0)
    page.find("body").send_keys("e")
    page.wait_until(lambda: page.find(".downloads a").is_displayed())
    assert page.driver.switch_to.active_element.text == "findings.csv"
    names = ["findings.csv", "findings.geojson", "findings.kml", "findings.zip"]
    assert [link.text for link in page.all(".downloads a")] == names
    written = page.run(
        "return fetch(document.querySelector('.downloads a').href).then((answer) => answer.text())"
    )
    assert [row["number"] for row in csv.DictReader(io.StringIO(written))] == list("123456")


# --- the map --------------------------------------------------------------------------------------------------


def inked(page: Browser) -> int:
    """How many pixels of the map's marks are drawn."""
    page.drawn()
    return int(
        page.run(
            "const canvas = document.querySelector('.leaflet-marks-pane canvas');"
            "const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);"
            "let count = 0; for (let i = 3; i < data.length; i += 4) count += data[i] > 0; return count"
        )
    )


def test_waypoints_have_numbers_where_there_is_room_for_them(page: Browser, one: str) -> None:
    opened(page, one, 0.0)
    assert inked(page) == 0, "the closest two are 4 m from each other"

    def zoomed_in() -> bool:
        page.click(".leaflet-control-zoom-in")
        return inked(page) > 0

    page.wait_until(zoomed_in)
    page.wait_until(lambda: not page.all(".leaflet-zoom-anim"))
    page.click(".fit")
    page.wait_until(lambda: inked(page) == 0)


def test_the_way_flown_begins_with_the_first_position(page: Browser, tmp_path: Path) -> None:
    """The map is drawn with the plan, before the log has any position."""
    log = tmp_path / "flight.jsonl"
    lines = flight().splitlines(keepends=True)
    rest = [text for text in lines[3:] if b'"call"' not in text]  # a call's operation redraws the whole map
    log.write_bytes(b"".join(lines[:3]))
    with view_of(log) as address:
        page.open(address)
        page.wait_until(lambda: boxes(page, ".chip"))
        page.drawn()
        steps = {"arming": [line("arming", 0.0)], "armed": [line("armed", 0.0)], "completed": rest}
        for doing, more in steps.items():
            with log.open("ab") as growing:
                growing.write(b"".join(more))
            while doing not in page.text("#bars") + page.text("main"):
                page.drawn()
        assert page.errors() == []


def test_the_labels_of_close_servers_cover_neither_each_other_nor_the_drone(page: Browser, one: str) -> None:
    opened(page, one, 0.0)
    for at_s in (0.0, 12.0, 15.0, 17.0, 35.0, 50.0):
        page.seek(at_s)
        labels, (drone,) = boxes(page, ".chip"), boxes(page, ".drone")
        assert len(labels) == 3
        for number, label in enumerate(labels):
            assert not any(overlap(label, other) for other in labels[:number])
            assert not overlap(label, drone)


def test_servers_that_nobody_uses_are_pale(page: Browser, one: str) -> None:
    def strong() -> list[str]:
        chips = page.all(".chip:not(.aside)")
        return [chip.text.split()[0] for chip in chips]

    opened(page, one, 10.0)
    assert strong() == []
    page.seek(15.5)
    assert strong() == ["s3"], "it is being checked"
    page.seek(30.0)
    assert strong() == ["s3"]


def test_a_line_leads_from_the_drone_to_the_server_that_it_uses(page: Browser, one: str) -> None:
    def is_between() -> bool:
        """Whether the server's colour is half-way from the drone to the server's label."""
        return bool(
            page.run(
                "const middle = (selector) => { const box = document.querySelector(selector).getBoundingClientRect();"
                " return [box.x + box.width / 2, box.y + box.height / 2]; };"
                "const [drone, server] = [middle('.drone'), middle('.server:nth-child(4) .chip, .chip:not(.aside)')];"
                "const canvas = document.querySelector('.leaflet-overlay-pane canvas');"
                "const at = canvas.getBoundingClientRect();"
                "const [x, y] = [0, 1].map((axis) => (drone[axis] + server[axis]) / 2 - [at.x, at.y][axis]);"
                "const { data } = canvas.getContext('2d').getImageData(x - 3, y - 3, 7, 7);"
                "const style = getComputedStyle(document.documentElement).getPropertyValue('--place-3').trim();"
                "const wanted = [1, 3, 5].map((from) => parseInt(style.slice(from, from + 2), 16));"
                "for (let i = 0; i < data.length; i += 4)"
                " if (wanted.every((value, channel) => Math.abs(data[i + channel] - value) < 12)"
                " && data[i + 3] > 200) return true;"
                "return false"
            )
        )

    opened(page, one, 34.0)
    assert page.text(".chip:not(.aside)").startswith("s3")
    assert is_between()


def test_the_drone_points_the_way_it_flies(page: Browser, one: str) -> None:
    opened(page, one, 7.0)
    assert page.find(".airframe").get_attribute("transform") == "rotate(90 16 16)", "to the east"
    rotors = set()
    for at_s in (7.0, 8.0, 9.0):
        page.seek(at_s)
        rotors.add(page.find(".rotor").value_of_css_property("fill"))
    assert len(rotors) == 1, "they have the same colour at each moment"


def test_the_readout_is_of_the_pointer_alone(page: Browser, one: str) -> None:
    opened(page, one, 10.0)
    assert page.text(".readout") == ""
    ActionChains(page.driver).move_to_element(page.find(".map")).perform()
    page.wait_until(lambda: page.text(".readout").startswith("pointer: "))
    assert "°" in page.text(".readout")
    ActionChains(page.driver).move_to_element(page.find("h1")).perform()
    page.wait_until(lambda: page.text(".readout") == "")
    page.run("document.querySelector('.map').focus({focusVisible: true})")
    page.find(".map").send_keys("\ue012")  # to the left
    page.wait_until(lambda: page.text(".readout").startswith("centre of the map: "))


# --- calls ----------------------------------------------------------------------------------------------------


def test_the_operation_of_a_call_is_told_by_the_fill_of_its_mark(page: Browser, one: str) -> None:
    opened(page, one, END_S)
    page.open_tab("servers")
    entries = [element.text for element in page.all(".legend .entry")]
    assert "filled: detector" in entries and "hollow: gauge" in entries, "services by their titles"
    middles = page.run(
        "const canvas = document.querySelector('.lanes canvas'), context = canvas.getContext('2d');"
        "const style = getComputedStyle(document.documentElement).getPropertyValue('--place-3').trim();"
        "const wanted = [1, 3, 5].map((from) => parseInt(style.slice(from, from + 2), 16));"
        "const { data } = context.getImageData(0, 0, canvas.width, canvas.height);"
        "const isWanted = (x, y) => wanted.every((value, channel) => "
        " Math.abs(data[4 * (y * canvas.width + x) + channel] - value) < 12)"
        " && data[4 * (y * canvas.width + x) + 3] > 250;"  # the lines beneath the marks are faint
        "const marks = []; let last = -9;"
        "for (let x = 92; x < canvas.width; x += 1) {"  # right of the names
        "  const ys = []; for (let y = 0; y < canvas.height; y += 1) if (isWanted(x, y)) ys.push(y);"
        "  if (!ys.length) continue;"
        "  if (x > last + 1) marks.push({x: [], y: []});"
        "  last = x; marks.at(-1).x.push(x); marks.at(-1).y.push(...ys); }"
        "const middle = (values) => Math.round((Math.min(...values) + Math.max(...values)) / 2);"
        "return marks.map(({x, y}) => isWanted(middle(x), middle(y)))"
    )
    assert middles == [True, False] * 3, "of the two calls at each of three waypoints"


def test_a_figure_is_the_same_whichever_way_its_moment_was_reached(page: Browser, one: str) -> None:
    keep = (
        "window.kept = [...document.querySelectorAll('.lanes canvas, .leaflet-marks-pane canvas')].map("
        "(each) => each.getContext('2d').getImageData(0, 0, each.width, each.height).data)"
    )

    def kept() -> None:
        page.run(keep + "; window.before = window.kept")

    def differing() -> int:
        """How many pixels are drawn otherwise than in the figures that were kept."""
        return int(
            page.run(
                keep + "; let count = 0; window.kept.forEach((data, figure) => {"
                " for (let i = 3; i < data.length; i += 4)"
                " count += Math.abs(data[i] - window.before[figure][i]) > 32; }); return count"
            )
        )

    opened(page, one, 0.0)
    page.seek(31.5)
    kept()
    page.seek(END_S)
    assert differing() > 100
    page.seek(31.5)
    assert differing() == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1400])
def test_axe_finds_nothing_wrong(page: Browser, one: str, width: int, scheme: str) -> None:
    opened(page, one, 34.0, width=width, scheme=scheme)
    for name in ("now", "findings"):
        page.open_tab(name)
        page.wait_until(lambda: page.all(".boxes text"))
        assert page.violations() == []
    assert page.errors() == []
