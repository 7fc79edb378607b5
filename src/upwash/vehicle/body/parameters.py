"""The parameters of a stand-in: those that it obeys, and those that programs ask for and it only keeps.

An autopilot's names, defaults and MAV_PARAM_TYPEs stand in its `parameters.csv`. Later versions have a `new_name`
for some parameters, and count them in another unit: `new_unit` times the old value. Inside the stand-in the old
name and unit count.
"""

from __future__ import annotations

import csv
import math
from functools import cache
from importlib.resources import files
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import UsageError
from upwash.mavlink.px4 import bytes_of_float, float_of_bytes
from upwash.support.text import number_of

_REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_LIMITS = {
    mavlink.MAV_PARAM_TYPE_INT8: 2.0**7,
    mavlink.MAV_PARAM_TYPE_INT16: 2.0**15,
    mavlink.MAV_PARAM_TYPE_INT32: 2.0**31,
    _REAL32: 3.4e38,
}


class ParameterTable:
    """All parameters of one autopilot, in an order that stays.

    With `new_names` a parameter is known outside by its new name. With `int_bytes` an integer travels in the bytes of
    a float, as PX4 sends it; else as a float of the same value.
    """

    def __init__(self, autopilot: str, *, new_names: bool = False, int_bytes: bool = False) -> None:
        self._int_bytes = int_bytes
        self._values: dict[str, float] = {}
        self._types: dict[str, int] = {}
        self.names: dict[str, tuple[str, float]] = {}  # the names outside: the old name, and the new unit
        for row in _rows(autopilot):
            name, new_name = row["name"], row.get("new_name") if new_names else None
            kind = self._types[name] = getattr(mavlink, f"MAV_PARAM_TYPE_{row['type']}")
            self._values[name] = float(row["value"]) if kind == _REAL32 else int(row["value"])
            self.names[new_name or name] = name, float(row["new_unit"]) if new_name else 1.0

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def named(self, name: str) -> Any | None:
        """PARAM_VALUE of the parameter of that name outside; None for an unknown name."""
        if name not in self.names:
            return None
        inside, unit = self.names[name]
        kind, value = self._types[inside] if inside == name else _REAL32, self._values[inside] * unit
        sent = float_of_bytes(int(value)) if self._int_bytes and kind != _REAL32 else value
        index = list(self.names).index(name)
        return mavlink.MAVLink_param_value_message(name.encode(), sent, kind, len(self), index)

    def at(self, index: int) -> Any | None:
        """PARAM_VALUE of the parameter at that place; None outside the list."""
        return self.named(list(self.names)[index]) if 0 <= index < len(self) else None

    def preset(self, name: str, value: float) -> None:
        """Gives a parameter another default, by its old name and in its old unit."""
        self._values[name] = value

    def add(self, name: str, value: float) -> None:
        """Adds a parameter that a script brings with it."""
        self.names[name] = name, 1.0
        self._types[name], self._values[name] = _REAL32, value

    def receive(self, name: str, sent: float) -> bool:
        """Changes a parameter to the value that PARAM_SET holds; whether it is there and the value fits its type."""
        in_bytes = self._int_bytes and self._types.get(name, _REAL32) != _REAL32
        return self.change(name, bytes_of_float(sent) if in_bytes else sent)

    def change(self, name: str, value: float) -> bool:
        """Changes a parameter by its name outside; whether it is there and the value fits its type."""
        if name not in self.names:
            return False
        inside, unit = self.names[name]
        kind = self._types[inside]
        if not (math.isfinite(value) and abs(value / unit) < _LIMITS[kind]):
            return False
        self._values[inside] = value / unit if kind == _REAL32 else round(value / unit)
        return True


@cache
def _rows(autopilot: str) -> list[dict[str, str]]:
    table = files("upwash.vehicle").joinpath(autopilot, "parameters.csv").read_text(encoding="utf-8")
    return list(csv.DictReader(table.splitlines()))


def read_setting(text: str) -> tuple[str, float]:
    """The parameter and the value in `NAME=VALUE`; UsageError for any other text."""
    name, _, value = text.partition("=")
    try:
        return name, number_of(value)
    except ValueError:
        raise UsageError(
            f'"{text}" sets no parameter; write its name and value, such as FENCE_RADIUS=60'
        ) from None
