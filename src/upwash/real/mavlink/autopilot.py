"""ports.Autopilot for a vehicle over MAVLink: what all firmwares have in common.

A pilot or a fail-safe may take the vehicle at any time. The latch then closes, the verb in progress raises
AutopilotOverruled, and no later verb sends a command. A subclass has what differs from firmware to firmware.
"""

from __future__ import annotations

import asyncio
import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import Position, distance_m, ground_distance_m
from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.eventlog.schema import ArmingDelayed, VehicleSetting
from upwash.ports import ComingDown
from upwash.real.mavlink.needs import require_version
from upwash.real.mavlink.reports import ReportingAutopilot, check_speed

_TURN_S = 20.0  # half a turn, of a vehicle that turns slowly
_POINTS_WITHIN_DEG = 5.0
_ALL_TELL_S = 2.0  # each vehicle on the link reports its landed state within this time
_EXTENDED_SYS_STATE = mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE


class MavlinkAutopilot(ReportingAutopilot):
    """The autopilot of a found vehicle; a subclass has the firmware's commands."""

    return_mode: ClassVar[str]
    land_mode: ClassVar[str]
    _delayed_by: tuple[str, ...] | None = None  # the last told reasons why it cannot be armed

    # --- before the flight ----------------------------------------------------------------------------------

    async def claim(self, *, resumes: bool, ordered: ComingDown | None = None) -> None:
        """Claims the vehicle for the program, by its last heartbeat; AutopilotOverruled if that is refused."""
        async with self.vehicle.limited("start", self._settings.margin_s):
            await self.vehicle.until("start", lambda: self._telemetry.mode is not None)
        ordered_mode = {"return": self.return_mode, "land": self.land_mode}[ordered] if ordered else ""
        self.vehicle.claim("start", resumes=resumes, ordered_mode=ordered_mode)
        if self._telemetry.armed:  # it flies already: `limits` is for a vehicle that stands
            await self._know_home()
            self._tracker.fix_ground()
            await self.learn()
            await self._learn_rally_in_flight()

    async def _learn_rally_in_flight(self) -> None:
        """Read the rally points of a vehicle in flight, which is not ended for what cannot be counted."""
        try:
            await self.learn_rally(self._home_limits())
        except (AutopilotRefused, AutopilotTimeout) as error:
            advice = f"{error}; the way home counts as ending at the vehicle's home"
            self.vehicle.news.tell(VehicleSetting(name="list of rally points", value=None, advice=advice))

    async def inspect(self) -> None:
        """Checks the vehicle by questions alone; raises AutopilotRefused if it cannot be flown."""
        require_version(self.vehicle)

    async def ready(self) -> None:
        """Checks the vehicle, and waits until it may be armed, without a command; reports the reasons of the wait."""
        await self.inspect()
        settings, vehicle = self._settings, self.vehicle
        deadline_s = vehicle.now_s + settings.ready_timeout_s
        while not self._may_be_armed():
            self._refuse_two_vehicles()
            begun_s = vehicle.now_s
            vehicle.question(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
            within_s = min(settings.ask_again_s, max(deadline_s - begun_s, settings.patience.answer_s))
            for until_s in (0.0, min(settings.words_s, within_s), within_s):
                await vehicle.happens("arm", self._may_be_armed, within_s=begun_s + until_s - vehicle.now_s)
                vehicle.require_control("arm")
                vehicle.require_alone("arm")
                if not self._may_be_armed():
                    self._tell_delay(self._reasons_since(begun_s) or self._own_reasons())
            if vehicle.now_s >= deadline_s and vehicle.linked and not self._may_be_armed():
                raise self._not_ready(self._delayed_by or ())
        await vehicle.look_for_others("arm")

    def _refuse_two_vehicles(self) -> None:
        if self._tracker.leaps_to_and_fro:
            system, _ = self.vehicle.ids
            raise AutopilotRefused(
                "arm",
                f"{self._tracker.restless}, again and again: either two vehicles send as system {system} on this "
                "link, or its GPS is lost; give each vehicle a number of its own (SYSID_THISMAV or MAV_SYS_ID), or "
                "wait for a good fix; nothing was sent",
                self.vehicle.said_lately,
            )

    def _tell_delay(self, reasons: tuple[str, ...]) -> None:
        """Report new reasons why the vehicle cannot be armed; without any the last reasons stay."""
        reasons = reasons or self._delayed_by or ()
        if reasons != self._delayed_by:
            self._delayed_by = reasons
            self.vehicle.news.tell(ArmingDelayed(reasons=reasons))

    def _not_ready(self, reasons: tuple[str, ...]) -> AutopilotRefused:
        own = self._own_reasons()
        said = "; ".join(reason for reason in reasons if reason not in own)
        because = f": {'; '.join(own)}" if own else ""
        within_s = self._settings.ready_timeout_s
        return AutopilotRefused("arm", f"the vehicle was not ready within {within_s:g} s{because}", said)

    def _may_be_armed(self) -> bool:
        """Whether the vehicle's checks pass in the mode to be flown; True too if it was lost, to end the wait."""
        telemetry = self._telemetry
        ready = telemetry.can_be_armed and telemetry.knows_its_place and not self._tracker.restless
        return bool(ready) or not self.vehicle.is_ours

    def _reasons_since(self, since_s: float) -> tuple[str, ...]:
        texts = [text.text for said_s, text in self._telemetry.texts if said_s >= since_s]
        reasons = (text.partition(": ")[2] for text in texts if text.startswith(("PreArm: ", "Arm: ")))
        return tuple(dict.fromkeys(reasons))

    def _own_reasons(self) -> tuple[str, ...]:
        """The reasons against arming in its reports, as its checks may pass in a mode that needs no position."""
        if self._tracker.restless:
            return (self._tracker.restless,)
        unsure = self._telemetry.can_be_armed and not self._telemetry.knows_its_place
        return ("it does not know its position yet",) if unsure else ()

    # --- verbs ----------------------------------------------------------------------------------------------

    async def arm(self) -> None:
        """Starts the motors, and tries again while the last checks fail; raises AutopilotRefused with the reason."""
        vehicle, settings = self.vehicle, self._settings
        deadline_s = vehicle.now_s + settings.ready_timeout_s
        async with vehicle.limited("arm", settings.ready_timeout_s + settings.margin_s):
            while True:
                begun_s = vehicle.now_s
                try:
                    await self._change_mode("arm", vehicle.firmware.own_mode)
                    await vehicle.arm("arm", armed=True)
                    vehicle.beat()  # from here on a dead man counts what it hears
                    break
                except AutopilotRefused:
                    vehicle.require_control("arm")
                    if vehicle.now_s + settings.arm_again_s > deadline_s:
                        raise
                    self._tell_delay(self._reasons_since(begun_s))
                await asyncio.sleep(settings.arm_again_s)
            await self._while_ours("arm", lambda: self._telemetry.position is not None)

    async def takeoff(self, altitude_m: float) -> None:
        """Takes off straight up to the altitude above home; returns when it is reached."""
        step = f"takeoff to {altitude_m:g} m"
        self.vehicle.require_one(step)
        async with self.vehicle.limited(step, self._vertical_s(altitude_m)):
            await self._climb(step, altitude_m)

    @abstractmethod
    async def _climb(self, step: str, altitude_m: float) -> None: ...

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the ground speed of the following legs, in metres per second."""
        check_speed(ground_speed_m_s)
        self._ground_speed_m_s = ground_speed_m_s

    async def goto(self, position: Position) -> None:
        """Flies to the position; returns on arrival, at rest, with a position that the vehicle is sure of."""
        step = f"goto {position.east_m:.1f} m east, {position.north_m:.1f} m north"
        async with self.vehicle.limited(step, self._leg_s(position)):
            await self._fly_to(step, position)

    @abstractmethod
    async def _fly_to(self, step: str, position: Position) -> None: ...

    async def turn_to(self, heading_deg: float) -> None:
        """Turns the nose to the heading; returns once the vehicle reports it, within a few degrees."""
        step = f"turn to {heading_deg:g} degrees"

        def points_there() -> bool:
            now_deg = self._telemetry.heading_deg
            return (
                now_deg is not None and abs(math.remainder(heading_deg - now_deg, 360)) <= _POINTS_WITHIN_DEG
            )

        async with self.vehicle.limited(step, self._settings.margin_s + _TURN_S):
            self._require_flying(step)
            await self._begin_turn(step, heading_deg)
            await self._while_ours(step, points_there)

    @abstractmethod
    async def _begin_turn(self, step: str, heading_deg: float) -> None: ...

    async def command(self, number: int, name: str, parameters: Sequence[float]) -> None:
        """Sends a payload command as COMMAND_LONG; returns once the vehicle has accepted it."""
        async with self.vehicle.limited(name, self._settings.margin_s):
            await self.vehicle.command(name, number, *parameters)

    def say(self, severity: int, text: str) -> None:
        """Sends a text to ground stations as STATUSTEXT, a long text in chunks."""
        self.vehicle.say(severity, text)

    async def hold(self) -> None:
        """Stops the vehicle; returns when it hovers."""
        async with self.vehicle.limited("hold", self._settings.margin_s):
            await self._stop()

    @abstractmethod
    async def _stop(self) -> None: ...

    async def return_home_and_land(self) -> None:
        """Flies back to the vehicle's home or rally point and lands; returns on touchdown."""
        altitude_m = max(self.position.altitude_m, self._settings.return_altitude_m)
        place = self.energy.returns_to(self.position)
        home_s = self._leg_s(place.position) + 2 * self._vertical_s(altitude_m)
        await self._land_in("return home and land", self.return_mode, timeout_s=home_s)

    async def land(self) -> None:
        """Lands where the vehicle is; returns on touchdown."""
        await self._land_in("land", self.land_mode, timeout_s=self._vertical_s(self.position.altitude_m))

    async def _land_in(self, step: str, mode: str, *, timeout_s: float) -> None:
        begun_s = self.vehicle.now_s
        async with self.vehicle.limited(step, timeout_s):
            await self.vehicle.confirm_control(step)
            if self.vehicle.mode_name != mode:  # a safe end finds the mission's return under way
                await self._change_mode(step, mode)
            await self._touch_down(step, begun_s)

    @abstractmethod
    async def _change_mode(self, step: str, mode: str) -> None: ...

    async def disarm(self) -> None:
        """Stops the motors; refused by the vehicle in flight."""
        async with self.vehicle.limited("disarm", self._settings.margin_s):
            await self.vehicle.arm("disarm", armed=False)

    # --- parts of verbs -------------------------------------------------------------------------------------

    def _require_flying(self, step: str) -> None:
        self.vehicle.require_control(step)
        if not self._telemetry.armed or self._telemetry.on_ground:
            raise AutopilotRefused(step, "the vehicle stands on the ground; nothing was sent")

    async def _while_ours(self, step: str, done: Callable[[], bool]) -> None:
        """Return when `done` is true; raise if the vehicle is lost, or stops its motors, before."""
        vehicle = self.vehicle
        await vehicle.until(step, lambda: done() or not vehicle.may_steer or not self._telemetry.armed)
        if done():
            return
        vehicle.require_control(step)
        vehicle.require_one(step)
        raise AutopilotRefused(step, "the vehicle disarmed", vehicle.said_lately)

    def _arrived(self, target: Position) -> bool:
        return self._rests_at(target) and self.position_is_sure

    def _rests_at(self, target: Position) -> bool:
        """Whether the vehicle rests at the target by its own report, even if it doubts its position."""
        return distance_m(self.position, target) <= self._settings.arrival_distance_m and self._at_rest()

    def _climbed(self, altitude_m: float) -> bool:
        """Whether the vehicle rests at the altitude and is known to fly; its landed state may come late."""
        missing_m = altitude_m - self.position.altitude_m
        near = missing_m <= self._settings.arrival_distance_m
        return near and self._at_rest() and self._telemetry.in_the_air

    def _at_rest(self) -> bool:
        return self._telemetry.speed_m_s < self._settings.arrival_speed_m_s

    def _landed(self, since_s: float) -> bool:
        """Whether a landed state came since then; without such reports, whether the motors have stopped."""
        if self._telemetry.stands is None:
            return not self._telemetry.armed
        telemetry, vehicle = self._telemetry, self.vehicle
        if vehicle.identity.two_with_one_id and vehicle.now_s - telemetry.airborne_s < _ALL_TELL_S:
            return False  # one of the two still flies
        return self.stands and vehicle.heard_since(_EXTENDED_SYS_STATE, since_s)

    async def _touch_down(self, step: str, begun_s: float) -> None:
        """Return on touchdown; raise if the vehicle is lost, or its motors stop in the air, before."""
        vehicle, telemetry = self.vehicle, self._telemetry
        vehicle.latch.expect_armed(False)  # it disarms itself some time after touchdown

        def falls() -> bool:
            stopped = not telemetry.armed and telemetry.disarmed_s >= begun_s
            return stopped and self._seen_after_disarming() and self._may_fall()

        await vehicle.until(step, lambda: self._landed(begun_s) or falls() or not vehicle.is_ours)
        if not self._landed(begun_s):
            vehicle.require_control(step)
            raise AutopilotRefused(step, "its motors stopped in the air", vehicle.said_lately)

    def _leg_s(self, end: Position) -> float:
        """The longest time (s) that a flight to `end` may take."""
        slowest_m_s = self._ground_speed_m_s * self._settings.slowest_share
        rise_m = abs(end.altitude_m - self.position.altitude_m)
        return ground_distance_m(self.position, end) / slowest_m_s + self._vertical_s(rise_m)

    def _vertical_s(self, height_m: float) -> float:
        return self._settings.margin_s + height_m / self._settings.slowest_vertical_m_s
