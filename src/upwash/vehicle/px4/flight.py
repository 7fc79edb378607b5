"""How a stand-in PX4 goes on for a step: what steers it in each mode, on the ground and in the air."""

from __future__ import annotations

import math
from collections import deque

from upwash.core.geo import Position, Velocity
from upwash.mavlink.px4 import EventMessage, Mode, px4_events
from upwash.vehicle.body.copter import GRAVITY_M_S2, Multicopter
from upwash.vehicle.body.parameters import ParameterTable
from upwash.vehicle.px4.airframe import BELIEVES_GROUND_S, FOLLOWING_LAG_S, spool_up_s
from upwash.vehicle.px4.body import BLIND_SINKING_M_S, STEP_S, Body, Steering
from upwash.vehicle.px4.inputs import THROTTLE_MIDDLE, InputSource, Px4Inputs, Setpoint, past_deadzone
from upwash.vehicle.px4.navigator import LEAST_LIFT_M, Navigator, within_limits
from upwash.vehicle.px4.settings import Px4Settings

MANUAL = (Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.ACRO, Mode.STABILIZED)
DISARMED_BY_COMMAND, _DISARMED_BY_LANDING, _DISARMED_BEFORE_FLIGHT = 4, 6, 7
_DISARMS_LATE_S = 1.0  # after COM_DISARM_PRFLT
_TAKEOFF_SEEN_S, _TAKEOFF_SHOWN_S = 1.0, 1.2  # after the command, long before it lifts
_TOUCHING_M = 0.02
_THROTTLE_UP = 700
_FIRST_EVENT = 65_526  # so that the count soon restarts at 0


class Px4Flight(Multicopter):
    """The body between the ground, its navigator, a companion's setpoints and a pilot's sticks."""

    settings: Px4Settings
    at_most_percent_in_fault, empty_v, full_v = 6.0, 14.4, 16.2

    def __init__(self, settings: Px4Settings, *, now_s: float) -> None:
        super().__init__(settings, ParameterTable("px4", int_bytes=True), now_s=now_s)
        self.mode = Mode.LOITER
        self._unsaid: list[EventMessage] = []
        self._event = _FIRST_EVENT
        self.inputs = Px4Inputs(self.parameters)
        self._time_s = now_s
        self._body = Body()
        self._navigator = Navigator(
            self.parameters,
            self._body,
            self.happened,
            home_altitude_m=settings.home_altitude_m,
            now_s=now_s,
            rally=self.rally,
        )
        self._setpoint = Setpoint()
        self._setpoints: deque[tuple[float, Setpoint]] = deque()  # on their way, and when they arrive
        self._armed_s: float | None = None
        self._grounded = True
        self._falls = False  # without its motors
        self._flew = False  # since it was armed
        self._lifting_s: float | None = None  # since when it spools up
        self._touched_s: float | None = None
        self._disarms_s: float | None = None

    @property
    def armed(self) -> bool:
        """Whether its motors run."""
        return self._armed_s is not None

    def happened(self, name: str, *arguments: float, log_levels: int | None = None) -> None:
        """Tells everyone of an event, by its name in PX4."""
        number, kind = next((number, kind) for number, kind in px4_events().items() if kind.name == name)
        event = EventMessage(
            id_of_event=number,
            event_time_boot_ms=round(self.uptime_s(self._time_s) * 1e3) % 2**32,
            sequence=self._event,
            destination_component=0,
            destination_system=0,
            log_levels=kind.log_levels if log_levels is None else log_levels,
            arguments=kind.packed(*arguments),
        )
        self._event = (self._event + 1) % 2**16
        self._unsaid.append(event)

    def said(self) -> list[EventMessage]:
        """The events since the last call; each is returned once."""
        unsaid, self._unsaid = self._unsaid, []
        return unsaid

    # --- on the ground --------------------------------------------------------------------------------------

    def _start_motors(self, now_s: float) -> None:
        self.start_draining(now_s)
        self._armed_s = now_s
        self._flew, self._disarms_s, self._lifting_s = False, None, None

    def _stop_motors(self) -> None:
        self.stop_draining(self._time_s)
        self._armed_s = self._disarms_s = self._lifting_s = None

    def _lift(self) -> None:
        """Begins to spool up, if it stands."""
        if self._grounded and self._lifting_s is None:
            self._lifting_s, self._disarms_s = self._time_s, None

    def _take_off_to(self, altitude_m: float) -> None:
        """Begins a take-off to the altitude, if it is above the vehicle and within reach."""
        if self._navigator.take_off_to(altitude_m, grounded=self._grounded):
            self._lift()

    def _shows_takeoff(self, now_s: float) -> bool:
        """Whether it reports a take-off, still on the ground."""
        return self._lifting_s is not None and now_s >= self._lifting_s + _TAKEOFF_SHOWN_S

    def _spool_up(self, mode: Mode) -> None:
        throttle = self.inputs.sticks.throttle if self.inputs.hears(InputSource.STICKS, self._time_s) else 0.0
        lifts_by_setpoint = mode is Mode.OFFBOARD and (self._setpoint.altitude_m or 0.0) > LEAST_LIFT_M
        if lifts_by_setpoint or (mode in MANUAL and throttle > _THROTTLE_UP):
            self._lift()
        if self._lifting_s is None:
            return
        since_s = self._time_s - self._lifting_s
        if since_s - STEP_S < _TAKEOFF_SEEN_S <= since_s:
            self.happened("commander_takeoff_detected")
        if since_s >= spool_up_s:
            self._grounded, self._flew, self._lifting_s = False, True, None
            self._navigator.lifted()

    def _why_disarm(self) -> int | None:
        """Why its motors stop on the ground now, by PX4's numbers; None while they run on."""
        if self._armed_s is None or not self._grounded:
            return None
        if self._disarms_s is not None and self._time_s >= self._disarms_s:
            return _DISARMED_BY_LANDING
        before_flight_s = self.parameters["COM_DISARM_PRFLT"]
        waits = not self._flew and self._lifting_s is None and before_flight_s > 0
        late = self._time_s >= self._armed_s + before_flight_s + _DISARMS_LATE_S
        return _DISARMED_BEFORE_FLIGHT if waits and late else None

    def _look_for_ground(self) -> None:
        """Notes a touch of the ground; after a while the vehicle counts as landed."""
        touches = not self._grounded and self._body.altitude_m <= _TOUCHING_M and self._body.up_m_s <= 0
        if not touches:
            self._touched_s = None
            return
        if self._touched_s is None:
            self._touched_s = self._time_s
        if self._falls or self._time_s >= self._touched_s + BELIEVES_GROUND_S:
            self._grounded, self._falls, self._touched_s = True, False, None
            self.happened("commander_landing_detected")
            delay_s = self.parameters["COM_DISARM_LAND"]
            self._disarms_s = self._time_s + delay_s if self.armed and delay_s > 0 else None

    # --- in the air -----------------------------------------------------------------------------------------

    def _target_in(self, mode: Mode) -> Position | None:
        if mode is not Mode.OFFBOARD:
            return self._navigator.target
        if self._setpoint.east_north_m is None or self._setpoint.altitude_m is None:
            return None
        return Position(*self._setpoint.east_north_m, self._setpoint.altitude_m)

    def _take_setpoint(self, now_s: float, setpoint: Setpoint) -> None:
        self._setpoints.append((now_s + FOLLOWING_LAG_S, setpoint))
        self.inputs.take(InputSource.SETPOINTS, now_s)

    def _receive_setpoints(self) -> None:
        while self._setpoints and self._setpoints[0][0] <= self._time_s:
            _, self._setpoint = self._setpoints.popleft()

    def _ends_takeoff(self, mode: Mode) -> bool:
        """Whether its take-off has reached its altitude, which it holds from then on."""
        flies = self.armed and not self._grounded and not self._falls
        return mode is Mode.TAKEOFF and flies and self._navigator.ends_climb()

    def _step(self, mode: Mode, *, blindly: bool) -> None:
        """Moves the vehicle by one step of `STEP_S`; `blindly`, without a position, it only sinks."""
        body = self._body
        if self._falls:
            body.up_m_s -= GRAVITY_M_S2 * STEP_S
            body.altitude_m += body.up_m_s * STEP_S
        elif not self.armed or self._grounded:
            body.rest()
            if self.armed:
                self._spool_up(mode)
        elif blindly:
            body.step(Steering(level=True, altitude_m=-math.inf, sink_m_s=BLIND_SINKING_M_S))
        else:
            body.step(self._steering(mode))
        if body.altitude_m <= 0 and body.up_m_s <= 0:
            body.altitude_m = 0.0
            body.rest()

    def _steering(self, mode: Mode) -> Steering:
        match mode:
            case Mode.TAKEOFF:
                return self._navigator.climbing(self._time_s)
            case Mode.OFFBOARD:
                return self._by_setpoint(self._setpoint)
            case Mode.RTL:
                return self._navigator.on_the_way_home(self._time_s)
            case Mode.LAND:
                return self._navigator.landing(self._time_s)
            case Mode.LOITER:
                return self._navigator.holding(self._time_s)
        return self._by_sticks(mode)

    def _by_setpoint(self, setpoint: Setpoint) -> Steering:
        """Steering by the setpoints of a companion in OFFBOARD."""
        cap_m_s = within_limits(self.parameters["MPC_XY_VEL_MAX"], self.parameters)
        climb_m_s, sink_m_s = self.parameters["MPC_Z_VEL_MAX_UP"], self.parameters["MPC_Z_VEL_MAX_DN"]
        velocity, place = setpoint.velocity, None
        if velocity is not None:
            fast = max(1.0, velocity.ground_m_s / cap_m_s)
            up_m_s = max(-sink_m_s, min(climb_m_s, velocity.up_m_s))
            velocity = Velocity(velocity.east_m_s / fast, velocity.north_m_s / fast, up_m_s)
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

    def _by_sticks(self, mode: Mode) -> Steering:
        """Steering by the pilot's sticks; without them it brakes and sinks to the ground."""
        if not self.inputs.hears(InputSource.STICKS, self._time_s):
            velocity, sink_m_s = Velocity(), BLIND_SINKING_M_S
            return Steering(velocity=velocity, eases=True, altitude_m=-math.inf, sink_m_s=sink_m_s)
        sticks = self.inputs.sticks
        rises = past_deadzone((sticks.throttle - THROTTLE_MIDDLE) / THROTTLE_MIDDLE)
        climb_m_s = rises * self.parameters["MPC_Z_VEL_MAX_UP" if rises > 0 else "MPC_Z_VEL_MAX_DN"]
        if mode is not Mode.POSCTL and not sticks.moved():
            return Steering(level=True, velocity=Velocity(up_m_s=climb_m_s))
        most_m_s = within_limits(self.parameters["MPC_VEL_MANUAL"], self.parameters)
        forward_m_s = past_deadzone(sticks.forward) * most_m_s
        right_m_s = past_deadzone(sticks.right) * most_m_s
        turn_deg = past_deadzone(sticks.turn) * 90
        heading_deg = self._body.heading_deg
        return Steering(
            velocity=turned(forward_m_s, right_m_s, climb_m_s, math.radians(heading_deg)),
            eases=True,
            turns_to_deg=heading_deg + turn_deg if turn_deg else None,
        )


def turned(forward_m_s: float, right_m_s: float, up_m_s: float, heading: float) -> Velocity:
    """The velocity of a body with that heading, in radians."""
    return Velocity(
        forward_m_s * math.sin(heading) + right_m_s * math.cos(heading),
        forward_m_s * math.cos(heading) - right_m_s * math.sin(heading),
        up_m_s,
    )
