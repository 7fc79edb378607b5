"""A simulated vehicle that flies a recorded track, wherever the mission sends it."""

from __future__ import annotations

from typing import Any

from upwash.core.geo import Position, distance_m
from upwash.core.vehicle.track import THERE_M, Track
from upwash.errors import AutopilotRefused
from upwash.sim.autopilot import ModelAutopilot
from upwash.sim.vehicle import LAND, RETURN
from upwash.vehicle.body.kinematics import LongMotion, Phase, steadily


class TrackedAutopilot(ModelAutopilot):
    """The autopilot of a vehicle that is on its track at each moment: nothing that the mission does changes that.

    The track begins with the take-off; where it begins in the air, after a climb. `goto` returns when the track
    passes the place, or at once if it has passed it since the place before. A hold ends at once. A return, and a
    landing, last until the track ends; where it ends in the air the vehicle lands below.
    """

    def __init__(self, track: Track, **options: Any) -> None:
        super().__init__(track.places[0], **options)
        self._track = track
        self._began_s = 0.0
        self._passed_s = 0.0  # of the track: at the last place where the mission sent it

    @property
    def stopping_place(self) -> Position:
        """Where it is: nothing stops it."""
        return self.position

    async def takeoff(self, altitude_m: float) -> None:
        """Climbs to the first place of the track if that is in the air, and flies the track to the altitude."""
        first, track = self._track.places[0], self._track
        if first.altitude_m > THERE_M:
            await super().takeoff(first.altitude_m)
        else:
            self._reach("take-off")
            if not self._vehicle.armed:
                raise AutopilotRefused("take-off", "the vehicle is not armed")
            self._command("take-off", goes=True)
            self._battery.take_off()
        self._began_s = self._loop.time()
        phases: list[Phase] = []
        begins_s: list[float] = []
        for number, (start, end) in enumerate(zip(track.places, track.places[1:], strict=False)):
            begins_s.append(track.times_s[number])
            phases += steadily(start, end, duration_s=track.times_s[number + 1] - track.times_s[number])
        self._vehicle.follow(LongMotion(self._began_s, tuple(phases), track.places[-1], begins_s))
        await self._until(track.risen_s(altitude_m) or 0.0)
        self._reach("take-off")

    async def goto(self, position: Position) -> None:
        """Returns when the track passes the place; at once where it did, or never will."""
        self._reach("goto")
        self._command("goto", goes=True, target=position)
        if self._loop.time() >= self._began_s + self._track.ends_s:
            raise AutopilotRefused("goto", "the track is over: the mission took longer than the flight")
        at_s = self._track.passing_s(position, after_s=self._passed_s)
        if at_s is not None:
            self._passed_s = at_s
            await self._until(at_s)
            self._reach("goto")
        self._observe("reached", off_m=distance_m(self._vehicle.true_position, position))

    async def hold(self) -> None:
        """Returns at once."""
        self._command("hold", goes=True, target=self.position)

    async def return_home_and_land(self) -> None:
        """Flies the track to its end, and lands there."""
        self._command("return", modes=(RETURN,))
        await self._end("return")

    async def land(self) -> None:
        """Flies the track to its end, and lands there."""
        self._command("land", modes=(LAND,))
        await self._end("land")

    async def _end(self, step: str) -> None:
        await self._until(self._track.ends_s)
        here = self.position
        ground = here.at_altitude(0.0)
        if here.altitude_m > THERE_M:
            await self._move(step, self._manner.landing(here), end=ground)
        self._vehicle.settle(ground)
        self._reach(step)

    async def _until(self, at_s: float) -> None:
        """Wait until that time of the track."""
        left_s = self._began_s + at_s - self._loop.time()
        if left_s > 0:
            await self._pass(left_s)
