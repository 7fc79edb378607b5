"""A Camera whose photos come from a ROS 2 topic."""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import Iterator
from typing import Any, TypeAlias

from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.errors import CameraError
from upwash.ports import OtherClock, Photo
from upwash.ros.session import ros_imports, spinning
from upwash.ros.topics import EventTopic, ImageTopic, age_s, jpeg_soon

_PHOTO_S = 5.0
_Image: TypeAlias = tuple[Any, float, OtherClock | None]  # a message, and when it was taken


class TopicCamera:
    """A Camera whose photo is the first image of a topic that was taken after the request, by its stamp.

    An image whose stamp is of another clock, or a little ahead, counts as taken when it comes. The events of the
    flight are published at `~/events`.
    """

    def __init__(self, node: Any, topic: str, *, lens: Lens | None) -> None:
        self.follow = EventTopic(node).follow
        self._node, self._lens = node, lens
        self._loop = asyncio.get_running_loop()
        self._requests: list[tuple[float, asyncio.Future[_Image]]] = []
        self._topic = ImageTopic(node, topic, self._take, now_s=self._loop.time)

    async def take_photo(self, at: Position) -> Photo:
        """Returns the next image as a JPEG; raises CameraError if none comes in 5 s, or if it is no photo."""
        came: asyncio.Future[_Image] = self._loop.create_future()
        request = self._loop.time(), came
        self._requests.append(request)
        try:
            message, captured_s, other_clock = await asyncio.wait_for(came, _PHOTO_S)
        except TimeoutError:
            why = "; ".join(self._topic.troubles()) or "see that its node runs, and takes pictures"
            raise CameraError(self._topic.name, f"no image within {_PHOTO_S:g} s: {why}") from None
        finally:
            self._requests.remove(request)
        jpeg = await jpeg_soon(self._topic.name, message)
        source = _source(self._topic.name, message)
        return Photo(jpeg, captured_s, source, lens=self._lens, other_clock=other_clock)

    def _take(self, message: Any) -> None:
        if not self._requests:
            return
        captured_s = self._loop.time() - age_s(self._node, message)
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            image = message, captured_s, self._topic.other_clock
            self._loop.call_soon_threadsafe(self._hand_out, image)

    def _hand_out(self, image: _Image) -> None:
        _, captured_s, _ = image
        for asked_s, came in self._requests:
            if captured_s >= asked_s and not came.done():
                came.set_result(image)


def _source(topic: str, message: Any) -> str:
    stamp = message.header.stamp
    return f"{topic} at {stamp.sec}.{stamp.nanosec:09}"


@contextlib.contextmanager
def topic_camera(topic: str, *, lens: Lens | None) -> Iterator[TopicCamera]:
    """The camera, until the end of the block, by a node called `upwash`; raises UsageError without ROS 2."""
    with ros_imports():
        from rclpy.node import Node
    with spinning(functools.partial(Node, "upwash")) as node:
        yield TopicCamera(node, topic, lens=lens)


def require_ros() -> None:
    """Raises UsageError where ROS 2 cannot be imported."""
    with ros_imports():
        import rclpy  # noqa: F401
        import sensor_msgs.msg  # noqa: F401
