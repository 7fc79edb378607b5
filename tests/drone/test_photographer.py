"""Photos that a mission gets know where on the Earth they were taken, where anything does."""

from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from PIL import ExifTags, Image

from upwash.config import read_drone_config
from upwash.core.geo import EarthPosition, Position
from upwash.drone.payload import Photographer
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate
from upwash.sim.camera import ModelCamera
from upwash.sim.loop import run_virtually

MISSION = """
from pathlib import Path

def fly(drone):
    told = drone.autopilot.earth_position
    drone.autopilot.arm()
    drone.autopilot.takeoff(20.0)
    drone.autopilot.goto(drone.plan[0])
    Path(__file__).with_name("photo.jpg").write_bytes(drone.camera.take_photo())
    {}
    drone.autopilot.return_home_and_land()
"""
SCENARIO = """
[mission]
program = "mission.py:fly"
waypoints_m = [[100, -50]]
{}
[camera]
park_seed = 1
photo_s = 1.23456789
"""
HOME = "home = { latitude_deg = -20.5, longitude_deg = 130.25 }"


def fly(folder: Path, *, home: str, statement: str = "pass") -> tuple[Run, bytes]:
    (folder / "mission.py").write_text(MISSION.format(statement))
    (folder / "scenario.toml").write_text(SCENARIO.format(home))
    run = simulate(read_drone_config(folder / "scenario.toml"))
    return run, (folder / "photo.jpg").read_bytes()


def test_a_photo_says_where_it_was_taken(tmp_path: Path) -> None:
    run, photo = fly(
        tmp_path,
        home=HOME,
        statement="assert drone.autopilot.earth_position.above_sea_m is None",
    )
    assert run.failure == ""
    (taken,) = (event for event in run.events if isinstance(event, schema.PhotoTaken))
    assert taken.latitude_deg is not None and taken.longitude_deg is not None
    assert taken.latitude_deg == pytest.approx(-20.5 - 50 / 110_700, abs=1e-5)
    assert taken.longitude_deg == pytest.approx(130.25 + 100 / 104_300, abs=1e-5)
    assert taken.above_sea_m is None
    assert taken.age_s == 1.234568
    assert taken.bytes == len(photo)
    gps = Image.open(io.BytesIO(photo)).getexif().get_ifd(ExifTags.IFD.GPSInfo)
    degrees, minutes, seconds = gps[ExifTags.GPS.GPSLatitude]
    assert float(degrees + minutes / 60 + seconds / 3600) == pytest.approx(-taken.latitude_deg, abs=2e-7)
    assert gps[ExifTags.GPS.GPSLatitudeRef] == "S"
    assert ExifTags.GPS.GPSAltitude not in gps


def test_the_log_has_what_a_photo_shows_of_the_ground(tmp_path: Path) -> None:
    run, photo = fly(tmp_path, home="")
    (taken,) = (event for event in run.events if isinstance(event, schema.PhotoTaken))
    assert taken.footprint_m is not None
    (left, upper), (right, _), (_, lower), _ = taken.footprint_m
    width, height = Image.open(io.BytesIO(photo)).size
    assert (left + right) / 2 == pytest.approx(taken.position.east_m, abs=0.01)
    assert (upper + lower) / 2 == pytest.approx(taken.position.north_m, abs=0.01)
    assert (right - left) / taken.position.altitude_m == pytest.approx(1.206, abs=0.001), "62.2 degrees"
    assert (right - left) / (upper - lower) == pytest.approx(width / height, abs=0.001)


def test_the_altitude_above_the_sea_is_logged_to_the_centimetre() -> None:
    log: list[schema.PhotoTaken] = []
    journal: Any = SimpleNamespace(record=log.append)
    thread: Any = SimpleNamespace(call=run_virtually)
    vehicle: Any = SimpleNamespace(
        position=Position(1.0, 2.0, 20.0),
        telemetry=SimpleNamespace(heading_deg=90.0),
        earth_position=EarthPosition(47.123456789, 8.5, 432.1987),
    )
    Photographer(ModelCamera(photo_s=1.0), thread, journal, autopilot=vehicle).take_photo()
    (taken,) = log
    assert (taken.latitude_deg, taken.longitude_deg, taken.above_sea_m) == (47.1234568, 8.5, 432.2)


def test_without_a_home_nothing_is_known_of_the_place(tmp_path: Path) -> None:
    run, photo = fly(tmp_path, home="", statement="assert told is drone.autopilot.earth_position is None")
    assert run.failure == ""
    (taken,) = (event for event in run.events if isinstance(event, schema.PhotoTaken))
    assert taken.latitude_deg is taken.longitude_deg is None
    assert not Image.open(io.BytesIO(photo)).getexif()
