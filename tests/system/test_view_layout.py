"""The page of a flight that goes on: each part keeps its place, whatever the log tells."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from tests.programs import ROOT, upwash
from tests.report.test_findings import BOX
from tests.system.browser import NEEDED, Browser, view_of
from tests.system.moments import FLYING, Event, event, written

pytestmark = NEEDED

PARTS = ["#bar", "#notices", ".map-frame", ".dock", ".tabs", "#timeline", "#controls", "#lanes"]
STEPS = 12


def told(folder: Path) -> Iterator[Event]:
    """The demonstration with a battery, photos, findings, an alarm and a notice."""
    log = folder / "simulated.jsonl"
    assert upwash("simulate", ROOT / "scenarios" / "demonstration.toml", "--log", log).returncode == 0
    yield event("log_opened", 0.0, time=(datetime.now(UTC) + timedelta(minutes=5)).isoformat())
    for each in map(json.loads, log.read_text().splitlines()):
        if each["event"] == "photo":
            each["source"] = f"park {each['t']:.0f}"
        yield each
        if each["event"] == "arrived":
            here = {"east_m": each["east_m"], "north_m": each["north_m"], "altitude_m": 10.0}
            yield event("position", each["t"], **here, **FLYING, battery_percent=90.0 - each["waypoint"])
            if each["waypoint"] == 5:
                yield event(
                    "vehicle_said", each["t"], severity=2, text="Battery 1 is critical " + "now " * 60
                )
        if each["event"] == "call":
            yield event("notified", each["t"], message=[BOX] * 3, at=here)


def test_an_alarm_that_the_row_has_no_room_for_is_read_whole_by_a_click(
    page: Browser, tmp_path: Path
) -> None:
    started = event("mission_started", 0.0, policy="x", waypoints=1)
    said = event("vehicle_said", 1.0, severity=2, text="Battery is critical, " * 20 + "the end")
    log = written(tmp_path / "long.jsonl", [started, said, event("mission_ended", 2.0, why="x")])
    with view_of(log) as address:
        page.open(address, width=390, height=844)
        page.wait_until(lambda: "the end" in page.text("#alarms"))
        page.drawn()
        cut = "const text = document.querySelector('#alarms > p'); return text.scrollHeight > text.clientHeight + 1"
        row = page.find("#notices").rect
        assert page.run(cut)
        page.click("#alarms summary")
        page.drawn()
        assert not page.run(cut)
        assert page.find("#notices").rect == row, "it lies over the map"
        assert page.violations() == []


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (390, 844)])
@pytest.mark.parametrize("tab", ["now", "findings"])
def test_nothing_moves_in_a_flight(page: Browser, tmp_path: Path, width: int, height: int, tab: str) -> None:
    events = list(told(tmp_path))
    log = written(tmp_path / "live.jsonl", events[:1])
    with view_of(log) as address:
        page.open(address, width=width, height=height)
        page.wait_until(lambda: page.text("#mode") == "live")
        page.open_tab(tab)

        def places() -> list[object]:
            page.drawn()
            return page.each(", ".join(PARTS), "JSON.stringify(each.getBoundingClientRect())")

        first = places()
        assert len(first) == len(PARTS)
        for step in range(1, STEPS + 1):
            known = events[: 1 + step * (len(events) - 1) // STEPS]
            with log.open("a") as file:
                file.writelines(
                    f"{json.dumps(each)}\n" for each in known[1 + (step - 1) * (len(events) - 1) // STEPS :]
                )
            last_s = known[-1]["t"]
            page.wait_until(lambda: float(page.find("#time").get_attribute("max") or 0) >= round(last_s, 1))  # noqa: B023 - it is called before the next
            assert places() == first
        assert page.text(".who") == "LANDED" and page.text("#tab-findings") != "Findings"
        page.wait_until(
            lambda: page.find(".photo img").get_attribute("src")
        )  # the page waits for the last of many
        assert page.all(".finds li")
        assert page.run("return document.documentElement.scrollHeight <= innerHeight")
        assert page.errors() == []
