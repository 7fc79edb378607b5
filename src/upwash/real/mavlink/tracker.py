"""A vehicle's reported position relative to the mission's home, and whether it can be true.

Altitudes count from the ground below the take-off, by the vehicle's altitude above the sea. A ground station may move
the vehicle's home in flight: the reported height above home then changes at once.
"""

from __future__ import annotations

from collections import deque

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, LocalFrame, Position, Velocity, distance_m
from upwash.core.vehicle.continuity import Continuity
from upwash.eventlog.schema import HomeMoved, PositionDoubted
from upwash.mavlink.packets import Message
from upwash.real.mavlink.telemetry import place_of_e7
from upwash.real.mavlink.vehicle import MavlinkVehicle

_HOME = Position(0.0, 0.0)
_NO_PLACE = (
    mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
)
_STAYS_M = 1.0  # what a home that was set again may differ by
_RESTLESS_S = 5.0  # for this time after a jump the vehicle cannot be armed
_MANY_JUMPS = 3  # in that time: no filter settles so
_UNSURE_S = 2.0  # reports of less are no news
_FLIES_ON_S = 0.5  # after its last report at most


class PositionTracker:
    """Follows a vehicle's position, home and target; reports a target in the program's own mode to the latch."""

    def __init__(self, vehicle: MavlinkVehicle, frame: LocalFrame) -> None:
        self._vehicle = vehicle
        self._telemetry = vehicle.telemetry
        self._frame = frame
        self._ground_m: float | None = None  # below the take-off, above the sea
        self._home: Position | None = None  # the vehicle's last reported one
        self._reported_s: float | None = None
        self._continuity = Continuity()
        self._last_jump: tuple[float, float] | None = None
        self._jumped_s: deque[float] = deque(maxlen=_MANY_JUMPS)  # by this computer's clock
        self._unsure_since_s: float | None = None  # by the vehicle's own reports
        self._doubted = (False, False)  # for a jump, and as the vehicle is unsure
        vehicle.hindrance = lambda: f": {self.doubt}" if self.doubt else ""
        self.watches_targets = True  # not where the vehicle itself flies round obstacles

    @property
    def position(self) -> Position:
        """The last known position; home until the vehicle knows its own."""
        telemetry = self._telemetry
        if telemetry.position is None:
            return _HOME
        here = self._frame.position(telemetry.position)
        if self._ground_m is None or telemetry.above_sea_m is None:
            return here
        return here.at_altitude(telemetry.above_sea_m - self._ground_m)

    @property
    def present_position(self) -> Position:
        """The last known position, and on from there at the velocity of its report; after a silence not far."""
        here, velocity = self.position, self._telemetry.velocity
        if velocity is None or self._reported_s is None:
            return here
        age_s = min(self._vehicle.now_s - self._reported_s, _FLIES_ON_S)
        return Position(
            here.east_m + velocity.east_m_s * age_s,
            here.north_m + velocity.north_m_s * age_s,
            here.altitude_m + velocity.up_m_s * age_s,
        )

    @property
    def home(self) -> Position | None:
        """The vehicle's home, where it returns; None while not reported."""
        home = self._telemetry.home
        return self._frame.position(home).at_altitude(0.0) if home else None

    @property
    def is_sure(self) -> bool:
        """Whether the reported position can be true and is one vehicle's, and the vehicle is sure of it."""
        one_tells = not self._vehicle.identity.two_with_one_id
        return one_tells and self._telemetry.knows_its_place is not False and not self._continuity.doubt_m

    @property
    def doubt(self) -> str:
        """Why the reported position counts for no arrival; "" if it counts."""
        if doubt_m := self._continuity.doubt_m:
            return f"its reported position jumped {doubt_m:.0f} m, farther than it can fly"
        return "" if self.is_sure else "it is not sure of its position"

    @property
    def restless(self) -> str:
        """Why the position is too restless for a take-off; "" if it is calm."""
        if not self._jumps_lately():
            return ""
        return f"its reported position jumped {self._continuity.jumps[-1][1]:.0f} m while it stands"

    @property
    def leaps_to_and_fro(self) -> bool:
        """Whether the position jumps again and again, as if two vehicles sent with the same ids."""
        return self._jumps_lately() >= _MANY_JUMPS

    def fix_ground(self) -> None:
        """Count altitudes from the vehicle's present home from now on."""
        telemetry = self._telemetry
        if telemetry.position is not None and telemetry.above_sea_m is not None:
            self._ground_m = telemetry.home_above_sea_m
        self._home = self._present_home()

    def above_sea(self, position: Position) -> GeoPosition:
        """The place on the Earth of a position, with its altitude above the sea."""
        ground_m = self._telemetry.home_above_sea_m if self._ground_m is None else self._ground_m
        return self._frame.geo(position.at_altitude(position.altitude_m + ground_m))

    def hear(self, message: Message) -> None:
        """Take in a message of the vehicle."""
        time_s, velocity = self._vehicle.elapsed_s, self._telemetry.velocity or Velocity()
        match message.get_type():
            case "GLOBAL_POSITION_INT" if self._telemetry.position is not None:
                self._reported_s = self._vehicle.now_s
                here = self._frame.position(self._telemetry.position)
                self._continuity.take_estimate(here, time_s=time_s, velocity=velocity)
                self._look_at_doubts()
            case "GPS_RAW_INT" if message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX:
                there = self._frame.position(place_of_e7(message.lat, message.lon))
                self._continuity.take_receiver(there, time_s=time_s, velocity=velocity)
                self._look_at_doubts()
            case "EKF_STATUS_REPORT" | "ESTIMATOR_STATUS":
                is_unsure = self._telemetry.in_the_air and self._telemetry.knows_its_place is False
                since_s = self._vehicle.now_s if self._unsure_since_s is None else self._unsure_since_s
                self._unsure_since_s = since_s if is_unsure else None
            case "HOME_POSITION":
                self._look_at_home()
            case "POSITION_TARGET_GLOBAL_INT" if self._steers_by_targets:
                place = place_of_e7(message.lat_int, message.lon_int, message.alt)
                self._vehicle.judge_target(self._frame.position(place))
            case "POSITION_TARGET_LOCAL_NED" if self._steers_by_targets:
                if message.type_mask & _NO_PLACE == _NO_PLACE:
                    self._vehicle.judge_target(None)

    @property
    def _steers_by_targets(self) -> bool:
        firmware, mode = self._vehicle.firmware, self._vehicle.mode_name
        return self.watches_targets and firmware.keeps_targets and mode == firmware.own_mode

    def _look_at_doubts(self) -> None:
        continuity, now_s = self._continuity, self._vehicle.now_s
        jumps = continuity.jumps
        if jumps and jumps[-1] != self._last_jump:
            self._last_jump = jumps[-1]
            self._jumped_s.append(now_s)
        if not self._telemetry.armed and not self._jumps_lately():
            continuity.believe()  # it stands, and its filter has settled
        jumped, since_s = continuity.doubt_m > 0, self._unsure_since_s
        unsure = not jumped and since_s is not None and now_s - since_s >= _UNSURE_S
        if (jumped, unsure) != self._doubted:
            self._doubted = jumped, unsure
            if self._telemetry.armed and not self._vehicle.identity.two_with_one_id:
                doubted = PositionDoubted(jumped_m=round(continuity.doubt_m, 1), unsure=unsure)
                self._vehicle.news.tell(doubted)

    def _jumps_lately(self) -> int:
        since_s = self._vehicle.now_s - _RESTLESS_S
        return sum(jumped_s >= since_s for jumped_s in self._jumped_s)

    def _look_at_home(self) -> None:
        """Report a home that was moved in the flight."""
        now, before = self._present_home(), self._home
        if self._ground_m is None or now is None or before is None or distance_m(now, before) <= _STAYS_M:
            return
        if self._vehicle.identity.two_with_one_id:
            return  # it may be the other vehicle's
        self._home = now
        self._vehicle.news.tell(HomeMoved.of(now.at_altitude(now.altitude_m - self._ground_m)))

    def _present_home(self) -> Position | None:
        """The vehicle's home relative to the mission's, its altitude above the sea; None if unknown."""
        home = self._telemetry.home
        return self._frame.position(home) if home else None
