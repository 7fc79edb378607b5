"""upwash vehicle: runs a stand-in vehicle."""

from __future__ import annotations

import argparse
import asyncio
from typing import TYPE_CHECKING

from upwash.commands.arguments import announce, place

if TYPE_CHECKING:
    from upwash.commands.arguments import Commands


def add(commands: Commands) -> None:
    """Adds the command."""
    vehicle = commands.add_parser("vehicle", help="run a stand-in vehicle that speaks MAVLink")
    vehicle.add_argument("--listen", default="udp:127.0.0.1:14550", help="udp:HOST:PORT or tcp:HOST:PORT")
    vehicle.add_argument(
        "--home", type=place, default="39.3666,22.9507", metavar="LAT,LON", help="where it stands"
    )
    vehicle.add_argument(
        "--armable-after", type=float, default=42.0, metavar="S", help="after boot, in seconds (default: 42)"
    )
    vehicle.add_argument(
        "--speedup", type=float, default=1.0, metavar="N", help="let its clock run so many times as fast"
    )
    vehicle.add_argument(
        "--acceleration", type=float, metavar="M_S2",
        help="speed up and brake alike, in m/s² (default: as a recorded ArduCopter did)",
    )  # fmt: skip
    vehicle.add_argument(
        "--battery", type=float, default=100.0, metavar="PERCENT", help="how full it is at boot"
    )
    vehicle.add_argument(
        "--fault", action="append", default=[], dest="faults", metavar="KIND[:FROM[-TO]]",
        help="link, gps, battery or arming, from and to seconds after boot",
    )  # fmt: skip
    vehicle.set_defaults(run=run)


def run(options: argparse.Namespace) -> bool:
    """Runs it until it is told to stop."""
    from upwash.core.geo import GeoPosition
    from upwash.launch import run_vehicle
    from upwash.vehicle.copter import VehicleSettings
    from upwash.vehicle.faults import read_fault

    settings = VehicleSettings(
        home=GeoPosition(*options.home),
        acceleration_m_s2=options.acceleration,
        armable_after_s=options.armable_after,
        battery_percent=options.battery,
        speedup=options.speedup,
        faults=tuple(read_fault(text) for text in options.faults),
    )
    asyncio.run(run_vehicle(options.listen, settings, ready=_announce))
    return True


def _announce(address: str) -> None:
    announce(f"vehicle ready at {address}")
    connection = address.replace("udp:", "udpout:", 1)  # it waits to be spoken to
    announce(f"fly it with: upwash fly --config drone.toml --autopilot {connection}")
