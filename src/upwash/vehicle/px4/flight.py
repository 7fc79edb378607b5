"""How a stand-in PX4 goes on for a step: what steers it in each mode, on the ground and in the air."""

from __future__ import annotations

import math
from collections import deque

from upwash.core.geo import Position
from upwash.mavlink.px4 import Mode
from upwash.vehicle.body.parameters import ParameterTable
from upwash.vehicle.px4.airframe import FOLLOWING_LAG_S
from upwash.vehicle.px4.body import BLIND_SINKING_M_S, STEP_S, Body, Steering
from upwash.vehicle.px4.ground import Ground
from upwash.vehicle.px4.inputs import Px4Inputs, Setpoint
from upwash.vehicle.px4.navigator import LEAST_LIFT_M, Navigator
from upwash.vehicle.px4.steering import MANUAL, by_stick, following

_GRAVITY_M_S2 = 9.8
_THROTTLE_UP = 700


class Px4Flight:
    """The body between the ground, its navigator, a companion's setpoints and a pilot's sticks."""

    def __init__(
        self, parameters: ParameterTable, heard: Px4Inputs, body: Body, ground: Ground, navigator: Navigator
    ) -> None:
        self._parameters = parameters
        self._heard = heard
        self._body = body
        self._ground = ground
        self._navigator = navigator
        self._setpoint = Setpoint()
        self._setpoints: deque[tuple[float, Setpoint]] = deque()  # on their way, and when they arrive

    def follow(self, now_s: float, setpoint: Setpoint) -> None:
        """Takes a setpoint for OFFBOARD."""
        self._setpoints.append((now_s + FOLLOWING_LAG_S, setpoint))

    def receive(self, now_s: float) -> None:
        """Takes up the setpoints that have arrived."""
        while self._setpoints and self._setpoints[0][0] <= now_s:
            _, self._setpoint = self._setpoints.popleft()

    def target(self, mode: Mode) -> Position | None:
        """Where it flies to in that mode, if anywhere."""
        if mode is not Mode.OFFBOARD:
            return self._navigator.target
        if self._setpoint.east_north_m is None or self._setpoint.altitude_m is None:
            return None
        return Position(*self._setpoint.east_north_m, self._setpoint.altitude_m)

    def take_off_to(self, altitude_m: float, now_s: float) -> None:
        """Spools up for that altitude, if it makes sense."""
        if self._navigator.take_off_to(altitude_m, grounded=self._ground.grounded):
            self._ground.lift(now_s)

    def ends_takeoff(self, mode: Mode) -> bool:
        """Whether its take-off has come to its altitude, which it holds from then on."""
        flies = not self._ground.grounded and not self._ground.falls
        return mode is Mode.TAKEOFF and flies and self._navigator.ends_climb()

    def step(self, now_s: float, mode: Mode, *, armed: bool, blindly: bool) -> None:
        """Goes on for `STEP_S`; blindly it only sinks."""
        body = self._body
        if self._ground.falls:
            body.up_m_s -= _GRAVITY_M_S2 * STEP_S
            body.altitude_m += body.up_m_s * STEP_S
        elif not armed:
            body.rest()
        elif self._ground.grounded:
            body.rest()
            self._spool_up(now_s, mode)
        elif blindly:
            body.step(Steering(level=True, altitude_m=-math.inf, sink_m_s=BLIND_SINKING_M_S))
        else:
            body.step(self._steering(now_s, mode))
        if body.altitude_m <= 0 and body.up_m_s <= 0:
            body.altitude_m = 0.0
            body.rest()

    def _spool_up(self, now_s: float, mode: Mode) -> None:
        sticks = self._heard.sticks if self._heard.hears_sticks(now_s) else None
        if mode is Mode.OFFBOARD and (self._setpoint.altitude_m or 0.0) > LEAST_LIFT_M:
            self._ground.lift(now_s)
        if mode in MANUAL and sticks is not None and sticks.throttle > _THROTTLE_UP:
            self._ground.lift(now_s)
        if self._ground.spool_up(now_s):
            self._navigator.lifted()

    def _steering(self, now_s: float, mode: Mode) -> Steering:
        match mode:
            case Mode.TAKEOFF:
                return self._navigator.climbing(now_s)
            case Mode.OFFBOARD:
                return following(self._setpoint, self._parameters)
            case Mode.RTL:
                return self._navigator.on_the_way_home(now_s)
            case Mode.LAND:
                return self._navigator.landing(now_s)
            case Mode.LOITER:
                return self._navigator.holding(now_s)
        heading_deg = self._body.heading_deg
        return by_stick(self._heard, self._parameters, now_s, mode=mode, heading_deg=heading_deg)
