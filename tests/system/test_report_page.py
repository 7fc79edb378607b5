"""The page of `upwash report`, in a browser: on paper, on a phone, in the dark, and for people who do not see it."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import pytest
from tests.events import line
from tests.system.browser import NEEDED, Browser
from tests.view.hostile_logs import hostile_log

from upwash.cli.main import main

pytestmark = NEEDED

HANDLE = """
const drawn = () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
for (const tab of document.querySelectorAll("[role=tab]")) {
  tab.click();
  await drawn();
}
document.querySelectorAll("details").forEach((each) => (each.open = true));
const slider = document.getElementById("time");
for (const share of [0, 0.1, 0.4, 0.8, 1]) {
  slider.value = share * slider.max;
  slider.dispatchEvent(new Event("input"));
  await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
}
document.querySelectorAll(".finds button, .worst button, #previous").forEach((each) => each.click());
"""

BOX = {
    "left_px": 700.0,
    "top_px": 500.0,
    "width_px": 30.0,
    "height_px": 20.0,
    "label": "hot-spot",
    "score": 0.9,
}


@pytest.fixture(scope="module")
def ill(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight that found something and was left hovering."""
    here = {"east_m": 20.0, "north_m": 0.0, "altitude_m": 10.0}
    file = tmp_path_factory.mktemp("ill") / "ill.jsonl"
    lines = [
        line("planned", 0.0, waypoints_m=[(0, 0), (20, 0)]),
        line("mission_started", 1.0, policy="location-aware", waypoints=2),
        line("arrived", 2.0, waypoint=0),
        line("photo", 3.0, source="park 2", position=here),
        line("notified", 4.0, message=[BOX], at=here),
        line("vehicle_said", 5.0, severity=3, text="Battery low"),
        line("left_hovering", 6.0),
        line("mission_ended", 7.0, why="Ctrl-C"),
    ]
    file.write_bytes(b"".join(lines))
    return file


@pytest.fixture(scope="module")
def few(ill: Path) -> str:
    """The address of a page about one flight."""
    return page_about(ill, at=ill.with_name("few.html"))


@pytest.fixture(scope="module")
def many(ill: Path, logs: tuple[Path, Path]) -> str:
    """The address of a page about six."""
    copies = [ill.with_name(f"{number}-{log.name}") for number in range(2) for log in logs]
    for copy in copies:
        copy.write_bytes(logs[copy.name.endswith("without.jsonl")].read_bytes())
    return page_about(ill, *copies, at=ill.with_name("many.html"))


def page_about(*logs: Path, at: Path) -> str:
    assert main(["report", *map(str, logs), "-o", str(at)]) == 0
    return at.as_uri()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1400, 390])
def test_everybody_can_read_it(page: Browser, few: str, many: str, scheme: str, width: int) -> None:
    for address in (few, many):
        page.open(address, width=width, height=844, scheme=scheme)
        page.run("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
        assert page.violations() == []
        assert page.errors() == []
        assert page.run("return document.documentElement.scrollWidth <= window.innerWidth")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1400, 390])
def test_everybody_can_read_the_clients_document(page: Browser, ill: Path, scheme: str, width: int) -> None:
    file = ill.with_name("client.html")
    assert main(["report", str(ill), "--client", "-o", str(file)]) == 0
    page.open(file.as_uri(), width=width, height=844, scheme=scheme)
    assert page.violations() == []
    assert page.errors() == []
    assert page.run("return document.documentElement.scrollWidth <= window.innerWidth")
    assert page.each(".looks svg", "each.getBoundingClientRect().width > 100") == [True, True]
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        assert page.run("return getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        assert set(page.each(".object, tr", "getComputedStyle(each).breakInside")) == {"avoid"}
    finally:
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_the_pictures_are_shown_under_the_pages_own_policy(page: Browser, few: str) -> None:
    page.open(few)
    loads = "const image = new Image(); image.src = document.querySelector('.gallery image').getAttribute('href');"
    assert page.run(f"{loads} return image.decode().then(() => image.naturalWidth)") == 96
    assert page.errors() == []


def test_the_alarm_is_the_first_thing_that_is_seen(page: Browser, few: str, many: str) -> None:
    for address, alarm in ((few, "#alarms"), (many, ".urgent")):
        page.open(address, width=1400)
        box = page.run("return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()", alarm)
        assert box["bottom"] < 450


def test_a_log_that_breaks_off_in_the_air_says_so_first(page: Browser, tmp_path: Path) -> None:
    log = tmp_path / "torn.jsonl"
    here = {"east_m": 20.0, "north_m": 0.0, "altitude_m": 10.0}
    began = line("planned", 0.0, waypoints_m=[(0, 0), (20, 0)]) + line("mission_started", 1.0, waypoints=2)
    foreseen = line("foreseen", 1.0, as_asked_s=60.0, reached_s=[10.0, 20.0])
    log.write_bytes(began + foreseen + line("position", 30.0, **here) + line("arrived", 31.0, waypoint=0))
    page.open(page_about(log, at=tmp_path / "torn.html"))
    page.wait_until(lambda: page.text(".who"))
    assert (page.text(".who"), page.text(".doing")) == ("LOG ENDS", "at 0:30 in the air · last: PROGRAM")
    assert "torn" in (page.find(".bar").get_attribute("class") or "")
    assert not page.text(".outlook"), "nobody knows when it was over"
    assert page.violations() == []
    page.seek(5.0)
    assert page.text(".who") == "PROGRAM"


def test_of_many_flights_the_one_that_is_shown_comes_after_the_summary(page: Browser, many: str) -> None:
    page.open(many, width=1400)
    page.drawn()
    tops = page.each(".together, main, .sheet > .note", "each.getBoundingClientRect().top")
    assert len(tops) == 3 and tops == sorted(tops)
    assert page.text(".aside").startswith("ill · ")


def test_of_four_flights_of_a_drone_each_can_be_chosen(
    page: Browser, tmp_path: Path, logs: tuple[Path, Path]
) -> None:
    copies = [tmp_path / f"{number}.jsonl" for number in range(4)]
    for copy in copies:
        copy.write_bytes(logs[0].read_bytes())
    page.open(page_about(*copies, at=tmp_path / "four.html"))
    page.wait_until(lambda: page.text(".aside").startswith("0 · "))
    page.find(".which select").send_keys("2")
    page.wait_until(lambda: page.text(".aside").startswith("2 · "))
    page.click("#hide")
    assert not page.find(".dock").is_displayed(), "one click hides it, whichever flight is shown"
    page.click("#hide")
    assert page.find(".dock").is_displayed() and len(page.all(".map")) == 1
    assert page.errors() == []


def test_what_is_folded_is_not_printed_and_no_figure_is_cut_from_its_heading(
    page: Browser, many: str
) -> None:
    page.open(many, width=1400, scheme="dark")
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        shown = page.each(
            "summary, #controls, .map-frame, .gallery svg, .together table", "each.checkVisibility()"
        )
        names = page.each("summary, #controls, .map-frame, .gallery svg, .together table", "each.tagName")
        seen = {name for name, is_shown in zip(names, shown, strict=True) if is_shown}
        assert seen == {"DIV", "svg", "TABLE"}, "the map, the pictures of findings, and a row a flight"
        assert page.run("return getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        kept = "return [...document.querySelectorAll('h2, .note')].map((each) => getComputedStyle(each).breakAfter)"
        assert set(page.run(kept)) == {"avoid"}
        torn = page.each("#page, main, .dock, .panel", "getComputedStyle(each).display")
        assert not {"grid", "flex"} & set(torn), "parts of a grid cover each other where a page ends"
    finally:
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_without_scripts_it_has_words_and_tables_and_no_dead_controls(page: Browser, few: str) -> None:
    page.driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        page.open(few, width=1400)
        shown = page.find("body").text
    finally:
        page.driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})
    assert "Without scripts" in shown
    assert "A person had to act" in shown
    assert "Play" not in shown
    assert "Loading" not in shown


def test_what_is_drawn_on_a_dark_screen_is_drawn_light_before_it_is_printed(page: Browser, few: str) -> None:
    darkest = (
        "const canvas = document.querySelector('.lanes canvas');"
        "const { data } = canvas.getContext('2d').getImageData(0, 0, 92, canvas.height);"
        "let least = 765; for (let i = 0; i < data.length; i += 4)"
        " if (data[i + 3] > 250) least = Math.min(least, data[i] + data[i + 1] + data[i + 2]); return least"
    )
    page.open(few, width=1400, scheme="dark")
    page.drawn()
    dark = page.run(darkest)
    assert page.run(f"dispatchEvent(new Event('beforeprint')); {darkest}") < 120 < dark, "the lanes' names"
    assert (
        page.run("return getComputedStyle(document.querySelector('.map')).backgroundColor")
        == "rgb(244, 246, 248)"
    )
    assert page.run(f"dispatchEvent(new Event('afterprint')); {darkest}") == dark


def test_it_prints_on_a4_with_its_map(page: Browser, few: str) -> None:
    page.open(few, width=1400)
    page.drawn()
    paper = {"paperWidth": 8.27, "paperHeight": 11.69}
    printed = base64.b64decode(page.driver.execute_cdp_cmd("Page.printToPDF", paper)["data"])
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", printed)) <= 6
    scale = page.run("return Number(document.querySelector('.map-frame').style.getPropertyValue('--scale'))")
    assert 0 < scale <= 1, "as wide as the paper"


@pytest.mark.parametrize(
    ("seed", "width"), [(seed, 390 if seed % 2 else 1280) for seed in (6, 7, 27, 31, 38)]
)
def test_no_log_breaks_the_page(page: Browser, tmp_path: Path, seed: int, width: int) -> None:
    log, file = tmp_path / "hostile.jsonl", tmp_path / "page.html"
    log.write_bytes(hostile_log(seed))
    assert main(["report", str(log), "-o", str(file)]) == 0
    page.open(file.as_uri(), width=width)
    page.driver.execute_async_script(f"(async () => {{{HANDLE}}})().finally(arguments[0])")
    page.drawn()
    assert page.errors() == []
    assert page.width() <= width
    assert page.all("main script, main iframe, main img:not(.photo img, .thumb img)") == []


def test_a_page_of_thousands_of_servers_shows_those_that_were_asked(page: Browser, tmp_path: Path) -> None:
    here = {"east_m": 3.0, "north_m": 4.0, "altitude_m": 20.0}
    names = ["constructor", *(f"s{number}" for number in range(5_000))]
    ranges = {name: {"centre": here, "radius_m": 5} for name in names}
    log, file = tmp_path / "many.jsonl", tmp_path / "page.html"
    log.write_bytes(
        line("planned", 0.0, waypoints_m=[[0, 0]], ranges=ranges)
        + line("mission_started", 1.0, policy="p", waypoints=1)
        + line("position", 1.5, **here)
        + line("started", 2.0, server="s4321", before="CHECK", after="READY")
        + line("mission_ended", 6.0, why="x")
    )
    assert main(["report", str(log), "-o", str(file)]) == 0
    page.open(file.as_uri())
    page.wait_until(lambda: len(page.rows(".servers")) == 100)
    assert ["s4321", "ready", "0 m, in range", "0", ""] in [
        [name, state.split()[0], *rest] for name, state, *rest in page.rows(".servers")
    ]
    assert "The log has 4901 servers more" in page.text(".of-servers")
    assert page.errors() == []
