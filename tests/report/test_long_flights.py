"""What a page says of a long flight stays small."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.report.pages import Told, log_of, parsed, table_named, text

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


def test_a_long_table_has_the_first_and_the_last_rows_and_says_where_the_rest_is(tmp_path: Path) -> None:
    rows = table_named(parsed(long_flight(tmp_path / "long.jsonl", 2000, operations=500)), "Totals")[1:]
    assert rows[0][0] == "policy" and "operation 99," in rows[-1][0]
    assert rows[100] == ["311 rows are left out: --csv FILE writes every call"]


@pytest.mark.parametrize("number", [20_000])
def test_the_page_of_a_longer_flight_is_no_larger(tmp_path: Path, number: int) -> None:
    page = parsed(long_flight(tmp_path / "longer.jsonl", number))
    assert len(list(page.iter("tr"))) < 1500
    assert sum(1 for _ in page.iter()) < 25_000
    assert f"{number} of {number}" in text(page)
