"""The charges of a vehicle's batteries, from SYS_STATUS and BATTERY_STATUS.

SYS_STATUS has one charge: an ArduPilot's that of its first battery, a PX4's the lowest. BATTERY_STATUS has one
battery a message. A charge of -1 is not known. That is no news while another message knows the charge; but a charge
that nothing confirms for 20 s is not known any more.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import Message

_BELIEVED_S = 20.0  # ArduPilot reports up to nine batteries in turn, on a narrow link one in two seconds
_ROUNDED_PERCENT = 2.0  # the two messages round differently, and come at different times


class Batteries:
    """The batteries that the vehicle flies with, by number from 1 on, as in the names of the autopilot's parameters.

    A battery for the payload alone is none of them.
    """

    def __init__(self) -> None:
        self._numbers: list[int] = []
        self._known: dict[int, tuple[float, float]] = {}  # when each charge was last known, and the charge
        self._heard_s = -math.inf  # any message

    def take(self, message: Message, now_s: float) -> None:
        """Take in a message of the vehicle."""
        self._heard_s = now_s
        match message.get_type():
            case "SYS_STATUS":
                self._take(0, message.battery_remaining)
            case "BATTERY_STATUS" if message.battery_function != mavlink.MAV_BATTERY_FUNCTION_PAYLOAD:
                number = message.id + 1
                if number not in self._numbers:
                    self._numbers = sorted([*self._numbers, number])
                self._take(number, message.battery_remaining)

    @property
    def charges_percent(self) -> dict[int, float | None]:
        """The charge of each battery in percent; None while it is not known."""
        fresh = {
            number: percent
            for number, (known_s, percent) in self._known.items()
            if self._heard_s - known_s <= _BELIEVED_S
        }
        only_in_sys_status = fresh.pop(0, math.inf)
        charges: dict[int, float | None] = {number: fresh.get(number) for number in self._numbers}
        if only_in_sys_status < min(fresh.values(), default=math.inf) - _ROUNDED_PERCENT:
            charges[1] = only_in_sys_status
        return charges

    def _take(self, number: int, percent: int) -> None:
        if 0 <= percent <= 100:
            self._known[number] = self._heard_s, float(percent)
