"""Finds the vehicle on a connection, and the driver for its firmware."""

from __future__ import annotations

from collections.abc import Callable

from upwash.core.geo import LocalFrame
from upwash.mavlink.signing import Signing
from upwash.real.mavlink.arducopter import ARDUCOPTER, ArduCopterAutopilot
from upwash.real.mavlink.autopilot import MavlinkAutopilot
from upwash.real.mavlink.link import Opener
from upwash.real.mavlink.needs import ask_version
from upwash.real.mavlink.px4 import Px4Autopilot
from upwash.real.mavlink.px4_firmware import PX4
from upwash.real.mavlink.reports import check_speed
from upwash.real.mavlink.settings import FlightSettings
from upwash.real.mavlink.vehicle import MavlinkVehicle

_DRIVERS: dict[str, type[MavlinkAutopilot]] = {ARDUCOPTER.name: ArduCopterAutopilot, PX4.name: Px4Autopilot}
_DEFAULTS = FlightSettings()


async def connect_autopilot(
    connection: str | Opener,
    *,
    frame: LocalFrame,
    ground_speed_m_s: float,
    heartbeat_timeout_s: float = 10.0,
    settings: FlightSettings = _DEFAULTS,
    signing: Signing | None = None,
    system: int | None = None,
    waiting: Callable[[str, float], None] = lambda *_: None,
) -> MavlinkAutopilot:
    """The autopilot of the vehicle on the connection, after its heartbeat; raises AutopilotError without one.

    `connection` is as for `MavlinkLink`. With `signing` the driver signs all messages, and accepts only signed
    messages. `system` selects the vehicle; without it exactly one vehicle may be on the link, else AutopilotRefused
    names them. While the vehicle is silent, `waiting` gets the reason and the seconds since the start.
    """
    check_speed(ground_speed_m_s)
    vehicle = MavlinkVehicle(connection, settings.patience, (ARDUCOPTER, PX4), signing=signing, system=system)
    try:
        await vehicle.found(within_s=heartbeat_timeout_s, waiting=waiting)
        vehicle.version = await ask_version(vehicle)
    except BaseException:
        await vehicle.close()
        raise
    driver = _DRIVERS[vehicle.firmware.name]
    return driver(vehicle, frame=frame, ground_speed_m_s=ground_speed_m_s, settings=settings)
