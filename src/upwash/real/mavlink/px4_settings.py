"""PX4's parameters that decide what happens without the program, and what a person should know of them."""

from __future__ import annotations

from upwash.errors import AutopilotRefused
from upwash.ports import VehicleSetting
from upwash.real.mavlink.quantities import Quantity, read_quantities
from upwash.real.mavlink.vehicle import MavlinkVehicle

_LOST = Quantity(
    "",
    {"COM_OBL_RC_ACT": 1.0},
    "",
    None,
    without="what the vehicle does when the program or its link is lost is not known: it may fall",
)
_NOTICES_AFTER = Quantity(
    "",
    {"COM_OF_LOSS_T": 1.0},
    "s",
    None,
    without="how soon the vehicle notices that the program or its link is lost is not known",
)
_OVERRIDE = Quantity(
    "",
    {"COM_RC_OVERRIDE": 1.0},
    "",
    None,
    without="whether sticks take the vehicle from the program is not known",
)
_DELAY = Quantity("the time before a fail-safe acts", {"COM_FAIL_ACT_T": 1.0}, "s", 5.0)
_FALLS = {6.0: "terminate", 7.0: "disarm"}
_GOES_ON = (3.0, 5.0)
_STICKS_IN_OFFBOARD = 2
_LONG_S = 10.0


async def check_settings(vehicle: MavlinkVehicle) -> None:
    """Tells what the vehicle does without the program, and refuses to fly where it falls then."""
    told = await read_quantities(vehicle, (_LOST, _NOTICES_AFTER, _OVERRIDE))
    lost, after_s, override = told.known(_LOST), told.known(_NOTICES_AFTER), told.known(_OVERRIDE)
    if lost in _FALLS:
        raise AutopilotRefused(
            "arm",
            f"COM_OBL_RC_ACT is {lost:g} ({_FALLS[lost]}): the vehicle falls when the program or its link is "
            "lost; set it to 3 (return) or 5 (hover); nothing was sent",
        )
    if lost is not None and lost not in _GOES_ON:
        what = "comes down where it is, unless a pilot has it by stick" if lost in (0, 1, 2) else "lands"
        advice = f"without the program the vehicle {what}; 3 has it return, 5 hover"
        vehicle.tell(VehicleSetting("COM_OBL_RC_ACT", lost, advice))
    if after_s is not None and after_s > _LONG_S:
        vehicle.tell(
            VehicleSetting(
                "COM_OF_LOSS_T", after_s, "the vehicle notices the loss only after that many seconds"
            )
        )
    if override is not None and not int(override) & _STICKS_IN_OFFBOARD:
        advice = (
            "sticks do not take the vehicle from the program, a mode switch does; 3 has sticks do it, too"
        )
        vehicle.tell(VehicleSetting("COM_RC_OVERRIDE", override, advice))


async def failsafe_delay_s(vehicle: MavlinkVehicle) -> float:
    """For how long the vehicle hovers before a fail-safe acts."""
    return (await read_quantities(vehicle, (_DELAY,)))[_DELAY]
