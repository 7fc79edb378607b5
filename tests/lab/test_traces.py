"""Simulated servers and links that behave as measured: traces in CSV files."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from statistics import fmean
from typing import Any

import pytest
from tests.programs import ROOT

import upwash
from upwash.config.traces import read_goodput_trace
from upwash.config.truth import times_of
from upwash.core.geo import Position
from upwash.core.operation import Operation
from upwash.sim.radio import Spot, traced

THESIS = ROOT / "scenarios" / "thesis.toml"
HEAVY = "detector.process_photo[heavy]"


def written(folder: Path, text: str) -> Path:
    file = folder / "trace.csv"
    file.write_text(text)
    return file


def survey(**truth: Any) -> upwash.Simulation:
    return upwash.simulate(
        THESIS, overrides={f"server.s1.truth.{key}": str(value) for key, value in truth.items()}
    )


def test_calls_draw_their_times_from_the_trace(tmp_path: Path) -> None:
    times_s = (0.5, 0.9, 2.5)
    file = written(tmp_path, "operation,seconds\n" + "".join(f"{HEAVY},{time_s}\n" for time_s in times_s))
    run, again = survey(service_csv=file), survey(service_csv=file)
    assert run.calls == again.calls, "the seed decides"
    delays = Counter(round(call.delay_s - call.waited_s, 3) for call in run.calls if call.place == "s1")
    transfer_s = 8 * 425_500 / 54e6
    assert set(delays) == {round(time_s + transfer_s, 3) for time_s in times_s}, delays
    assert max(delays.values()) < 2 * min(delays.values())
    assert {call.place for call in run.calls} == {"local", "s1", "s2"}
    assert run.bound is not None and run.bound.free_s < run.mission_time_s


def test_a_true_time_of_one_operation_beside_a_believed_delay_of_another_is_flown() -> None:
    run = upwash.simulate(THESIS, overrides={"server.s1.truth.processing_s.heavy": 2.0})
    assert min(call.delay_s for call in run.calls if call.place == "s1") == pytest.approx(
        2.0 + 8 * 425_500 / 54e6
    )


@pytest.mark.parametrize("name", ["heavy", "detector.process_photo[heavy]"])
def test_an_operation_is_named_as_in_logs_or_by_its_key(tmp_path: Path, name: str) -> None:
    run = survey(service_csv=written(tmp_path, f"seconds,machine,operation\n1.5,box,{name}\n"))
    assert min(call.delay_s for call in run.calls if call.place == "s1") > 1.5
    assert min(call.delay_s for call in run.calls if call.place == "s2") < 1.0


def test_an_operation_has_the_times_of_its_full_name_first() -> None:
    times = {"light": (2.0,), "detector.process_photo[light]": (1.0,), "count": (3.0,)}
    assert times_of(Operation("detector", "process_photo", "light"), times) == (1.0,)
    assert times_of(Operation("other", "process_photo", "light"), times) == (2.0,)
    assert times_of(Operation("counter", "count"), times) == (3.0,)
    assert times_of(Operation("counter", "look"), times) == ()


def test_goodput_changes_with_the_time_also_within_a_transfer(tmp_path: Path) -> None:
    link = traced(read_goodput_trace(written(tmp_path, "t_s,bit_s\n10,8e6\n# a gap\n20,0\n25,16e6\n")))
    million = 1_000_000
    for now_s, expected_s in (
        (0.0, 1.0),  # 8 Mbit/s from the first row on, and before it
        (12.0, 1.0),
        (19.5, 0.5 + 5.0 + 0.25),
        (22.0, 3.0 + 0.5),
        (1000.0, 0.5),
        (None, 0.5),
    ):
        assert link.transfer_s(million, Spot(0.0, None, now_s)) == pytest.approx(expected_s)
    dead = traced(read_goodput_trace(written(tmp_path / "..", "t_s,bit_s\n0,8e6\n1,0\n")))
    assert dead.transfer_s(million, Spot(0.0, None, 0.5)) == math.inf


def test_goodput_by_distance_and_by_place(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    near = traced(read_goodput_trace(written(tmp_path, "distance_m,bit_s\n0,8e6\n100,4e6\n")))
    assert near.transfer_s(750_000, Spot(50.0)) == pytest.approx(1.0)
    assert near.transfer_s(1, Spot(100.1)) == math.inf
    places = "east_m,north_m,bit_s\n-10,0,8e6\n10,0,2e6\n"
    there = traced(read_goodput_trace(written(tmp_path / "other", places)))
    assert there.transfer_s(1_000_000, Spot(0.0, Position(-1.0, 50.0))) == pytest.approx(1.0)
    assert there.transfer_s(1_000_000, Spot(0.0, Position(1.0, 50.0))) == pytest.approx(4.0)
    assert there.transfer_s(1_000_000, Spot(0.0)) == pytest.approx(1.0)


def test_a_mission_is_slower_over_a_slow_link_and_bounded_from_below(tmp_path: Path) -> None:
    plain = survey()
    for number, text in enumerate(("t_s,bit_s\n0,1e6\n900,50e6\n", "distance_m,bit_s\n0,2e6\n150,1e6\n")):
        (folder := tmp_path / str(number)).mkdir()
        run = survey(goodput_csv=written(folder, text))
        assert run.completed and run.mission_time_s > plain.mission_time_s
        assert run.bound is not None and run.bound.free_s <= run.mission_time_s
    first = [call.delay_s for call in run.calls if call.place == "s1"]
    assert not first or fmean(first) > 1.0


@pytest.mark.parametrize(
    ("key", "text", "problem"),
    [
        (
            "service_csv",
            "",
            r"trace\.csv.*line 1.*the first line has nothing: name the columns operation",
        ),
        ("service_csv", "operation,s\nheavy,1\n", r"line 1.*has operation, s: name the columns"),
        (
            "service_csv",
            "operation,seconds\nheavy,1\nheavy,-1\n",
            r"line 3, seconds.*'-1': expected a number of at",
        ),
        ("service_csv", "operation,seconds\nheavy\n", r"line 2, seconds.*missing in a line of 1 values"),
        ("service_csv", "operation,seconds\nheavy,fast\n", r"line 2, seconds.*'fast': expected a number"),
        ("service_csv", "operation,seconds\nheavy,nan\n", r"line 2, seconds.*'nan': expected a number"),
        ("service_csv", "operation,seconds\n,1\n", r"line 2, operation.*empty"),
        ("service_csv", "operation,seconds\n", r"no rows: add one for each measured call"),
        ("service_csv", "operation,seconds\nhuge,1\n", r"huge is no operation with a local_call_s"),
        (
            "goodput_csv",
            "t_s,mbit_s\n1,2\n",
            r"has t_s, mbit_s: name the columns t_s and bit_s, or distance_m and",
        ),
        ("goodput_csv", "t_s,bit_s\n1,2\n1,3\n", r"line 3, t_s.*1 follows 1: let the values ascend"),
        ("goodput_csv", "t_s,bit_s\n1_0,1\n", r"line 2, t_s.*'1_0': expected a number"),
        ("goodput_csv", "t_s,bit_s\n\u0661,1\n", r"line 2, t_s.*expected a number"),
        ("goodput_csv", "t_s,bit_s,t_s\n1,1,2\n", r"line 1, t_s.*two columns have this name"),
        ("goodput_csv", "t_s,bit_s\n1,2\n" + "#\n" * 999_999, r"more than 1,000,000 lines: leave rows out"),
        ("radio", "distance_m,goodput_mbit_s\n1_0,1\n", r"'1_0' is no finite number"),
        ("radio", "distance_m,goodput_mbit_s,distance_m\n1,1,2\n", r"two columns are named distance_m"),
        ("goodput_csv", "t_s,bit_s\n1,0\n", r"nothing gets through in any row"),
        ("goodput_csv", "east_m,north_m,bit_s\n-1,inf,1\n", r"line 2, north_m.*'inf': expected a number"),
    ],
)
def test_a_file_that_is_no_trace_is_refused_with_its_line(
    tmp_path: Path, key: str, text: str, problem: str
) -> None:
    with pytest.raises(upwash.UsageError, match=problem):
        survey(**{key: written(tmp_path, text)})


def test_a_trace_that_is_missing_or_stands_beside_a_radio_is_refused(tmp_path: Path) -> None:
    with pytest.raises(upwash.ConfigError, match=r"none\.csv"):
        survey(goodput_csv=tmp_path / "none.csv")
    with pytest.raises(upwash.ConfigError, match=r"radio.*goodput_csv says how fast the link is: leave one"):
        survey(goodput_csv=written(tmp_path, "t_s,bit_s\n0,1e6\n"), radio="disc54")
