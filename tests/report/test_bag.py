"""`upwash report --bag`: what rosbags reads from the bag, and the bag as a camera."""

from __future__ import annotations

import asyncio
import json
import math
import struct
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from tests.report.test_mcap import FLOWN, HIGH, JPEG, write

from upwash.cli.main import main
from upwash.core.geo import Position
from upwash.errors import CameraError, UsageError
from upwash.real.camera.bag import BagCamera

TYPES = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A short flight with one photo as a bag."""
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "1.jpg").write_bytes(JPEG)
    log, folder = write(tmp_path / "flown.jsonl", HIGH), tmp_path / "flown"
    assert main(["report", str(log), "--bag", str(folder), "--photos", str(tmp_path / "photos")]) == 0
    return folder


def test_a_bag_has_the_flight_in_standard_messages(bag: Path) -> None:
    found: dict[str, list[tuple[float, Any]]] = {}
    with Reader(bag) as reader:
        for connection, time_ns, raw in reader.messages():
            message = TYPES.deserialize_cdr(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    ((taken_ns, image),) = found["/camera/image/compressed"]
    assert (bytes(image.data), image.format) == (JPEG, "jpeg")
    assert image.header.stamp.sec * 10**9 + image.header.stamp.nanosec == taken_ns
    assert found["/upwash/events"][0][0] == taken_ns - round(3.5e9)
    assert len(found["/upwash/events"]) == len(HIGH)
    ((_, fix), *_) = found["/fix"]
    assert (round(fix.latitude, 3), fix.altitude) == (39.0, 508.0)
    states = [json.loads(said.data) for _, said in found["/upwash/servers"]]
    assert states == [
        {"selected": ["s1"], "states": {"s1": "CHECK"}},
        {"selected": [], "states": {"s1": "BLACKLISTED"}},
    ]
    assert max(said.level for _, said in found["/rosout"]) >= 30


def test_a_place_has_no_altitude_where_that_of_home_is_unknown(tmp_path: Path) -> None:
    log = write(tmp_path / "flown.jsonl", FLOWN)
    assert main(["report", str(log), "--bag", str(tmp_path / "flown")]) == 0
    with Reader(tmp_path / "flown") as reader:
        found: list[Any] = [TYPES.deserialize_cdr(raw, "sensor_msgs/msg/NavSatFix")
                 for connection, _, raw in reader.messages() if connection.topic == "/fix"]  # fmt: skip
    assert found
    assert all(math.isnan(fix.altitude) for fix in found)


def test_the_images_of_a_bag_are_a_cameras_photos_again_and_again(bag: Path) -> None:
    async def take() -> list[bytes]:
        camera = BagCamera(bag, None, photo_s=0.0, lens=None)
        return [(await camera.take_photo(Position(0, 0))).jpeg for _ in range(2)]

    assert asyncio.run(take()) == [JPEG, JPEG]


def test_a_folder_without_metadata_is_read_by_its_one_file(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    BagCamera(bag, None, photo_s=0.0, lens=None)
    (bag / "second.db3").touch()
    with pytest.raises(UsageError, match="more than one file"):
        BagCamera(bag, None, photo_s=0.0, lens=None)


def test_a_bag_that_is_none_or_lacks_the_topic_is_named(bag: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="photos is no ROS 2 bag"):
        BagCamera(tmp_path / "photos", None, photo_s=0.0, lens=None)
    with pytest.raises(UsageError, match="has images of /camera/image/compressed: name one"):
        BagCamera(bag, "/other", photo_s=0.0, lens=None)


def test_a_bag_that_breaks_in_flight_gives_no_photo_until_it_is_whole_again(bag: Path) -> None:
    (file,) = bag.glob("*.mcap")
    whole, position = file.read_bytes(), Position(0, 0)
    (at,) = struct.unpack("<Q", whole[-28:-20])  # of the summary

    async def take() -> bytes:
        camera = BagCamera(bag, None, photo_s=0.0, lens=None)
        for broken in (whole[: at + 1] + b"\xff" * 8 + whole[at + 9 :], whole[: len(whole) // 2], b""):
            file.write_bytes(broken)
            with pytest.raises(CameraError, match=r"cannot be read: .*copy the bag again"):
                await camera.take_photo(position)
        file.write_bytes(whole)
        return (await camera.take_photo(position)).jpeg

    assert asyncio.run(take()) == JPEG


def test_no_bag_is_written_over_another(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(bag.parent / "flown.jsonl"), "--bag", str(bag)]) == 2
    assert "is a folder: give the name of a file, or of a new folder" in capsys.readouterr().err
