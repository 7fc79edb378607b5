"""A camera whose photos are the images of a ROS 2 bag."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from pathlib import Path

from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.errors import CameraError, UpwashError, UsageError
from upwash.ports import Photo
from upwash.services.ros_image import jpeg_of_message
from upwash.support.background import in_thread
from upwash.support.text import printable, worded, words_of

_TYPES = get_typestore(Stores.ROS2_HUMBLE)
_FILES = (".mcap", ".db3")
_IMAGES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
_READ_S = 20.0
_LONGEST_REASON = 300  # characters
_REMEDY = "copy the bag again, or mend it with `ros2 bag reindex` or `mcap recover`"


class BagCamera:
    """A Camera whose photos are the images of a bag, in their order, again and again; each takes `photo_s`.

    Raises UsageError for a bag that cannot be read, and unless it has images of one topic, or of the given one.
    """

    def __init__(self, bag: Path, topic: str | None, *, photo_s: float, lens: Lens | None) -> None:
        self._bag, self._photo_s, self._lens = _bag_file(bag), photo_s, lens
        try:
            with _reading(), Reader(self._bag) as reader:
                topics = sorted({found.topic for found in reader.connections if found.msgtype in _IMAGES})
        except _Unreadable as error:
            raise UsageError(
                f"camera.bag: {bag} cannot be read as a ROS 2 bag: {error}; {_REMEDY}"
            ) from error
        wanted = topics if topic is None else [name for name in topics if name == topic]
        if not topics:
            raise UsageError(f"camera.bag: {bag} has no images, of {' or '.join(_IMAGES)}")
        if len(wanted) != 1:
            names = printable(", ".join(topics), _LONGEST_REASON)
            raise UsageError(f"camera.bag: {bag} has images of {names}: name one of them as camera.topic")
        self._topic = wanted[0]
        self._images: Iterator[tuple[str, int, bytes]] = iter(())

    async def take_photo(self, at: Position) -> Photo:
        """Returns the next image after `photo_s` seconds; raises CameraError if it is no photo, or cannot be read.

        An image that is damaged by itself is left out of those that follow.
        """
        await asyncio.sleep(self._photo_s)
        captured_s = asyncio.get_running_loop().time()
        try:
            reading = in_thread(self._next, name=f"reading {self._bag.name}")
            time_ns, jpeg = await asyncio.wait_for(reading, _READ_S)
        except TimeoutError:
            raise CameraError(
                str(self._bag), f"it could not be read within {_READ_S:g} s; {_REMEDY}"
            ) from None
        except _Unreadable as error:
            raise CameraError(str(self._bag), f"{self._topic} cannot be read: {error}; {_REMEDY}") from error
        return Photo(jpeg, captured_s, source=f"{self._topic} at {time_ns / 1e9:.3f}", lens=self._lens)

    def _next(self) -> tuple[int, bytes]:
        with _reading():
            for again in (True, False):
                for kind, time_ns, raw in self._images:
                    return time_ns, jpeg_of_message(self._topic, _TYPES.deserialize_cdr(raw, kind))
                if again:
                    self._images = self._read()
        raise CameraError(str(self._bag), f"{self._topic} has no more images that can be read")

    def _read(self) -> Iterator[tuple[str, int, bytes]]:
        """The type, the time and the bytes of each image."""
        with Reader(self._bag) as reader:
            chosen = [found for found in reader.connections if found.topic == self._topic]
            for connection, time_ns, raw in reader.messages(connections=chosen):
                yield connection.msgtype, time_ns, raw


class _Unreadable(Exception):
    """Why a bag cannot be read."""


def _bag_file(bag: Path) -> Path:
    """The bag; of a folder without metadata.yaml, as of a recorder that was cut off, its one file."""
    if not bag.is_dir() or (bag / "metadata.yaml").exists():
        return bag
    files = [file for file in sorted(bag.iterdir()) if file.suffix in _FILES]
    if not files:
        raise UsageError(
            f"camera.bag: {bag} is no ROS 2 bag: it has no metadata.yaml, no .mcap and no .db3 file"
        )
    if len(files) > 1:
        names = ", ".join(file.name for file in files)
        raise UsageError(
            f"camera.bag: {bag} has no metadata.yaml, and more than one file ({names}): name one of "
            "its files, or have `ros2 bag reindex` write metadata.yaml"
        )
    return files[0]


@contextlib.contextmanager
def _reading() -> Iterator[None]:
    """Any error that the bag's libraries raise for a damaged bag is raised as _Unreadable."""
    try:
        yield
    except UpwashError:
        raise
    except Exception as error:
        raise _Unreadable(printable(words_of(worded(error)), _LONGEST_REASON)) from error
