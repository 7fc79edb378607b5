"""The drone's place from topics of MAVROS or PX4: only read, as nothing here flies a vehicle."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from upwash.core.geo import Circle, GeoPosition, LocalFrame, Position
from upwash.errors import AutopilotLost
from upwash.ros.session import guarded, ros_imports
from upwash.support.background import never

_PX4 = "/fmu/out/"
_SILENT_S = 5.0
_NO_FIX = -1  # NavSatStatus.STATUS_NO_FIX


class NowhereKnown:
    """The whereabouts of a drone whose place is not asked for: always home."""

    position = Position(0.0, 0.0)

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Never returns."""
        await never()

    def troubles(self) -> Iterator[str]:
        """None."""
        yield from ()


class TopicPosition:
    """Whereabouts by NavSatFix or PX4's VehicleGlobalPosition; altitudes count from the first place."""

    def __init__(self, node: Any, topic: str, frame: LocalFrame) -> None:
        with ros_imports():
            from rclpy.qos import qos_profile_sensor_data
            from sensor_msgs.msg import NavSatFix

            kind: Any = NavSatFix
            take: Callable[[Any], None] = self._take_fix
            if topic.startswith(_PX4):
                from px4_msgs.msg import VehicleGlobalPosition

                kind, take = VehicleGlobalPosition, self._take_px4
        self._topic, self._frame = topic, frame
        self._loop = asyncio.get_running_loop()
        self._ground_m: float | None = None
        self._heard_s = -math.inf
        self._moved = asyncio.Event()
        self._failed = ""
        self.position = Position(0.0, 0.0)
        came = functools.partial(self._hand_over, guarded(take, self._fail))
        node.create_subscription(kind, topic, came, qos_profile_sensor_data)

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns when a place inside a circle follows one outside, or the other way; AutopilotLost in silence."""
        before = [circle.contains(self.position) for circle in circles]
        while True:
            self._moved.clear()
            try:
                await asyncio.wait_for(self._moved.wait(), _SILENT_S)
            except TimeoutError:
                raise AutopilotLost("position", next(self.troubles(), "it is silent")) from None
            if [circle.contains(self.position) for circle in circles] != before:
                return

    def troubles(self) -> Iterator[str]:
        """What is wrong now, a sentence each."""
        silent_s = self._loop.time() - self._heard_s
        if silent_s > _SILENT_S:
            since = f"for {silent_s:.0f} s" if silent_s < math.inf else "yet"
            yield f"no place came on {self._topic} {since}: the last known one, or home, is believed"
        if self._failed:
            yield self._failed

    def _hand_over(self, take: Callable[[Any], None], message: Any) -> None:
        """In the thread of ROS: all else is done in the loop, in the order of the messages."""
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            self._loop.call_soon_threadsafe(take, message)

    def _fail(self, why: str) -> None:
        self._failed = f"{self._topic}: {why}"

    def _take_fix(self, fix: Any) -> None:
        if fix.status.status > _NO_FIX:
            self._take(fix.latitude, fix.longitude, fix.altitude)

    def _take_px4(self, place: Any) -> None:
        if getattr(place, "lat_lon_valid", True):
            self._take(place.lat, place.lon, place.alt)

    def _take(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> None:
        """Takes a place, which is out of bounds while a receiver starts."""
        if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):  # false for NaN too
            self._fail(f"{latitude_deg} and {longitude_deg} degrees are no place on the Earth")
            return
        if math.isfinite(altitude_m) and self._ground_m is None:
            self._ground_m = altitude_m
        above_m = (
            altitude_m - self._ground_m if self._ground_m is not None and math.isfinite(altitude_m) else 0.0
        )
        self._failed = ""
        self._heard_s = self._loop.time()
        place = GeoPosition(latitude_deg, longitude_deg)
        self.position = self._frame.position(place).at_altitude(above_m)
        self._moved.set()
