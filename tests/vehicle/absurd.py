"""Bytes and messages that no sane peer would send."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

_FLOATS = math.nan, math.inf, -math.inf, 1e30, -1e30, 3.4e38, 0.0, -1.0
_FLIES_ANYWAY = (
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,
    mavlink.MAV_CMD_NAV_LAND,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM,
)
COMMANDS = (
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_DO_SET_MODE,
    mavlink.MAV_CMD_DO_CHANGE_SPEED,
    mavlink.MAV_CMD_DO_REPOSITION,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_REQUEST_MESSAGE,
    0,
    65_535,
)


def garbage(count_bytes: int, chance: random.Random) -> Iterator[bytes]:
    """So many bytes in pieces: random ones, some as if a message began, and messages that were cut short."""
    whole = bytes(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0).pack(_codec()))
    while count_bytes > 0:
        piece = chance.choice(
            (
                chance.randbytes(chance.randrange(1, 1_000)),
                b"\xfd" + chance.randbytes(chance.randrange(1, 300)),
                b"\xfe" + chance.randbytes(chance.randrange(1, 300)),
                whole[: chance.randrange(1, len(whole))],
                whole[:-3] + chance.randbytes(3),
            )
        )
        count_bytes -= len(piece)
        yield piece


def every_message(chance: random.Random) -> Iterator[Any]:
    """One of each kind that there is, with absurd values in all its fields."""
    for kind in mavlink.mavlink_map.values():
        sane = {} if kind is not mavlink.MAVLink_set_mode_message else {"custom_mode": 99}  # 0 is a mode
        yield message_of(kind, chance, **sane)


def message_of(kind: Any, chance: random.Random, **fields: Any) -> Any:
    """A message with the given fields, and absurd values in all others."""
    values = [
        fields.get(name, _absurd(type_name, length, chance))
        for name, type_name, length in zip(
            kind.fieldnames, kind.fieldtypes, _lengths_by_name(kind), strict=True
        )
    ]
    return kind(*values)


def absurd_orders(chance: random.Random) -> Iterator[Any]:
    """Commands, targets and parameters for system 1 that it knows, with values that it cannot mean."""
    for command in COMMANDS:
        for _ in range(20):
            for kind in mavlink.MAVLink_command_long_message, mavlink.MAVLink_command_int_message:
                yield message_of(kind, chance, target_system=1, target_component=1, command=command)
    for _ in range(200):
        yield message_of(
            mavlink.MAVLink_set_position_target_global_int_message,
            chance,
            target_system=1,
            target_component=1,
            type_mask=0b110111111000,
            coordinate_frame=chance.choice((0, 3, 5, 6, 99)),
        )
        yield message_of(
            mavlink.MAVLink_mission_item_message,
            chance,
            target_system=1,
            target_component=1,
            frame=3,
            command=16,
            current=2,
        )
        yield message_of(
            mavlink.MAVLink_param_set_message,
            chance,
            target_system=1,
            target_component=1,
            param_id=b"WPNAV_SPEED",
            param_value=chance.choice(_FLOATS[:6]),
        )


def orders_for_others() -> Iterator[Any]:
    """Sane orders to fly, for other systems and other components."""
    for system, component in ((2, 1), (255, 1), (1, 99)):
        for command in _FLIES_ANYWAY:
            yield mavlink.MAVLink_command_long_message(system, component, command, 0, *[0] * 7)
        yield mavlink.MAVLink_command_long_message(system, component, 400, 0, 0, 21196, *[0] * 5)
        yield mavlink.MAVLink_set_position_target_global_int_message(
            0, system, component, 6, 0b110111111000, 393_670_000, 229_510_000, 20, *[0] * 8
        )
        if system != 1:
            yield mavlink.MAVLink_set_mode_message(system, 1, mavlink.COPTER_MODE_RTL)


def _lengths_by_name(kind: Any) -> list[int]:
    by_name = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    return [by_name[name] for name in kind.fieldnames]


def _absurd(type_name: str, length: int, chance: random.Random) -> Any:
    if type_name == "char":
        return chance.randbytes(length or 1)
    if length:
        return [_absurd(type_name, 0, chance) for _ in range(length)]
    if type_name in ("float", "double"):
        return chance.choice(_FLOATS)
    bits = int("".join(filter(str.isdigit, type_name)))
    if type_name.startswith("u"):
        return chance.choice((0, 2**bits - 1, 2 ** (bits - 1)))
    return chance.choice((-(2 ** (bits - 1)), 2 ** (bits - 1) - 1, -1))


def _codec() -> Any:
    return mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
