"""Simulated flights that fly a recorded track, in measured wind, on a measured battery."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.programs import ROOT

import upwash
from upwash.cli.main import main
from upwash.core.geo import Position
from upwash.core.vehicle.track import Track

THESIS = ROOT / "scenarios" / "thesis.toml"
MOVING = ROOT / "scenarios" / "on-the-move.toml"
LINE: dict[str, Any] = {
    "mission": {
        "home": {"latitude_deg": 39.3666, "longitude_deg": 22.9507},
        "waypoints_m": [[0, 0], [40, 0], [80, 0]],
    },
    "service": [{"name": "detector", "local_call_s": {"light": 1.0, "heavy": 3.0}}],
}
FLIGHT = "0,0,0,0\n5,0,0,20\n15,40,1,20\n17,44,1,20\n30,80,-2,20\n40,80,-2,20\n50,80,-2,0\n"


def written(folder: Path, rows: str, columns: str = "t_s,east_m,north_m,altitude_m") -> str:
    file = folder / "trace.csv"
    file.write_text(f"{columns}\n{rows}")
    return str(file)


def flown(**vehicle: Any) -> upwash.Simulation:
    return upwash.simulate(LINE, overrides={f"vehicle.{key}": value for key, value in vehicle.items()})


def traced(scenario: Path, folder: Path, **overrides: Any) -> tuple[upwash.Simulation, upwash.Simulation]:
    """A mission, and the mission in the traces of its log."""
    log = folder / "flight.jsonl"
    given = ["--policy", "location-aware", "--log", str(log)]
    assert main(["simulate", str(scenario), *given]) == 0
    assert main(["traces", str(log), "--out", str(folder)]) == 0
    files = {"vehicle.track_csv": folder / "track.csv"} | {
        f"server.{name}.truth.service_csv": folder / f"{name}-times.csv" for name in ("s1", "s2")
    }
    first = upwash.simulate(scenario, policy="location-aware")
    return first, upwash.simulate(scenario, policy="location-aware", overrides={**files, **overrides})


def test_a_mission_in_the_traces_of_its_log_has_the_same_delays(tmp_path: Path) -> None:
    first, again = traced(THESIS, tmp_path)
    assert [call.place for call in again.calls] == [call.place for call in first.calls]
    assert [call.delay_s for call in again.calls] == pytest.approx(
        [call.delay_s for call in first.calls], abs=1.5
    )
    assert again.totals.service_delay_s == pytest.approx(first.totals.service_delay_s, rel=0.03)
    assert again.mission_time_s == pytest.approx(first.mission_time_s, abs=0.1)
    assert again.bound is None


def test_photos_in_flight_are_taken_where_the_track_passes(tmp_path: Path) -> None:
    scenario = tmp_path / "moving.toml"
    text = MOVING.read_text()
    scenario.write_text(text.replace(text[text.index("[event]") : text.index("[vehicle]")], ""))
    first, again = traced(scenario, tmp_path)
    delays_s, again_s = ({call.waypoint: call.delay_s for call in run.calls} for run in (first, again))
    assert again_s == pytest.approx(delays_s, abs=0.1)


def test_the_mission_neither_stops_nor_hurries_the_vehicle(tmp_path: Path) -> None:
    track = written(tmp_path, FLIGHT)
    slow, fast = (
        upwash.simulate(
            LINE, overrides={"vehicle.track_csv": track, "service.detector.local_call_s.heavy": s}
        )
        for s in (12.0, 1.0)
    )
    assert slow.completed and fast.completed
    assert [call.at_s for call in fast.calls] == pytest.approx([6.0, 16.0, 31.0], abs=0.1)
    assert [call.at_s for call in slow.calls] == pytest.approx([6.0, 19.0, 32.0], abs=0.1)
    assert fast.mission_time_s == pytest.approx(50.0, abs=0.01)
    ended = upwash.simulate(
        LINE, overrides={"vehicle.track_csv": track, "service.detector.local_call_s.heavy": 30.0}
    )
    assert not ended.completed and "the track is over" in ended.failure


def test_a_track_in_degrees_from_a_receiver_that_counts_by_its_own_clock(tmp_path: Path) -> None:
    metres = flown(track_csv=written(tmp_path, FLIGHT))
    frame = upwash.simulate(LINE).events
    home = next(event.home for event in frame if event.kind == "planned")  # type: ignore[attr-defined]
    rows = "".join(
        f"{1.7e9 + t_s},{home.latitude_deg + north / 111_035:.8f},{home.longitude_deg + east / 86_145:.8f},{up}\n"
        for t_s, east, north, up in (map(float, row.split(",")) for row in FLIGHT.split())
    )
    degrees = flown(track_csv=written(tmp_path, rows, "t_s,latitude_deg,longitude_deg,altitude_m"))
    assert [call.at_s for call in degrees.calls] == pytest.approx(
        [call.at_s for call in metres.calls], abs=0.1
    )


def test_a_place_is_passed_where_the_track_is_nearest() -> None:
    east_m = [0.0, 10.0, 20.0, 20.05, 20.0, 40.0, 0.0]
    track = Track([5.0 * number for number in range(7)], [Position(at_m, 3.0, 20.0) for at_m in east_m])
    assert track.passing_s(Position(15.0, 0.0), after_s=0.0) == pytest.approx(7.5)
    assert track.passing_s(Position(20.0, 3.0), after_s=0.0) == pytest.approx(10.0), "it rests from then on"
    assert track.passing_s(Position(10.0, 3.0), after_s=21.0) == pytest.approx(28.75)
    assert track.passing_s(Position(20.0, 60.0), after_s=0.0) is None


def test_energy_depends_on_the_speed_through_the_air(tmp_path: Path) -> None:
    def drawn_wh(wind: str | None) -> float:
        files = (
            {} if wind is None else {"vehicle.wind_csv": written(tmp_path, wind, "t_s,east_m_s,north_m_s")}
        )
        energy = upwash.simulate(LINE, overrides={"energy.hover_w": 168.5, **files}).energy
        assert energy is not None
        return energy.total_wh

    still_wh = drawn_wh(None)
    assert drawn_wh("0,0,0\n") == pytest.approx(still_wh, rel=0.005)
    assert drawn_wh("0,-20,0\n9,-20,0\n") > still_wh > drawn_wh("0,-10,0\n"), (
        "a hover costs most in still air"
    )


def test_a_measured_battery_ends_the_mission_at_its_reserve(tmp_path: Path) -> None:
    charge = written(tmp_path, "0,90\n20,20\n", "t_s,percent")
    run = upwash.simulate(LINE, overrides={"vehicle.battery_csv": charge, "mission.reserve_percent": 30.0})
    assert not run.completed and "is left" in run.failure
    with pytest.raises(upwash.ConfigError, match=r"vehicle\.endurance_s says too how long the battery lasts"):
        flown(battery_csv=charge, endurance_s=600.0)


PLACES = "t_s,east_m,north_m"


@pytest.mark.parametrize(
    ("key", "columns", "rows", "problem"),
    [
        ("track_csv", "t_ms,east_m,north_m", "0,0,0\n", r"line 1.*has t_ms, east_m, north_m: name the columns t_s"),
        ("track_csv", "0,0,0", "1,1,1\n", r"line 1.*the first line has 0, 0, 0: name the columns"),
        ("track_csv", PLACES, "0,0,0\n-1,0,0\n", r"line 3, t_s.*'-1': expected a number of at least 0"),
        ("track_csv", PLACES, "0,0,0\n1,,0\n", r"line 3, east_m.*'': expected a number"),
        ("track_csv", PLACES, "0,0,0\n40,80,0\n", r"line 3, t_s.*a gap of 40 s: add the places between"),
        ("track_csv", PLACES, "0,0,0\n1,800,0\n", r"line 3, east_m.*800 m in 1 s: give metres, or degrees"),
        ("track_csv", PLACES, "0,0,0\n", r"one row is no flight"),
        ("track_csv", "t_s,latitude_deg,longitude_deg", "0,390,22\n", r"latitude_deg.*from -90 to 90"),
        ("track_csv", f"{PLACES},altitude_m", "0,0,0,0\n9,80,0,9\n", r"it rises to 9\.0 m, and mission\.altitude_m"),
        ("track_csv", PLACES, "0,0,0\n9,40,0\n", r"waypoint 2 is 40 m from the track: give waypoints within 20 m"),
        ("track_csv", PLACES, "0,80,0\n9,0,0\n", r"waypoint 1 is not passed after the one before"),
        ("wind_csv", "t_s,wind_m_s", "0,3\n", r"line 1.*name the columns t_s and east_m_s and north_m_s"),
        ("wind_csv", "t_s,east_m_s,north_m_s", "0,3,400\n", r"north_m_s.*'400': expected a number from -100 to 100"),
        ("battery_csv", "t_s,percent", "0,0.9\n5,120\n", r"line 3, percent.*'120': expected a number from 0 to 100"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_trace_is_refused_with_its_line(
    tmp_path: Path, key: str, columns: str, rows: str, problem: str
) -> None:
    with pytest.raises(upwash.ConfigError, match=problem):
        flown(**{key: written(tmp_path, rows, columns)})


def test_what_would_leave_the_track_is_refused(tmp_path: Path) -> None:
    track = {"vehicle.track_csv": written(tmp_path, FLIGHT)}
    for more, problem in (
        ({"event": {"every": 2}}, "an answer with a demand would turn the vehicle back"),
        (
            {"fault": [{"target": "autopilot", "kind": "slow"}]},
            "a fault of the autopilot would take the vehicle off",
        ),
        ({"drone": [{"name": "d1"}]}, "a track is one vehicle's"),
    ):
        with pytest.raises(upwash.ConfigError, match=problem):
            upwash.simulate({**LINE, **more}, overrides=track)


def test_a_log_without_anything_to_trace_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "stood.jsonl"
    log.write_text(
        '{"event":"mission_started","t":0.0,"policy":"look-ahead"}\n'
        '{"event":"armed","t":1.0,"position":{"east_m":0,"north_m":0,"altitude_m":0}}\n'
    )
    assert main(["traces", str(log), "--out", str(tmp_path / "out")]) == 2
    assert "no trace can be made of it" in capsys.readouterr().err
