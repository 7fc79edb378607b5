"""The reports that a program receives from a simulated vehicle, and their meaning for its owner and position."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from upwash.core.geo import Position, Velocity
from upwash.core.vehicle.continuity import Continuity
from upwash.core.vehicle.control import Control, Heartbeat, Latch
from upwash.errors import AutopilotLost
from upwash.eventlog.schema import SEVERITIES, HomeMoved, PositionDoubted, VehicleSaid
from upwash.ports import VehicleNews
from upwash.sim.vehicle import GUIDED, ModelVehicle

_HEARTBEAT_S = 1.0
_CRITICAL = SEVERITIES.index("critical")
_FLOWN_M_S = 1e9  # between two jumps: no bound on what was flown there


class ModelVehicleLink:
    """Passes the vehicle's reports to the latch while its link is not silent.

    `is_off` returns whether the link is down. The future `lost` is done once the program loses the vehicle.
    """

    def __init__(self, vehicle: ModelVehicle, *, is_off: Callable[[], bool]) -> None:
        self._loop = asyncio.get_running_loop()
        self._vehicle = vehicle
        self._is_off = is_off
        self.latch = Latch(self._loop.time())
        self.lost: asyncio.Future[None] = self._loop.create_future()
        self.jumped = asyncio.Event()  # replaced and set when the doubt about its position changes
        self.home = vehicle.home
        self._continuity = Continuity()
        self._doubted = False
        self._reported: Heartbeat | None = None  # to the latch, last; the same again says nothing
        self._target: Position | None = None  # the same
        self._boots = vehicle.boots
        self._tell: Callable[[VehicleNews], None] = lambda _: None

    @property
    def control(self) -> Control:
        """The vehicle's owner, and why."""
        return self.latch.control

    @property
    def is_silent(self) -> bool:
        """Whether its link is silent now."""
        return self._vehicle.is_booting or self._is_off()

    @property
    def doubt(self) -> str:
        """Why the reported position cannot be true; "" if it can."""
        doubt_m = self._continuity.doubt_m
        return f"its reported position jumped {doubt_m:.0f} m, farther than it can fly" if doubt_m else ""

    def listen(self, tell: Callable[[VehicleNews], None]) -> None:
        """Calls `tell` with all news from now on."""
        self._tell = tell

    def say(self, text: str) -> None:
        """Report a text of the vehicle, which sends texts only while its motors run."""
        if self._vehicle.armed and not self.is_silent:
            self._tell(VehicleSaid(severity=_CRITICAL, text=text))

    def require(self, step: str) -> None:
        """Take in the present reports; raises AutopilotLost while the link is silent."""
        if self.is_silent:
            raise AutopilotLost(step, "the vehicle's link is silent")
        self.take()

    def take(self) -> None:
        """Take in the present reports: heartbeat, time since boot, target and home."""
        vehicle, now_s = self._vehicle, self._loop.time()
        if vehicle.report is not self._reported:
            self._reported = vehicle.report
            self._judge(lambda: self.latch.report(vehicle.report, now_s))
        if vehicle.boots != self._boots:
            self._boots = vehicle.boots
            why = "its autopilot restarted: its time since boot went back"
            self._judge(lambda: self.latch.report_restart(why, now_s))
        if vehicle.target is not self._target and vehicle.mode == GUIDED:
            self._target = vehicle.target
            self._judge(lambda: self.latch.report_target(vehicle.target, now_s))
        if vehicle.home is not self.home:
            self.home = vehicle.home
            self._tell(HomeMoved.of(vehicle.home))

    def take_soon(self) -> None:
        """Take in the present reports at once, or within a second after the silence of the link."""
        if not self.is_silent:
            self.take()
        elif self.control.is_ours:
            self._loop.call_later(_HEARTBEAT_S, self.take_soon)

    def take_heartbeat(self, report: Heartbeat, *, by_autopilot: bool) -> None:
        """Take in a heartbeat with the vehicle's ids, which another program may have sent."""
        if not self.is_silent and self._is_believed(by_autopilot=by_autopilot):
            self._judge(lambda: self.latch.report(report, self._loop.time()))

    def take_jump(self, before: Position, after: Position) -> None:
        """Take in a jump of the reported position from `before` to `after`."""
        now_s = self._loop.time()
        self._continuity.take_estimate(before, time_s=now_s, velocity=Velocity(_FLOWN_M_S))
        self._continuity.take_estimate(after, time_s=now_s, velocity=Velocity())
        doubt_m = self._continuity.doubt_m
        if self._doubted != (doubt_m > 0) and self._vehicle.armed:
            self._tell(PositionDoubted(jumped_m=round(doubt_m, 1)))
        self._doubted = doubt_m > 0
        jumped, self.jumped = self.jumped, asyncio.Event()
        jumped.set()

    def _is_believed(self, *, by_autopilot: bool) -> bool:
        return by_autopilot

    def _judge(self, report: Callable[[], None]) -> None:
        before = self.latch.control
        report()
        self.tell_control(before)

    def tell_control(self, before: Control) -> None:
        """Reports the owner of the vehicle after a change."""
        if self.control != before:
            if before.is_ours and not self.control.is_ours:
                self.lost.set_result(None)
            self._tell(self.control)
