"""A vehicle's parameters for its battery's stages, its way home with its end, and its legs.

Up to version 4.6, ArduCopter's parameters are in cm, cm/s, cm/s² and ms. Version 4.7.0 renamed most of them, and
counts in metres. PX4's parameters are in metres and in shares of a full battery.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import cache

from msgspec.structs import replace

from upwash.core.vehicle.course import Abilities
from upwash.core.vehicle.way_home import ARDUCOPTER, LONGEST_WAIT_S, PX4, EnergyFacts, WayHome
from upwash.eventlog.schema import VehicleSetting
from upwash.real.mavlink.parameters import QuantityValues, VehicleQuantity

_CENTI = 0.01
_SLOWEST_M_S, _WEAKEST_M_S2 = 0.01, 0.01
_LOWEST_M = 1_000.0  # below home
_USUAL_LOITER_S = 5.0
_SETTLES_S = ARDUCOPTER.hover_s - _USUAL_LOITER_S
_USUAL = Abilities()
_GAINED = ARDUCOPTER.acceleration_m_s2 / 2.5  # of WPNAV_ACCEL (2.5 by default), in recorded returns
_NO_STAGE = "the reserve does not count with this stage of the battery"


def _speed(
    what: str, names: Mapping[str, float], usual_m_s: float, *, least_m_s: float = _SLOWEST_M_S
) -> VehicleQuantity:
    return VehicleQuantity(what, names, "m/s", usual_m_s, least_m_s)


# --- ArduCopter ---------------------------------------------------------------------------------------------

_NAMES = "123456789ABCDEFG"  # of batteries, in the names of their parameters


@cache
def _battery(number: int) -> tuple[VehicleQuantity, VehicleQuantity, VehicleQuantity]:
    """The capacity, the low stage and the critical stage of a battery."""
    name = "BATT" if number == 1 else f"BATT{_NAMES[number - 1]}"
    capacity, low, critical = (
        VehicleQuantity("", {f"{name}_{stage}": 1.0}, "mAh", None, without=_NO_STAGE)
        for stage in ("CAPACITY", "LOW_MAH", "CRT_MAH")
    )
    return capacity, low, critical


_ALTITUDE = VehicleQuantity(
    "the altitude of returns", {"RTL_ALT": _CENTI, "RTL_ALT_M": 1.0}, "m", ARDUCOPTER.altitude_m
)
_RETURN = _speed(
    "the speed of returns (0: that of legs)", {"RTL_SPEED": _CENTI, "RTL_SPEED_MS": 1.0}, 0.0, least_m_s=0.0
)
_LEGS = _speed("the speed of legs", {"WPNAV_SPEED": _CENTI, "WP_SPD": 1.0}, ARDUCOPTER.speed_m_s)
_CLIMB = _speed("the speed of climbs", {"WPNAV_SPEED_UP": _CENTI, "WP_SPD_UP": 1.0}, ARDUCOPTER.climb_m_s)
_DESCENT = _speed(
    "the speed of descents", {"WPNAV_SPEED_DN": _CENTI, "WP_SPD_DN": 1.0}, ARDUCOPTER.descent_m_s
)
_ACCELERATION = VehicleQuantity(
    "the acceleration of legs",
    {"WPNAV_ACCEL": _CENTI * _GAINED, "WP_ACC": _GAINED},
    "m/s²",
    ARDUCOPTER.acceleration_m_s2,
    _WEAKEST_M_S2,
)
_LOITER = VehicleQuantity("the wait above home", {"RTL_LOIT_TIME": 1e-3}, "s", _USUAL_LOITER_S)
_FINAL = VehicleQuantity(
    "the altitude where returns end (0 or less: they land)",
    {"RTL_ALT_FINAL": _CENTI, "RTL_ALT_FINAL_M": 1.0},
    "m",
    0.0,
    -_LOWEST_M,
)
_HIGH_LANDING = _speed(
    "the speed of a landing's first part (0: that of descents)",
    {"LAND_SPEED_HIGH": _CENTI, "LAND_SPD_HIGH_MS": 1.0},
    0.0,
    least_m_s=0.0,
)
_SLOWLY_BELOW = VehicleQuantity(
    "the height of a landing's last part",
    {"LAND_ALT_LOW": _CENTI, "LAND_ALT_LOW_M": 1.0},
    "m",
    ARDUCOPTER.slowly_below_m,
)
_LANDING = _speed(
    "the speed of a landing's last part", {"LAND_SPEED": _CENTI, "LAND_SPD_MS": 1.0}, ARDUCOPTER.landing_m_s
)
ARDUCOPTER_QUANTITIES = (
    *_battery(1), _ALTITUDE, _RETURN, _LEGS, _CLIMB, _DESCENT, _ACCELERATION, _LOITER, _FINAL, _HIGH_LANDING,
    _SLOWLY_BELOW, _LANDING,
)  # fmt: skip


def arducopter_quantities(batteries: Iterable[int]) -> tuple[VehicleQuantity, ...]:
    """What to ask an ArduCopter with these batteries."""
    others = (quantity for number in _others(batteries) for quantity in _battery(number))
    return *ARDUCOPTER_QUANTITIES, *others


def arducopter_energy(values: QuantityValues, batteries: Iterable[int] = ()) -> EnergyFacts:
    """An ArduCopter's battery stages in percent of the capacities, and its way home."""
    capacity, low, critical = _battery(1)
    return EnergyFacts(
        low_percent=_stage_percent(values, low, capacity),
        low_percents={
            number: _stage_percent(values, low, capacity)
            for number in _others(batteries)
            for capacity, low, _ in [_battery(number)]
        },
        critical_percent=_stage_percent(values, critical, capacity),
        way_home=WayHome(
            altitude_m=values[_ALTITUDE],
            climb_m_s=values[_CLIMB],
            speed_m_s=values[_RETURN] or values[_LEGS],
            acceleration_m_s2=values[_ACCELERATION],
            hover_s=values[_LOITER] + _SETTLES_S,
            descent_m_s=values[_HIGH_LANDING] or values[_DESCENT],
            slowly_below_m=values[_SLOWLY_BELOW],
            landing_m_s=values[_LANDING],
            low_m=max(0.0, values[_FINAL]),
            waits_s=math.inf if values[_FINAL] > 0 else 0.0,
        ),
        guessed=values.guessed,
    )


def arducopter_ends(values: QuantityValues) -> Iterator[VehicleSetting]:
    """What a person should know of the end of an ArduCopter's returns."""
    if values[_FINAL] > 0:
        yield _hover(
            values, _FINAL, f"a return does not land: it hovers {values[_FINAL]:g} m above its end", "0"
        )
    if values[_LOITER] > LONGEST_WAIT_S:
        yield _long_wait(values, _LOITER, LONGEST_WAIT_S * 1e3)


def _hover(values: QuantityValues, quantity: VehicleQuantity, what: str, remedy: str) -> VehicleSetting:
    name, value = values.told[quantity]
    advice = (
        f"{what}; this program lands a mission's return there, and nobody lands the return of a fail-safe or of the "
        f"pilot; set it to {remedy} to have returns land"
    )
    return VehicleSetting(name=name, value=value, advice=advice)


def _long_wait(values: QuantityValues, quantity: VehicleQuantity, most: float) -> VehicleSetting:
    name, value = values.told[quantity]
    advice = (
        f"a return hovers for {values[quantity]:g} s above its end before it lands; this program lands the vehicle "
        f"after {LONGEST_WAIT_S:g} s there; set it to {most:g} at most"
    )
    return VehicleSetting(name=name, value=value, advice=advice)


def _others(batteries: Iterable[int]) -> list[int]:
    return [number for number in batteries if 1 < number <= len(_NAMES)]


def _stage_percent(values: QuantityValues, stage: VehicleQuantity, capacity: VehicleQuantity) -> float | None:
    """The stage in percent, from its parameter in mAh; None if it is 0 or unknown."""
    left_mah, capacity_mah = values.known(stage), values.known(capacity)
    return 100 * left_mah / capacity_mah if left_mah and capacity_mah else None


# --- PX4 ----------------------------------------------------------------------------------------------------

_LOW_SHARE = VehicleQuantity("", {"BAT_LOW_THR": 100.0}, "%", None, without=_NO_STAGE)
_CRITICAL_SHARE = VehicleQuantity("", {"BAT_CRIT_THR": 100.0}, "%", None, without=_NO_STAGE)
_PX4_ALTITUDE = VehicleQuantity("the altitude of returns", {"RTL_RETURN_ALT": 1.0}, "m", PX4.altitude_m)
_DELAY = VehicleQuantity(
    "the wait of returns before they land (below 0: they do not land)",
    {"RTL_LAND_DELAY": 1.0},
    "s",
    0.0,
    -3_600.0,
)
_WAITS_AT = VehicleQuantity("the altitude of that wait", {"RTL_DESCEND_ALT": 1.0}, "m", 30.0)
_CRUISE = _speed("the speed of returns", {"MPC_XY_CRUISE": 1.0}, PX4.speed_m_s)
_FASTEST = _speed("the highest speed of legs", {"MPC_XY_VEL_MAX": 1.0}, _USUAL.ground_speed_m_s)
_PX4_CLIMB = _speed("the speed of climbs", {"MPC_Z_V_AUTO_UP": 1.0}, _USUAL.climb_m_s)
_PX4_DESCENT = _speed("the speed of descents", {"MPC_Z_V_AUTO_DN": 1.0}, PX4.descent_m_s)
_PX4_ACCELERATION = VehicleQuantity(
    "the acceleration of legs", {"MPC_ACC_HOR": 1.0}, "m/s²", _USUAL.acceleration_m_s2, _WEAKEST_M_S2
)
PX4_QUANTITIES = (
    _LOW_SHARE, _CRITICAL_SHARE, _PX4_ALTITUDE, _DELAY, _WAITS_AT, _CRUISE, _FASTEST, _PX4_CLIMB, _PX4_DESCENT,
    _PX4_ACCELERATION,
)  # fmt: skip


def px4_energy(values: QuantityValues) -> EnergyFacts:
    """A PX4's battery stages in percent, and its way home."""
    return EnergyFacts(
        low_percent=values.known(_LOW_SHARE) or None,  # 0 stands for none
        critical_percent=values.known(_CRITICAL_SHARE) or None,
        way_home=replace(
            PX4,
            altitude_m=values[_PX4_ALTITUDE],
            speed_m_s=values[_CRUISE],
            descent_m_s=values[_PX4_DESCENT],
            low_m=min(values[_WAITS_AT], values[_PX4_ALTITUDE]) if values[_DELAY] else 0.0,
            waits_s=math.inf if values[_DELAY] < 0 else values[_DELAY],
        ),
        guessed=values.guessed,
    )


def px4_ends(values: QuantityValues) -> Iterator[VehicleSetting]:
    """What a person should know of the end of a PX4's returns."""
    if values[_DELAY] < 0:
        what = f"a return does not land: it hovers {values[_WAITS_AT]:g} m above its end (RTL_DESCEND_ALT)"
        yield _hover(values, _DELAY, what, "0")
    elif values[_DELAY] > LONGEST_WAIT_S:
        yield _long_wait(values, _DELAY, LONGEST_WAIT_S)


def px4_abilities(values: QuantityValues) -> Abilities:
    """The greatest speeds and acceleration of a PX4."""
    return Abilities(values[_FASTEST], values[_PX4_CLIMB], values[_PX4_DESCENT], values[_PX4_ACCELERATION])
