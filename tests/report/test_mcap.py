"""`upwash report --mcap`: what the mcap reader finds, held against its schemas, Foxglove's messages, and the log."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.json_format import MessageToDict
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader

from upwash.cli.main import main
from upwash.core.geo import GeoPosition, LocalFrame
from upwash.report.record import Record, read_records
from upwash.services.solar_park import Park, View, photograph

SCENARIOS = Path(__file__).parents[2] / "scenarios"
DEFINED: dict[str, Any] = {
    "foxglove.SceneUpdate": SceneUpdate,
    "foxglove.LocationFix": LocationFix,
    "foxglove.Log": Log,
    "foxglove.CompressedImage": CompressedImage,
}
OPENED = datetime(2026, 5, 1, 10, 0, 0, 250_000, tzinfo=UTC)
JPEG = b"\xff\xd8\xff\xe0 a photo \xff\xd9"
HERE = {"east_m": 3.0, "north_m": 4.0, "altitude_m": 20.0}
FLOWN = [
    {"t": 0.0, "event": "log_opened", "time": OPENED.isoformat()},
    {"t": 1.0, "event": "planned", "home": {"latitude_deg": 39.0, "longitude_deg": 22.0},
     "waypoints_m": [[3, 4]], "ranges": {"s1": {"centre": {"east_m": 0, "north_m": 0}, "radius_m": 50}}},
    {"t": 2.0, "event": "mission_started", "policy": "location-aware", "waypoints": 1},
    {"t": 3.0, "event": "position", "east_m": 3.0, "north_m": 4.0, "altitude_m": 20.0},
    {"t": 3.0, "event": "selected", "server": "s1", "before": "AVL", "after": "CHECK", "why": "in range"},
    {"t": 3.5, "event": "check_failed", "server": "s1", "before": "CHECK", "after": "BLACKLISTED", "why": "off"},
    {"t": 4.0, "event": "photo", "source": "1.jpg", "bytes": len(JPEG), "age_s": 0.5, "position": HERE},
    {"t": 5.0, "event": "photo", "source": "gone.jpg", "bytes": 7, "age_s": 0.5, "position": HERE},
    {"t": 6.0, "event": "photo", "source": "../2.jpg", "bytes": 7, "age_s": 0.5, "position": HERE},
    {"t": 7.0, "event": "safe_end", "action": "land", "why": "the radio is silent"},
]  # fmt: skip


class Read:
    """One message of a file: where it was, when, and what it says."""

    def __init__(self, schema: Any, channel: Any, message: Any) -> None:
        assert schema.encoding == channel.message_encoding == "protobuf"
        self.kind, self.topic, self.time_s = schema.name, channel.topic, message.log_time / 1e9
        self.schema, self.data = schema.data, message.data
        self.message = DEFINED[self.kind].FromString(self.data)


def read(file: Path) -> list[Read]:
    with file.open("rb") as stream:
        return [Read(*found) for found in make_reader(stream, validate_crcs=True).iter_messages()]


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


def test_each_message_is_what_foxglove_defines_and_as_its_schema_in_the_file_says(
    simulated: tuple[list[Read], Record], flown: Path
) -> None:
    messages = [*simulated[0], *recorded(flown, photos=flown.parent / "photos")]
    schemas = {message.kind: message.schema for message in messages}
    assert set(schemas) == set(DEFINED)
    described = {kind: class_of(kind, schema) for kind, schema in schemas.items()}
    for message in messages:
        in_words = MessageToDict(described[message.kind].FromString(message.data))
        assert in_words == MessageToDict(message.message), "what one of the two does not define it leaves out"


def class_of(kind: str, schema: bytes) -> Any:
    """The class of the messages that a schema in a file describes: readers know no other."""
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(kind))


def test_the_fixes_are_the_drones_way(simulated: tuple[list[Read], Record]) -> None:
    messages, record = simulated
    assert record.plan.home is not None
    frame = LocalFrame(record.plan.home)
    fixes = kind(messages, "LocationFix")
    assert len(fixes) == len(list(record.track))
    for fix, told in zip(record.track, fixes, strict=True):
        place = frame.position(GeoPosition(told.message.latitude, told.message.longitude))
        assert (place.east_m, place.north_m) == pytest.approx(
            (fix.position.east_m, fix.position.north_m), abs=1e-6
        )
        assert told.time_s == pytest.approx(record.began_s + fix.at_s, abs=1e-6)


def test_the_scene_has_the_plan_each_state_the_drone_and_a_mark_for_each_call(
    simulated: tuple[list[Read], Record],
) -> None:
    messages, record = simulated
    scene = [
        (each.time_s, entity) for each in kind(messages, "SceneUpdate") for entity in each.message.entities
    ]
    by_name = {entity.id: entity for _, entity in scene}
    assert len(by_name["plan"].spheres) == len(record.plan.waypoints_m) == 121
    assert sum(name.startswith("call ") for name in by_name) == len(record.calls) == 121
    assert sum(name.endswith(": drone") for name in by_name) == record.result.totals.local
    for server, stretches in record.stretches.items():
        told = [(at_s, entity) for at_s, entity in scene if entity.id == f"server {server}"]
        assert [entity.texts[0].text for _, entity in told] == [
            f"{server} {stretch.state}" for stretch in stretches
        ]
        assert [at_s for at_s, _ in told] == pytest.approx([stretch.from_s for stretch in stretches])
        radius_m = record.plan.ranges[server].radius_m
        assert {entity.cylinders[0].size.x for _, entity in told} == {2 * radius_m}


def test_times_are_those_of_the_day(flown: Path) -> None:
    (first,) = kind(recorded(flown), "LocationFix")
    assert first.time_s == pytest.approx(OPENED.timestamp() + 3.0)
    stamp = first.message.timestamp
    assert stamp.seconds + stamp.nanos / 1e9 == pytest.approx(OPENED.timestamp() + 3.0)


def test_the_log_says_in_words_what_went_wrong(flown: Path) -> None:
    told = [(each.message.level, each.message.message) for each in kind(recorded(flown), "Log")]
    assert told == [
        (2, "mission started, policy location-aware"),
        (2, "s1: AVL → CHECK (in range)"),
        (3, "s1: CHECK → BLACKLISTED (off)"),
        (4, "landing where it is: the radio is silent"),
    ]


def test_photos_are_those_of_the_folder_and_of_no_other(flown: Path) -> None:
    (flown.parent / "2.jpg").write_bytes(JPEG)  # the log may be anybody's
    (photo,) = kind(recorded(flown, photos=flown.parent / "photos"), "CompressedImage")
    assert (photo.message.data, photo.message.format) == (JPEG, "jpeg")
    assert photo.time_s == pytest.approx(OPENED.timestamp() + 3.5)


def test_rendered_photos_are_rendered_again(flown: Path) -> None:
    rendered = [{**event, "source": "park 1"} if event["event"] == "photo" else event for event in FLOWN]
    first, *others = kind(recorded(write(flown, rendered)), "CompressedImage")
    assert first.message.data == photograph(Park(1), View(3.0, 4.0, 20.0), shot=0).jpeg
    assert len(others) == 2


def test_a_folder_without_the_photos_is_refused(flown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = flown.with_suffix(".mcap")
    assert main(["report", str(flown), "--mcap", str(file), "--photos", str(flown.parent)]) == 2
    assert re.search("has none of the photos .* give the folder of", capsys.readouterr().err)
    assert not file.exists()


@pytest.mark.parametrize("at_s", [2.0**33, 1e300])
def test_a_time_that_no_message_can_have_is_refused(
    flown: Path, at_s: float, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write(flown, [*FLOWN[:4], {**FLOWN[3], "t": at_s, "east_m": 9.0}])
    assert main(["report", str(log), "--mcap", str(log.with_suffix(".mcap"))]) == 2
    assert "is not an event log that this version reads" in capsys.readouterr().err


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
