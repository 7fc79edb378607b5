"""Flies a square with MAVSDK, at the connection of its argument; prints the corners."""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

from mavsdk import ComponentType, Configuration
from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import ActionError

ALTITUDE_M = 15.0
CORNERS_M = (20, 0), (20, 20), (0, 20), (0, 0)
PATIENCE_S = 30.0


async def until(reports: AsyncIterator[Any], condition: Callable[[Any], bool]) -> Any:
    async with asyncio.timeout(PATIENCE_S):
        async for report in reports:
            if condition(report):
                return report
    raise SystemExit("the reports ended")


async def fly(connection: str) -> None:
    configuration = Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER)
    async with Mavsdk(configuration) as mavsdk:
        await mavsdk.add_any_connection(connection)
        system = await mavsdk.first_autopilot(timeout_s=PATIENCE_S)
        if system is None:
            raise SystemExit("no autopilot was found")
        action, telemetry = ActionAsync(system), TelemetryAsync(system)
        await telemetry.set_rate_position(20.0)
        await telemetry.set_rate_velocity_ned(20.0)
        await telemetry.set_rate_health(5.0)
        await until(
            telemetry.subscribe_health(),
            lambda health: health.is_global_position_ok and health.is_home_position_ok,
        )
        while True:
            try:
                await action.arm()
                break
            except ActionError as error:
                print("not yet:", error, file=sys.stderr)
                await asyncio.sleep(0.5)
        await action.set_takeoff_altitude(ALTITUDE_M)
        await action.takeoff()
        home = await until(
            telemetry.subscribe_position(),
            lambda position: position.relative_altitude_m > ALTITUDE_M * 0.95,
        )
        above_sea_m = home.absolute_altitude_m - home.relative_altitude_m + ALTITUDE_M
        for east_m, north_m in CORNERS_M:
            corner = home.latitude_deg + north_m / 111_030, home.longitude_deg + east_m / 86_170
            await action.goto_location(*corner, above_sea_m, float("nan"))

            def near(position: Any, corner: tuple[float, float] = corner) -> bool:
                north_m = (position.latitude_deg - corner[0]) * 111_030
                east_m = (position.longitude_deg - corner[1]) * 86_170
                return math.hypot(north_m, east_m) < 0.5

            await until(telemetry.subscribe_position(), near)
            print("corner", flush=True)
        await action.return_to_launch()
        await until(telemetry.subscribe_armed(), lambda armed: not armed)
        print("disarmed", flush=True)


if __name__ == "__main__":
    asyncio.run(fly(sys.argv[1]))
