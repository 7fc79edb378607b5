"""Photos that a mission gets know where on the Earth they were taken, where anything does."""

from __future__ import annotations

import asyncio
import io
import math
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from PIL import ExifTags, Image
from tests.report.test_findings import jpeg

from upwash.config.drone_file import read_drone_config
from upwash.core.camera.georeference import Ground, PhotoGeometry, Place, Unplaced
from upwash.core.camera.lens import Lens
from upwash.core.geo import EarthPosition, Position, Velocity
from upwash.core.vehicle.telemetry import Attitude, GpsFix, Telemetry
from upwash.drone.mission import MissionThread
from upwash.drone.photographer import Photographer, PhotoPose
from upwash.errors import CameraError, UpwashError
from upwash.eventlog import schema
from upwash.eventlog.narration import Narrator
from upwash.lab.run import Run, simulate
from upwash.ports import Camera, OtherClock, Photo
from upwash.services import Detection
from upwash.sim.camera import ModelCamera
from upwash.sim.loop import run_virtually
from upwash.support.exif import PhotoPlace, own_place, with_place

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


@dataclass
class Reported:
    """A vehicle that reports this, `moves` metres east of there after a second."""

    earth: EarthPosition | None = None
    told: dict[str, Any] = field(default_factory=dict)
    moves_m: float = 0.0

    @property
    def position(self) -> Position:
        return Position(self.moves_m * asyncio.get_running_loop().time(), 2.0, 20.0)

    @property
    def earth_position(self) -> EarthPosition | None:
        return self.earth

    @property
    def telemetry(self) -> Telemetry:
        return Telemetry(self.position, "GUIDED", armed=True, **self.told)


def shoot(
    camera: Camera,
    vehicle: Reported,
    *,
    pointed_deg: tuple[float, float] | None = None,
    ground: Ground | None = None,
) -> tuple[PhotoPose, schema.PhotoTaken]:
    log: list[schema.PhotoTaken] = []
    journal: Any = SimpleNamespace(record=log.append)
    thread: Any = SimpleNamespace(call=run_virtually)
    autopilot: Any = vehicle
    payload: Any = SimpleNamespace(pointed_deg=pointed_deg)
    photographer = Photographer(
        camera, thread, journal, autopilot=autopilot, payload=payload, ground=lambda _: ground or Ground()
    )
    photographer.take_photo()
    assert photographer.pose is not None
    return photographer.pose, log[0]


class Shutter:
    """A camera with this lens, whose photo of 1,600 by 1,200 pixels is captured so long before it arrives."""

    def __init__(self, lens: Lens | None, *, late_s: float = 0.0) -> None:
        self._lens, self._late_s = lens, late_s

    async def take_photo(self, at: Position) -> Photo:
        await asyncio.sleep(1.0)
        now_s = asyncio.get_running_loop().time()
        return Photo(jpeg(1600, 1200), now_s - self._late_s, "test", lens=self._lens)


DOWN = Lens(fov_deg=90.0)


def geometry(camera: Camera, vehicle: Reported, **changed: Any) -> PhotoGeometry:
    found = shoot(camera, vehicle, **changed)[1].geometry
    assert found is not None
    return found


def test_a_photo_is_placed_where_the_drone_was_at_the_shutter() -> None:
    vehicle = Reported(moves_m=10.0, told={"attitude": Attitude(1.0, -2.0, 90.0)})
    photo = geometry(Shutter(DOWN, late_s=0.3), vehicle)
    assert photo.position.east_m == pytest.approx(7.0)
    assert photo.attitude == Attitude(1.0, -2.0, 90.0)
    assert photo.size_px == (1600, 1200)


@pytest.mark.parametrize(
    ("gps", "speed_m_s", "error_m"),
    [
        (None, 0.0, 1.5),
        (GpsFix("3d", hdop=0.7), 0.0, 1.5),
        (GpsFix("3d", hdop=2.0), 0.0, 3.0),
        (GpsFix("rtk-fixed", hdop=0.5), 0.0, 0.05),
        (GpsFix("3d", hdop=2.0, error_m=1.0), 0.0, 0.707),
        (GpsFix("rtk-fixed"), 10.0, 1.001),
        (GpsFix("none"), 0.0, 10.0),
    ],
)
def test_a_photo_says_how_sure_its_position_is(gps: GpsFix | None, speed_m_s: float, error_m: float) -> None:
    told = {"gps": gps, "velocity": Velocity(speed_m_s, 0.0, 0.0)}
    assert geometry(Shutter(DOWN), Reported(told=told)).accuracy.position_m == pytest.approx(error_m)


def film(
    every_s: float, *, fails: set[int], stops_s: float = math.inf
) -> tuple[list[float], list[float], str]:
    """When photos began and frames came, whose analysis takes 0.5 s, or 3 s for the third, and how it ended."""
    began, came = list[float](), list[float]()

    class Failing(ModelCamera):
        async def take_photo(self, at: Position) -> Photo:
            began.append(asyncio.get_running_loop().time())
            if len(began) in fails:
                raise CameraError("test", "no frame")
            return await super().take_photo(at)

    async def flight() -> str:
        loop, thread = asyncio.get_running_loop(), MissionThread()
        log: Any = SimpleNamespace(record=lambda _: came.append(loop.time()))
        vehicle: Any = Reported()
        photographer = Photographer(Failing(photo_s=0.2), thread, log, autopilot=vehicle, payload=vehicle)

        def program() -> None:
            for number, _ in enumerate(photographer.frames(every_s), 1):
                assert photographer.pose is not None
                thread.call(asyncio.sleep(3.0 if number == 3 else 0.5))

        if stops_s < math.inf:
            loop.call_later(stops_s, thread.stop, "the pilot has taken over")
        try:
            await thread.run(program)
        except UpwashError as error:
            return str(error)
        return ""

    end = run_virtually(flight())
    return began, came, end


def test_frames_are_photos_at_a_steady_pace_until_the_mission_is_stopped() -> None:
    began, came, end = film(1.0, fails=set(), stops_s=8.0)
    assert began == pytest.approx([0.0, 1.0, 2.0, 5.2, 6.2, 7.2]), "the third is looked at for 3 s"
    assert came == pytest.approx([at_s + 0.2 for at_s in began])
    assert end == "the pilot has taken over"


def test_a_frame_that_fails_is_left_out_and_a_camera_that_fails_is_an_error() -> None:
    began, came, end = film(1.0, fails={2, 3, 5, 6, 7})
    assert (len(began), len(came)) == (7, 2)
    assert began[1:4] == pytest.approx([1.0, 2.0, 3.0])
    assert end == "camera test: no frame"


@pytest.mark.parametrize("every_s", [-1.0, math.nan, math.inf])
def test_frames_need_a_time_that_passes(every_s: float) -> None:
    photographer: Any = Photographer(
        *[cast(Any, None)] * 3, autopilot=cast(Any, None), payload=cast(Any, None)
    )
    with pytest.raises(ValueError, match="give a number of seconds"):
        photographer.frames(every_s)


def test_a_mission_reads_where_an_object_lies() -> None:
    vehicle = Reported(told={"attitude": Attitude(0.0, 0.0, 90.0), "gps": GpsFix("rtk-fixed")})
    pose, _ = shoot(Shutter(DOWN), vehicle)
    found = pose.place_of(Detection(790.0, 0.0, 20.0, 20.0, label="car", score=0.9))
    assert isinstance(found, Place)
    assert found.position.east_m == pytest.approx(0.0 + 20.0 * 590 / 800), (
        "the nose, up in the photo, is east"
    )
    assert found.position.north_m == pytest.approx(2.0)
    assert 0.1 < found.error_m < 3.0


def test_what_has_no_place_says_why_to_a_mission() -> None:
    known, _ = shoot(Shutter(DOWN), Reported())
    assert "label" in why(known.place_of("a car"))
    unknown, taken = shoot(Shutter(None), Reported())
    assert taken.geometry is None
    assert "camera.fov_deg" in why(unknown.place_of({"x": 1, "y": 2, "label": "car"}))


def why(found: Place | Unplaced) -> str:
    assert isinstance(found, Unplaced)
    return found.why


def test_a_gimbal_keeps_the_camera_level_and_points_it() -> None:
    lens = Lens(fov_deg=62.0, tilt_deg=45.0, on_gimbal=True)
    leaning = {"attitude": Attitude(10.0, -10.0, 30.0)}
    still = geometry(Shutter(lens), Reported(told=leaning))
    assert (still.attitude, still.lens.tilt_deg) == (Attitude(0.0, 0.0, 30.0), 45.0)
    pointed = geometry(Shutter(lens), Reported(told=leaning), pointed_deg=(-60.0, 20.0))
    assert (pointed.lens.tilt_deg, pointed.lens.turned_deg) == (60.0, 20.0)
    reported = geometry(
        Shutter(lens),
        Reported(told={**leaning, "gimbal": Attitude(0.5, -70.0, 40.0)}),
        pointed_deg=(-60.0, 20.0),
    )
    assert (reported.attitude, reported.lens.tilt_deg) == (Attitude(0.5, -70.0, 40.0), 0.0)


def test_a_photo_says_what_ground_it_is_over() -> None:
    hill = Ground(altitude_m=3.0, slope_east=0.1, error_m=1.2)
    assert geometry(Shutter(DOWN), Reported(), ground=hill).ground == hill


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
    assert taken.geometry is not None
    corners = taken.geometry.footprint_m()
    assert corners is not None
    (left, upper), (right, _), (_, lower), _ = corners
    width, height = Image.open(io.BytesIO(photo)).size
    assert (left + right) / 2 == pytest.approx(taken.position.east_m, abs=0.01)
    assert (upper + lower) / 2 == pytest.approx(taken.position.north_m, abs=0.01)
    assert (right - left) / taken.position.altitude_m == pytest.approx(1.206, abs=0.001), "62.2 degrees"
    assert (right - left) / (upper - lower) == pytest.approx(width / height, abs=0.001)


def test_the_altitude_above_the_sea_is_logged_to_the_centimetre() -> None:
    vehicle = Reported(earth=EarthPosition(47.123456789, 8.5, 432.1987))
    _, taken = shoot(ModelCamera(photo_s=1.0), vehicle)
    assert (taken.latitude_deg, taken.longitude_deg, taken.above_sea_m) == (47.1234568, 8.5, 432.2)


class Album:
    """A camera whose photos are these, one after the other."""

    def __init__(self, *photos: bytes, other_clock: OtherClock | None = None) -> None:
        self._photos = iter(photos)
        self._other_clock = other_clock

    async def take_photo(self, at: Position) -> Photo:
        now_s = asyncio.get_running_loop().time()
        return Photo(next(self._photos), now_s, "DJI_7.JPG", lens=DOWN, other_clock=self._other_clock)


def taken(vehicle: Reported, *photos: bytes) -> tuple[list[bytes], list[str]]:
    """The photos that a mission gets, and what is doubted aloud."""
    log: list[object] = []
    photographer = Photographer(
        Album(*photos),
        cast(Any, SimpleNamespace(call=run_virtually)),
        cast(Any, SimpleNamespace(record=log.append)),
        autopilot=cast(Any, vehicle),
        payload=cast(Any, SimpleNamespace(pointed_deg=None)),
    )
    got = [photographer.take_photo() for _ in photos]
    return got, [event.why for event in log if isinstance(event, schema.PhotoPlaceDoubted)]


def test_a_camera_whose_clock_lags_is_named_once_with_both_times_and_the_difference() -> None:
    own = datetime(2026, 7, 1, 12, 0, 30, tzinfo=UTC)
    other = OtherClock(own - timedelta(hours=2, seconds=1.5), own)
    log: list[Any] = []
    photographer = Photographer(
        Album(jpeg(64, 48), jpeg(64, 48), other_clock=other),
        cast(Any, SimpleNamespace(call=run_virtually)),
        cast(Any, SimpleNamespace(record=log.append)),
        autopilot=cast(Any, Reported()),
        payload=cast(Any, SimpleNamespace(pointed_deg=None)),
    )
    photographer.take_photo()
    photographer.take_photo()
    (told,) = (event for event in log if isinstance(event, schema.CameraClockDiffers))
    assert told.behind_s == 7201.5
    sentence = Narrator().tell(told)
    assert sentence is not None and sentence.text.startswith(
        "the camera's clock says 2026-07-01 10:00:28 UTC where this computer's says 2026-07-01 12:00:30 UTC: "
        "7201.5 s behind; "
    )


EARTH = EarthPosition(47.1, 8.5, 432.0)


@pytest.mark.parametrize(
    ("speed_m_s", "away_m", "stays"), [(0, 45, True), (0, 55, False), (10, 95, True), (10, 105, False)]
)
def test_a_place_that_the_drone_can_have_flown_to_is_the_cameras_own(
    speed_m_s: float, away_m: float, *, stays: bool
) -> None:
    own = with_place(jpeg(64, 48), PhotoPlace(47.1 + away_m / 111_170, 8.5))
    vehicle = Reported(earth=EARTH, told={"velocity": Velocity(speed_m_s, 0.0, 0.0)})
    (photo,), doubts = taken(vehicle, own)
    assert (photo is own, doubts == []) == (stays, stays)


def test_a_place_that_cannot_be_is_doubted_once_and_the_drones_is_written() -> None:
    far = with_place(jpeg(64, 48), PhotoPlace(47.2, 8.5))
    photos, (why,) = taken(Reported(earth=EARTH, told={"velocity": Velocity()}), far, far)
    assert [own_place(photo) for photo in photos] == [pytest.approx((47.1, 8.5))] * 2
    assert "(47.200000, 8.500000) is 11,117 m from the drone, which can have flown 50 m at most" in why
    assert "the drone's place is written into it" in why


def test_a_photo_that_takes_no_place_says_so() -> None:
    full = jpeg(64, 48)[:2] + b"\xff\xe1\0\x0eExif\0\0XX*\0\0\0" + jpeg(64, 48)[2:]
    (photo,), (why,) = taken(Reported(earth=EARTH), full)
    assert photo is full
    assert "could not be written into it" in why


def test_the_direction_in_the_exif_is_that_of_the_photo() -> None:
    told = {"attitude": Attitude(0.0, 0.0, 90.0), "heading_deg": 90.3}
    (photo,), _ = taken(Reported(earth=EARTH, told=told), jpeg(64, 48))
    gps = Image.open(io.BytesIO(photo)).getexif().get_ifd(ExifTags.IFD.GPSInfo)
    assert gps[ExifTags.GPS.GPSImgDirection] == 90.0


def test_without_a_home_nothing_is_known_of_the_place(tmp_path: Path) -> None:
    run, photo = fly(tmp_path, home="", statement="assert told is drone.autopilot.earth_position is None")
    assert run.failure == ""
    (taken,) = (event for event in run.events if isinstance(event, schema.PhotoTaken))
    assert taken.latitude_deg is taken.longitude_deg is None
    assert not Image.open(io.BytesIO(photo)).getexif()
