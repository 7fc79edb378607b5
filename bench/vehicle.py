"""Flies the thesis's grid from rest with the stand-in and sets it beside the recorded flight of an ArduCopter.

Run from the repository: `python -m bench.vehicle`. The client does what the recording's did: the next target 3 s
after arrival, which is within 1 m and below 0.5 m/s; all times are the vehicle's own, read from its reports.
"""

from __future__ import annotations

import asyncio
import csv
import math
import statistics
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.program import command_line
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition, LocalFrame, Position, distance_m
from upwash.real.mavlink import MavlinkLink
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.server import serve_vehicle

SPEEDUP = 10.0
QUICK_SPEEDUP, QUICK_LEGS = 40.0, 2
REPORTS_HZ = 10.0
HOME = GeoPosition(39.3666, 22.9507)
ALTITUDE_M, GROUND_SPEED_M_S, HOVER_S = 15.0, 4.0, 3.0
TAKEOFF_DONE_M, TAKEOFF_DONE_M_S = 0.1, 0.1
TOUCHED_DOWN_M = 0.02
RECORDED_LEGS = Path(__file__).parents[1] / "tests" / "sim" / "data" / "arducopter_legs.csv"


@dataclass(frozen=True)
class Times:
    """How long the parts of a flight took."""

    legs_s: list[float]
    lifts_s: float
    takeoff_s: float
    grid_s: float
    touchdown_s: float  # from the command to return
    disarmed_s: float

    @property
    def total_s(self) -> float:
        """From the command to take off until the motors stood still."""
        return self.takeoff_s + self.grid_s + self.disarmed_s


# guided_4ms_from_rest.csv: what its README says, and the moments of its phases. It was armed 0.4 s before the command
# to take off; here the times count from arming, as the lift-off does.
RECORDED_LIFTS_S, RECORDED_TAKEOFF_S = 3.9, 12.6
RECORDED_GRID_S, RECORDED_TOUCHDOWN_S, RECORDED_DISARMED_S = 446.1, 44.0, 46.7


def recorded() -> tuple[Times, list[Position]]:
    """The recorded flight, and the targets of its legs."""
    rows = list(csv.DictReader(RECORDED_LEGS.read_text(encoding="utf-8").splitlines()))
    legs_s = [float(row["arrival_s"]) - float(row["begin_s"]) for row in rows]
    targets = [Position(float(row["to_east_m"]), float(row["to_north_m"]), ALTITUDE_M) for row in rows]
    return Times(
        legs_s,
        RECORDED_LIFTS_S,
        RECORDED_TAKEOFF_S,
        RECORDED_GRID_S,
        RECORDED_TOUCHDOWN_S,
        RECORDED_DISARMED_S,
    ), targets


class Client:
    """A program that flies by the messages alone."""

    def __init__(self) -> None:
        self.last: dict[str, Any] = {}
        self.send: Callable[[Any], None] = lambda _: None
        self._news = asyncio.Event()
        self._frame = LocalFrame(HOME)

    def hear(self, message: Any) -> None:
        """Takes what the vehicle says."""
        self.last[message.get_type()] = message
        self._news.set()

    async def until(self, condition: Callable[[], bool]) -> None:
        """Returns when the condition, looked at with each message, is true."""
        while not condition():
            self._news.clear()
            await self._news.wait()

    async def command(self, number: int, *parameters: float) -> None:
        """Returns when the vehicle has said yes."""
        self.last.pop("COMMAND_ACK", None)
        padded = (*parameters, *[0.0] * (7 - len(parameters)))
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *padded))
        await self.until(lambda: "COMMAND_ACK" in self.last)
        assert self.last["COMMAND_ACK"].result == 0, self.last["COMMAND_ACK"]

    def target(self, position: Position) -> None:
        """Sends the vehicle there."""
        geo = self._frame.geo(position)
        place = round(geo.latitude_deg * 1e7), round(geo.longitude_deg * 1e7), position.altitude_m
        frame, only_position = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, 0b110111111000
        self.send(
            mavlink.MAVLink_set_position_target_global_int_message(
                0, 1, 1, frame, only_position, *place, *[0.0] * 8
            )
        )

    def now_s(self) -> float:
        """The vehicle's time at its last report."""
        return float(self.last["GLOBAL_POSITION_INT"].time_boot_ms) / 1e3

    def position(self) -> Position:
        """Where it was then."""
        report = self.last["GLOBAL_POSITION_INT"]
        geo = GeoPosition(report.lat / 1e7, report.lon / 1e7, report.relative_alt / 1e3)
        return self._frame.position(geo)

    def speed_m_s(self) -> float:
        """How fast it was then."""
        report = self.last["GLOBAL_POSITION_INT"]
        return math.hypot(report.vx, report.vy, report.vz) / 100

    async def wait(self, duration_s: float) -> None:
        """Wait by the vehicle's clock."""
        begun_s = self.now_s()
        await self.until(lambda: self.now_s() >= begun_s + duration_s)


async def fly_grid_over_udp(targets: list[Position], *, speedup: float) -> Times:
    """Fly them with a stand-in that runs its clock `speedup` times as fast."""
    settings = VehicleSettings(home=HOME, armable_after_s=0.0, speedup=speedup)
    vehicle, client = await serve_vehicle("udp:127.0.0.1:0", settings), Client()
    link = MavlinkLink(vehicle.address.replace("udp:", "udpout:"), client.hear)
    client.send = link.send
    try:
        await link.opened.wait()
        return await fly_grid(client, targets)
    finally:
        await link.close()
        await vehicle.close()


async def fly_grid(client: Client, targets: list[Position]) -> Times:
    """Takes off, flies them with a hover before each, returns and lands."""
    await client.command(
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 1e6 / REPORTS_HZ
    )
    await client.until(lambda: "GLOBAL_POSITION_INT" in client.last)
    await client.command(mavlink.MAV_CMD_DO_SET_MODE, 1, mavlink.COPTER_MODE_GUIDED)
    await client.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    begun_s = client.now_s()
    await client.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, ALTITUDE_M)
    await client.until(lambda: client.position().altitude_m > 0.02)
    lifted_s = client.now_s()
    await client.until(
        lambda: (
            client.position().altitude_m > ALTITUDE_M - TAKEOFF_DONE_M
            and client.speed_m_s() < TAKEOFF_DONE_M_S
        )
    )
    up_s = client.now_s()
    await client.wait(HOVER_S)
    legs_s = [await _leg(client, target, first=number == 0) for number, target in enumerate(targets)]
    home_s = client.now_s()
    await client.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    await client.until(lambda: client.position().altitude_m < TOUCHED_DOWN_M)
    down_s = client.now_s()
    await client.until(lambda: not client.last["HEARTBEAT"].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    return Times(
        legs_s, lifted_s - begun_s, up_s - begun_s, home_s - up_s, down_s - home_s, client.now_s() - home_s
    )


async def _leg(client: Client, target: Position, *, first: bool) -> float:
    begun_s = client.now_s()
    client.target(target)
    if first:  # a speed told before is lost
        await client.until(lambda: client.speed_m_s() > 0.5)
        await client.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, GROUND_SPEED_M_S, -1)
    await client.until(lambda: distance_m(client.position(), target) <= 1.0 and client.speed_m_s() < 0.5)
    leg_s = client.now_s() - begun_s
    await client.wait(HOVER_S)
    return leg_s


def _table(was: Times, flown: Times) -> str:
    def row(name: str, was_s: float, flown_s: float) -> str:
        return f"| {name} | {was_s:.1f} | {flown_s:.1f} | {(flown_s / was_s - 1) * 100:+.1f} % |"

    apart = max(abs(mine_s / theirs_s - 1) for mine_s, theirs_s in zip(flown.legs_s, was.legs_s, strict=True))
    return "\n".join(
        [
            "| part, in seconds | ArduCopter | stand-in | apart |",
            "|---|---|---|---|",
            row("lifts off after", was.lifts_s, flown.lifts_s),
            row("take-off to 15 m", was.takeoff_s, flown.takeoff_s),
            row(
                f"leg of 20 m (median of {len(was.legs_s)})",
                *map(statistics.median, (was.legs_s, flown.legs_s)),
            ),
            row("shortest leg", min(was.legs_s), min(flown.legs_s)),
            row("longest leg", max(was.legs_s), max(flown.legs_s)),
            f"| the leg that differs most | | | {apart * 100:.1f} % |",
            row("all legs, with hovers", was.grid_s, flown.grid_s),
            row("return to touchdown", was.touchdown_s, flown.touchdown_s),
            row("return to disarmed, by HEARTBEAT", was.disarmed_s, flown.disarmed_s),
            row("total", was.total_s, flown.total_s),
        ]
    )


def main() -> None:
    """Flies and prints."""
    was, targets = recorded()
    speedup = SPEEDUP
    if command_line("vehicle", __doc__).parse_args().quick:
        was, targets = replace(was, legs_s=was.legs_s[:QUICK_LEGS]), targets[:QUICK_LEGS]
        speedup = QUICK_SPEEDUP
    print(_table(was, asyncio.run(fly_grid_over_udp(targets, speedup=speedup))))


if __name__ == "__main__":
    main()
