"""The program's side of a vehicle on paper: verbs behind the latch, on the event loop's clock."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence

from upwash.config import FaultConfig
from upwash.core.control import Control, Latch, Report
from upwash.core.energy import EnergyFacts
from upwash.core.geo import Circle, EarthPosition, LocalFrame, Position, Velocity
from upwash.core.telemetry import Attitude, GpsFix, Telemetry
from upwash.errors import AutopilotLost, AutopilotRefused, AutopilotTimeout
from upwash.eventlog.schema import SEVERITIES
from upwash.ports import DeadMan, DeadManAction, VehicleLimits, VehicleNews, VehicleText
from upwash.sim.energy import EnergyMeter
from upwash.sim.vehicle import GUIDED, LAND, RETURN, Manner, ModelVehicle
from upwash.vehicle.flight import TURN_DEG_S
from upwash.vehicle.kinematics import Phase, duration_s, stretched

_PATIENCE_S = 60.0  # a leg has failed that takes so much longer than it should
_HEARTBEAT_S = 1.0
_CRITICAL = SEVERITIES.index("critical")
_GPS = GpsFix("3d", satellites=12, hdop=0.8)


class ModelDeadMan:
    """Always ready, and never needed: a simulated program does not die without a word."""

    async def missing(self) -> str:
        """Nothing."""
        return ""

    async def install(self) -> str:
        """It is there."""
        return ""

    async def watch(self, *, silence_s: float, action: DeadManAction) -> None:
        """At once."""

    async def release(self) -> None:
        """At once."""


class ModelAutopilot:
    """Flies in its manner from the ground below `start`; its `frame` says where on the Earth that is.

    `stretch` gives a factor on the duration of each leg, for noise, `fault` what is wrong with the vehicle now, and
    `takeovers` who else takes it and when; `sim.faults` says what each fault means. `given_back_unheard` is told when
    a pilot gives it back of whom the program has heard nothing. The battery is as full as `energy` says, or else
    empty `endurance_s` after the first take-off. One that `hovers_at` a place has been left there by another program.
    """

    def __init__(
        self,
        start: Position,
        *,
        ground_speed_m_s: float,
        manner: Manner,
        frame: LocalFrame | None = None,
        stretch: Callable[[], float] = lambda: 1.0,
        fault: Callable[[], FaultConfig | None] = lambda: None,
        takeovers: Sequence[FaultConfig] = (),
        endurance_s: float | None = None,
        energy: EnergyMeter | None = None,
        hovers_at: Position | None = None,
        commanded: Callable[[str], None] = lambda _: None,
        taken: Callable[[str], None] = lambda _: None,
        given_back_unheard: Callable[[], None] = lambda: None,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._home = Position(start.east_m, start.north_m)
        self._ground_speed_m_s = ground_speed_m_s
        self._manner = manner
        self._frame = frame
        self._stretch = stretch
        self._fault = fault
        self._waypoint = hovers_at
        self._endurance_s = endurance_s
        self._energy = energy
        self._took_off_s: float | None = None
        self._vehicle = ModelVehicle(
            self._home,
            manner,
            hovers_at=hovers_at,
            commanded=commanded,
            taken=taken,
            moved=energy.move if energy else lambda _: None,
        )
        self._nose_deg = 0.0  # where it points once it hovers
        self._turned_to_deg: float | None = None
        self._given_back_unheard = given_back_unheard
        self._latch = Latch(self._loop.time())
        self._reported: Report | None = None  # to the latch, last; the same again says nothing
        self._hear: Callable[[VehicleNews], None] = lambda _: None
        # Done once the vehicle is no longer the program's, and never will be again.
        self._lost: asyncio.Future[None] = self._loop.create_future()
        for takeover in takeovers:
            self._loop.call_at(takeover.from_s, self._be_taken, takeover)
        self._take_report()
        if energy is not None:
            self._watch_battery(energy, energy.failsafe_percent)

    @property
    def position(self) -> Position:
        """Where it is now."""
        return self._vehicle.position

    @property
    def earth_position(self) -> EarthPosition | None:
        """The frame's; None without a frame. A model has no altitude above the sea and no date."""
        if self._frame is None:
            return None
        geo = self._frame.geo(self.position)
        return EarthPosition(geo.latitude_deg, geo.longitude_deg)

    @property
    def battery_percent(self) -> float | None:
        """By what was drawn from it, or else steadily less from the first take-off on."""
        if self._energy is not None:
            return self._energy.left_percent
        if self._endurance_s is None:
            return None
        flown_s = 0.0 if self._took_off_s is None else self._loop.time() - self._took_off_s
        return 100.0 * max(0.0, 1 - flown_s / self._endurance_s)

    @property
    def velocity(self) -> Velocity | None:
        """How it moves now."""
        return self._vehicle.velocity

    @property
    def stopping_place(self) -> Position:
        """In its manner."""
        phases = self._braking()
        return phases[-1].end if phases else self.position

    @property
    def heading_deg(self) -> float | None:
        """It flies nose first; None where it stands or hovers, unless it was turned there."""
        now = self._vehicle.velocity
        if not (now.east_m_s or now.north_m_s):
            return self._turned_to_deg
        return math.degrees(math.atan2(now.east_m_s, now.north_m_s)) % 360.0

    @property
    def telemetry(self) -> Telemetry:
        """Always level, with a perfect receiver."""
        heading_deg = self.heading_deg
        return Telemetry(
            position=self.position,
            mode=self._vehicle.mode,
            armed=self.armed,
            velocity=self.velocity,
            attitude=None if heading_deg is None else Attitude(0.0, 0.0, heading_deg),
            heading_deg=heading_deg,
            gps=_GPS,
            battery_percent=self.battery_percent,
        )

    @property
    def wind(self) -> Velocity | None:
        """None blows."""
        return Velocity()

    @property
    def energy(self) -> EnergyFacts:
        """It returns to where it took off; its battery's one stage is that of its fail-safe."""
        stage = self._energy.failsafe_percent if self._energy else None
        return EnergyFacts(
            low_percent=stage, critical_percent=stage, home=self._home, way_home=self._manner.returning
        )

    @property
    def control(self) -> Control:
        """Who has it."""
        return self._latch.control

    @property
    def dead_man(self) -> DeadMan:
        """One that has nothing to do."""
        return ModelDeadMan()

    @property
    def armed(self) -> bool:
        """Whether its motors run."""
        return self._vehicle.armed

    @property
    def stands(self) -> bool:
        """By its altitude."""
        return not self._vehicle.flies

    def listen(self, hear: Callable[[VehicleNews], None]) -> None:
        """It says nothing in words."""
        self._hear = hear

    async def in_the_air(self) -> bool:
        """By its altitude."""
        self._hear_of("start")
        return self._vehicle.flies

    async def claim(self, *, resumes: bool) -> None:
        """At once."""
        self._hear_of("start")
        before = self._latch.control
        self._latch.claim(self._loop.time(), own_mode=GUIDED, resumes=resumes)
        self._tell_control(before)
        self._latch.require("start")

    async def stood(self) -> None:
        """When its altitude is 0 and its motors stand still."""
        while self._vehicle.flies or self._vehicle.armed:
            await self._vehicle.changed.wait()
        self._take_report()

    async def limits(self) -> VehicleLimits:
        """Its home is where it stood; it has no fence."""
        return VehicleLimits(self._home)

    async def ready(self) -> None:
        """At once."""
        self._reach("arm")

    async def arm(self) -> None:
        """At once."""
        self._command("arm", modes=(GUIDED,), armed=True)

    async def takeoff(self, altitude_m: float) -> None:
        """Climbs straight up."""
        self._reach("take-off")
        if not self._vehicle.armed:
            raise AutopilotRefused("take-off", "the vehicle is not armed")
        self._command("take-off")
        if self._took_off_s is None:
            self._took_off_s = self._loop.time()
        await self._move("take-off", self._manner.takeoff(self.position, altitude_m))

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """At once, for the legs that follow."""
        self._command("ground speed")
        self._ground_speed_m_s = ground_speed_m_s

    async def goto(self, position: Position) -> None:
        """Flies a leg from rest; returns when the vehicle counts as arrived."""
        self._reach("goto")
        if self.stands:
            raise AutopilotRefused("goto", "the vehicle is on the ground")
        fault = self._fault()
        if fault is not None and fault.kind == "slow":
            await self._pass(fault.extra_s)
        self._command("goto")
        noise = self._stretch()

        def leg_from(start: Position) -> tuple[Phase, ...]:
            return self._manner.waypoint_leg(start, position, ground_speed_m_s=self._ground_speed_m_s)

        arrival_s = self._manner.arrival_s(stretched(leg_from(self._waypoint or self.position), noise))
        phases = stretched(self._in_time(leg_from, self._manner.arrival_s), noise)
        if fault is not None and fault.kind == "stuck":
            await self._pass(arrival_s + _PATIENCE_S)
            self._reach("goto")
            raise AutopilotTimeout(
                "goto", f"the vehicle did not arrive within {arrival_s + _PATIENCE_S:.0f} s"
            )
        self._nose_deg = _bearing_deg(self.position, position, self._nose_deg)
        await self._move("goto", phases, until_s=arrival_s)
        self._waypoint = position

    async def turn_to(self, heading_deg: float) -> None:
        """As fast as the stand-in vehicle turns."""
        self._reach("turn")
        if self.stands:
            raise AutopilotRefused("turn", "the vehicle is on the ground")
        self._command("turn")
        await self._pass(abs(math.remainder(heading_deg - self._nose_deg, 360)) / TURN_DEG_S)
        self._reach("turn")
        self._nose_deg = self._turned_to_deg = heading_deg

    async def command(self, number: int, name: str, parameters: Sequence[float]) -> None:
        """Accepted at once: it carries whatever is asked for."""
        self._command(name)

    def say(self, severity: int, text: str) -> None:
        """Nobody listens."""

    async def hold(self) -> None:
        """Brakes, and stops where that ends."""
        self._command("hold")
        await self._move("hold", self._braking())

    async def return_home_and_land(self) -> None:
        """Back to where it took off."""
        self._command("return", modes=(RETURN,))
        way = self._in_time(lambda start: self._manner.return_and_land(start, self._home), duration_s)
        await self._move("return", way, end=self._home)

    async def land(self) -> None:
        """Straight down."""
        self._command("land", modes=(LAND,))
        here = self.position
        way = self._in_time(self._manner.landing, duration_s)
        await self._move("land", way, end=Position(here.east_m, here.north_m))

    async def disarm(self) -> None:
        """At once, on the ground."""
        self._reach("disarm")
        if self._vehicle.flies:
            raise AutopilotRefused("disarm", "the vehicle is in the air")
        self._command("disarm", armed=False)

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns just after the vehicle has crossed a border; AutopilotLost where its link is silent then."""
        while True:
            self._hear_of("watch the borders")
            if await self._vehicle.borders.crossed(circles):
                self._hear_of("watch the borders")
                return

    async def close(self) -> None:
        """Tells nothing more."""
        self._hear = lambda _: None

    # --- commands and reports -------------------------------------------------------------------------------

    def _command(self, step: str, *, modes: tuple[str, ...] = (), armed: bool | None = None) -> None:
        """The one way by which a command reaches the vehicle."""
        self._reach(step)
        if modes:
            self._latch.expect_modes(modes)
        if armed is not None:
            self._latch.expect_armed(armed)
        self._vehicle.obey(step, mode=modes[-1] if modes else None, armed=armed)
        self._take_report()

    def _reach(self, step: str) -> None:
        """Raises where the vehicle is not heard, or is not the program's."""
        self._hear_of(step)
        self._latch.require(step)

    def _hear_of(self, step: str) -> None:
        if self._is_silent():
            raise AutopilotLost(step, "the vehicle's link is silent")
        self._take_report()

    def _is_silent(self) -> bool:
        fault = self._fault()
        return fault is not None and fault.kind == "off"

    def _take_report(self) -> None:
        report, before = self._vehicle.report, self._latch.control
        if report is not self._reported:
            self._reported = report
            self._latch.report(report, self._loop.time())
            self._tell_control(before)

    def _tell_control(self, before: Control) -> None:
        if self.control != before:
            if before.is_ours:
                self._lost.set_result(None)
            self._hear(self.control)

    def _be_taken(self, takeover: FaultConfig) -> None:
        if takeover.kind == "pilot":
            self._vehicle.be_taken_by_pilot(
                back_after_s=takeover.to_s - takeover.from_s, before_back=self._check_unheard
            )
        else:
            self._vehicle.fail_safe()
        self._take_heartbeats()

    def _watch_battery(self, energy: EnergyMeter, level_percent: float) -> None:
        """Has the vehicle land by itself once the battery is down to the level, and fall once it is empty."""
        left_percent = energy.left_percent
        if left_percent is None:
            return
        if left_percent > level_percent:
            self._loop.call_later(energy.lasts_s(level_percent), self._watch_battery, energy, level_percent)
            return
        if left_percent > 0:
            self._say(f"Battery Failsafe: {left_percent:.0f} % is left")
            self._vehicle.fail_safe()
            self._watch_battery(energy, 0.0)
        else:
            self._say("Battery empty: the motors stop")
            self._vehicle.fall()
        self._take_heartbeats()

    def _say(self, text: str) -> None:
        if self._vehicle.armed and not self._is_silent():
            self._hear(VehicleText(_CRITICAL, text))

    def _take_heartbeats(self) -> None:
        """One that tells of the takeover comes at once, or in the first second after the silence of the link."""
        if not self._is_silent():
            self._take_report()
        elif self.control.is_ours:
            self._loop.call_later(_HEARTBEAT_S, self._take_heartbeats)

    def _check_unheard(self) -> None:
        if self.control.is_ours:
            self._given_back_unheard()

    def _in_time(
        self, way: Callable[[Position], tuple[Phase, ...]], takes_s: Callable[[tuple[Phase, ...]], float]
    ) -> tuple[Phase, ...]:
        """The way from here, in the time that it takes from the waypoint at which the vehicle has arrived.

        How near that it has crept depends on how long it was left alone, thus on the policy; a leg's time must not.
        """
        here = self.position
        from_here = way(here)
        if self._waypoint is None or self._waypoint == here:
            return from_here
        planned_s, real_s = takes_s(way(self._waypoint)), takes_s(from_here)
        return stretched(from_here, planned_s / real_s) if planned_s > 0 and real_s > 0 else from_here

    def _braking(self) -> tuple[Phase, ...]:
        return self._manner.brake(self.position, self._vehicle.velocity)

    async def _move(
        self,
        step: str,
        phases: tuple[Phase, ...],
        *,
        until_s: float | None = None,
        end: Position | None = None,
    ) -> None:
        """Begins to move, and returns at the end of the phases or earlier; `end` is where that is, exactly."""
        end = end or (phases[-1].end if phases else self.position)
        self._waypoint = self._turned_to_deg = None
        self._vehicle.move(phases, end)
        await self._pass(duration_s(phases) if until_s is None else until_s)
        if until_s is None and self.control.is_ours:
            self._vehicle.settle(end)
        self._reach(step)

    async def _pass(self, for_s: float) -> None:
        """Returns after that time, or once the vehicle is not the program's any more."""
        await asyncio.wait((self._lost,), timeout=for_s)


def _bearing_deg(start: Position, end: Position, otherwise_deg: float) -> float:
    """Clockwise from north; `otherwise_deg` for a way straight up or down."""
    east_m, north_m = end.east_m - start.east_m, end.north_m - start.north_m
    return math.degrees(math.atan2(east_m, north_m)) % 360 if east_m or north_m else otherwise_deg
