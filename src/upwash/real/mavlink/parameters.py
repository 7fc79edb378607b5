"""Reading and setting a vehicle's parameters."""

from __future__ import annotations

import math
import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.errors import AutopilotTimeout
from upwash.real.mavlink.hearing import Message
from upwash.real.mavlink.vehicle import MavlinkVehicle

_ATTEMPTS = 3
_AS_BYTES = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<Bxxx",
    mavlink.MAV_PARAM_TYPE_INT8: "<bxxx",
    mavlink.MAV_PARAM_TYPE_UINT16: "<Hxx",
    mavlink.MAV_PARAM_TYPE_INT16: "<hxx",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


@dataclass(frozen=True, slots=True)
class _Parameter:
    value: float
    kind: int  # MAV_PARAM_TYPE


async def read_parameters(vehicle: MavlinkVehicle, names: Collection[str]) -> dict[str, float]:
    """The values by name, without those that the vehicle does not have, or does not tell."""
    return {name: found.value for name, found in (await _read(vehicle, names)).items()}


async def set_parameter(vehicle: MavlinkVehicle, name: str, value: float) -> None:
    """Returns once the vehicle has it; AutopilotTimeout where it does not take it.

    It does not ask whose the vehicle is: only for parameters that leave the flight as it is.
    """
    before = (await _read(vehicle, [name])).get(name)
    if before is None:
        raise AutopilotTimeout("parameter", f"the vehicle does not know {name}", vehicle.said_lately)
    wire = _encoded(value, before.kind) if vehicle.firmware.sends_parameters_as_bytes else value
    for _ in range(_ATTEMPTS):
        vehicle.ask(
            lambda system, component: mavlink.MAVLink_param_set_message(
                system, component, name.encode(), wire, before.kind
            )
        )
        after = (await _read(vehicle, [name])).get(name)
        if after is not None and math.isclose(after.value, value, rel_tol=1e-6, abs_tol=1e-6):
            return
    raise AutopilotTimeout("parameter", f"{name} was not set to {value:g}", vehicle.said_lately)


async def _read(vehicle: MavlinkVehicle, names: Collection[str]) -> dict[str, _Parameter]:
    """Asks for all at once, and again for those that were not told."""
    found: dict[str, _Parameter] = {}

    def hear(message: Message) -> None:
        if message.get_type() == "PARAM_VALUE" and message.param_id in names:
            found[message.param_id] = _Parameter(_decoded(vehicle, message), message.param_type)

    with vehicle.listening(hear):
        for _ in range(_ATTEMPTS):
            for name in names:
                if name not in found:
                    vehicle.ask(partial(_question, name))
            all_told = partial(_are_told, names, found)
            if await vehicle.happens("parameters", all_told, within_s=vehicle.patience.answer_s):
                break
    return found


def _are_told(names: Collection[str], found: Mapping[str, _Parameter]) -> bool:
    return all(name in found for name in names)


def _question(name: str, system: int, component: int) -> Message:
    return mavlink.MAVLink_param_request_read_message(system, component, name.encode(), -1)


def _decoded(vehicle: MavlinkVehicle, message: Message) -> float:
    layout = _AS_BYTES.get(message.param_type)
    if layout is None or not vehicle.firmware.sends_parameters_as_bytes:
        return float(message.param_value)
    return float(struct.unpack(layout, struct.pack("<f", message.param_value))[0])


def _encoded(value: float, kind: int) -> float:
    layout = _AS_BYTES.get(kind)
    if layout is None:
        return value
    return float(struct.unpack("<f", struct.pack(layout, round(value)))[0])
