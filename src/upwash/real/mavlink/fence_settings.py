"""What each autopilot's parameters and its list of areas say of its fence.

Sources: ArduPilot's AC_Fence.cpp and AC_PolyFence_loader.cpp, ModeRTL::compute_return_target; PX4's geofence.cpp and
failsafe.cpp.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from upwash.core.geo import LocalFrame
from upwash.core.vehicle.geofence import Fence
from upwash.errors import AutopilotRefused
from upwash.ports import FenceNames, VehicleLimits, VehicleSetting
from upwash.real.mavlink.fence import circle_around, download_fence
from upwash.real.mavlink.vehicle import MavlinkVehicle

ARDUCOPTER_FENCE = (
    "FENCE_ENABLE", "FENCE_AUTOENABLE", "FENCE_TYPE", "FENCE_OPTIONS",
    "FENCE_RADIUS", "FENCE_ALT_MAX", "FENCE_ALT_MIN", "FENCE_MARGIN",
)  # fmt: skip
PX4_FENCE = ("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", "GF_PREDICT")
_CEILING, _CIRCLE, _AREAS, _FLOOR = 1, 2, 4, 8  # of FENCE_TYPE
_NEEDED = {_CEILING: "FENCE_ALT_MAX", _CIRCLE: "FENCE_RADIUS", _FLOOR: "FENCE_ALT_MIN"}
_JOINS = 2  # of FENCE_OPTIONS
_HOLDS, _TERMINATES = 2, 4  # of GF_ACTION
_DRIFTS_M = 1.0  # of a PX4 in height, as recorded ones did
_HOVERS = 5.0  # of COM_OBL_RC_ACT


async def arducopter_limits(
    vehicle: MavlinkVehicle, frame: LocalFrame, limits: VehicleLimits, told: Mapping[str, float]
) -> VehicleLimits:
    """An ArduCopter's, whose way home is kept below its ceiling by its margin.

    FENCE_AUTOENABLE switches the fence on at arming (3) or at the end of the take-off (1, 2), with FENCE_ENABLE
    0 too. Targets up to the border are accepted; the margin keeps none out.
    """
    if not (told.get("FENCE_ENABLE") or told.get("FENCE_AUTOENABLE")):
        return replace(limits, untold=_untold(told, "FENCE_ENABLE"))
    kinds, margin_m = int(told.get("FENCE_TYPE", 0)), told.get("FENCE_MARGIN", 0.0)
    needed = [name for kind, name in _NEEDED.items() if kinds & kind]
    highest_m = told.get("FENCE_ALT_MAX") if kinds & _CEILING else None
    fences: list[Fence] = []
    if kinds & _CIRCLE:
        fences += circle_around(limits.home, told.get("FENCE_RADIUS", 0.0))
    if kinds & _AREAS:
        joins = bool(int(told.get("FENCE_OPTIONS", 0)) & _JOINS)
        fences += await download_fence(vehicle, frame, joins=joins)
    return replace(
        limits,
        fences=fences,
        highest_m=highest_m,
        lowest_m=told.get("FENCE_ALT_MIN") if kinds & _FLOOR else None,
        margin_m=margin_m,
        returns_at_m=limits.returns_at_m
        if highest_m is None
        else min(limits.returns_at_m, highest_m - margin_m),
        names=FenceNames("FENCE_ALT_MAX", "FENCE_ALT_MIN", "FENCE_MARGIN", "RTL_ALT"),
        untold=_untold(told, "FENCE_TYPE", *needed) + _homeless(limits, kinds & _CIRCLE),
    )


async def px4_limits(
    vehicle: MavlinkVehicle, frame: LocalFrame, limits: VehicleLimits, told: Mapping[str, float]
) -> VehicleLimits:
    """A PX4's, which has to be in each of its areas to stay in; AutopilotRefused where it falls at a border."""
    action, farthest_m = told.get("GF_ACTION"), told.get("GF_MAX_HOR_DIST", 0.0)
    if not action:
        return replace(limits, untold=_untold(told, "GF_ACTION"))
    fences: list[Fence] = circle_around(limits.home, farthest_m)
    fences += await download_fence(vehicle, frame)
    highest_m = told.get("GF_MAX_VER_DIST") or None
    if fences or highest_m is not None:
        _check_action(vehicle, action, told)
    return replace(
        limits,
        fences=fences,
        highest_m=highest_m,
        margin_m=_DRIFTS_M,
        names=FenceNames(highest="GF_MAX_VER_DIST", margin="the drift of a PX4", returns_at="RTL_RETURN_ALT"),
        untold=_untold(told, "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST") + _homeless(limits, farthest_m),
    )


def _check_action(vehicle: MavlinkVehicle, action: float, told: Mapping[str, float]) -> None:
    """Tells what happens at the border, where a user may expect another thing; AutopilotRefused where it falls."""
    if action == _TERMINATES:
        raise AutopilotRefused(
            "arm",
            f"GF_ACTION is {action:g} (terminate): the vehicle stops its motors and falls when it leaves its fence; "
            "set it to 3 (return) or 5 (land), or remove the fence; nothing was sent",
        )
    if action == _HOLDS and told.get("COM_OBL_RC_ACT") != _HOVERS:
        advice = (
            "at its fence the vehicle holds for COM_OF_LOSS_T, as the program stops sending, and then does what "
            "COM_OBL_RC_ACT says; with a GF_ACTION of 3 it returns"
        )
        vehicle.tell(VehicleSetting("GF_ACTION", action, advice))
    if predicts := told.get("GF_PREDICT"):
        advice = (
            "it acts before the border is reached, which PX4 calls experimental and a cause of fly-aways; "
            "set it to 0"
        )
        vehicle.tell(VehicleSetting("GF_PREDICT", predicts, advice))


def _untold(told: Mapping[str, float], *names: str) -> tuple[str, ...]:
    return tuple(name for name in names if name not in told)


def _homeless(limits: VehicleLimits, radius: float) -> tuple[str, ...]:
    """Its home, where a fence around it counts and it is not known."""
    return ("its home",) if radius and limits.home is None else ()
