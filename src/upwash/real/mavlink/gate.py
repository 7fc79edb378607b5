"""The gate between packets and the driver: impossible numbers are dropped.

A message with a number that is not finite or out of range is dropped, unless MAVLink has a value for "not known":
the number then gets that value. The table holds the numbers that the driver uses; integers that cannot be out of
range are not in it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import Message
from upwash.real.mavlink.news import VehicleNewsFeed


@dataclass(frozen=True, slots=True)
class Range:
    """The numbers from `least` to `most`; `unknown` is MAVLink's value for "not known", if it has one."""

    least: float
    most: float
    unknown: int | None = None


Ranges: TypeAlias = Mapping[str, Mapping[str, Range]]
"""By message and field, in the message's units."""

LATITUDE_E7, LONGITUDE_E7 = Range(-90e7, 90e7), Range(-180e7, 180e7)
ABOVE_SEA_M = Range(-1e3, 1e5)
_ABOVE_SEA_MM, _ABOVE_HOME_MM = Range(-1e6, 1e8), Range(-1e7, 1e8)
_ANGLE_RAD, _DIRECTION_DEG = Range(-2 * math.tau, 2 * math.tau), Range(-360.0, 360.0)
_WIND_M_S, _WIND_PART_M_S = Range(0.0, 150.0), Range(-150.0, 150.0)
_PERCENT = Range(-1, 100, unknown=-1)
_UNDEFINED, _LANDING = mavlink.MAV_LANDED_STATE_UNDEFINED, mavlink.MAV_LANDED_STATE_LANDING
_LATEST_UNIX_US = 4_102_444_800e6  # 2100

RANGES: Ranges = MappingProxyType(
    {
        "GLOBAL_POSITION_INT": {
            "lat": LATITUDE_E7,
            "lon": LONGITUDE_E7,
            "alt": _ABOVE_SEA_MM,
            "relative_alt": _ABOVE_HOME_MM,
        },
        "GPS_RAW_INT": {"lat": LATITUDE_E7, "lon": LONGITUDE_E7},
        "HOME_POSITION": {"latitude": LATITUDE_E7, "longitude": LONGITUDE_E7, "altitude": _ABOVE_SEA_MM},
        "ATTITUDE": {"roll": _ANGLE_RAD, "pitch": _ANGLE_RAD, "yaw": _ANGLE_RAD},
        "WIND": {"speed": _WIND_M_S, "direction": _DIRECTION_DEG},
        "WIND_COV": {"wind_x": _WIND_PART_M_S, "wind_y": _WIND_PART_M_S},
        "SYS_STATUS": {"battery_remaining": _PERCENT},
        "BATTERY_STATUS": {"battery_remaining": _PERCENT},
        "EXTENDED_SYS_STATE": {"landed_state": Range(_UNDEFINED, _LANDING, unknown=_UNDEFINED)},
        "CAMERA_FEEDBACK": {"lat": LATITUDE_E7, "lng": LONGITUDE_E7, "alt_msl": ABOVE_SEA_M},
        "CAMERA_IMAGE_CAPTURED": {"lat": LATITUDE_E7, "lon": LONGITUDE_E7, "alt": _ABOVE_SEA_MM},
        "SYSTEM_TIME": {"time_unix_usec": Range(0, _LATEST_UNIX_US, unknown=0)},
    }
)


def admits(message: Message, ranges: Ranges, news: VehicleNewsFeed) -> bool:
    """Whether each number of the message is possible or marked as not known; the others are told as troubles."""
    kind = message.get_type()
    for name, span in ranges.get(kind, {}).items():
        value = getattr(message, name)
        if span.least <= value <= span.most:
            continue
        without = "the message was dropped" if span.unknown is None else "the number counts as not known"
        news.count("out-of-range", f"{kind}.{name}", f"{name} of {kind} was {value:g}: {without}")
        if span.unknown is None:
            return False
        setattr(message, name, span.unknown)
    return True
