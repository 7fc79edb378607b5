"""Puts a stand-in vehicle on a socket."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from upwash.mavlink.signing import Signing
from upwash.real.host.signals import stopping_politely
from upwash.real.mavlink.signing import read_key
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.px4.settings import Px4Settings
from upwash.vehicle.server import serve_vehicle


async def run_vehicle(
    listen: str,
    settings: VehicleSettings | Px4Settings,
    *,
    ready: Callable[[str], None],
    signing_key: Path | None = None,
) -> None:
    """Run a stand-in vehicle until SIGTERM or Ctrl-C; `ready` gets its address once it answers."""
    signing = Signing(read_key(signing_key)) if signing_key else None
    vehicle = await serve_vehicle(listen, settings, signing=signing)
    stopped = asyncio.Event()
    with stopping_politely(lambda _: stopped.set()):
        try:
            ready(vehicle.address)
            await stopped.wait()
        finally:
            await vehicle.close()
