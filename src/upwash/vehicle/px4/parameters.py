"""The stand-in's parameters: some of PX4's 883, those that it obeys and those that programs ask for first.

The defaults are those of the recorded vehicle. What it does not obey it keeps and gives back.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import UsageError
from upwash.mavlink.px4 import bytes_of_float, float_of_bytes
from upwash.vehicle.body.parameters import Parameter

_INT32 = mavlink.MAV_PARAM_TYPE_INT32
_REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_MOST = 3.4e38

# An int is an INT32, a float a FLOAT.
_DEFAULTS: dict[str, float | int] = {
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15,
    "BAT1_N_CELLS": 4,
    "CBRK_SUPPLY_CHK": 0,
    "COM_ARM_WO_GPS": 1,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_DL_LOSS_T": 10,
    "COM_FAIL_ACT_T": 5.0,
    "COM_FLIGHT_UUID": 0,
    "COM_LOW_BAT_ACT": 3,
    "COM_OBC_LOSS_T": 5.0,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RC_IN_MODE": 3,
    "COM_RC_LOSS_T": 0.5,
    "COM_RC_OVERRIDE": 1,
    "COM_RC_STICK_OV": 30.0,
    "COM_RCL_EXCEPT": 0,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    "GF_PREDICT": 0,
    "MAV_COMP_ID": 1,
    "MAV_SYS_ID": 1,
    "MAV_TYPE": 2,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_HOR": 3.0,
    "MPC_JERK_AUTO": 4.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_TKO_SPEED": 1.5,
    "MPC_VEL_MANUAL": 10.0,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_Z_V_AUTO_DN": 1.5,
    "MPC_Z_V_AUTO_UP": 3.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "NAV_ACC_RAD": 2.0,
    "NAV_DLL_ACT": 0,
    "NAV_MC_ALT_RAD": 0.8,
    "NAV_RCL_ACT": 2,
    "RTL_MIN_DIST": 10.0,
    "RTL_RETURN_ALT": 30.0,
    "RTL_TYPE": 0,
    "SIM_GPS_USED": 10,
    "SYS_AUTOSTART": 10040,
}


class Parameters:
    """All parameters, in an order that stays; INT32 values travel in the bytes of a float."""

    def __init__(self, values: Mapping[str, float]) -> None:
        self._values = dict(_DEFAULTS)
        self._names = sorted(_DEFAULTS)
        for name, value in values.items():
            if not self.change(name, value):
                raise UsageError(
                    f"vehicle: {name} = {value}: the stand-in has no such parameter, or not such a value"
                )

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def named(self, name: str) -> Parameter | None:
        """The parameter of that name as it is sent, if there is one."""
        if name not in _DEFAULTS:
            return None
        value = self._values[name]
        if isinstance(value, int):
            return Parameter(name, self._names.index(name), float_of_bytes(value), _INT32)
        return Parameter(name, self._names.index(name), value, _REAL32)

    def at(self, index: int) -> Parameter | None:
        """The parameter at that place, if there is one."""
        return self.named(self._names[index]) if 0 <= index < len(self._names) else None

    def set(self, name: str, sent: float) -> bool:
        """Changes one to the value that was sent for it; whether it is there and the value fits."""
        whole = isinstance(_DEFAULTS.get(name), int)
        return self.change(name, bytes_of_float(sent) if whole else sent)

    def change(self, name: str, value: float) -> bool:
        """Changes one; whether it is there and the value fits."""
        if name not in _DEFAULTS or not (math.isfinite(value) and abs(value) < _MOST):
            return False
        self._values[name] = round(value) if isinstance(_DEFAULTS[name], int) else float(value)
        return True
