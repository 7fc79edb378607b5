"""The programs of the comparison that speak ROS 2: `python -m bench.ros.nodes server|drone`, in ROS's own Python.

Three ways to have a photo of 430,000 bytes looked at on the server:

    service   a ROS service over Fast DDS with its defaults; rclpy has no time-out
    topics    a topic there and a topic back between given addresses, as FogROS2 connects a robot and a cloud
    upwash    a topic of the robot, which `upwash ros` subscribes to
"""

from __future__ import annotations

import array
import json
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from nav_msgs.srv import SetMap
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String

PHOTO_BYTES = 430_000
DOMAINS = {"service": 11, "topics": 12, "upwash": 13}
GIVEN_UP_S = 60.0  # in the black-out and the first call
LOSSY_GIVEN_UP_S = 10.0
_WARM_UP_S = 60.0
_QUIET_S = 0.3  # what one way leaves on the radio delays no other


def node_of(way: str, peers: str = "") -> Node:
    """A node in that way's domain, which spins in a thread of its own."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET" if way == "service" else "LOCALHOST"
    os.environ["ROS_STATIC_PEERS"] = peers
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAINS[way])
    node = Node(f"{way}_{sys.argv[1]}", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    return node


def serve(peer: str) -> None:
    """Answers by the first two ways, until it is killed."""
    bare, fog = node_of("service"), node_of("topics", peer)

    def look(request: SetMap.Request, response: SetMap.Response) -> SetMap.Response:
        response.success = len(request.map.data) == PHOTO_BYTES
        return response

    bare.create_service(SetMap, "look", look)
    results = fog.create_publisher(String, "result", 10)
    fog.create_subscription(
        CompressedImage,
        "image/compressed",
        lambda image: results.publish(String(data=f"{image.header.stamp.sec} {len(image.data)}")),
        10,
    )
    print("ready", flush=True)
    threading.Event().wait()


class Calls:
    """The drone's calls; each returns where it was computed, or None after `given_up_s` without an answer."""

    def __init__(self, peer: str) -> None:
        photo = b"\xff\xd8\xff" + os.urandom(PHOTO_BYTES - 3)
        self._service = node_of("service").create_client(SetMap, "look")
        self._request = SetMap.Request()
        self._request.map.data = array.array("b", photo)
        self._image = CompressedImage(format="jpeg", data=array.array("B", photo))
        self._stamp = 0
        self.given_up_s = GIVEN_UP_S
        self._publishers = {}
        self._came: dict[int, tuple[threading.Event, list[str]]] = {}
        for way, qos, result, peers in (
            ("topics", 10, "result", peer),
            ("upwash", qos_profile_sensor_data, "/upwash/looker/result", ""),
        ):
            node = node_of(way, peers)
            self._publishers[way] = node.create_publisher(CompressedImage, "/image/compressed", qos)
            node.create_subscription(String, result, self._hear, 10)

    def call(self, way: str) -> str | None:
        """One call in that way."""
        return self._by_service() if way == "service" else self._by_topic(way)

    def _by_service(self) -> str | None:
        done = threading.Event()
        self._service.call_async(self._request).add_done_callback(lambda _: done.set())
        return "server" if done.wait(self.given_up_s) else None

    def _by_topic(self, way: str) -> str | None:
        self._stamp += 1
        came = self._came[self._stamp] = threading.Event(), []
        self._image.header.stamp.sec = self._stamp
        self._publishers[way].publish(self._image)
        return came[1][0] if came[0].wait(self.given_up_s) else None

    def _hear(self, message: String) -> None:
        if message.data.startswith("{"):
            said = json.loads(message.data)
            stamp, place = said["stamp"]["sec"], said["place"]
        else:
            stamp, place = int(message.data.split()[0]), "server"
        if (came := self._came.get(stamp)) is not None and not came[0].is_set():
            came[1].append("drone" if place == "local" else "server")
            came[0].set()


def tell(**said: Any) -> None:
    """One line for the comparison."""
    print(json.dumps(said), flush=True)


def drone(peer: str, in_turns: int, at_once_s: float, period_s: float) -> None:
    """Makes calls as stdin says: `turns NAME` way after way, `at_once NAME` side by side, or some of one way."""
    calls = Calls(peer)

    def measured(name: str, way: str) -> None:
        began_s = time.monotonic()
        place = calls.call(way)
        tell(what=name, way=way, began_s=began_s, took_s=time.monotonic() - began_s, place=place)

    for way in DOMAINS:
        _warm_up(calls, way)
    tell(what="ready")
    for line in sys.stdin:
        how, name = line.split()
        calls.given_up_s = LOSSY_GIVEN_UP_S if how in DOMAINS else GIVEN_UP_S
        if how == "turns":
            for _ in range(in_turns):
                for way in DOMAINS:
                    measured(name, way)
                    time.sleep(_QUIET_S)
        elif how in DOMAINS:
            for _ in range(max(1, in_turns // 3)):
                measured(name, how)
        else:
            threads = [
                threading.Thread(target=_again, args=(measured, name, way, at_once_s, period_s))
                for way in DOMAINS
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
        tell(what="over")


def _warm_up(calls: Calls, way: str) -> None:
    """Calls, a second apart, until the server answers."""
    warm, until_s = threading.Event(), time.monotonic() + _WARM_UP_S

    def call() -> None:
        if calls.call(way) == "server":
            warm.set()

    while not warm.wait(1.0):
        if time.monotonic() > until_s:
            raise SystemExit(f"no answer by {way} within {_WARM_UP_S:.0f} s")
        threading.Thread(target=call, daemon=True).start()
    time.sleep(2.0)


def _again(measured: Callable[[str, str], None], name: str, way: str, for_s: float, period_s: float) -> None:
    until_s = time.monotonic() + for_s
    while (began_s := time.monotonic()) < until_s:
        measured(name, way)
        time.sleep(max(0.0, began_s + period_s - time.monotonic()))


if __name__ == "__main__":
    if sys.argv[1] == "server":
        serve(sys.argv[2])
    else:
        drone(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), float(sys.argv[5]))
