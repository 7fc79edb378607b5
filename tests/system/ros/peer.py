"""A ROS 2 node that knows nothing of upwash: it publishes, listens, calls and looks around, as stdin says.

Runs in the Python that has ROS 2. A line is a JSON object with `do`; the answer is a line too.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import sys
import threading
import time
from collections import defaultdict
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

_PATIENCE_S = 60.0  # another node has started on a busy machine


def _type(name: str) -> Any:
    package, group, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.{group}"), kind)


def _set(message: Any, fields: dict[str, Any]) -> None:
    for name, value in fields.items():
        if isinstance(value, dict):
            _set(getattr(message, name), value)
        elif name == "data" and isinstance(value, int):  # bytes: as many, behind the start of a JPEG
            setattr(message, name, b"\xff\xd8\xff" + bytes(value - 3))
        else:
            setattr(message, name, value)


def _plain(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else len(value)
    if isinstance(value, str | int | float | bool):
        return value
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else str(value)


class Peer:
    """The node, and what came at the topics that it listens to."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = Node("peer")
        self.came: dict[str, list[Any]] = defaultdict(list)
        self.publishers: dict[str, Any] = {}
        threading.Thread(target=rclpy.spin, args=(self.node,), daemon=True).start()

    def publish(
        self, topic: str, kind: str, fields: dict[str, Any], times: int = 1, every_s: float = 0.0
    ) -> int:
        """Publishes a message; a header without a stamp gets the present time."""
        if topic not in self.publishers:
            best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
            self.publishers[topic] = self.node.create_publisher(_type(kind), topic, best_effort)
            until_s = time.monotonic() + _PATIENCE_S * bool(times)
            while not self.publishers[topic].get_subscription_count() and time.monotonic() < until_s:
                time.sleep(0.02)
        for _ in range(times):
            message = _type(kind)()
            _set(message, fields)
            if hasattr(message, "header") and not message.header.stamp.sec:
                message.header.stamp = self.node.get_clock().now().to_msg()
            self.publishers[topic].publish(message)
            time.sleep(every_s)
        return int(self.publishers[topic].get_subscription_count())

    def listen(self, topic: str, kind: str, latched: bool = False) -> None:
        """Keeps what comes at a topic from now on, and with `latched` the last message before."""
        qos = QoSProfile(depth=50)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        self.node.create_subscription(
            _type(kind), topic, lambda message: self.came[topic].append(_plain(message)), qos
        )

    def wait(self, topic: str, text: str = "", count: int = 1, within_s: float = _PATIENCE_S) -> list[Any]:
        """The messages with that text, once there are `count`, or after `within_s`."""
        until_s = time.monotonic() + within_s
        while True:
            found = [message for message in list(self.came[topic]) if text in json.dumps(message)]
            if len(found) >= count or time.monotonic() > until_s:
                return found
            time.sleep(0.02)

    def forget(self, topic: str) -> None:
        """Forgets what came."""
        self.came[topic].clear()

    def call(self, service: str, kind: str, fields: dict[str, Any] | None = None) -> Any:
        """The reply of a service; None if it is not there, or does not answer."""
        client = self.node.create_client(_type(kind), service)
        if not client.wait_for_service(_PATIENCE_S):
            return None
        request = _type(kind).Request()
        _set(request, fields or {})
        reply = client.call_async(request)
        until_s = time.monotonic() + _PATIENCE_S
        while not reply.done() and time.monotonic() < until_s:
            time.sleep(0.02)
        return _plain(reply.result()) if reply.done() else None

    def graph(self) -> dict[str, Any]:
        """What rclpy lists: nodes, and the types of topics and services."""
        return {
            "nodes": self.node.get_node_names(),
            "topics": dict(self.node.get_topic_names_and_types()),
            "services": dict(self.node.get_service_names_and_types()),
        }


def main() -> None:
    """Does what the lines say."""
    peer = Peer()
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    with contextlib.suppress(KeyboardInterrupt):
        for line in sys.stdin:
            wanted = json.loads(line)
            sys.stdout.write(json.dumps(getattr(peer, wanted.pop("do"))(**wanted)) + "\n")
            sys.stdout.flush()
    os._exit(0)  # without a thread of ROS that ends later than what it needs


main()
