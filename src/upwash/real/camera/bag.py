"""A camera whose photos are the images of a ROS 2 bag."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader, ReaderError
from rosbags.typesys import Stores, get_typestore

from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.errors import CameraError, UsageError
from upwash.ports import Photo
from upwash.services.ros_image import jpeg_of_message
from upwash.support.background import in_thread

_TYPES = get_typestore(Stores.ROS2_HUMBLE)
_FILES = (".mcap", ".db3")
_IMAGES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")


class BagCamera:
    """A Camera whose photos are the images of a bag, in their order, again and again; each takes `photo_s`.

    Raises UsageError for a bag that cannot be read, and unless it has images of one topic, or of the given one.
    """

    def __init__(self, bag: Path, topic: str | None, *, photo_s: float, lens: Lens | None) -> None:
        self._bag, self._photo_s, self._lens = bag, photo_s, lens
        with _reading(bag) as reader:
            topics = sorted({found.topic for found in reader.connections if found.msgtype in _IMAGES})
        wanted = topics if topic is None else [name for name in topics if name == topic]
        if not topics:
            raise UsageError(f"camera.bag: {bag} has no images, of {' or '.join(_IMAGES)}")
        if len(wanted) != 1:
            raise UsageError(
                f"camera.bag: {bag} has images of {', '.join(topics)}: name one of them as camera.topic"
            )
        self._topic = wanted[0]
        self._images: Iterator[tuple[int, Any]] = iter(())

    async def take_photo(self, at: Position) -> Photo:
        """Returns the next image after `photo_s` seconds; raises CameraError for an image that is no photo."""
        await asyncio.sleep(self._photo_s)
        captured_s = asyncio.get_running_loop().time()
        time_ns, jpeg = await in_thread(self._next, name=f"reading {self._bag.name}")
        return Photo(jpeg, captured_s, source=f"{self._topic} at {time_ns / 1e9:.3f}", lens=self._lens)

    def _next(self) -> tuple[int, bytes]:
        for again in (True, False):
            for time_ns, message in self._images:
                return time_ns, jpeg_of_message(self._topic, message)
            if again:
                self._images = self._read()
        raise CameraError(str(self._bag), f"{self._topic} has no more images that can be read")

    def _read(self) -> Iterator[tuple[int, Any]]:
        with _reading(self._bag) as reader:
            chosen = [found for found in reader.connections if found.topic == self._topic]
            for connection, time_ns, raw in reader.messages(connections=chosen):
                yield time_ns, _TYPES.deserialize_cdr(raw, connection.msgtype)


def _bag_file(bag: Path) -> Path:
    """The bag; of a folder without metadata.yaml, as of a recorder that was cut off, its one file."""
    if not bag.is_dir() or (bag / "metadata.yaml").exists():
        return bag
    files = [file for file in sorted(bag.iterdir()) if file.suffix in _FILES]
    if len(files) != 1:
        names = ", ".join(file.name for file in files) or "none"
        raise ValueError(
            f"it has no metadata.yaml, and not one {' or '.join(_FILES)} file ({names}): name one of its files, "
            "or have `ros2 bag reindex` write metadata.yaml"
        )
    return files[0]


@contextlib.contextmanager
def _reading(bag: Path) -> Iterator[Reader]:
    try:
        with Reader(_bag_file(bag)) as reader:
            yield reader
    except (ReaderError, OSError, ValueError, KeyError) as error:
        raise UsageError(f"camera.bag: {bag} cannot be read as a ROS 2 bag: {error}") from error
