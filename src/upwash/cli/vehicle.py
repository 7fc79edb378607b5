"""upwash vehicle: runs a stand-in vehicle."""

from __future__ import annotations

import argparse
import asyncio
import math
from typing import Any

from upwash.cli.arguments import announce, number, option, reads, repeated, whole
from upwash.core.geo import GeoPosition
from upwash.errors import UsageError
from upwash.launch.vehicle import run_vehicle
from upwash.mavlink.version import Version
from upwash.support.text import number_of
from upwash.vehicle.ardupilot.settings import VehicleSettings
from upwash.vehicle.body.copter import SecondBattery, read_fault
from upwash.vehicle.body.parameters import read_setting
from upwash.vehicle.px4.settings import Px4Settings


def _place(text: str) -> GeoPosition:
    try:
        latitude_deg, longitude_deg = map(number_of, text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not LAT,LON in degrees, such as 39.3666,22.9507"
        ) from None
    if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no place: latitudes go from -90 to 90, longitudes to 180 degrees"
        )
    return GeoPosition(latitude_deg, longitude_deg)


def _rally_point(text: str) -> GeoPosition:
    place, _, altitude = text.rpartition(",")
    try:
        where, altitude_m = _place(place), number_of(altitude)
    except (ValueError, argparse.ArgumentTypeError):
        raise UsageError(
            f'"{text}" is no rally point: write LAT,LON,ALT in degrees and metres, such as 39.3670,22.9511,30'
        ) from None
    if not -_RALLY_WITHIN_M <= altitude_m <= _RALLY_WITHIN_M:
        raise UsageError(
            f'"{text}" is no rally point: its altitude is not within {_RALLY_WITHIN_M:g} m of home'
        )
    return GeoPosition(where.latitude_deg, where.longitude_deg, altitude_m)


def _second_battery(text: str) -> SecondBattery:
    percent, _, seconds = text.partition(":")
    try:
        return SecondBattery(number_of(percent), *([number_of(seconds)] if seconds else []))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f'"{text}" is no battery: write percent, such as 80 or 80:400'
        ) from None


def _glitch(text: str) -> dict[str, float]:
    size, _, cleared = text.partition(":")
    try:
        found = {"glitch_m": number_of(size)}
        if cleared:
            found["glitch_cleared_after_s"] = math.inf if cleared == "inf" else number_of(cleared)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f'"{text}" is no glitch: write metres, such as 30 or 30:12'
        ) from None
    return found


_RALLY_WITHIN_M = 1_000.0
_GLITCH = (
    'arducopter: what the fault glitch is: how far GPS is off, and after how many seconds it says "Glitch cleared" '
    "though it still is (default: 55.66:20; inf: never)"
)
ARGUMENTS = {
    "--autopilot": option(
        "the autopilot to imitate (default: arducopter)", choices=("arducopter", "px4"), default="arducopter"
    ),
    "--listen": option("udp:HOST:PORT or tcp:HOST:PORT", default="udp:127.0.0.1:14550", type=None),
    "--version X.Y.Z": "of its firmware (default: 4.7.0-dev, PX4: 1.16.1): its names of parameters, and what it "
    "knows",
    "--serial N": option(
        "of its board, as two vehicles differ (default: one of its own; 0: none)", type=whole
    ),
    # where it stands, and its state at boot
    "--home LAT,LON": option("where it stands", type=_place, default="39.3666,22.9507"),
    "--home-altitude M": option("of the ground above the sea (default: 0)", type=number, default=0.0),
    "--armable-after S": option("after boot, in seconds (default: 41.4, PX4: 4)", type=number),
    "--battery PERCENT": option("how full it is at boot", type=number, default=100.0),
    "--second-battery PERCENT[:SECONDS]": option(
        "a second battery, how full it is at boot, and how long it lasts when full (default: no second battery)",
        type=_second_battery,
    ),
    "--param NAME=VALUE": repeated("a parameter at boot, such as FENCE_RADIUS=60", "parameters"),
    "--rally LAT,LON,ALT": repeated("a rally point, at an altitude in metres above home", "rally"),
    # how it flies, how its time passes, and what goes wrong
    "--speedup N": option("run its clock N times as fast", type=number, default=1.0),
    "--acceleration M_S2": option(
        "arducopter: speed up and brake alike, in m/s² (default: as a recorded one did)", type=number
    ),
    "--fault KIND[:FROM[-TO]]": repeated(
        "link, gps, glitch, battery, second-battery, radio, ground, compass or arming, from and to seconds after "
        "boot",
        "faults",
    ),
    "--glitch M[:CLEARED_S]": option(_GLITCH, type=_glitch),
    "--clock-offset S": option(
        "arducopter: difference of its GPS's time of day from this machine's clock", type=number, default=0.0
    ),
    "--one-peer": "px4, UDP: answer only the first sender until a restart, as a real one",
    "--signing-key FILE": reads("sign all messages with its key, and obey only messages signed with it"),
}


def run(options: argparse.Namespace) -> None:
    """Run the vehicle until a signal ends it."""
    settings = _px4(options) if options.autopilot == "px4" else _arducopter(options)
    asyncio.run(run_vehicle(options.listen, settings, ready=_announce, signing_key=options.signing_key))


def _arducopter(options: argparse.Namespace) -> VehicleSettings:
    _refuse(options, {"--one-peer": options.one_peer})
    return VehicleSettings(
        acceleration_m_s2=options.acceleration,
        clock_offset_s=options.clock_offset,
        **(options.glitch or {}),
        **_of_both(options),
    )


def _px4(options: argparse.Namespace) -> Px4Settings:
    of_arducopter = {
        "--acceleration": options.acceleration is not None,
        "--clock-offset": options.clock_offset,
        "--glitch": options.glitch,
    }
    _refuse(options, of_arducopter)
    return Px4Settings(one_peer=options.one_peer, **_of_both(options))


def _of_both(options: argparse.Namespace) -> dict[str, Any]:
    """The settings that both autopilots have."""
    settings = {
        "home": options.home,
        "home_altitude_m": options.home_altitude,
        "battery_percent": options.battery,
        "second_battery": options.second_battery,
        "speedup": options.speedup,
        "parameters": dict(read_setting(text) for text in options.parameters),
        "faults": tuple(read_fault(text) for text in options.faults),
        "rally": tuple(_rally_point(text) for text in options.rally),
    }
    if options.serial is not None:
        settings["serial"] = options.serial
    if options.armable_after is not None:
        settings["armable_after_s"] = options.armable_after
    if options.version is not None:
        try:
            settings["version"] = Version.read(options.version)
        except ValueError as error:
            raise UsageError(f"vehicle: --version {error}") from None
    return settings


def _refuse(options: argparse.Namespace, given: dict[str, object]) -> None:
    for name, value in given.items():
        if value:
            raise UsageError(f"vehicle: {name} is not for --autopilot {options.autopilot}; leave it out")


def _announce(address: str) -> None:
    announce(f"vehicle ready at {address}")
    connection = address.replace("udp:", "udpout:", 1)  # the vehicle listens
    announce(f"fly it with: upwash fly --config drone.toml --autopilot {connection}")
