"""A subscription to images, and what is wrong with it; and the events of the log as a topic."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from typing import Any

import msgspec

from upwash.eventlog.schema import Event
from upwash.ports import OtherClock
from upwash.ros.session import guarded, ros_imports
from upwash.services.ros_image import jpeg_of_message
from upwash.support.background import in_thread
from upwash.support.text import clocks_apart, counted

_KEPT_EVENTS = 100  # for a subscriber that is slower
_SILENT_S = 5.0
_JUMP_S = 1.0  # of stamps, backwards: more than cameras and their drivers mix up
_APART_S = 5.0  # a stamp that differs by more from this computer's clock is of another clock


class ImageTopic:
    """Subscribes to the images of a topic with the quality of service of sensor data; `came` gets each message.

    The type is CompressedImage for a name that ends in `compressed`, else Image. `now_s` is the time by a steady
    clock. What is wrong is in `troubles`; messages of other types are never received.
    """

    def __init__(
        self, node: Any, topic: str, came: Callable[[Any], None], *, now_s: Callable[[], float]
    ) -> None:
        with ros_imports():
            from rclpy.event_handler import SubscriptionEventCallbacks
            from rclpy.qos import qos_profile_sensor_data
            from sensor_msgs.msg import CompressedImage, Image
        self._node, self._came, self._now_s = node, came, now_s
        self.name: str = node.resolve_topic_name(topic)
        kind = CompressedImage if self.name.endswith("compressed") else Image
        self.type = f"sensor_msgs/msg/{kind.__name__}"
        self.received = 0
        self._began_s = self._last_s = now_s()
        self._stamp_s = 0.0
        self._jumped = ""
        self._failed = ""
        self._refused = 0
        self.other_clock: OtherClock | None = None  # of the last image
        events = SubscriptionEventCallbacks(
            incompatible_qos=self._hear_qos, incompatible_type=lambda _: None, use_default_callbacks=False
        )
        self._subscription = node.create_subscription(
            kind, self.name, guarded(self._take, self.fail), qos_profile_sensor_data, event_callbacks=events
        )

    def close(self) -> None:
        """Ends the subscription."""
        self._node.destroy_subscription(self._subscription)

    def fail(self, why: str) -> None:
        """Keeps a failure among the troubles until the next image."""
        self._failed = why

    def troubles(self) -> Iterator[str]:
        """What is wrong now, a sentence each."""
        publishers = self._node.get_publishers_info_by_topic(self.name)
        others = sorted({publisher.topic_type for publisher in publishers} - {self.type})
        if others:
            yield (
                f"{self.name} carries {', '.join(others)}, and {self.type} is subscribed to: the name of a topic of "
                "CompressedImage ends in `compressed`, and that of another does not"
            )
        if self._refused:
            yield f"{counted(self._refused, 'publisher')} of {self.name} offered no fitting quality of service"
        if (silent_s := self._now_s() - self._last_s) > _SILENT_S and not others:
            there = counted(len(publishers), "publisher") if publishers else "no publisher"
            yield f"no image came on {self.name} for {silent_s:.0f} s: it has {there}"
        if (other := self.other_clock) is not None:
            said = clocks_apart(f"the clock of {self.name}", other.camera, other.own)
            yield f"{said}; set it, or use_sim_time for a bag"
        yield from (trouble for trouble in (self._jumped, self._failed) if trouble)

    def _hear_qos(self, event: Any) -> None:
        self._refused = event.total_count

    def _take(self, message: Any) -> None:
        taken_s = stamp_s(message)
        if taken_s < self._stamp_s - _JUMP_S:
            self._jumped = (
                f"the stamps of {self.name} went back by {self._stamp_s - taken_s:.1f} s: a clock was set, or a bag "
                "begins again; images are taken in the order in which they come"
            )
        self._stamp_s = taken_s
        self._last_s = self._now_s()
        self.received += 1
        self._failed = ""
        self.other_clock = other_clock(node_s(self._node), taken_s)
        self._came(message)


class EventTopic:
    """Publishes events of the log at `~/events`, as JSON in std_msgs/String."""

    def __init__(self, node: Any) -> None:
        with ros_imports():
            from std_msgs.msg import String
        self._string = String
        self._publisher = node.create_publisher(String, "~/events", _KEPT_EVENTS)

    def follow(self, event: Event) -> None:
        """Publishes the event; an event that cannot be published is only in the log."""
        with contextlib.suppress(Exception):  # such as a context that was shut down from outside
            self._publisher.publish(self._string(data=msgspec.json.encode(event).decode()))


async def jpeg_soon(topic: str, message: Any) -> bytes:
    """The JPEG of an image, as `jpeg_of_message`; what takes time is done in a thread."""
    work = functools.partial(jpeg_of_message, topic, message)
    is_jpeg = not hasattr(message, "encoding") and message.data[:1].tobytes() == b"\xff"
    return work() if is_jpeg else await in_thread(work, name="an image of ROS 2")


def age_s(node: Any, message: Any) -> float:
    """How old an image is by its stamp; 0 if its stamp is of another clock."""
    now_s, then_s = node_s(node), stamp_s(message)
    return 0.0 if other_clock(now_s, then_s) else max(0.0, now_s - then_s)


def other_clock(now_s: float, stamp_s: float) -> OtherClock | None:
    """The two times if the stamp can be of no clock that agrees with this computer's, else None."""
    if abs(now_s - stamp_s) <= _APART_S:
        return None
    return OtherClock(datetime.fromtimestamp(stamp_s, UTC), datetime.fromtimestamp(now_s, UTC))


def node_s(node: Any) -> float:
    """The time by the node's clock, in seconds since 1970, or of a simulation."""
    return float(node.get_clock().now().nanoseconds / 1e9)


def stamp_s(message: Any) -> float:
    """The time of the message's stamp, in seconds since 1970."""
    stamp = message.header.stamp
    return float(stamp.sec + stamp.nanosec / 1e9)
