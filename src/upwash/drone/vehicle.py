"""The vehicle as a mission uses it: each verb logged, held against the fences, and blocking until it is true."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, Literal

from upwash.core.geo import EarthPosition, Position, Waypoint, rounded
from upwash.core.selection.events import DescentBegun, MissionBegun, TargetUnknown
from upwash.core.vehicle.telemetry import Telemetry
from upwash.drone.coming_down import Homecoming
from upwash.drone.pending import Demand
from upwash.drone.places import index_of
from upwash.drone.settling import Settling
from upwash.drone.site import require_altitude
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.schema import SEVERITIES
from upwash.ports import ComingDown
from upwash.support.text import printable

Severity = Literal["emergency", "alert", "critical", "error", "warning", "notice", "info", "debug"]
_LONGEST_TEXT_BYTES = 200  # four chunks of STATUSTEXT
_AtPlace = type[schema.Armed | schema.Holding | schema.Disarmed]


class Vehicle:
    """The vehicle as a mission uses it: a method returns when its action is complete, or raises AutopilotError."""

    def __init__(self, settling: Settling, homecoming: Homecoming) -> None:
        self._settling = settling
        self._homecoming = homecoming
        self._thread, self._legs = settling.thread, settling.legs
        self._autopilot, self._journal = self._legs.autopilot, self._legs.journal
        self._tell = self._legs.tell

    @property
    def position(self) -> Position:
        """The drone's position relative to the mission's home, in metres."""
        return self._autopilot.position

    @property
    def earth_position(self) -> EarthPosition | None:
        """The drone's place on the Earth in degrees (WGS 84), and its altitude above the sea; None while unknown.

        `above_sea_m` and `unix_s`, the time by its GPS, are None if the vehicle does not report them, as in a
        simulation.
        """
        return self._autopilot.earth_position

    @property
    def in_the_air(self) -> bool:
        """Whether the mission has taken off and not landed since."""
        return self._legs.in_the_air

    @property
    def battery_percent(self) -> float | None:
        """The battery's charge in percent, as last reported; None if the vehicle does not report it."""
        return self._autopilot.telemetry.battery_percent

    @property
    def telemetry(self) -> Telemetry:
        """The vehicle's last reports: speed, attitude, heading, GPS, mode, battery."""
        return self._autopilot.telemetry

    @property
    def on_a_leg(self) -> bool:
        """Whether the vehicle is on its way to a place where the mission sent it."""
        return self._legs.on_a_leg

    @property
    def place(self) -> Waypoint | Position | None:
        """The place where the mission last sent the vehicle; None before its first leg."""
        return self._legs.place

    @property
    def waypoint(self) -> int | None:
        """The index of the waypoint where the mission last sent the vehicle; None for a place off the plan."""
        return index_of(self._legs.place)

    @property
    def ground_speed_m_s(self) -> float | None:
        """The ground speed of legs as the mission last set it; None for the configured speed."""
        return self._legs.ground_speed_m_s

    def arm(self) -> None:
        """Waits until the vehicle is ready to fly, then arms its motors.

        Raises AutopilotRefused if the vehicle stands too far from the mission, or its own fence forbids a part of it.
        """
        if not self._legs.found_flying:  # arming would change the mode that it flies in
            self._thread.call(self._logged(self._arm, schema.Armed))

    def takeoff(self, altitude_m: float) -> None:
        """Takes off and climbs to the altitude above home; a vehicle found flying only climbs, and never sinks."""
        if self._legs.found_flying:
            self._thread.call(self._climb(altitude_m))
            return
        self._legs.stands_at = None
        self._legs.in_the_air = True  # from the attempt on: it may fail half-way up
        self._thread.call(self._takeoff(altitude_m))

    def set_ground_speed(self, ground_speed_m_s: float) -> None:
        """Sets the ground speed of the following legs, in metres per second."""
        self._thread.call(self._legs.set_ground_speed(ground_speed_m_s))

    def goto(self, place: Waypoint | Position, *, unless: Demand[Any] | None = None) -> bool:
        """Flies to a waypoint or position; returns True on arrival, at rest, and after the waypoint's hold time.

        On a row of `mission.photos` it returns True when the drone passes the waypoint, and the drone flies on.
        With `unless=pending.demands(...)`, an answer with that demand stops the flight: the vehicle brakes and `goto`
        returns False, at rest on the way, or at the target if that is nearer. Raises AutopilotRefused, without a
        movement, if the plan's geofence forbids the place or the way.
        """
        self._thread.require_turn()
        return self._settling.goto(place, unless=unless)

    def turn_to(self, heading_deg: float) -> None:
        """Turns the hovering vehicle's nose to a heading, in degrees clockwise from north, until the next leg.

        Raises UsageError unless the heading is from 0 to 360.
        """
        if not 0 <= heading_deg <= 360:
            raise UsageError(f"turn_to: heading_deg is {heading_deg}: give degrees from 0 to 360")
        self._settling.settle()
        self._thread.call(self._turn_to(heading_deg % 360))

    def send_text(self, text: str, *, severity: Severity = "info") -> None:
        """Sends a text to the ground station as the vehicle's own (MAVLink's STATUSTEXT), without a confirmation.

        Raises UsageError unless the text has 1 to 200 bytes in UTF-8.
        """
        if severity not in SEVERITIES:
            raise UsageError(f"send_text: no severity {severity!r}: choose of {', '.join(SEVERITIES)}")
        size, most = len(text.encode()), _LONGEST_TEXT_BYTES
        if not 0 < size <= most:
            raise UsageError(f"send_text: {size} bytes: give a text of 1 to {most} bytes in UTF-8")
        self._thread.call(self._send_text(SEVERITIES.index(severity), text))

    def hover(self, duration_s: float) -> None:
        """Hovers where the vehicle is for `duration_s`; on a row it first comes back to the last spot."""
        self._thread.require_turn()
        self._settling.rest()
        self._thread.call(asyncio.sleep(duration_s))

    def hold(self) -> None:
        """Stops the vehicle, and returns when it hovers."""
        self._settling.settle()
        self._legs.stands_at = None
        self._thread.call(self._logged(self._autopilot.hold, schema.Holding))

    def return_home_and_land(self) -> None:
        """Flies back to the vehicle's home or rally point, lands, and returns when it has landed."""
        self._come_down("return")

    def land(self) -> None:
        """Lands where the vehicle is, and returns when it has landed."""
        self._come_down("land")

    def disarm(self) -> None:
        """Stops the motors of the landed vehicle."""
        self._settling.settle()
        self._thread.call(self._logged(self._autopilot.disarm, schema.Disarmed))

    def _come_down(self, how: ComingDown) -> None:
        self._settling.settle(comes_back=how == "land")
        self._settling.seek_answers()
        self._thread.call(self._descend(how))
        self._legs.in_the_air = self._legs.found_flying = False
        self._settling.after_landing()

    async def _descend(self, how: ComingDown) -> None:
        self._tell(DescentBegun())
        here, returns = rounded(self._autopilot.position), how == "return"
        self._journal.record(schema.Returning(position=here) if returns else schema.Landing(position=here))
        await (self._homecoming.return_and_land() if returns else self._homecoming.land())
        self._journal.record(self._homecoming.landed())

    async def _turn_to(self, heading_deg: float) -> None:
        await self._autopilot.turn_to(heading_deg)
        self._journal.record(schema.Turned(heading_deg=heading_deg))

    async def _send_text(self, severity: int, text: str) -> None:
        self._autopilot.say(severity, text)
        self._journal.record(schema.TextSent(severity=severity, text=printable(text)))

    async def _arm(self) -> None:
        await self._autopilot.ready()
        limits, battery = await self._autopilot.limits(), self._autopilot.energy
        self._journal.record(
            schema.LimitsRead(
                home=rounded(limits.home) if limits.home else None,
                home_above_sea_m=limits.home_above_sea_m,
                highest_m=limits.highest_m,
                lowest_m=limits.lowest_m,
                fences=[fence.name for fence in limits.fences],
                low_percent=battery.low_percent,
                critical_percent=battery.critical_percent,
                rally=[rounded(point.position) for point in limits.rally.points],
            )
        )
        stands, site = self._autopilot.position, self._legs.site
        site.require_reachable(stands)
        site.require_within(limits, stands)
        for why in site.doubts(limits, stands):
            self._journal.record(schema.SiteDoubt(why=why))
        self._legs.limits = limits
        self._journal.record(schema.Arming())
        await self._autopilot.arm()
        self._tell(MissionBegun(self._autopilot.energy, self._autopilot.pace))

    async def _takeoff(self, altitude_m: float) -> None:
        require_altitude(self._legs.limits, altitude_m, step=f"takeoff to {altitude_m:g} m")
        self._tell(TargetUnknown())
        self._journal.record(schema.TakingOff(altitude_m=altitude_m))
        await self._autopilot.takeoff(altitude_m)
        here = rounded(self._autopilot.position)
        self._journal.record(schema.TookOff(altitude_m=altitude_m, position=here))

    async def _climb(self, altitude_m: float) -> None:
        here = self._autopilot.position
        if here.altitude_m < altitude_m:  # never down: only the plan knows what is below
            require_altitude(self._legs.limits, altitude_m, step=f"climb to {altitude_m:g} m")
            await self._autopilot.goto(Position(here.east_m, here.north_m, altitude_m))

    async def _logged(self, verb: Callable[[], Coroutine[Any, Any, None]], after: _AtPlace) -> None:
        self._tell(TargetUnknown())
        await verb()
        self._journal.record(after(position=rounded(self._autopilot.position)))
