"""`upwash report --mcap`: what the mcap reader finds, held against its schemas, Foxglove's messages, and the log."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.json_format import ParseDict
from mcap.reader import make_reader

from upwash.cli import main
from upwash.core.geo import GeoPosition, LocalFrame
from upwash.report.record import Record, read_records
from upwash.services.solar_park import Park, View, photograph

SCENARIOS = Path(__file__).parents[2] / "scenarios"
DEFINED = {
    "foxglove.SceneUpdate": SceneUpdate,
    "foxglove.LocationFix": LocationFix,
    "foxglove.Log": Log,
    "foxglove.CompressedImage": CompressedImage,
}
OPENED = datetime(2026, 5, 1, 10, 0, 0, 250_000, tzinfo=UTC)
JPEG = b"\xff\xd8\xff\xe0 a photo \xff\xd9"
FLOWN = [
    {"t": 0.0, "event": "log_opened", "time": OPENED.isoformat()},
    {"t": 1.0, "event": "planned", "home": {"latitude_deg": 39.0, "longitude_deg": 22.0},
     "waypoints_m": [[3, 4]], "ranges": {"s1": {"centre": {"east_m": 0, "north_m": 0}, "radius_m": 50}}},
    {"t": 2.0, "event": "mission_started", "policy": "location-aware", "waypoints": 1},
    {"t": 3.0, "event": "position", "east_m": 3.0, "north_m": 4.0, "altitude_m": 20.0},
    {"t": 3.0, "event": "selected", "server": "s1", "before": "AVL", "after": "CHECK", "why": "in range"},
    {"t": 3.5, "event": "check_failed", "server": "s1", "before": "CHECK", "after": "BLACKLISTED", "why": "off"},
    {"t": 4.0, "event": "photo", "source": "1.jpg", "bytes": len(JPEG), "age_s": 0.5},
    {"t": 5.0, "event": "photo", "source": "gone.jpg", "bytes": 7, "age_s": 0.5},
    {"t": 6.0, "event": "photo", "source": "../2.jpg", "bytes": 7, "age_s": 0.5},
    {"t": 7.0, "event": "safe_end", "action": "land", "why": "the radio is silent"},
]  # fmt: skip


class Read:
    """One message of a file: where it was, when, and what it says."""

    def __init__(self, schema: Any, channel: Any, message: Any) -> None:
        assert schema.encoding == "jsonschema"
        assert channel.message_encoding == "json"
        self.kind, self.topic, self.time_s = schema.name, channel.topic, message.log_time / 1e9
        self.schema = json.loads(schema.data)
        self.fields = json.loads(message.data)


def read(file: Path) -> list[Read]:
    with file.open("rb") as stream:
        return [Read(*found) for found in make_reader(stream, validate_crcs=True).iter_messages()]


def in_protobufs_json(message: Any, name: str = "") -> Any:
    """The same message as protobuf's JSON has it, where times are text."""
    match message:
        case {"sec": int(sec), "nsec": int(nsec)} if name == "timestamp":
            return f"{datetime.fromtimestamp(sec, UTC):%Y-%m-%dT%H:%M:%S}.{nsec:09d}Z"
        case {"sec": int(sec), "nsec": int(nsec)}:
            return f"{sec}.{nsec:09d}s"
        case dict():
            return {name: in_protobufs_json(value, name) for name, value in message.items()}
        case list():
            return [in_protobufs_json(each) for each in message]
        case _:
            return message


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Read], Record]:
    """The thesis's mission."""
    folder = tmp_path_factory.mktemp("simulated")
    log, file = folder / "thesis.jsonl", folder / "thesis.mcap"
    assert main(["simulate", str(SCENARIOS / "thesis.toml"), "--log", str(log)]) == 0
    assert main(["report", str(log), "--mcap", str(file)]) == 0
    return read(file), read_records([log])[0]


@pytest.fixture
def flown(tmp_path: Path) -> Path:
    """The log of a short flight, and its one photo."""
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "1.jpg").write_bytes(JPEG)
    return write(tmp_path / "flown.jsonl", FLOWN)


def write(log: Path, events: list[dict[str, Any]]) -> Path:
    log.write_text("".join(json.dumps(event) + "\n" for event in events))
    return log


def recorded(log: Path, *others: Path, photos: Path | None = None) -> list[Read]:
    file = log.with_suffix(".mcap")
    logs, options = map(str, (log, *others)), ["--photos", str(photos)] if photos else []
    assert main(["report", *logs, "--mcap", str(file), *options]) == 0
    return read(file)


def kind(messages: list[Read], name: str) -> list[Read]:
    return [message for message in messages if message.kind == f"foxglove.{name}"]


def test_each_message_is_as_its_schema_in_the_file_says(
    simulated: tuple[list[Read], Record], flown: Path
) -> None:
    messages = [*simulated[0], *recorded(flown, photos=flown.parent / "photos")]
    assert {message.kind for message in messages} == set(DEFINED)
    schemas = {message.kind: message.schema for message in messages}
    for schema in schemas.values():
        jsonschema.Draft202012Validator.check_schema(schema)
        assert "$ref" not in json.dumps(schema), "viewers follow no references"
    validators = {kind: jsonschema.Draft202012Validator(closed(schema)) for kind, schema in schemas.items()}
    for message in messages:
        validators[message.kind].validate(message.fields)


def closed(schema: Any) -> Any:
    """The same schema, but what it does not mention is forbidden."""
    match schema:
        case {"type": "object", "properties": Mapping() as properties, **rest}:
            inner = {name: closed(each) for name, each in properties.items()}
            return {**rest, "type": "object", "properties": inner, "additionalProperties": False}
        case {"items": items, **rest}:
            return {**rest, "items": closed(items)}
        case _:
            return schema


def test_each_message_is_what_foxglove_defines(simulated: tuple[list[Read], Record], flown: Path) -> None:
    for message in (*simulated[0], *recorded(flown, photos=flown.parent / "photos")):
        # A field that Foxglove does not have, or one of another type, is refused.
        parsed = ParseDict(in_protobufs_json(message.fields), DEFINED[message.kind]())
        assert parsed.DESCRIPTOR.full_name == message.kind


def test_the_fixes_are_the_drones_way(simulated: tuple[list[Read], Record]) -> None:
    messages, record = simulated
    assert record.plan.home is not None
    frame = LocalFrame(record.plan.home)
    fixes = kind(messages, "LocationFix")
    assert len(fixes) == len(list(record.track))
    for fix, told in zip(record.track, fixes, strict=True):
        place = frame.position(GeoPosition(told.fields["latitude"], told.fields["longitude"]))
        assert (place.east_m, place.north_m) == pytest.approx(
            (fix.position.east_m, fix.position.north_m), abs=1e-6
        )
        assert told.time_s == pytest.approx(record.began_s + fix.at_s, abs=1e-6)


def test_the_scene_has_the_plan_each_state_the_drone_and_a_mark_for_each_call(
    simulated: tuple[list[Read], Record],
) -> None:
    messages, record = simulated
    scene = [
        (each.time_s, entity) for each in kind(messages, "SceneUpdate") for entity in each.fields["entities"]
    ]
    by_name = {entity["id"]: entity for _, entity in scene}
    assert len(by_name["plan"]["spheres"]) == len(record.plan.waypoints_m) == 121
    assert sum(name.startswith("call ") for name in by_name) == len(record.calls) == 121
    assert sum(name.endswith(": drone") for name in by_name) == record.result.totals.local
    for server, stretches in record.stretches.items():
        told = [(at_s, entity) for at_s, entity in scene if entity["id"] == f"server {server}"]
        assert [entity["texts"][0]["text"] for _, entity in told] == [
            f"{server} {stretch.state}" for stretch in stretches
        ]
        assert [at_s for at_s, _ in told] == pytest.approx([stretch.from_s for stretch in stretches])
        radius_m = record.plan.ranges[server].radius_m
        assert {entity["cylinders"][0]["size"]["x"] for _, entity in told} == {2 * radius_m}


def test_times_are_those_of_the_day(flown: Path) -> None:
    (first,) = kind(recorded(flown), "LocationFix")
    assert first.time_s == pytest.approx(OPENED.timestamp() + 3.0)
    stamp = first.fields["timestamp"]
    assert stamp["sec"] + stamp["nsec"] / 1e9 == pytest.approx(OPENED.timestamp() + 3.0)


def test_the_log_says_in_words_what_went_wrong(flown: Path) -> None:
    told = [(each.fields["level"], each.fields["message"]) for each in kind(recorded(flown), "Log")]
    assert told == [
        (2, "mission started, policy location-aware"),
        (2, "s1: AVL → CHECK (in range)"),
        (3, "s1: CHECK → BLACKLISTED (off)"),
        (4, "landing where it is: the radio is silent"),
    ]


def test_photos_are_those_of_the_folder_and_of_no_other(flown: Path) -> None:
    (flown.parent / "2.jpg").write_bytes(JPEG)  # the log may be anybody's
    (photo,) = kind(recorded(flown, photos=flown.parent / "photos"), "CompressedImage")
    image = ParseDict(in_protobufs_json(photo.fields), CompressedImage())
    assert (image.data, image.format) == (JPEG, "jpeg")
    assert photo.time_s == pytest.approx(OPENED.timestamp() + 3.5)


def test_rendered_photos_are_rendered_again(flown: Path) -> None:
    rendered = [{**event, "source": "park 1"} if event["event"] == "photo" else event for event in FLOWN]
    first, *others = kind(recorded(write(flown, rendered)), "CompressedImage")
    image = ParseDict(in_protobufs_json(first.fields), CompressedImage())
    assert image.data == photograph(Park(1), View(3.0, 4.0, 20.0), shot=0).jpeg
    assert len(others) == 2


def test_a_folder_without_the_photos_is_refused(flown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = flown.with_suffix(".mcap")
    assert main(["report", str(flown), "--mcap", str(file), "--photos", str(flown.parent)]) == 2
    assert re.search("has none of the photos .* give the folder of", capsys.readouterr().err)
    assert not file.exists()


def test_several_flights_have_their_names_before_their_topics(flown: Path) -> None:
    other = write(flown.with_name("other.jsonl"), FLOWN)
    topics = {message.topic for message in recorded(flown, other)}
    assert topics == {f"/{log}/{topic}" for log in ("flown", "other") for topic in ("scene", "fix", "log")}
    assert {message.topic for message in recorded(flown)} == {"/scene", "/fix", "/log"}


def test_a_flight_without_a_home_has_a_scene_and_no_coordinates(flown: Path) -> None:
    nowhere = [{**event, "home": None} if event["event"] == "planned" else event for event in FLOWN]
    messages = recorded(write(flown, nowhere))
    assert not kind(messages, "LocationFix")
    assert kind(messages, "SceneUpdate")
