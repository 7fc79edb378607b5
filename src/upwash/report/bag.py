"""Runs as a ROS 2 bag, which rosbag2, rqt_bag and Foxglove open: MCAP in a folder, with standard messages alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from upwash.core.geo import LocalFrame
from upwash.core.knowledge.servers import SELECTED, State
from upwash.errors import NotWritten, UsageError
from upwash.eventlog import schema
from upwash.eventlog.narration import Narrator, Tone
from upwash.report.findings import Pairing
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record

_METADATA: Literal[8] = 8  # which every rosbag2 from Iron on reads, and of Humble too
_INFO, _WARN, _ERROR = 20, 30, 40  # of rcl_interfaces/Log
_LEVELS = {Tone.TROUBLE: _WARN, Tone.ALARM: _ERROR}
_TYPES = get_typestore(Stores.ROS2_HUMBLE)
_FIX, _STRING = "sensor_msgs/msg/NavSatFix", "std_msgs/msg/String"
_LOG, _IMAGE = "rcl_interfaces/msg/Log", "sensor_msgs/msg/CompressedImage"


def write_bag(records: Sequence[Record], folder: Path, *, photos: Path | None = None) -> None:
    """Writes a new folder with the bag; of several runs each has its name before its topics.

    With `photos`, a folder, the bag has the photos there that the logs name. Raises NotWritten, and UsageError where
    the folder is there already.
    """
    if folder.exists():
        raise UsageError(
            f"{folder} exists: a bag is a new folder, so give the name of one that does not exist"
        )
    shelf = PhotoShelf(photos)
    found: list[tuple[int, str, Any]] = []
    for record in records:
        prefix = f"/{_ros_name(record.name)}" if len(records) > 1 else ""
        found += [(time_ns, prefix + topic, message) for time_ns, topic, message in _messages(record, shelf)]
    try:
        with Writer(folder, version=_METADATA, storage_plugin=StoragePlugin.MCAP) as writer:
            connections: dict[str, Any] = {}
            for time_ns, topic, message in sorted(found, key=lambda entry: entry[0]):
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=_TYPES)
                writer.write(connections[topic], time_ns, _TYPES.serialize_cdr(message, kind))
    except OSError as error:
        raise NotWritten(folder, error, "the bag is not whole") from error


def _messages(record: Record, shelf: PhotoShelf) -> Iterator[tuple[int, str, Any]]:
    states: dict[str, State] = dict.fromkeys(record.servers, State.AVL)
    narrator, pairing, text = Narrator(), Pairing(), _TYPES.types[_STRING]
    for event in record.events:
        time_ns = record.ns(event.t - record.began_s)
        yield time_ns, "/upwash/events", text(data=msgspec.json.encode(event).decode())
        if (said := narrator.tell(event)) is not None:
            yield time_ns, "/rosout", _log(time_ns, _LEVELS.get(said.tone, _INFO), record.name, said.text)
        if isinstance(event, schema.ServerStep):
            states[event.server] = event.after
            selected = [server for server, state in states.items() if state in SELECTED]
            said_of = {"selected": selected, "states": states}
            yield time_ns, "/upwash/servers", text(data=msgspec.json.encode(said_of).decode())
        pairing.take(event)
        if isinstance(event, schema.PhotoTaken) and (photo := pairing.last) is not None:
            jpeg, taken_ns = shelf.find(photo.shot), record.ns(event.t - event.age_s - record.began_s)
            if jpeg is not None:
                data = np.frombuffer(jpeg, np.uint8)
                image = _TYPES.types[_IMAGE](header=_header(taken_ns, "camera"), format="jpeg", data=data)
                yield taken_ns, "/camera/image/compressed", image
    yield from _fixes(record)


def _fixes(record: Record) -> Iterator[tuple[int, str, Any]]:
    if record.plan.home is None:
        return
    frame, status = LocalFrame(record.plan.home), _TYPES.types["sensor_msgs/msg/NavSatStatus"]
    for fix in record.track:
        place, time_ns = frame.geo(fix.position), record.ns(fix.at_s)
        yield (
            time_ns,
            "/fix",
            _TYPES.types[_FIX](
                header=_header(time_ns, "map"),
                status=status(status=0, service=1),
                latitude=place.latitude_deg,
                longitude=place.longitude_deg,
                altitude=fix.above_sea_m,
                position_covariance=np.zeros(9),
                position_covariance_type=0,
            ),
        )


def _log(time_ns: int, level: int, name: str, words: str) -> Any:
    return _TYPES.types[_LOG](
        stamp=_time(time_ns), level=level, name=name, msg=words, file="", function="", line=0
    )


def _header(time_ns: int, frame: str) -> Any:
    return _TYPES.types["std_msgs/msg/Header"](stamp=_time(time_ns), frame_id=frame)


def _time(time_ns: int) -> Any:
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    return _TYPES.types["builtin_interfaces/msg/Time"](sec=min(seconds, 2**31 - 1), nanosec=nanoseconds)


def _ros_name(name: str) -> str:
    """The name as a part of a topic's, which has letters, digits and underscores, and begins with no digit."""
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)
    return f"run_{plain}" if not plain[:1].isalpha() else plain
