"""The stand-in's parameters: a few of ArduCopter's 1,354, those that programs ask for, with version 4.7's values.

It obeys those for fences, fail-safes, returns and disarming by itself; the rest it only keeps and gives back. Inside,
each parameter has its name and its unit of version 4.6.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.version import Version
from upwash.vehicle.body.parameters import Parameter

_INT8 = mavlink.MAV_PARAM_TYPE_INT8
_INT16 = mavlink.MAV_PARAM_TYPE_INT16
_INT32 = mavlink.MAV_PARAM_TYPE_INT32
_REAL32 = mavlink.MAV_PARAM_TYPE_REAL32

_LIMITS = {_INT8: 2.0**7, _INT16: 2.0**15, _INT32: 2.0**31, _REAL32: 3.4e38}

_DEFAULTS: dict[str, tuple[float, int]] = {
    "MAV_SYSID": (1, _INT16),
    "MAV_GCS_SYSID": (255, _INT16),
    "FORMAT_VERSION": (120, _INT16),
    "FRAME_CLASS": (1, _INT8),
    "FRAME_TYPE": (0, _INT8),
    "AHRS_EKF_TYPE": (3, _INT8),
    "ARMING_CHECK": (1, _INT32),
    "BATT_ARM_VOLT": (0, _REAL32),
    "BATT_CAPACITY": (3300, _INT32),
    "BATT_CRT_MAH": (0, _REAL32),
    "BATT_CRT_VOLT": (0, _REAL32),
    "BATT_FS_CRT_ACT": (0, _INT8),
    "BATT_FS_LOW_ACT": (0, _INT8),
    "BATT_LOW_MAH": (0, _REAL32),
    "BATT_LOW_TIMER": (10, _INT8),
    "BATT_LOW_VOLT": (10.5, _REAL32),
    "BATT_MONITOR": (4, _INT8),
    "COMPASS_USE": (1, _INT8),
    "DISARM_DELAY": (10, _INT8),
    "FENCE_ACTION": (1, _INT8),
    "FENCE_ALT_MAX": (100, _REAL32),
    "FENCE_ALT_MIN": (-10, _REAL32),
    "FENCE_AUTOENABLE": (0, _INT8),
    "FENCE_ENABLE": (0, _INT8),
    "FENCE_MARGIN": (2, _REAL32),
    "FENCE_OPTIONS": (0, _INT16),
    "FENCE_RADIUS": (150, _REAL32),
    "FENCE_TOTAL": (0, _INT8),
    "FENCE_TYPE": (7, _INT8),
    "FLTMODE1": (7, _INT8),
    "FLTMODE2": (9, _INT8),
    "FLTMODE3": (6, _INT8),
    "FLTMODE4": (3, _INT8),
    "FLTMODE5": (5, _INT8),
    "FLTMODE6": (0, _INT8),
    "FS_CRASH_CHECK": (1, _INT8),
    "FS_DR_ENABLE": (2, _INT8),
    "FS_DR_TIMEOUT": (30, _INT16),
    "FS_EKF_ACTION": (1, _INT8),
    "FS_EKF_THRESH": (0.8, _REAL32),
    "FS_GCS_ENABLE": (0, _INT8),
    "FS_GCS_TIMEOUT": (5, _REAL32),
    "FS_OPTIONS": (16, _INT32),
    "FS_THR_ENABLE": (1, _INT8),
    "FS_VIBE_ENABLE": (1, _INT8),
    "GUID_OPTIONS": (0, _INT32),
    "GUID_TIMEOUT": (3, _REAL32),
    "LAND_ALT_LOW": (1000, _INT16),
    "LAND_SPEED": (50, _INT16),
    "LAND_SPEED_HIGH": (0, _INT16),
    "LOIT_SPEED": (1250, _REAL32),
    "MIS_TOTAL": (0, _INT16),
    "PILOT_SPEED_UP": (250, _INT16),
    "RALLY_TOTAL": (0, _INT8),
    "RTL_ALT": (1500, _INT32),
    "RTL_ALT_FINAL": (0, _INT16),
    "RTL_ALT_TYPE": (0, _INT8),
    "RTL_CLIMB_MIN": (0, _INT16),
    "RTL_LOIT_TIME": (5000, _INT32),
    "RTL_OPTIONS": (0, _INT32),
    "RTL_SPEED": (0, _INT16),
    "SCR_ENABLE": (1, _INT8),
    "SIM_SPEEDUP": (1, _REAL32),
    "WPNAV_ACCEL": (250, _REAL32),
    "WPNAV_ACCEL_Z": (100, _REAL32),
    "WPNAV_JERK": (1, _REAL32),
    "WPNAV_RADIUS": (200, _REAL32),
    "WPNAV_SPEED": (1000, _REAL32),
    "WPNAV_SPEED_DN": (150, _REAL32),
    "WPNAV_SPEED_UP": (250, _REAL32),
    "WP_YAW_BEHAVIOR": (2, _INT8),
}
_RENAMED_FROM = Version(4, 7)
_CENTI, _ONE = 0.01, 1.0
_RENAMED: dict[str, tuple[str, float]] = {
    "LAND_ALT_LOW": ("LAND_ALT_LOW_M", _CENTI),
    "LAND_SPEED": ("LAND_SPD_MS", _CENTI),
    "LAND_SPEED_HIGH": ("LAND_SPD_HIGH_MS", _CENTI),
    "LOIT_SPEED": ("LOIT_SPEED_MS", _CENTI),
    "PILOT_SPEED_UP": ("PILOT_SPD_UP", _CENTI),
    "RTL_ALT": ("RTL_ALT_M", _CENTI),
    "RTL_ALT_FINAL": ("RTL_ALT_FINAL_M", _CENTI),
    "RTL_CLIMB_MIN": ("RTL_CLIMB_MIN_M", _CENTI),
    "RTL_SPEED": ("RTL_SPEED_MS", _CENTI),
    "WPNAV_ACCEL": ("WP_ACC", _CENTI),
    "WPNAV_ACCEL_Z": ("WP_ACC_Z", _CENTI),
    "WPNAV_JERK": ("WP_JERK", _ONE),
    "WPNAV_RADIUS": ("WP_RADIUS_M", _CENTI),
    "WPNAV_SPEED": ("WP_SPD", _CENTI),
    "WPNAV_SPEED_DN": ("WP_SPD_DN", _CENTI),
    "WPNAV_SPEED_UP": ("WP_SPD_UP", _CENTI),
}


class Parameters:
    """All parameters, in an order that stays; outside, each has the name of the version."""

    def __init__(self, values: Mapping[str, float], version: Version) -> None:
        self._values = {name: value for name, (value, _) in _DEFAULTS.items()} | dict(values)
        self._kinds = {name: kind for name, (_, kind) in _DEFAULTS.items()}
        renamed = _RENAMED if version >= _RENAMED_FROM else {}
        self._names = [renamed[name][0] if name in renamed else name for name in _DEFAULTS]
        self._inside = {outside: (name, size) for name, (outside, size) in renamed.items()}

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def named(self, name: str) -> Parameter | None:
        """The parameter of that name, if there is one."""
        if name not in self._names:
            return None
        inside, size = self._inside.get(name, (name, 1.0))
        kind = _REAL32 if name in self._inside else self._kinds[name]
        return Parameter(name, self._names.index(name), self._values[inside] * size, kind)

    def at(self, index: int) -> Parameter | None:
        """The parameter at that place, if there is one."""
        return self.named(self._names[index]) if 0 <= index < len(self._names) else None

    def add(self, name: str, value: float) -> None:
        """One that a script brings with it."""
        if name not in self._names:
            self._names.append(name)
        self._kinds[name], self._values[name] = _REAL32, value

    def set(self, name: str, value: float) -> bool:
        """Changes one; whether it is there and the value fits its type."""
        if name not in self._names:
            return False
        inside, size = self._inside.get(name, (name, 1.0))
        kind = self._kinds[inside]
        if not (math.isfinite(value) and abs(value / size) < _LIMITS[kind]):
            return False
        self._values[inside] = value / size if kind == _REAL32 else round(value / size)
        return True
