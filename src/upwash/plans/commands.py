"""The commands of mission items, as MAV_CMD numbers them: flown, left out with a notice, or refused with a remedy."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum


class Command(IntEnum):
    """The commands that are flown."""

    WAYPOINT = 16
    LOITER_TIME = 19
    RETURN = 20
    LAND = 21
    TAKEOFF = 22
    LOITER_TO_ALT = 31
    SPLINE_WAYPOINT = 82
    DELAY = 93
    CONDITION_DELAY = 112
    CHANGE_SPEED = 178


SET_HOME = 179
FENCE_ENABLE = 207

_PHOTOS = "left out: the mission takes its photos itself"
_AIM = "left out: the flight points no camera; a mission does with drone.payload"
_NOSE = "left out: the vehicle turns its nose as its own settings say"
_MARK = "left out: it marks a place in the plan, and commands nothing"

LEFT_OUT: Mapping[int, str] = {
    **dict.fromkeys((202, 203, 206, 214, 260, 530, 531, 532, 534, 2000, 2001, 2003, 2500, 2501), _PHOTOS),
    **dict.fromkeys((80, 195, 196, 197, 201, 204, 205, 1000, 1001), _AIM),
    115: _NOSE,
    **dict.fromkeys((189, 600), _MARK),
    114: "left out: a command that it delays takes effect at once",
}

_MOVES = (
    "moves something on the vehicle: remove it from the plan, and have the mission send it where that is safe "
    "(drone.payload)"
)
_REPEATS = "repeats a part of the plan: remove it, and plan the waypoints as often as they are flown"
_VTOL = "is for a VTOL: plan the flight for a multicopter, with Takeoff (22) and Land (21)"

_REFUSED: Mapping[int, str] = {
    17: "hovers until a person acts: remove it, and end the plan with Return To Launch or Land",
    18: "circles a place, where an obstacle may stand: remove it, and plan the circle as waypoints",
    **dict.fromkeys((84, 85, 3000), _VTOL),
    92: "hands the vehicle to another program: remove it",
    **dict.fromkeys((177, 601), _REPEATS),
    179: "moves the place of the return: remove it, and plan the flight from where the vehicle takes off",
    **dict.fromkeys((94, 181, 182, 183, 184, 208, 211, 216, 218, 42600), _MOVES),
    207: "switches the vehicle's own fence on: switch it on at the vehicle before the flight (FENCE_ENABLE 1 of an "
    "ArduPilot), and remove the item",
}


def why_refused(command: int) -> str:
    """What to do about a command that cannot be flown; goes on from the command's name."""
    return _REFUSED.get(
        command,
        "is not understood: remove it; a plan may have waypoints, a take-off, hold times, changes of the ground "
        "speed, and a return or a landing at its end",
    )


def command_name(command: int) -> str:
    """The MAVLink name of a command."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink  # only needed for refusals and notices

    entry = mavlink.enums["MAV_CMD"].get(command)
    return entry.name if entry else "an unknown command"
