"""How a stand-in PX4 is steered by others: by a pilot's sticks, and by setpoints in OFFBOARD."""

from __future__ import annotations

import math

from upwash.core.geo import Position, Velocity
from upwash.mavlink.px4 import Mode
from upwash.vehicle.body.parameters import ParameterTable
from upwash.vehicle.px4.body import BLIND_SINKING_M_S, Steering
from upwash.vehicle.px4.inputs import DEADZONE, THROTTLE_MIDDLE, Px4Inputs, Setpoint, Sticks, past_deadzone

MANUAL = (Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.ACRO, Mode.STABILIZED)
_SLOWEST_M_S, _FASTEST_M_S = 0.1, 30.0


def following(setpoint: Setpoint, parameters: ParameterTable) -> Steering:
    """By what a companion streams in OFFBOARD."""
    cap_m_s = within_limits(parameters["MPC_XY_VEL_MAX"], parameters)
    climb_m_s, sink_m_s = parameters["MPC_Z_VEL_MAX_UP"], parameters["MPC_Z_VEL_MAX_DN"]
    velocity = setpoint.velocity
    if velocity is not None:
        fast = max(1.0, math.hypot(velocity.east_m_s, velocity.north_m_s) / cap_m_s)
        up_m_s = max(-sink_m_s, min(climb_m_s, velocity.up_m_s))
        velocity = Velocity(velocity.east_m_s / fast, velocity.north_m_s / fast, up_m_s)
    place = None
    if setpoint.east_north_m is not None:
        place = Position(*setpoint.east_north_m, setpoint.altitude_m or 0.0)
    return Steering(
        place=place,
        cap_m_s=cap_m_s,
        stiffly=True,
        velocity=velocity if velocity is not None or place is not None else Velocity(),
        altitude_m=setpoint.altitude_m,
        climb_m_s=climb_m_s,
        sink_m_s=sink_m_s,
        turns_to_deg=setpoint.yaw_deg,
    )


def by_stick(
    heard: Px4Inputs, parameters: ParameterTable, now_s: float, *, mode: Mode, heading_deg: float
) -> Steering:
    """By the pilot's sticks; without them it brakes and sinks to the ground."""
    if not heard.hears_sticks(now_s):
        return Steering(velocity=Velocity(), eases=True, altitude_m=-math.inf, sink_m_s=BLIND_SINKING_M_S)
    sticks, most_m_s = heard.sticks, within_limits(parameters["MPC_VEL_MANUAL"], parameters)
    climb_m_s = _climb_by_stick_m_s(sticks, parameters)
    if mode is not Mode.POSCTL and not sticks.moved(DEADZONE):
        return Steering(level=True, velocity=Velocity(up_m_s=climb_m_s))
    heading = math.radians(heading_deg)
    forward, right = past_deadzone(sticks.forward) * most_m_s, past_deadzone(sticks.right) * most_m_s
    turn_deg = past_deadzone(sticks.turn) * 90
    return Steering(
        velocity=Velocity(
            forward * math.sin(heading) + right * math.cos(heading),
            forward * math.cos(heading) - right * math.sin(heading),
            climb_m_s,
        ),
        eases=True,
        turns_to_deg=heading_deg + turn_deg if turn_deg else None,
    )


def within_limits(speed_m_s: float, parameters: ParameterTable) -> float:
    """The speed over the ground, no higher than the vehicle flies at all."""
    return min(max(speed_m_s, _SLOWEST_M_S), max(parameters["MPC_XY_VEL_MAX"], _SLOWEST_M_S), _FASTEST_M_S)


def _climb_by_stick_m_s(sticks: Sticks, parameters: ParameterTable) -> float:
    share = past_deadzone((sticks.throttle - THROTTLE_MIDDLE) / THROTTLE_MIDDLE)
    most = parameters["MPC_Z_VEL_MAX_UP" if share > 0 else "MPC_Z_VEL_MAX_DN"]
    return share * most
