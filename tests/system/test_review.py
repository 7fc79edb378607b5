"""Findings are reviewed in a browser: by keyboard alone, by touch on a phone, live, and in a page that was mailed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from tests.events import line
from tests.report.test_findings import BOX
from tests.system.browser import NEEDED, Browser, view_of

from upwash.cli.main import main
from upwash.report.record import read_records, reviewed_of
from upwash.report.reviewed import ReviewedFindings
from upwash.report.reviews import append_review, review_file

pytestmark = NEEDED

HOSTILE = "</title><img src=x onerror=alert(1)> \u05e9\u05dc\u05d5\u05dd"


def notified(number: int) -> bytes:
    place = {"east_m": 20.0 * number, "north_m": 0.0, "altitude_m": 10.0}
    return b"".join(
        (
            line("photo", 10.0 * number + 3, source="park 2", position=place),
            line("notified", 10.0 * number + 4, message=[BOX], at=place),
        )
    )


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A flight that goes on, with four findings."""
    file = tmp_path / "f.jsonl"
    plan = line("planned", 0.0, waypoints_m=[(20 * number, 0) for number in range(6)])
    began = line("mission_started", 1.0, policy="location-aware", waypoints=6)
    file.write_bytes(b"".join((plan, began, *map(notified, range(4)))))
    return file


@pytest.fixture
def address(log: Path) -> Iterator[str]:
    with view_of(log) as address:
        yield address


def press(page: Browser, *keys: str) -> None:
    """Presses them one after the other, as a person does who sees what each has done."""
    for key in keys:
        ActionChains(page.driver).send_keys(key).perform()
        page.drawn()


def opened(page: Browser, address: str, width: int = 1280) -> None:
    page.open(address, width=width)
    page.wait_until(lambda: page.text(".tally") == "0 of 4 reviewed")
    page.drawn()


def kept(log: Path) -> ReviewedFindings:
    return reviewed_of(read_records([log]))


def test_findings_are_reviewed_by_keyboard_alone(page: Browser, address: str, log: Path) -> None:
    opened(page, address)
    press(page, "a")
    assert page.text(".tally") == "0 of 4 reviewed", "nothing is selected"
    press(page, "n", "r", "a", "l")
    press(page, HOSTILE, Keys.ENTER)
    page.wait_until(lambda: page.text(".tally") == "3 of 4 reviewed, 1 rejected")
    page.wait_until(lambda: page.text(".sentence").startswith("3 findings: 2 hot-spots, 1 x "))
    assert HOSTILE in page.text(".finds"), "as text"
    assert page.each(".finds .number", "each.textContent") == ["2", "3", "4"]
    assert [(each.number, each.finding.what) for each in kept(log).objects] == [
        (2, "hot-spot"),
        (3, HOSTILE),
        (4, "hot-spot"),
    ]
    press(page, "u", "u", "u")
    page.wait_until(lambda: not any(each.is_reviewed for each in kept(log).everything))
    page.wait_until(lambda: page.text(".finds [aria-current] .number") == "1")
    press(page, "n", Keys.ARROW_DOWN, Keys.ARROW_UP)
    assert page.driver.switch_to.active_element.text.startswith("2 "), "arrows go through the list"
    assert page.each(".finds button", "each.tabIndex") == [-1, 0, -1, -1], "Tab leaves it at once"
    assert page.violations() == []
    assert page.errors() == []


def test_findings_are_reviewed_by_touch_on_a_phone(page: Browser, address: str, log: Path) -> None:
    opened(page, address, width=390)
    page.open_tab("findings")
    assert page.too_small(".findings button, .findings summary, .findings select", least_px=44) == []

    def tap(selector: str) -> None:
        page.run("document.querySelector(arguments[0]).scrollIntoView({block: 'center'})", selector)
        page.drawn()
        box = page.run(
            "return document.querySelector(arguments[0]).getBoundingClientRect().toJSON()", selector
        )
        at = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
        for kind, points in (("touchStart", [at]), ("touchEnd", [])):
            page.driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        page.drawn()

    page.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    try:
        tap(".finds li:nth-child(2) button")
        page.wait_until(lambda: page.text(".review .target").startswith("2 "))
        tap(".verdicts button:nth-child(2)")
        page.wait_until(lambda: page.text(".review .target").startswith("3 "))
        tap(".verdicts button:nth-child(1)")
        page.wait_until(lambda: page.text(".tally") == "2 of 4 reviewed, 1 rejected")
        page.find(".choice [aria-label=Review]").send_keys("all")
        page.wait_until(lambda: len(page.all(".finds li")) == 4)
        tap(".more summary")
        assert page.width() <= 390
        assert page.violations() == []
    finally:
        page.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
    page.wait_until(lambda: kept(log).tally.words == "2 of 4 reviewed, 1 rejected")
    assert page.errors() == []


def test_what_comes_while_a_person_reviews_takes_nothing_out_of_their_hand(
    page: Browser, address: str, log: Path
) -> None:
    opened(page, address)
    press(page, "n", "m", "half a ")
    with log.open("ab") as grown:
        grown.write(notified(4))
    page.wait_until(lambda: page.text(".tally") == "0 of 5 reviewed")
    press(page, "note", Keys.ENTER)
    page.wait_until(lambda: [each.note for each in kept(log).everything] == ["half a note", "", "", "", ""])
    assert page.text(".review .target").startswith("1 ")
    (review,) = kept(log).everything[0].reviews
    append_review(log, replace(review, note="another hand"))
    page.wait_until(lambda: "another hand" in page.text(".finds"))  # so the program has read the file
    review_file(log).unlink()
    page.wait_until(lambda: "half a note" not in page.text(".finds"))
    page.wait_until(lambda: "another hand" not in page.text(".finds"))
    review_file(log).mkdir()
    press(page, "r")
    page.wait_until(lambda: "the review was not kept" in page.text(".said"))
    assert page.text(".tally") == "0 of 5 reviewed"
    page.errors()  # which has the answer


def test_a_page_that_was_mailed_offers_its_reviews_as_a_file(page: Browser, log: Path) -> None:
    file = log.with_name("f.html")
    assert main(["report", str(log), "-o", str(file)]) == 0
    opened(page, file.as_uri())
    press(page, "n", "r", "m", "look again", Keys.ENTER)
    page.wait_until(lambda: page.text(".made") == "Download f.review.jsonl")
    folder = log.with_name("downloads")
    allow = {"behavior": "allow", "downloadPath": str(folder)}
    page.driver.execute_cdp_cmd("Browser.setDownloadBehavior", allow)
    page.click(".made a")
    page.wait_until((folder / "f.review.jsonl").exists)
    review_file(log).write_bytes((folder / "f.review.jsonl").read_bytes())
    first, second = kept(log).everything[:2]
    assert (first.is_rejected, second.is_reviewed, second.note) == (True, False, "look again")
    assert page.text(".tally") == "1 of 4 reviewed, 1 rejected"
    assert page.errors() == []
