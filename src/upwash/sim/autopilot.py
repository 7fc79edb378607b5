"""The program's side of a simulated vehicle: its verbs, on the event loop's clock."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Sequence
from typing import NoReturn

from msgspec.structs import replace

from upwash.config.world import FaultConfig
from upwash.core.geo import Circle, EarthPosition, LocalFrame, Position, Velocity, distance_m
from upwash.core.planning.legs import Pace
from upwash.core.vehicle.control import Control
from upwash.core.vehicle.return_place import RallyPoints, ReturnPlace
from upwash.core.vehicle.telemetry import Attitude, GpsFix, Telemetry
from upwash.core.vehicle.way_home import EnergyFacts, WayHome, descent_s
from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.ports import ComingDown, DeadMan, DeadManAction, VehicleLimits, VehicleNews
from upwash.sim.energy import EnergyMeter
from upwash.sim.incidents import Incidents, ModelBattery
from upwash.sim.link import Observe, unobserved
from upwash.sim.over_time import OverTime
from upwash.sim.vehicle import GUIDED, LAND, RETURN, FlightModel, ModelVehicle
from upwash.sim.vehicle_link import ModelVehicleLink
from upwash.support.background import first
from upwash.vehicle.ardupilot.airframe import TURN_DEG_S
from upwash.vehicle.body.kinematics import Phase, duration_s, stretched

_PATIENCE_S = 60.0  # the most that a leg may exceed its time
_SAME_PLACE_M = 1e-3
_HOVERS_M, _HOVERS_S = 5.0, 600.0  # a return without a landing, and how long a driver waits for one
_GPS = GpsFix("3d", satellites=12, hdop=0.8)


class ModelAutopilot:
    """The autopilot of a simulated vehicle, which flies in its `manner` from the ground below `start`.

    `frame` places `start` on the Earth. `stretch` returns a factor on the duration of each leg, for noise, `fault`
    the present fault, `incidents` are the events without a command, and `returns` has settings of its returns;
    docs/faults.md describes them. `observe`
    gets the events of the vehicle and the incidents, and "reached" with the distance `off_m` of its true position
    from the waypoint. The battery's charge is `charge`, or that of `energy`, or else 0 `endurance_s` after the first
    take-off; `wind` is the measured one. A vehicle that `hovers_at` a place was left there by another program.
    """

    def __init__(
        self,
        start: Position,
        *,
        ground_speed_m_s: float,
        manner: FlightModel,
        frame: LocalFrame | None = None,
        stretch: Callable[[], float] = lambda: 1.0,
        fault: Callable[[], FaultConfig | None] = lambda: None,
        incidents: Sequence[FaultConfig] = (),
        returns: Sequence[FaultConfig] = (),
        endurance_s: float | None = None,
        energy: EnergyMeter | None = None,
        charge: OverTime | None = None,
        wind: OverTime | None = None,
        hovers_at: Position | None = None,
        observe: Observe = unobserved,
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._manner = manner
        self._frame = frame
        self._stretch = stretch
        self._fault = fault
        self._returns = returns
        self._waypoint = hovers_at
        self._vehicle = ModelVehicle(
            Position(start.east_m, start.north_m),
            manner,
            ground_speed_m_s=ground_speed_m_s,
            hovers_at=hovers_at,
            observe=observe,
            moved=energy.move if energy else lambda _: None,
        )
        self._nose_deg = 0.0  # where it points once it hovers
        self._turned_to_deg: float | None = None
        self._ground_m = self._vehicle.home.altitude_m  # below the take-off, above the sea
        self._observe = observe
        self._link = ModelVehicleLink(self._vehicle, is_off=self._is_off)
        self._battery = ModelBattery(
            self._vehicle, self._link, energy=energy, endurance_s=endurance_s, measured=charge
        )
        Incidents(incidents, self._vehicle, self._link, self._battery, observe=observe)
        self._link.take()
        self._wind = wind

    @property
    def position(self) -> Position:
        """The reported position."""
        return self._vehicle.position

    @property
    def position_is_sure(self) -> bool:
        """Whether each jump of the reported position is undone."""
        return not self._link.doubt

    @property
    def earth_position(self) -> EarthPosition | None:
        """The place on the Earth; None without a frame. A model has no altitude above the sea and no date."""
        if self._frame is None:
            return None
        geo = self._frame.geo(self.position)
        return EarthPosition(geo.latitude_deg, geo.longitude_deg)

    @property
    def true_position(self) -> Position:
        """The true position, which no program knows."""
        return self._vehicle.true_position

    @property
    def battery_percent(self) -> float | None:
        """The charge in percent, by the energy used, or else falling steadily after the first take-off."""
        return self._battery.percent

    @property
    def _charges_percent(self) -> dict[int, float | None]:
        first = {} if self.battery_percent is None else {1: self.battery_percent}
        return {**first, **self._battery.second_reported_percent}

    @property
    def stopping_place(self) -> Position:
        """Where the vehicle would come to rest if it braked now."""
        phases = self._braking()
        return phases[-1].end if phases else self.position

    @property
    def telemetry(self) -> Telemetry:
        """The vehicle's reports: always level, with a perfect satellite receiver."""
        vehicle = self._vehicle
        heading_deg = self._heading_deg(vehicle.velocity)
        return Telemetry(
            position=self.position,
            mode=vehicle.mode,
            armed=vehicle.armed,
            velocity=vehicle.velocity,
            attitude=None if heading_deg is None else Attitude(0.0, 0.0, heading_deg),
            heading_deg=heading_deg,
            gps=_GPS,
            batteries=self._charges_percent,
        )

    def _heading_deg(self, now: Velocity) -> float | None:
        """Its heading, as it flies nose first; None if it stands or hovers, unless it was turned there."""
        if not (now.east_m_s or now.north_m_s):
            return self._turned_to_deg
        return math.degrees(math.atan2(now.east_m_s, now.north_m_s)) % 360.0

    @property
    def wind(self) -> Velocity | None:
        """The wind of the trace, or none."""
        return Velocity() if self._wind is None else Velocity(*self._wind.at(self._battery.flown_s))

    @property
    def energy(self) -> EnergyFacts:
        """The battery's stage, which is its fail-safe's, and the way to its home."""
        stage = self._battery.failsafe_percent
        return EnergyFacts(
            low_percent=stage,
            critical_percent=stage,
            home=self._link.home.at_altitude(0.0),
            way_home=self._way_home(),
            rally=self._rally(),
        )

    def _way_home(self) -> WayHome:
        way = self._manner.returning
        if not self._set_now("hovers"):
            return way
        landing_s = duration_s(self._manner.landing(Position(0.0, 0.0, _HOVERS_M)))
        uncounted_s = max(0.0, landing_s - descent_s(_HOVERS_M, way))  # of a vehicle with fixed times
        return replace(way, low_m=_HOVERS_M, waits_s=math.inf, hover_s=way.hover_s + uncounted_s)

    def _rally(self) -> RallyPoints:
        """Its rally points; where it has one, it does not return home."""
        points = (
            ReturnPlace(f"rally point {number}", Position(*point.moved_m[:2]))
            for number, point in enumerate(self._set_now("rally"), 1)
        )
        return RallyPoints(tuple(points), home_counts=False)

    def _set_now(self, kind: str) -> list[FaultConfig]:
        now_s = self._loop.time()
        return [
            setting
            for setting in self._returns
            if setting.kind == kind and setting.from_s <= now_s < setting.to_s
        ]

    @property
    def pace(self) -> Pace | None:
        """None, as the configuration has the pace."""
        return None

    @property
    def control(self) -> Control:
        """The vehicle's owner, and why."""
        return self._link.control

    @property
    def dead_man(self) -> DeadMan:
        """A switch that is always ready, and never needed."""
        return ModelDeadMan()

    @property
    def armed(self) -> bool:
        """Whether the motors run."""
        return self._vehicle.armed

    @property
    def stands(self) -> bool:
        """Whether the vehicle is on the ground, by its altitude."""
        return not self._vehicle.flies

    def listen(self, hear: Callable[[VehicleNews], None]) -> None:
        """Calls `hear` with all news from now on."""
        self._link.listen(hear)

    async def in_the_air(self) -> bool:
        """Whether the vehicle flies, by its altitude; waits for a restarting autopilot."""
        await self._booted()
        self._link.require("start")
        return self._vehicle.flies

    async def claim(self, *, resumes: bool, ordered: ComingDown | None = None) -> None:
        """Claims the vehicle for the program, at once; raises AutopilotOverruled."""
        self._link.require("start")
        latch, before = self._link.latch, self.control
        ordered_mode = {"return": RETURN, "land": LAND}[ordered] if ordered else ""
        latch.claim(self._loop.time(), own_mode=GUIDED, resumes=resumes, ordered_mode=ordered_mode)
        self._link.tell_control(before)
        latch.require("start")

    async def stood(self) -> None:
        """Waits until the altitude is 0 and the motors have stopped."""
        while self._vehicle.flies or self._vehicle.armed:
            await self._vehicle.changed.wait()
        self._link.take_soon()

    async def limits(self) -> VehicleLimits:
        """The limits: its home is where it stood, with its rally points; there is no fence."""
        return VehicleLimits(self._link.home.at_altitude(0.0), rally=self._rally())

    async def ready(self) -> None:
        """Returns at once, or when the autopilot has restarted."""
        await self._booted()
        self._reach("arm")

    async def arm(self) -> None:
        """Starts the motors, at once."""
        self._command("arm", modes=(GUIDED,), armed=True)

    async def takeoff(self, altitude_m: float) -> None:
        """Climbs straight up to the altitude; AutopilotRefused if disarmed."""
        self._reach("take-off")
        if not self._vehicle.armed:
            raise AutopilotRefused("take-off", "the vehicle is not armed")
        self._command("take-off", goes=True)
        self._battery.take_off()
        top = self.position.at_altitude(altitude_m)
        climb = self._manner.takeoff(self.position, altitude_m)
        await self._move("take-off", climb)
        if not self._leads_to(top):
            await self._wait_in_vain("take-off", duration_s(climb))

    async def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the speed of the following legs, at once."""
        self._command("ground speed")
        self._vehicle.ground_speed_m_s = ground_speed_m_s

    async def goto(self, position: Position) -> None:
        """Flies a leg from rest; returns when the vehicle counts as arrived."""
        self._reach("goto")
        if self.stands:
            raise AutopilotRefused("goto", "the vehicle is on the ground")
        fault = self._fault()
        if fault is not None and fault.kind == "slow":
            await self._pass(fault.extra_s)
        self._command("goto", goes=True, target=self._above_sea(position))
        noise, begun_s = self._stretch(), self._loop.time()
        end = self._vehicle.target or position

        def leg_from(start: Position) -> tuple[Phase, ...]:
            return self._manner.waypoint_leg(start, end, ground_speed_m_s=self._vehicle.ground_speed_m_s)

        arrival_s = self._manner.arrival_s(stretched(leg_from(self._waypoint or self.position), noise))
        phases = stretched(self._in_time(leg_from, self._manner.arrival_s), noise)
        if fault is not None and fault.kind == "stuck":
            await self._wait_in_vain("goto", arrival_s, for_s=arrival_s + _PATIENCE_S)
        self._nose_deg = _bearing_deg(self.position, position, self._nose_deg)
        await self._move("goto", phases, until_s=arrival_s)
        while self._link.doubt or not self._leads_to(end):
            if self._link.doubt:
                await self._become_sure(begun_s, arrival_s)
            else:  # a driver repeats the target to a vehicle that comes no nearer
                self._command("goto", goes=True, target=end)
                phases = stretched(leg_from(self.position), noise)
                await self._move("goto", phases, until_s=self._manner.arrival_s(phases))
        self._observe("reached", off_m=distance_m(self._vehicle.true_position, position))
        self._waypoint = position

    async def turn_to(self, heading_deg: float) -> None:
        """Turns the nose, as fast as the stand-in vehicle turns."""
        self._reach("turn")
        if self.stands:
            raise AutopilotRefused("turn", "the vehicle is on the ground")
        self._command("turn")
        takes_s = abs(math.remainder(heading_deg - self._nose_deg, 360)) / TURN_DEG_S
        begun = self._vehicle.report
        await self._pass(takes_s)
        self._reach("turn")
        if self._vehicle.report is not begun:
            await self._wait_in_vain("turn", takes_s)
        self._nose_deg = self._turned_to_deg = heading_deg

    async def command(self, number: int, name: str, parameters: Sequence[float]) -> None:
        """Accepts the command, at once."""
        self._command(name)

    def say(self, severity: int, text: str) -> None:
        """Drops the text, as there is no ground station."""

    async def hold(self) -> None:
        """Brakes, and stays where the vehicle comes to rest; returns when it counts as arrived there."""
        self._command("hold", goes=True, target=self.stopping_place)
        phases = self._braking()
        await self._move("hold", phases, until_s=self._manner.arrival_s(phases))

    async def return_home_and_land(self) -> None:
        """Flies back to its home or rally point and lands, unless it hovers there."""
        self._command("return", modes=(RETURN,))
        place = self._rally().chosen(self.position, self._vehicle.home).position
        end = place.at_altitude(_HOVERS_M if self._set_now("hovers") else 0.0)
        way = self._in_time(lambda start: self._manner.return_and_land(start, end), duration_s)
        await self._move("return", way, end=end)
        if end.altitude_m:
            await self._wait_in_vain("return", duration_s(way), for_s=_HOVERS_S)

    async def land(self) -> None:
        """Lands straight below."""
        self._command("land", modes=(LAND,))
        here = self.position
        way = self._in_time(self._manner.landing, duration_s)
        await self._move("land", way, end=Position(here.east_m, here.north_m))

    async def disarm(self) -> None:
        """Stops the motors, at once; raises AutopilotRefused in the air."""
        self._reach("disarm")
        if self._vehicle.flies:
            raise AutopilotRefused("disarm", "the vehicle is in the air")
        self._command("disarm", armed=False)

    async def border_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns just after the vehicle has crossed a border; raises AutopilotLost if its link is silent then."""
        while True:
            self._link.require("watch the borders")
            if await self._vehicle.borders.crossed(circles):
                self._link.require("watch the borders")
                return

    async def border_truly_crossed(self, circles: Sequence[Circle]) -> None:
        """Returns just after the vehicle has crossed a border, even if its link is silent."""
        while not await self._vehicle.borders.crossed(circles):
            pass

    async def close(self) -> None:
        """Reports nothing any more."""
        self._link.listen(lambda _: None)

    # --- commands and reports -------------------------------------------------------------------------------

    def _command(
        self,
        step: str,
        *,
        modes: tuple[str, ...] = (),
        armed: bool | None = None,
        goes: bool = False,
        target: Position | None = None,
    ) -> None:
        """Send a command; no other method does. With `goes` and without a target the command leads straight up."""
        self._reach(step)
        latch = self._link.latch
        if modes:
            latch.expect_modes(modes)
        if armed is not None:
            latch.expect_armed(armed)
        if goes:
            latch.expect_target(target)
        self._vehicle.obey(step, mode=modes[-1] if modes else None, armed=armed, target=target)
        self._link.take()
        if goes:
            latch.settle_target(obeyed=True)

    def _above_sea(self, place: Position) -> Position:
        """The target above the sea, which a moved home does not change."""
        return place.at_altitude(place.altitude_m + self._ground_m) if self._ground_m else place

    def _reach(self, step: str) -> None:
        """Raise if the link to the vehicle is silent, or if the program does not own the vehicle."""
        self._link.require(step)
        self._link.latch.require(step)

    def _is_off(self) -> bool:
        fault = self._fault()
        return fault is not None and fault.kind == "off"

    def _in_time(
        self, way: Callable[[Position], tuple[Phase, ...]], takes_s: Callable[[tuple[Phase, ...]], float]
    ) -> tuple[Phase, ...]:
        """The way from here, with the duration of the way from the last waypoint.

        The distance of the hovering vehicle from its waypoint depends on the time of the hover, and so on the policy;
        the duration of a leg must not.
        """
        here = self.position
        from_here = way(here)
        if self._waypoint is None or self._waypoint == here:
            return from_here
        planned_s, real_s = takes_s(way(self._waypoint)), takes_s(from_here)
        return stretched(from_here, planned_s / real_s) if planned_s > 0 and real_s > 0 else from_here

    def _braking(self) -> tuple[Phase, ...]:
        return self._manner.hold(self.position, self._vehicle.velocity)

    async def _move(
        self,
        step: str,
        phases: tuple[Phase, ...],
        *,
        until_s: float | None = None,
        end: Position | None = None,
    ) -> None:
        """Move, and return at the end of the phases or at `until_s`; `end` is their exact end."""
        end = end or (phases[-1].end if phases else self.position)
        self._waypoint = self._turned_to_deg = None
        self._vehicle.move(phases, end)
        motion = self._vehicle.motion
        await self._pass(duration_s(phases) if until_s is None else until_s)
        if motion is not self._vehicle.motion:
            await self._rest(step)
        if until_s is None and self.control.is_ours:
            self._vehicle.settle(self._vehicle.motion.end)
        self._reach(step)

    async def _rest(self, step: str) -> None:
        """Wait until the vehicle rests, after it has corrected its course for a jump of its position."""
        self._waypoint = None
        self._reach(step)
        while (left_s := self._vehicle.motion.ends_s - self._loop.time()) > 0:
            await self._pass(left_s)
            self._reach(step)

    async def _become_sure(self, begun_s: float, arrival_s: float) -> None:
        """Wait until the position has jumped again and the vehicle rests; AutopilotTimeout if that takes too long."""
        left_s = begun_s + arrival_s + _PATIENCE_S - self._loop.time()
        if left_s <= 0:
            raise _late("goto", arrival_s, self._link.doubt)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(left_s):
                await first(asyncio.wait([self._link.lost]), self._link.jumped.wait())
        await self._rest("goto")

    def _leads_to(self, end: Position) -> bool:
        """Whether it was not stopped on its way by a pilot who gave it back within one silence of the link."""
        return distance_m(self._vehicle.motion.end, end) < _SAME_PLACE_M

    async def _wait_in_vain(self, step: str, due_s: float, *, for_s: float = _PATIENCE_S) -> NoReturn:
        """Wait as long as a driver for what does not happen, then raise AutopilotTimeout."""
        await self._pass(for_s)
        self._reach(step)
        raise _late(step, due_s)

    async def _booted(self) -> None:
        while self._vehicle.is_booting:
            await self._vehicle.changed.wait()

    async def _pass(self, for_s: float) -> None:
        """Wait for that time, or until the program loses the vehicle."""
        await asyncio.wait((self._link.lost,), timeout=for_s)


def _late(step: str, arrival_s: float, doubt: str = "") -> AutopilotTimeout:
    because = f": {doubt}" if doubt else ""
    return AutopilotTimeout(
        step, f"the vehicle did not arrive within {arrival_s + _PATIENCE_S:.0f} s{because}"
    )


def _bearing_deg(start: Position, end: Position, otherwise_deg: float) -> float:
    """The bearing in degrees clockwise from north; `otherwise_deg` for a way straight up or down."""
    east_m, north_m = end.east_m - start.east_m, end.north_m - start.north_m
    return math.degrees(math.atan2(east_m, north_m)) % 360 if east_m or north_m else otherwise_deg


class ModelDeadMan:
    """A dead man's switch that is always ready, and never needed: a simulated program does not die silently."""

    async def missing(self) -> str:
        """The empty text: nothing is missing."""
        return ""

    async def install(self) -> str:
        """Does nothing, as it is installed."""
        return ""

    async def watch(self, *, silence_s: float, action: DeadManAction) -> None:
        """Does nothing."""

    async def release(self) -> None:
        """Does nothing."""
