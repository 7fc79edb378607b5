"""Flights whose calls have a deadline: a second server for late calls, what is promised, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import upwash
from upwash.eventlog import schema

OPERATION = "detector.process_photo[heavy]"


@pytest.fixture(scope="module")
def times(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Times of a server that stalls in 5 % of its calls."""
    file = tmp_path_factory.mktemp("times") / "times.csv"
    rows = [0.4] * 475 + [10.0] * 25
    file.write_text("operation,seconds\n" + "".join(f"heavy,{seconds}\n" for seconds in rows))
    return file


def mission(times: Path | None, *, seed: int = 1, servers: int = 2, **tables: Any) -> dict[str, Any]:
    """Fifty waypoints, all in the range of servers that stall."""
    server: dict[str, Any] = {
        "east_m": 20.0,
        "north_m": 20.0,
        "range_m": 300.0,
        "check_s": 2.0,
        "check_running_s": 1.0,
        "remote_call_s": 0.4,
    }
    if times is not None:
        server |= {"times_csv": str(times), "truth": {"service_csv": str(times)}}
    return {
        "seed": seed,
        "mission": {"grid": {"columns": 5, "rows": 10, "spacing_m": 10}},
        "network": {"radios": 2},
        "service": [{"name": "detector", "local_call_s": {"heavy": 3.0}, "deadline": {"s": 1.5, "p": 0.99}}],
        "server": [{"name": f"s{number}", **server} for number in range(1, servers + 1)],
    } | tables


def refusal(document: dict[str, Any]) -> str:
    with pytest.raises(upwash.UpwashError) as refused:
        upwash.simulate(document)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_late_calls_go_to_a_second_server_and_few_calls_are_late(times: Path) -> None:
    late = second = calls = 0
    for seed in range(1, 7):
        run = upwash.simulate(mission(times, seed=seed))
        totals = run.totals
        assert totals.in_time + totals.late == totals.calls
        for event in run.events:
            if isinstance(event, schema.Seconded):
                assert event.operation == OPERATION and event.after_s == pytest.approx(1.05)
        calls, late, second = (
            calls + totals.calls,
            late + totals.late,
            second + totals.second_servers,
        )
    assert calls == 300
    assert 5 <= second <= 30  # 15 stalls are expected, and a late call is sent on
    assert late <= 6  # against 15 that one server is late


def test_the_log_says_what_was_promised(times: Path) -> None:
    run = upwash.simulate(mission(times))
    (promised,) = (event for event in run.events if isinstance(event, schema.DeadlinePromised))
    assert (promised.operation, promised.within_s, promised.asked) == (OPERATION, 1.5, 0.99)
    assert promised.expected == 0.99 and promised.extra == pytest.approx(0.052, abs=0.002)


@pytest.mark.parametrize(
    ("changes", "had", "why"),
    [
        ({"network": {"radios": 1}}, 0.931, "with 2, s2 could get late calls too"),
        ({"servers": 1}, 0.931, "only s1 is in range there"),
        ({"times": None}, 0.0, "nothing is measured of s1: give its times_csv"),
        ({"deadline": {"s": 0.3, "p": 0.99}}, 0.0, "s1 with s2"),
        ({"deadline": {"s": 1.5, "p": 0.99, "extra": 0.01}}, 0.925, "allow more as extra"),
        ({"one_network": True}, 0.931, "s1 alone, as s2 is reached over the same network"),
        ({"far": True}, 0.0, "no server is in range there"),
    ],
)
def test_what_cannot_be_had_is_refused_with_what_can(
    times: Path, changes: dict[str, Any], had: float, why: str
) -> None:
    document = mission(changes.get("times", times), servers=changes.get("servers", 2))
    document["network"] = changes.get("network", document["network"])
    document["service"][0]["deadline"] = changes.get("deadline", document["service"][0]["deadline"])
    for server in document["server"] if changes.get("one_network") else ():
        server["network"] = "lte"
    if changes.get("far"):
        document["mission"]["waypoints_m"] = [[0, 0], [900, 0]]
        del document["mission"]["grid"]
    said = refusal(document)
    assert why in said and OPERATION in said
    found = re.search(r"with a probability of ([\d.]+) at least, and 0.99 is asked for", said)
    assert found is not None and float(found[1]) == pytest.approx(had, abs=0.003)


@pytest.mark.parametrize(("servers", "needed"), [(1, 299), (2, 39)])
def test_too_few_delays_are_refused_with_how_many_it_takes(servers: int, needed: int, tmp_path: Path) -> None:
    file = tmp_path / "times.csv"
    for known in (needed - 1, needed):
        file.write_text("operation,seconds\n" + "heavy,0.4\n" * known)
        document = mission(file, servers=servers)
        if known == needed:
            upwash.simulate(document)
            continue
        assert f"{known} delays of s1 in its times_csv, and this p takes {needed} at least" in refusal(
            document
        )


def test_a_drone_that_keeps_the_deadline_itself_is_not_refused(times: Path) -> None:
    document = mission(times, network={"radios": 1}, policy={"hedge": {"budget": 0.1}})
    document["service"][0] |= {"local_call_s": {"heavy": 0.9}, "deadline": {"s": 1.5, "p": 0.99}}
    run = upwash.simulate(document)
    (promised,) = (event for event in run.events if isinstance(event, schema.DeadlinePromised))
    assert promised.expected == 0.99 and promised.extra == 0  # of calls, that a second server gets
    assert run.totals.late == 0


def test_flights_without_servers_promise_nothing(times: Path) -> None:
    run = upwash.simulate(mission(times, policy={"name": "local-only"}))
    assert not any(isinstance(event, schema.DeadlinePromised) for event in run.events)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"two_answers": {"first": "light", "within_s": 9.0}}, "two_answers has a deadline of its own"),
        ({"deadline": {"s": 1.5, "p": 1.0}}, "a number above 0 and below 1"),
        ({"deadline": {"s": 1.5}}, "p"),
    ],
)
def test_a_deadline_that_cannot_be_meant_is_named(times: Path, changes: dict[str, Any], problem: str) -> None:
    document = mission(times)
    document["service"][0] |= {"local_call_s": {"heavy": 3.0, "light": 1.0}} | changes
    assert problem in refusal(document)


def test_photos_in_flight_have_no_deadline(times: Path) -> None:
    document = mission(times)
    document["mission"]["photos"] = {"every_m": 10.0}
    assert "a deadline goes with calls made one at a time" in refusal(document)


def test_a_file_of_times_names_the_operations_of_the_mission(times: Path, tmp_path: Path) -> None:
    other = tmp_path / "times.csv"
    other.write_text("operation,seconds\ncounter.count,0.3\n")
    document = mission(times)
    document["server"][0]["times_csv"] = str(other)
    assert "server[0].times_csv: counter.count is no operation" in refusal(document)


def test_a_sorted_file_of_more_times_than_are_kept_says_the_same_as_any_other(tmp_path: Path) -> None:
    file = tmp_path / "sorted.csv"
    rows = [0.4] * 5700 + [10.0] * 300  # 3,000 are kept: of the last ones 10 % are late, of all 5 %
    file.write_text("operation,seconds\n" + "".join(f"heavy,{seconds}\n" for seconds in rows))
    said = refusal(mission(file, servers=1))
    found = re.search(r"with a probability of ([\d.]+) at least", said)
    assert found is not None and float(found[1]) == pytest.approx(0.94, abs=0.006)
