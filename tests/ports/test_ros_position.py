"""The drone's place from a topic of ROS 2, without ROS: its messages, in the order in which they came."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from upwash.core.geo import GeoPosition, LocalFrame
from upwash.ros.position import TopicPosition
from upwash.sim.loop import run_virtually


class Topic:
    """A node whose subscription is called by hand."""

    come: Callable[[Any], None]

    def create_subscription(self, kind: object, topic: str, come: Callable[[Any], None], qos: object) -> None:
        self.come = come

    def fix(self, latitude_deg: float) -> None:
        status = SimpleNamespace(status=0)
        self.come(SimpleNamespace(status=status, latitude=latitude_deg, longitude=22.0, altitude=5.0))


def test_of_places_that_came_while_the_loop_was_busy_the_last_says_what_is_wrong(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    qos, kinds = SimpleNamespace(qos_profile_sensor_data=None), SimpleNamespace(NavSatFix=None)
    for name, module in {
        "rclpy": None,
        "rclpy.qos": qos,
        "sensor_msgs": None,
        "sensor_msgs.msg": kinds,
    }.items():
        monkeypatch.setitem(sys.modules, name, module or SimpleNamespace())

    async def troubles(*latitudes_deg: float) -> list[str]:
        topic = Topic()
        place = TopicPosition(topic, "/fix", LocalFrame(GeoPosition(39.0, 22.0)))
        for latitude_deg in latitudes_deg:
            topic.fix(latitude_deg)
        await asyncio.sleep(0.1)
        return list(place.troubles())

    assert run_virtually(troubles(1e9, 39.0)) == []
    (trouble,) = run_virtually(troubles(39.0, 1e9))
    assert "no place on the Earth" in trouble
