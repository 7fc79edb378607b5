"""`upwash report --mcap`: what the mcap reader finds, held against its schemas, Foxglove's messages, and the log."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.GeoJSON_pb2 import GeoJSON
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.json_format import MessageToDict
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader

from upwash.cli.main import main
from upwash.core.geo import GeoPosition, LocalFrame
from upwash.eventlog.narration import STATE_WORDS
from upwash.report.record import Record, read_records
from upwash.report.reviews import FindingKey, Review, Verdict, append_review
from upwash.report.series import STATE_NUMBERS
from upwash.services.solar_park import Park, View, photograph

ROOT = Path(__file__).parents[2]
SCENARIOS = ROOT / "scenarios"
LAYOUT = ROOT / "deploy" / "foxglove-layout.json"
DEFINED: dict[str, Any] = {
    "foxglove.SceneUpdate": SceneUpdate,
    "foxglove.LocationFix": LocationFix,
    "foxglove.Log": Log,
    "foxglove.CompressedImage": CompressedImage,
    "foxglove.ImageAnnotations": ImageAnnotations,
    "foxglove.GeoJSON": GeoJSON,
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
LIMITS: dict[str, Any] = {"home": None, "highest_m": None, "fences": [], "home_above_sea_m": 488.0}
HIGH: list[dict[str, Any]] = [
    *FLOWN[:2],
    {"t": 1.5, "event": "vehicle_limits", **LIMITS},
    *FLOWN[2:],
]  # home is above the sea


class Read:
    """One message of a file: where it was, when, and what it says."""

    def __init__(self, schema: Any, channel: Any, message: Any) -> None:
        self.kind, self.topic, self.time_s = schema.name, channel.topic, message.log_time / 1e9
        self.schema, self.data = schema.data, message.data
        if channel.message_encoding == "json":
            assert schema.encoding == "jsonschema"
            self.message = json.loads(self.data)
        else:
            assert schema.encoding == channel.message_encoding == "protobuf"
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


def of_topic(messages: list[Read], topic: str) -> list[Read]:
    return [message for message in messages if message.topic == topic]


def kind(messages: list[Read], name: str) -> list[Read]:
    return [message for message in messages if message.kind == f"foxglove.{name}"]


def test_each_message_is_what_foxglove_defines_and_as_its_schema_in_the_file_says(
    simulated: tuple[list[Read], Record], flown: Path
) -> None:
    messages = [*simulated[0], *recorded(flown, photos=flown.parent / "photos")]
    messages = [message for message in messages if isinstance(message.message, Message)]
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
            f"{server} {STATE_WORDS[stretch.state]}" for stretch in stretches
        ]
        assert [at_s for at_s, _ in told] == pytest.approx([stretch.from_s for stretch in stretches])
        radius_m = record.plan.ranges[server].radius_m
        assert {entity.cylinders[0].size.x for _, entity in told} == {2 * radius_m}


def test_the_plan_lies_at_its_own_altitudes_in_the_order_flown(flown: Path) -> None:
    plan = {"waypoints_m": [[3, 4], [30, 4]], "altitudes_m": [25.0, 40.0], "order": [1, 0]}
    log = write(flown, [{**event, **plan} if event["event"] == "planned" else event for event in FLOWN])
    assert [(place.x, place.z) for place in plan_of(recorded(log))] == [(30.0, 40.0), (3.0, 25.0)]


def test_the_plan_of_a_log_without_altitudes_lies_as_high_as_the_drone_flew(flown: Path) -> None:
    assert [place.z for place in plan_of(recorded(flown))] == [20.0]


def test_what_a_drone_logs_of_its_plan_has_its_altitude(simulated: tuple[list[Read], Record]) -> None:
    messages, record = simulated
    assert record.plan.altitudes_m == [20.0] * 121
    assert {place.z for place in plan_of(messages)} == {20.0}


def plan_of(messages: list[Read]) -> list[Any]:
    entities = [entity for each in kind(messages, "SceneUpdate") for entity in each.message.entities]
    (plan,) = (entity for entity in entities if entity.id == "plan")
    return [sphere.pose.position for sphere in plan.spheres]


def test_the_map_shows_the_plan_and_the_ranges(simulated: tuple[list[Read], Record]) -> None:
    messages, _ = simulated
    (plan,) = kind(messages, "GeoJSON")
    assert plan.topic == "/plan"
    features = json.loads(plan.message.geojson)["features"]
    kinds = [feature["properties"]["kind"] for feature in features]
    assert {each: kinds.count(each) for each in kinds} == {"home": 1, "range": 2, "waypoint": 121, "plan": 1}
    assert {feature["properties"]["name"] for feature in features} >= {"range s1", "range s2", "waypoint 120"}


def test_what_calls_took_and_the_states_of_servers_are_numbers(simulated: tuple[list[Read], Record]) -> None:
    messages, record = simulated
    calls = of_topic(messages, "/calls")
    assert [(call.message["place"], call.message["delay_s"]) for call in calls] == [
        (call.server or "drone", call.delay_s) for call in record.calls
    ]
    assert [call.time_s for call in calls] == pytest.approx(
        [record.began_s + call.at_s + call.delay_s for call in record.calls]
    )
    for server, stretches in record.stretches.items():
        *begun, last = of_topic(messages, f"/servers/{server}")
        assert [each.message["state"] for each in begun] == [stretch.state for stretch in stretches]
        assert last.message["state"] == begun[-1].message["state"]
        assert last.time_s == pytest.approx(record.began_s + stretches[-1].to_s)
        assert all(each.message["state_number"] == STATE_NUMBERS[each.message["state"]] for each in begun)
    for each in (*calls, *begun):
        properties = json.loads(each.schema)["properties"]
        assert set(each.message) == set(properties)


def test_the_layout_for_foxglove_asks_for_nothing_that_a_recording_lacks(
    simulated: tuple[list[Read], Record], flown: Path
) -> None:
    layout = json.loads(LAYOUT.read_text())
    text = json.dumps(layout["configById"])
    messages = [*simulated[0], *recorded(flown, photos=flown.parent / "photos")]
    topics = {message.topic for message in messages}
    asked = {topic.partition(".")[0] for topic in re.findall(r'"(/[a-z0-9/_.]+)"', text)}
    assert asked <= topics
    fields = {
        f"{each.topic}.{name}" for each in messages if isinstance(each.message, dict) for name in each.message
    }
    assert set(re.findall(r'"value": "([^"]+)"', text)) <= fields
    assert set(panels(layout["layout"])) == set(layout["configById"])


def panels(layout: Any) -> list[str]:
    """The panels of a layout, which splits a page in two over and over."""
    return [layout] if isinstance(layout, str) else [*panels(layout["first"]), *panels(layout["second"])]


def test_times_are_those_of_the_day(flown: Path) -> None:
    (first,) = kind(recorded(flown), "LocationFix")
    assert first.time_s == pytest.approx(OPENED.timestamp() + 3.0)
    stamp = first.message.timestamp
    assert stamp.seconds + stamp.nanos / 1e9 == pytest.approx(OPENED.timestamp() + 3.0)


def test_the_log_says_in_words_what_went_wrong(flown: Path) -> None:
    told = [(each.message.level, each.message.message) for each in kind(recorded(flown), "Log")]
    assert told == [
        (2, "mission started, policy location-aware"),
        (2, "joining s1 (in range)"),
        (3, "s1 is left alone (off)"),
        (4, "the flight cannot go on, landing where it is: the radio is silent. Be ready to take over"),
    ]


def test_photos_are_those_of_the_folder_and_of_no_other(flown: Path) -> None:
    (flown.parent / "2.jpg").write_bytes(JPEG)  # the log may be anybody's
    (photo,) = kind(recorded(flown, photos=flown.parent / "photos"), "CompressedImage")
    assert (photo.message.data, photo.message.format) == (JPEG, "jpeg")
    assert photo.time_s == pytest.approx(OPENED.timestamp() + 3.5)


FOUND = [{"label": "damage", "score": 0.9, "left_px": 10, "top_px": 20, "width_px": 30, "height_px": 40}]


def told(t: float, message: object) -> dict[str, Any]:
    return {"t": t, "event": "notified", "message": message, "at": HERE}


def annotated(log: Path) -> list[tuple[float, list[str]]]:
    """What is written on each photo, with the time of both."""
    messages = recorded(log, photos=log.parent / "photos")
    photos = [each.time_s for each in kind(messages, "CompressedImage")]
    on_them = [
        (each.time_s, [text.text for text in each.message.texts])
        for each in kind(messages, "ImageAnnotations")
    ]
    assert photos == [at_s for at_s, _ in on_them], "one for each, also where nothing is on it"
    assert {each.topic for each in kind(messages, "ImageAnnotations")} <= {"/camera/annotations"}
    return on_them


def test_what_was_found_is_drawn_on_its_photo(flown: Path) -> None:
    log = write(flown, [*FLOWN[:7], told(4.5, FOUND), {**FLOWN[6], "t": 5.0}, told(5.5, "all is well")])
    began_s = OPENED.timestamp()
    (first_s, on_first), (second_s, on_second) = annotated(log)
    assert (on_first, on_second) == (["1 damage 90 %"], [])
    assert [first_s, second_s] == pytest.approx([began_s + 3.5, began_s + 4.5])
    (annotations, _) = kind(recorded(log, photos=log.parent / "photos"), "ImageAnnotations")
    (box,) = annotations.message.points
    assert [(point.x, point.y) for point in box.points] == [(10, 20), (40, 20), (40, 60), (10, 60)]


def test_what_was_rejected_is_not_drawn_and_another_label_is(flown: Path) -> None:
    log = write(flown, [*FLOWN[:7], told(4.5, [FOUND[0], {**FOUND[0], "left_px": 300}])])
    for index, verdict, label in ((0, Verdict.REJECTED, ""), (1, Verdict.ACCEPTED, "dirt")):
        key = FindingKey(4.5, 0, index)
        append_review(log, Review(time=OPENED, finding=key, verdict=verdict, label=label))
    ((_, on_it),) = annotated(log)
    assert on_it == ["2 dirt 90 %"]


def test_an_answer_that_comes_after_the_next_photo_is_drawn_on_its_own(flown: Path) -> None:
    begun = {"event": "call_started", "operation": "detector.process_photo[heavy]"}
    log = write(
        flown,
        [
            *FLOWN[:7],
            {**begun, "t": 4.1, "waypoint": 0},
            {**FLOWN[6], "t": 5.0},
            {**begun, "t": 5.1, "waypoint": 1},
            {"t": 6.0, "event": "answer_taken", "waypoint": 0, "waited_s": 0.0},
            {**told(6.1, FOUND), "photo": 0},
        ],
    )
    assert [texts for _, texts in annotated(log)] == [["1 damage 90 %"], []]


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


@pytest.mark.parametrize("odd", [{"t": 2.0**33}, {"t": 1e300}, {"t": 1e9, "east_m": -1e9}])
@pytest.mark.parametrize("opened", ["0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-14:00"])
def test_a_time_that_no_message_can_have_costs_its_event_alone(
    flown: Path, opened: str, odd: dict[str, float]
) -> None:
    log = write(flown, [{**FLOWN[0], "time": opened}, *FLOWN[1:4], {**FLOWN[3], **odd}])
    assert main(["report", str(log), "--mcap", str(log.with_suffix(".mcap"))]) == 0
    assert kind(recorded(log), "LocationFix")


def test_the_places_have_their_altitude_above_the_sea(flown: Path) -> None:
    (fix,) = kind(recorded(write(flown, HIGH)), "LocationFix")
    assert fix.message.altitude == 508.0


def test_several_flights_have_their_names_before_their_topics(flown: Path) -> None:
    other = write(flown.with_name("other.jsonl"), FLOWN)
    topics = {message.topic for message in recorded(flown, other)}
    alone = {"/scene", "/plan", "/fix", "/log", "/servers/s1"}
    assert topics == {f"/{log}{topic}" for log in ("flown", "other") for topic in alone}
    assert {message.topic for message in recorded(flown)} == alone


def test_a_flight_without_a_home_has_a_scene_and_no_coordinates(flown: Path) -> None:
    nowhere = [{**event, "home": None} if event["event"] == "planned" else event for event in FLOWN]
    messages = recorded(write(flown, nowhere))
    assert not kind(messages, "LocationFix") + kind(messages, "GeoJSON")
    assert kind(messages, "SceneUpdate")
