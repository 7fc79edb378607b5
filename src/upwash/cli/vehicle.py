"""upwash vehicle: runs a stand-in vehicle."""

from __future__ import annotations

import argparse
import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Any

from upwash.cli.arguments import announce, place
from upwash.errors import UsageError

if TYPE_CHECKING:
    from upwash.cli.arguments import Commands
    from upwash.vehicle.ardupilot.settings import VehicleSettings
    from upwash.vehicle.px4.settings import Px4Settings


def add(commands: Commands) -> None:
    """Adds the command."""
    vehicle = commands.add_parser("vehicle", help="run a stand-in vehicle that speaks MAVLink")
    vehicle.add_argument(
        "--autopilot", choices=("arducopter", "px4"), default="arducopter",
        help="what it flies, answers and speaks like (default: arducopter)",
    )  # fmt: skip
    vehicle.add_argument("--listen", default="udp:127.0.0.1:14550", help="udp:HOST:PORT or tcp:HOST:PORT")
    vehicle.add_argument(
        "--version", metavar="X.Y.Z",
        help="of its firmware (default: 4.7.0-dev, PX4: 1.16.1): its names of parameters, and what it knows",
    )  # fmt: skip
    _add_start(vehicle)
    _add_flight(vehicle)
    vehicle.add_argument(
        "--one-peer", action="store_true",
        help="px4, UDP: answer nobody but the first who spoke to it, until it is restarted, as a real one",
    )  # fmt: skip
    vehicle.add_argument(
        "--signing-key", type=Path, metavar="FILE",
        help="sign all messages with its key, and obey none that is not signed with it",
    )  # fmt: skip
    vehicle.set_defaults(run=run)


def _add_start(vehicle: argparse.ArgumentParser) -> None:
    """Where it stands, and how it is at boot."""
    vehicle.add_argument(
        "--home", type=place, default="39.3666,22.9507", metavar="LAT,LON", help="where it stands"
    )
    vehicle.add_argument(
        "--home-altitude",
        type=float,
        default=0.0,
        metavar="M",
        help="of the ground above the sea (default: 0)",
    )
    vehicle.add_argument(
        "--armable-after", type=float, metavar="S", help="after boot, in seconds (default: 41.4, PX4: 4)"
    )
    vehicle.add_argument(
        "--battery", type=float, default=100.0, metavar="PERCENT", help="how full it is at boot"
    )
    vehicle.add_argument(
        "--param", action="append", default=[], dest="parameters", metavar="NAME=VALUE",
        help="a parameter at boot, such as FENCE_RADIUS=60",
    )  # fmt: skip


def _add_flight(vehicle: argparse.ArgumentParser) -> None:
    """How it flies, how its time passes, and what goes wrong."""
    vehicle.add_argument(
        "--speedup", type=float, default=1.0, metavar="N", help="let its clock run so many times as fast"
    )
    vehicle.add_argument(
        "--acceleration", type=float, metavar="M_S2",
        help="arducopter: speed up and brake alike, in m/s² (default: as a recorded one did)",
    )  # fmt: skip
    vehicle.add_argument(
        "--fault", action="append", default=[], dest="faults", metavar="KIND[:FROM[-TO]]",
        help="link, gps, glitch, battery, radio, ground, compass or arming, from and to seconds after boot",
    )  # fmt: skip
    vehicle.add_argument(
        "--glitch", type=_glitch, metavar="M[:CLEARED_S]",
        help="arducopter: what the fault glitch is: how far GPS is off, and after how many seconds it says \"Glitch "
        "cleared\" though it still is (default: 55.66:20; inf: never)",
    )  # fmt: skip
    vehicle.add_argument(
        "--clock-offset", type=float, default=0.0, metavar="S",
        help="arducopter: of the time of day that its GPS tells, against this machine's clock",
    )  # fmt: skip


def _glitch(text: str) -> tuple[float, float | None]:
    size, _, cleared = text.partition(":")
    try:
        return float(size), float(cleared) if cleared else None
    except ValueError:
        raise argparse.ArgumentTypeError(
            f'"{text}" is no glitch: write metres, such as 30 or 30:12'
        ) from None


def run(options: argparse.Namespace) -> bool:
    """Runs it until it is told to stop."""
    from upwash.launch.vehicle import run_vehicle

    settings = _px4(options) if options.autopilot == "px4" else _arducopter(options)
    asyncio.run(run_vehicle(options.listen, settings, ready=_announce, signing_key=options.signing_key))
    return True


def _arducopter(options: argparse.Namespace) -> VehicleSettings:
    from upwash.core.geo import GeoPosition
    from upwash.vehicle.ardupilot.settings import VehicleSettings
    from upwash.vehicle.body.copter import read_fault
    from upwash.vehicle.body.parameters import read_setting

    _refuse(options, {"--one-peer": options.one_peer})
    given = _given(options)
    if options.glitch is not None:
        given["glitch_m"], cleared_s = options.glitch
        if cleared_s is not None:
            given["glitch_cleared_after_s"] = cleared_s
    return VehicleSettings(
        home=GeoPosition(*options.home),
        home_altitude_m=options.home_altitude,
        acceleration_m_s2=options.acceleration,
        battery_percent=options.battery,
        speedup=options.speedup,
        clock_offset_s=options.clock_offset,
        parameters=dict(read_setting(text) for text in options.parameters),
        faults=tuple(read_fault(text) for text in options.faults),
        **given,
    )


def _px4(options: argparse.Namespace) -> Px4Settings:
    from upwash.core.geo import GeoPosition
    from upwash.vehicle.body.copter import read_fault
    from upwash.vehicle.body.parameters import read_setting
    from upwash.vehicle.px4.settings import Px4Settings

    _refuse(
        options,
        {
            "--acceleration": options.acceleration is not None,
            "--clock-offset": options.clock_offset,
            "--glitch": options.glitch,
        },
    )
    return Px4Settings(
        home=GeoPosition(*options.home),
        home_altitude_m=options.home_altitude,
        battery_percent=options.battery,
        speedup=options.speedup,
        faults=tuple(read_fault(text) for text in options.faults),
        parameters=dict(read_setting(text) for text in options.parameters),
        one_peer=options.one_peer,
        **_given(options),
    )


def _given(options: argparse.Namespace) -> dict[str, Any]:
    """What has another default for each autopilot."""
    from upwash.mavlink.version import Version

    given: dict[str, Any] = {}
    if options.armable_after is not None:
        given["armable_after_s"] = options.armable_after
    if options.version is not None:
        try:
            given["version"] = Version.read(options.version)
        except ValueError as error:
            raise UsageError(f"vehicle: --version {error}") from None
    return given


def _refuse(options: argparse.Namespace, given: dict[str, object]) -> None:
    for name, value in given.items():
        if value:
            raise UsageError(f"vehicle: {name} is not for --autopilot {options.autopilot}; leave it out")


def _announce(address: str) -> None:
    announce(f"vehicle ready at {address}")
    connection = address.replace("udp:", "udpout:", 1)  # it waits to be spoken to
    announce(f"fly it with: upwash fly --config drone.toml --autopilot {connection}")
