"""A long flight's page stays small, and its figures can be read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
from tests.report.pages import SVG, XHTML, Told, log_of, of_class, parsed, table_named, text

from upwash.report.delays import MANY

COMPLETED: Told = (9e6, "mission_completed", {})


def calls(number: int, *, operations: int = 1) -> Iterator[Told]:
    """A call each ten seconds, every other on s1, which waits one time in ten."""
    for waypoint in range(number):
        t = 10.0 * (waypoint + 1)
        yield (
            t,
            "arrived",
            {"waypoint": waypoint, "east_m": float(waypoint % 50), "north_m": float(waypoint // 50)},
        )
        where = {"east_m": float(waypoint % 50), "north_m": float(waypoint // 50)}
        operation = f"service.operation_{waypoint % operations}"
        facts = {"operation": operation, "why": "so it is", "position": where}
        yield t + 1, "decided", facts | {"decision": "local"}
        waited = {"wait": "paid off", "waited_s": 1.0} if waypoint % 10 == 1 else {}
        remote = waypoint % 2
        yield (
            t + 5,
            "call",
            {"operation": operation, "place": "s1" if remote else "local", "delay_s": 1.0 + waypoint % 4}
            | waited,
        )


def long_flight(file: Path, number: int, *, operations: int = 1) -> Path:
    return log_of(
        file,
        (1.0, "mission_started", {"policy": "location-aware", "waypoints": number}),
        *calls(number, operations=operations),
        COMPLETED,
    )


def figure(page: ElementTree.Element, title: str) -> ElementTree.Element:
    (svg,) = [
        each for each in page.iter(f"{SVG}svg") if (each.findtext(f"{SVG}title") or "").startswith(title)
    ]
    return svg


def test_up_to_some_hundred_calls_each_has_its_mark_and_its_row(tmp_path: Path) -> None:
    page = parsed(long_flight(tmp_path / "short.jsonl", MANY))
    assert len(of_class(figure(page, "Call delay"), "mark")) == MANY
    assert len(table_named(page, "Calls by waypoint")) == MANY + 1


def test_more_calls_are_drawn_by_their_quartiles(tmp_path: Path) -> None:
    page = parsed(long_flight(tmp_path / "long.jsonl", 2000))
    chart = figure(page, "Call delay")
    boxes = [each for each in chart.iter(f"{SVG}g") if of_class(each, "quartiles")]
    assert len(boxes) == 80, "40 bins of 50 waypoints, with calls at two places each"
    first = [box.findtext(f"{SVG}title") for box in boxes[:2]]
    assert first == [
        "waypoints 0-49: 25 calls of service.operation_0 on the drone, "
        "1.00 s in the middle, half of them 1.00 to 3.00 s, all 1.00 to 3.00 s",
        "waypoints 0-49: 25 calls of service.operation_0 on s1, "
        "2.00 s in the middle, half of them 2.00 to 4.00 s, all 2.00 to 4.00 s",
    ]
    waits = [title for title in chart.iter(f"{SVG}title") if "waited" in (title.text or "")]
    assert len(waits) == 40
    assert waits[0].text == "waypoints 0-49: 5 calls waited, 5.0 s altogether"


def test_a_long_table_has_the_first_and_the_last_rows_and_says_where_the_rest_is(tmp_path: Path) -> None:
    rows = table_named(parsed(long_flight(tmp_path / "long.jsonl", 2000)), "Calls by waypoint")[1:]
    assert [row[0] for row in (rows[0], rows[99], rows[101], rows[-1])] == ["0", "99", "1900", "1999"]
    assert rows[100] == ["1800 rows are left out: --csv FILE writes every call"]


@pytest.mark.parametrize("number", [20_000])
def test_the_page_of_a_longer_flight_is_no_larger(tmp_path: Path, number: int) -> None:
    page = parsed(long_flight(tmp_path / "longer.jsonl", number))
    assert len(of_class(page, "mark")) < 3 * 3000
    assert len(list(page.iter(f"{XHTML}tr"))) < 1500
    assert sum(1 for _ in page.iter()) < 25_000
    assert f"{number} of {number}" in text(page)


def test_states_that_follow_each_other_closely_are_drawn_by_the_longest(tmp_path: Path) -> None:
    steps = [
        (10.0 * number + offset, kind, {"server": "s1", "before": before, "after": after, "why": "so"})
        for number in range(1, 1001)
        for offset, kind, before, after in (
            (0.0, "selected", "AVL", "CHECK"),
            (1.0, "started", "CHECK", "READY"),
            (9.0, "deselected", "READY", "AVL"),
        )
    ]  # fmt: skip
    page = parsed(log_of(tmp_path / "busy.jsonl", *steps, (10_010.0, "mission_completed", {})))
    states = of_class(figure(page, "States of the servers"), "state")
    assert len(states) < 450
    ready = [state for state in states if "state-ready" in state.get("class", "")]
    assert sum(float(each.get("width", "")) for each in ready) > 600, (
        "of 656, as it was READY for the most part"
    )
    assert "the one that lasted longest is drawn" in text(page)
    assert "lasted longest" not in text(parsed(log_of(tmp_path / "quiet.jsonl", *steps[:30], COMPLETED)))


# --- several operations ---------------------------------------------------------------------------------------


def test_operations_differ_by_the_fill_of_their_marks(tmp_path: Path) -> None:
    page = parsed(long_flight(tmp_path / "three.jsonl", 9, operations=3))
    for drawn in (figure(page, "Call delay"), figure(page, "Map of the flight")):
        marks = of_class(drawn, "mark")
        fills = [(set(mark.get("class", "").split()) & {"hollow", "dotted"}) or {"filled"} for mark in marks]
        assert fills == [{"filled"}, {"hollow"}, {"dotted"}] * 3
        assert len(of_class(drawn, "dot")) == 3
    legends = [text(each) for each in of_class(page, "legend")]
    assert "filled: service.operation_0" in legends[0]
    assert "with a dot: service.operation_2" in legends[0]


def test_one_operation_is_not_told_apart_from_itself(tmp_path: Path) -> None:
    page = parsed(long_flight(tmp_path / "one.jsonl", 9))
    assert not of_class(page, "hollow")
    assert "operation_0" not in " ".join(text(each) for each in of_class(page, "legend"))


def test_the_plan_and_the_way_are_drawn_once_where_they_are_flown_often(tmp_path: Path) -> None:
    there_and_back = [
        (float(t), "position", {"east_m": float(t % 2), "north_m": 0.0, "altitude_m": 9.0})
        for t in range(2, 5000)
    ]
    page = parsed(log_of(tmp_path / "often.jsonl", *there_and_back, COMPLETED))
    (way,) = of_class(figure(page, "Map of the flight"), "track")
    assert way.get("d", "").count("L") == 1
