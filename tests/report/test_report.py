"""`upwash report`: the page stands alone, its numbers are the log's, and other tools can read what it exports."""

from __future__ import annotations

import copy
import csv
import itertools
import json
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import geojson
import msgspec
import pytest
from tests.scenarios import scenario as survey

from upwash.cli.main import main
from upwash.config.drone_file import read_drone_config
from upwash.config.places import server_areas, waypoints
from upwash.core.geo import GeoPosition, LocalFrame, Position, ground_distance_m
from upwash.core.knowledge.servers import State
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.lab.run import simulate
from upwash.report.exports import write_csv, write_geojson
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record, read_records
from upwash.report.sheet import draw_sheet
from upwash.support.text import clock, lasting

SCENARIOS = Path(__file__).parents[2] / "scenarios"
HOSTILE = "</title><script>alert('1')</script>&\"\x00]]>"
HERE = {"east_m": 3.0, "north_m": 4.0, "altitude_m": 20.0}
CALL = {
    "operation": "detector.count", "place": "local", "decision": "none near", "at_s": 1.0,
    "delay_s": 2.0, "waited_s": 0.0, "onboard_s": 2.0, "wait": "", "fell_back": False,
}  # fmt: skip


@pytest.fixture(scope="module")
def records(logs: Sequence[Path]) -> list[Record]:
    return read_records(logs)


def event(t: float, name: str, **facts: object) -> dict[str, Any]:
    return {"t": t, "event": name, **facts}


def write_log(file: Path, *events: Mapping[str, Any]) -> Path:
    lines = [json.dumps(each).encode() + b"\n" for each in events]
    file.write_bytes(b"".join(lines))
    return file


def step(t: float, name: str, before: str, after: str, server: str = "s1") -> dict[str, Any]:
    return event(t, name, server=server, before=before, after=after, why="so it is")


MISSION_BEGAN_S = 0.0  # in the simulated logs
STARTED = event(1.0, "mission_started", policy="location-aware", waypoints=1)


def sheet_of(records: Sequence[Record]) -> str:
    return draw_sheet(records, PhotoShelf(None))


def tree_of(records: Sequence[Record]) -> ElementTree.Element:
    return ElementTree.fromstring(sheet_of(records))


def rows_of(table: ElementTree.Element) -> list[list[str]]:
    return [["".join(cell.itertext()) for cell in row] for row in table.iter("tr")]


def tables_named(page: ElementTree.Element, caption: str) -> list[list[list[str]]]:
    return [rows_of(table) for table in page.iter("table") if table[0].text == caption]


# --- the page -------------------------------------------------------------------------------------------------


def test_the_totals_on_the_page_are_the_results(records: list[Record]) -> None:
    (table,) = tables_named(tree_of(records), "Totals")
    told = {row[0]: row[1:] for row in table}
    results = [record.result for record in records]
    assert told["mission time"] == [lasting(result.mission_time_s) for result in results]
    assert told["calls by place"] == ["18 on the drone, 51 on s1, 52 on s2", "121 on the drone"]
    assert told["time spent in calls"] == [lasting(result.totals.service_delay_s) for result in results]
    assert told["with every call on the drone"] == [
        lasting(result.local_only_time_s() or 0.0) for result in results
    ]


def test_the_mean_of_each_operation_stands_beside_what_it_takes_on_the_drone(records: list[Record]) -> None:
    (table,) = tables_named(tree_of(records), "Totals")
    name, *means = table[-1]
    assert name == "mean of detector (heavy), and on the drone"
    for record, mean in zip(records, means, strict=True):
        delays = [call.delay_s for call in record.result.calls]
        local = [call.delay_s - call.waited_s for call in record.result.calls if call.server is None]
        assert mean == f"{sum(delays) / len(delays):.2f} s, {sum(local) / len(local):.2f} s"


def test_it_says_where_every_row_is(records: list[Record]) -> None:
    assert "each call with --csv FILE, each place with --geojson FILE" in sheet_of(records)


def test_what_offloading_saved_is_told_also_against_the_flight_without(records: list[Record]) -> None:
    page = sheet_of(records)
    saved_s = records[0].result.saved_s()
    assert saved_s is not None
    assert f"offloading saved {clock(saved_s)}, " in page
    less_s = records[1].result.mission_time_s - records[0].result.mission_time_s
    assert f"It took {clock(less_s)} less than without" in page
    assert "less than" not in sheet_of(records[:1])


def test_the_worst_calls_are_told_with_their_loss_and_reasons(records: list[Record]) -> None:
    page = tree_of(records[:1])
    (worst,) = page.iter("ol")
    told = ["".join(item.itertext()) for item in worst]
    assert [each.call.waypoint for each in records[0].worst] == [0, 12], "a processor heats up twice"
    for text, lost in zip(told, records[0].worst, strict=True):
        loss_s, delay_s = lost.call.loss_s, lost.call.outcome.delay_s
        assert loss_s == pytest.approx(delay_s - 10.0), "the drone was expected to take that"
        assert f"ended at {clock(lost.call.at_s + delay_s)}, {loss_s:.1f} s lost" in text
        assert all(reason in text for reason in lost.reasons)


def test_a_flight_that_ended_before_its_first_call_has_a_page(tmp_path: Path) -> None:
    log = write_log(tmp_path / "early.jsonl", STARTED)
    assert "was not completed" in sheet_of(read_records([log]))


# --- what is read ---------------------------------------------------------------------------------------------


def test_the_log_tells_the_plan_and_the_ranges(records: list[Record]) -> None:
    config = read_drone_config(SCENARIOS / "thesis.toml")
    plan = records[0].plan
    assert plan.waypoints_m == [
        (waypoint.position.east_m, waypoint.position.north_m) for waypoint in waypoints(config.mission)
    ]
    assert plan.ranges == server_areas(config)


def test_the_states_of_each_server_fill_the_mission(records: list[Record]) -> None:
    for record in records:
        assert set(record.stretches) == {"s1", "s2"}
        for stretches in record.stretches.values():
            ends = [0.0, *(stretch.to_s for stretch in stretches)]
            assert [stretch.from_s for stretch in stretches] == ends[:-1]
            assert ends[-1] == pytest.approx(record.result.mission_time_s)


def test_calls_on_a_server_begin_while_it_is_ready_or_waited_for(records: list[Record]) -> None:
    for call in records[0].calls:
        if call.place != "local":
            sent_s = call.at_s + call.waited_s
            (state,) = [
                stretch.state for stretch in records[0].stretches[call.place]
                if stretch.from_s <= sent_s + 1e-6 < stretch.to_s
            ]  # fmt: skip
            assert state is State.READY


def test_a_program_that_takes_a_flight_up_again_knows_no_states(tmp_path: Path) -> None:
    log = write_log(
        tmp_path / "resumed.jsonl",
        event(0.0, "log_opened", time="2026-01-01T00:00:00+00:00"),
        STARTED,
        step(2.0, "selected", "AVL", "CHECK"),
        step(4.0, "found_running", "CHECK", "READY"),
        event(7.0, "log_resumed", time="2026-01-01T00:00:07+00:00"),
        event(8.0, "mission_started", policy="location-aware", waypoints=1),
        event(11.0, "mission_completed"),
        event(30.0, "position", **HERE),
    )
    (record,) = read_records([log])
    told = [(stretch.state, stretch.from_s, stretch.to_s) for stretch in record.stretches["s1"]]
    assert told == [
        (State.AVL, 0.0, 1.0), (State.CHECK, 1.0, 3.0), (State.READY, 3.0, 6.0), (State.AVL, 6.0, 10.0),
    ]  # fmt: skip
    assert record.result.mission_time_s == 10.0


@pytest.mark.parametrize("content", [b"\xff\n", b'"\xff"\n', b"[" * 100_000 + b"\n", b"photo\n", b"[1]\n"])
def test_other_files_are_no_logs(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "photo.jpeg"
    file.write_bytes(content)
    with pytest.raises(UsageError, match="is not an event log"):
        read_records([file])


def test_logs_of_the_same_name_are_told_apart(tmp_path: Path) -> None:
    files = [tmp_path / folder / "events.jsonl" for folder in ("monday", "tuesday")]
    others = [tmp_path / folder / "flight.jsonl" for folder in ("monday", "tuesday")]
    for file in (*files, *others):
        file.parent.mkdir(exist_ok=True)
        write_log(file, STARTED)
    assert [record.name for record in read_records(files)] == ["monday", "tuesday"]
    assert [record.name for record in read_records(others)] == [str(file) for file in others]


@pytest.mark.parametrize(
    ("events", "why"),
    [
        ([event(0.0, "log_opened", time="2026-01-01T00:00:00+00:00")], "has no mission"),
        ([{"t": 1}], "is not an event log"),
        ([], "is not an event log"),
    ],
)
def test_what_cannot_be_told_is_refused_with_the_logs_name(
    tmp_path: Path, events: list[dict[str, Any]], why: str
) -> None:
    log = write_log(tmp_path / "odd.jsonl", *events)
    with pytest.raises(UsageError, match=f"odd.jsonl .*{why}"):
        read_records([log])


@pytest.mark.parametrize(
    "odd",
    [
        event(2.0, "call", place="local"),
        step(2.0, "selected", "AVL", "ASLEEP"),
        event(0.0, "planned", ranges=7),
        event(3.0, "mission_started", policy="p", waypoints=2**63),
    ],
    ids=range(4),
)
def test_what_is_no_event_is_left_out_of_the_page_and_said_there(tmp_path: Path, odd: dict[str, Any]) -> None:
    (record,) = read_records([write_log(tmp_path / "odd.jsonl", STARTED, odd)])
    assert "1 line of the log is left out, line 2: " in " ".join(record.ending.cautions)
    assert "1 line of the log is left out, line 2: " in sheet_of([record])


# --- exports --------------------------------------------------------------------------------------------------


def test_json_has_the_results_that_simulate_prints(
    logs: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["simulate", str(SCENARIOS / "thesis.toml"), "--json"]) == 0
    simulated = json.loads(capsys.readouterr().out)
    assert main(["report", *map(str, logs), "--json"]) == 0
    with_offloading, without = json.loads(capsys.readouterr().out)
    for fact in ("policy", "mission_time_s", "completed", "calls", "totals"):
        assert with_offloading["result"][fact] == simulated[fact]
    assert (with_offloading["log"], without["log"]) == ("with", "without")
    saved_s = with_offloading["local_only_time_s"] - simulated["mission_time_s"]
    assert with_offloading["saved_s"] == pytest.approx(saved_s)


def test_csv_has_a_row_for_each_call(logs: tuple[Path, Path], records: list[Record], tmp_path: Path) -> None:
    file = tmp_path / "calls.csv"
    assert main(["report", *map(str, logs), "--csv", str(file)]) == 0
    with file.open(newline="") as text:
        rows = list(csv.DictReader(text))
    calls = [call for record in records for call in record.calls]
    assert [float(row["delay_s"]) for row in rows] == [call.delay_s for call in calls]
    assert [row["place"] for row in rows] == [call.place for call in calls]
    assert {row["log"] for row in rows} == {"with", "without"}


def test_a_logs_name_is_no_formula_of_a_spreadsheet(logs: tuple[Path, Path], tmp_path: Path) -> None:
    log = tmp_path / "=1+1.jsonl"
    log.write_bytes(logs[0].read_bytes())
    assert {row["log"] for row in csv.DictReader(write_csv(read_records([log])).splitlines())} == {"'=1+1"}


def test_one_file_may_be_printed(logs: tuple[Path, Path], capfdbinary: pytest.CaptureFixture[bytes]) -> None:
    assert main(["report", str(logs[0]), "--csv", "-"]) == 0
    printed, told = capfdbinary.readouterr()
    assert printed.startswith(b"log,")
    assert told == b""
    assert main(["report", str(logs[0]), "--csv", "-", "--json"]) == 2
    assert b"name a file" in capfdbinary.readouterr()[1]


def test_geojson_is_as_rfc_7946_has_it_and_lies_where_the_mission_was(
    logs: tuple[Path, Path], records: list[Record], tmp_path: Path
) -> None:
    file = tmp_path / "map.geojson"
    assert main(["report", str(logs[0]), "--geojson", str(file)]) == 0
    as_others_read_it = geojson.loads(file.read_text())  # with six digits of each degree
    assert isinstance(as_others_read_it, geojson.FeatureCollection)
    assert as_others_read_it.is_valid, as_others_read_it.errors()
    kinds: dict[str, list[dict[str, Any]]] = {}
    for feature in json.loads(file.read_text())["features"]:
        kinds.setdefault(feature["properties"]["kind"], []).append(feature)
    shapes = {kind: {feature["geometry"]["type"] for feature in found} for kind, found in kinds.items()}
    assert shapes == {
        "home": {"Point"}, "track": {"LineString"}, "range": {"Polygon"}, "waypoint": {"Point"}, "call": {"Point"},
        "photo": {"Point"},
    }  # fmt: skip
    record = records[0]
    assert record.plan.home is not None
    frame = LocalFrame(record.plan.home)
    for feature, (east_m, north_m) in zip(kinds["waypoint"], record.plan.waypoints_m, strict=True):
        place = position(frame, feature["geometry"]["coordinates"])
        assert (place.east_m, place.north_m) == pytest.approx((east_m, north_m), abs=0.02)
    for feature in kinds["range"]:
        (ring,) = feature["geometry"]["coordinates"]
        assert ring[0] == ring[-1]
        assert turns_left(ring)
        area = record.plan.ranges[feature["properties"]["server"]]
        away_m = [ground_distance_m(position(frame, corner), area.centre) for corner in ring]
        assert away_m == pytest.approx([area.radius_m] * len(ring), abs=0.02)
    told = [feature["properties"]["delay_s"] for feature in kinds["call"]]
    assert told == [call.delay_s for call in record.result.calls]
    photos = [event for event in record.events if isinstance(event, schema.PhotoTaken)]
    assert [feature["properties"]["photo"] for feature in kinds["photo"]] == list(range(len(photos)))
    for feature, photo in zip(kinds["photo"], photos, strict=True):
        place = position(frame, feature["geometry"]["coordinates"])
        assert ground_distance_m(place, photo.position) < 0.03
        assert feature["properties"]["source"] == photo.source
        assert feature["properties"]["altitude_m"] == photo.position.altitude_m
    (track,) = kinds["track"]
    assert (
        len(track["geometry"]["coordinates"]) == len(track["properties"]["at_s"]) == len(list(record.track))
    )


def position(frame: LocalFrame, coordinates: Sequence[float]) -> Any:
    longitude_deg, latitude_deg = coordinates
    return frame.position(GeoPosition(latitude_deg=latitude_deg, longitude_deg=longitude_deg))


def turns_left(ring: Sequence[Sequence[float]]) -> bool:
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in itertools.pairwise(ring)) > 0


def test_without_a_home_there_are_no_coordinates_and_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, file = write_log(tmp_path / "nowhere.jsonl", STARTED), tmp_path / "map.geojson"
    assert main(["report", str(log), "--geojson", str(file), "-o", str(tmp_path / "page.html")]) == 2
    assert "set mission.home" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == [log]


def test_something_has_to_be_asked_for(logs: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(logs[0])]) == 2
    assert "nothing to make" in capsys.readouterr().err


def test_half_a_last_line_is_left_out(tmp_path: Path, logs: tuple[Path, Path]) -> None:
    torn = tmp_path / "torn.jsonl"
    torn.write_bytes(logs[0].read_bytes() + msgspec.json.encode(STARTED)[:20])
    (record,) = read_records([torn])
    assert record.result.completed


def test_the_plan_is_drawn_in_the_order_of_the_flight() -> None:
    places = [(0.0, 0.0), (20.0, 0.0), (20.0, 20.0)]
    as_given = schema.Planned(waypoints_m=places)
    assert as_given.way_m == places
    swept = msgspec.structs.replace(as_given, order=[2, 0, 1])
    assert swept.way_m == [places[2], places[0], places[1]]
    for foreign in ([2, 7, 1], [2, 1], [0, 0, 0]):
        assert msgspec.structs.replace(as_given, order=foreign).way_m == places


# --- a drone that goes on before answers are there --------------------------------------------------------------


@pytest.fixture(scope="module")
def going(tmp_path_factory: pytest.TempPathFactory) -> Record:
    goes = survey(
        mission={"home": {"latitude_deg": 39.0, "longitude_deg": 22.0}},
        policy={"name": "local-only", "stay_or_go": "go", "act_within_s": 0.0},
        event={"every": 6, "offset": 2},
    )
    file = tmp_path_factory.mktemp("going") / "going.jsonl"
    file.write_bytes(simulate(goes).log())
    (record,) = read_records([file])
    return record


def test_turns_back_and_answers_that_it_went_on_before_are_told(going: Record) -> None:
    page = tree_of([going])
    assert [waypoint for waypoint, _ in going.turns] == [2, 8, 14]
    assert [place for _, place in going.turns] == [
        Position(60.0, 40.0, 20.0), Position(40.0, 20.0, 20.0), Position(60.0, 0.0, 20.0),
    ]  # fmt: skip
    (totals,) = tables_named(page, "Totals")
    told = {row[0]: row[1] for row in totals}
    assert told["went on before the answer"] == "17"
    assert told["turned back for the answer"] == "3"
    assert told["of the calls' time hidden"] == lasting(going.result.totals.hidden_s)


def test_each_call_stands_where_it_was_made_though_it_was_answered_elsewhere(going: Record) -> None:
    planned = going.plan.waypoints_m
    assert [place and (place.east_m, place.north_m) for place in going.places] == planned
    assert [call.waypoint for call in going.calls] == list(range(18))


def test_photos_of_a_camera_at_the_autopilot_lie_where_the_autopilot_says(going: Record) -> None:
    placed = schema.AutopilotPhoto(
        t=going.began_s + 3.0, camera=1, number=7, position=Position(1.0, 2.0, 20.0), latitude_deg=39.4,
        longitude_deg=22.9, above_sea_m=120.0, taken=datetime(2026, 3, 1, tzinfo=UTC),
    )  # fmt: skip
    record = copy.copy(going)
    record.events = [placed, schema.AutopilotPhoto(t=going.began_s, camera=1, number=8)]
    features = json.loads(write_geojson([record]))["features"]
    (photo,) = (each for each in features if each["properties"]["kind"] == "autopilot_photo")
    assert photo["geometry"]["coordinates"] == [22.9, 39.4]
    facts = {"camera": 1, "photo": 7, "at_s": 3.0, "altitude_m": 20.0, "above_sea_m": 120.0}
    assert facts.items() <= photo["properties"].items()
    assert photo["properties"]["time"] == "2026-03-01T00:00:00+00:00"


def test_other_tools_are_told_of_turns_and_hidden_time(going: Record) -> None:
    rows = list(csv.DictReader(write_csv([going]).splitlines()))
    assert sum(float(row["hidden_s"]) for row in rows) == pytest.approx(going.result.totals.hidden_s)
    kinds = [load["properties"]["kind"] for load in json.loads(write_geojson([going]))["features"]]
    assert kinds.count("turn") == 3


def test_of_a_drone_that_stays_nothing_is_told_of_going(records: list[Record]) -> None:
    assert not re.search("gone on|went on|urned back|hidden_s", sheet_of(records) + write_csv(records))
