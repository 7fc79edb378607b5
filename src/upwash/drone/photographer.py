"""The drone's camera as a mission uses it: photos, and where what they show lies."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, replace

import msgspec

from upwash.core.camera.georeference import (
    Accuracy,
    Ground,
    PhotoGeometry,
    Place,
    Sight,
    Unplaced,
    level_ground,
)
from upwash.core.camera.lens import Lens
from upwash.core.geo import (
    EarthPosition,
    GeoPosition,
    LocalFrame,
    Position,
    distance_m,
    ground_distance_m,
    part_way,
    rounded,
)
from upwash.core.vehicle.telemetry import Attitude, FixKind, Telemetry
from upwash.drone.answered_photos import AnsweredPhotos
from upwash.drone.mission import MissionThread
from upwash.drone.objects import FlightObjects
from upwash.drone.payload import Payload
from upwash.errors import CameraError, NotWritten
from upwash.eventlog import schema
from upwash.eventlog.objects import found_objects
from upwash.ports import Album, Autopilot, Camera, Journal, KeptPhoto, Photo
from upwash.support.background import now_s
from upwash.support.exif import PhotoPlace, own_place, with_place
from upwash.support.jpeg import size_of

_FAILURES = 3  # of frames in a row; a device that is silent takes 5 s for each
_DIGITS = 7  # of a degree: about a centimetre
_FIX_M: dict[FixKind, float] = {
    "none": 10.0, "2d": 5.0, "3d": 1.5, "dgps": 0.8, "rtk-float": 0.4, "rtk-fixed": 0.05,
}  # fmt: skip
_REPORT_S = 0.1  # between a position and its report
_GIMBAL_DEG = 1.0
_FILM_MM = 36.0  # wide, of 35 mm
_RECEIVERS_M = 50.0  # between the places of two receivers at one moment
_OWN_PLACE_S = 5.0  # the oldest place that a camera writes
_QUICK_M_S = 20.0  # of a vehicle whose speed is unknown


@dataclass(frozen=True, slots=True)
class PhotoPose:
    """Where and how the last photo was taken, at the moment of the shutter; None stands for what is unknown."""

    position: Position
    earth: EarthPosition | None
    attitude: Attitude | None
    heading_deg: float | None
    _geometry: PhotoGeometry | None
    _photos: AnsweredPhotos

    @property
    def gives_places(self) -> bool:
        """Whether objects on the photo have places, as the camera's lens is known."""
        return self._geometry is not None

    def place_of(self, found: object) -> Place | Unplaced:
        """Where an object lies that a service found on the photo, or why that is unknown.

        An object of an answer is placed by the photo that the call was made with. The object is a box or a point with
        a label, as `upwash.services.Detection` or a class of one's own.
        """
        objects = found_objects(msgspec.to_builtins(found))
        if objects is None or len(objects) != 1:
            return Unplaced("it is no box or point with a label")
        own = self._photos.of_objects(found)
        geometry = self._geometry if own is None else own.geometry
        if geometry is None:
            return Unplaced("the camera's lens is unknown: set camera.fov_deg")
        sight = geometry.sight
        return sight if isinstance(sight, Unplaced) else sight.place_of(*objects[0].middle_and_size)


@dataclass(frozen=True, slots=True)
class _Moment:
    at_s: float
    position: Position
    earth: EarthPosition | None
    told: Telemetry


class Photographer:
    """The camera as a mission uses it."""

    def __init__(
        self,
        camera: Camera,
        thread: MissionThread,
        journal: Journal,
        *,
        autopilot: Autopilot,
        payload: Payload,
        ground: Callable[[Position], Ground] = level_ground,
        album: Album | None = None,
        photos: AnsweredPhotos | None = None,
        objects: FlightObjects | None = None,
    ) -> None:
        self._camera = camera
        self._thread = thread
        self._journal = journal
        self._autopilot = autopilot
        self._payload = payload
        self._ground = ground
        self._album = album
        self._photos = photos or AnsweredPhotos()
        self._objects = objects or FlightObjects()
        self._told = set[str]()  # what the log has
        self.pose: PhotoPose | None = None  # of the last photo

    def take_photo(self) -> bytes:
        """Takes a photo and returns it as a JPEG, with its place on the Earth as EXIF if known; raises CameraError.

        A photo with a place by the camera's own GPS, near the drone, is returned unchanged. `pose` then has the
        photo's pose.
        """
        return self._thread.call(self._take_photo())

    def frames(self, every_s: float = 0.5) -> Iterator[bytes]:
        """Photos as by `take_photo`, one every `every_s` seconds until the loop is left or the mission ends.

        A photo that takes longer, or a mission that does, delays the next one. A photo that fails is left out; raises
        CameraError for the third failure in a row, and ValueError for a time below 0.
        """
        if not 0 <= every_s < math.inf:
            raise ValueError(f"every_s = {every_s}: give a number of seconds from 0 on")
        return self._frames(every_s)

    def _frames(self, every_s: float) -> Iterator[bytes]:
        began_s, failures = -math.inf, 0
        while True:
            began_s = self._thread.call(_wait_until(began_s + every_s))
            try:
                frame = self.take_photo()
            except CameraError:
                failures += 1
                if failures == _FAILURES:
                    raise
                continue
            failures = 0
            yield frame

    async def _take_photo(self) -> bytes:
        before = self._moment()
        photo = await self._camera.take_photo(before.position)
        after = self._moment()
        shot = _at(photo.captured_s, before, after)
        geometry, earth, told = self._geometry(photo, shot), shot.earth, shot.told
        self.pose = PhotoPose(shot.position, earth, told.attitude, told.heading_deg, geometry, self._photos)
        self._doubt_clock(photo)
        jpeg = self._placed(photo, shot, geometry, distance_m(before.position, after.position))
        self._photos.take(jpeg, geometry)
        self._journal.record(
            schema.PhotoTaken(
                source=await self._kept(jpeg, photo.source, earth, geometry),
                bytes=len(jpeg),
                age_s=round(now_s() - photo.captured_s, 6),
                position=rounded(shot.position),
                latitude_deg=_rounded(earth.latitude_deg, _DIGITS) if earth else None,
                longitude_deg=_rounded(earth.longitude_deg, _DIGITS) if earth else None,
                above_sea_m=_rounded(earth.above_sea_m, 2) if earth else None,
                geometry=geometry,
                truth=msgspec.to_builtins(photo.truth),
                object=self._objects.under_way,
            )
        )
        return jpeg

    def _placed(self, photo: Photo, shot: _Moment, geometry: PhotoGeometry | None, flown_m: float) -> bytes:
        """The photo with its place: the camera's own, or the drone's where the camera's is none or cannot be true."""
        if shot.earth is None:
            return photo.jpeg
        own = own_place(photo.jpeg)
        if own is not None:
            speed_m_s = shot.told.velocity.speed_m_s if shot.told.velocity else _QUICK_M_S
            reach_m = _RECEIVERS_M + flown_m + _OWN_PLACE_S * speed_m_s
            if (away_m := _away_m(shot.earth, own)) <= reach_m:
                return photo.jpeg
            why = (
                f"the camera's own place ({own[0]:.6f}, {own[1]:.6f}) is {away_m:,.0f} m from the drone, which can "
                f"have flown {reach_m:.0f} m at most: the drone's place is written into it, and into others like it"
            )
            self._record_once("own place", schema.PhotoPlaceDoubted(source=photo.source, why=why))
        placed = with_place(photo.jpeg, _place(shot.earth, shot.told, geometry))
        if placed is photo.jpeg and size_of(placed) is not None:  # the bytes of a model have no size
            why = (
                "the drone's place could not be written into it, as its header is damaged or full: the log has the "
                "place; have the camera write plain JPEG files"
            )
            self._record_once("not placed", schema.PhotoPlaceDoubted(source=photo.source, why=why))
        return placed

    def _record_once(self, what: str, event: schema.Event) -> None:
        if what not in self._told:
            self._told.add(what)
            self._journal.record(event)

    def _doubt_clock(self, photo: Photo) -> None:
        """Records that the camera's clock is wrong, or this computer's."""
        if (other := photo.other_clock) is not None:
            camera, own = other.camera, other.own
            behind_s = round((own - camera).total_seconds(), 1)
            differs = schema.CameraClockDiffers(
                source=photo.source, camera=camera, clock=own, behind_s=behind_s
            )
            self._record_once("clock", differs)

    async def _kept(
        self, jpeg: bytes, source: str, earth: EarthPosition | None, geometry: PhotoGeometry | None
    ) -> str:
        if self._album is None:
            return source
        photo = KeptPhoto(jpeg, source, earth)
        if geometry is not None and (sight := _sure_sight(geometry)) is not None:
            errors_m = geometry.accuracy.position_m, geometry.accuracy.altitude_m
            photo = replace(photo, angles_deg=sight.angles_deg, errors_m=errors_m)
        try:
            return await self._album.keep(photo)
        except NotWritten as error:
            self._record_once("album", schema.PhotosNotKept(why=str(error)))
            return source

    def _moment(self) -> _Moment:
        vehicle, at_s = self._autopilot, now_s()
        return _Moment(at_s, vehicle.position, vehicle.earth_position, vehicle.telemetry)

    def _geometry(self, photo: Photo, shot: _Moment) -> PhotoGeometry | None:
        told, size_px = shot.told, size_of(photo.jpeg) if photo.lens else None
        if photo.lens is None or size_px is None or min(size_px) <= 0:
            return None
        lens, attitude = self._held(photo.lens, told)
        return PhotoGeometry(
            position=rounded(shot.position),
            size_px=size_px,
            lens=lens,
            attitude=attitude and Attitude(*(round(angle, 2) for angle in astuple(attitude))),
            heading_deg=None if attitude else _rounded(told.heading_deg, 1),
            ground=self._ground(shot.position),
            accuracy=_accuracy(told, lens),
        )

    def _held(self, lens: Lens, told: Telemetry) -> tuple[Lens, Attitude | None]:
        if not lens.on_gimbal:
            return lens, told.attitude
        if told.gimbal is not None:
            return msgspec.structs.replace(lens, tilt_deg=0.0, turned_deg=0.0), told.gimbal
        if self._payload.pointed_deg is not None:
            pitch_deg, yaw_deg = self._payload.pointed_deg
            lens = msgspec.structs.replace(lens, tilt_deg=-pitch_deg, turned_deg=yaw_deg)
        nose_deg = told.heading_deg if told.attitude is None else told.attitude.yaw_deg
        return lens, None if nose_deg is None else Attitude(0.0, 0.0, nose_deg)


def _sure_sight(geometry: PhotoGeometry) -> Sight | None:
    sight = geometry.sight
    return sight if isinstance(sight, Sight) and not sight.assumes else None


async def _wait_until(time_s: float) -> float:
    loop = asyncio.get_running_loop()
    await asyncio.sleep(max(0.0, time_s - loop.time()))
    return loop.time()


def _at(captured_s: float, before: _Moment, after: _Moment) -> _Moment:
    """The moment of the shutter: places between the two reports, all else from the nearer one."""
    span_s = after.at_s - before.at_s
    share = min(1.0, max(0.0, (captured_s - before.at_s) / span_s)) if span_s > 0 else 1.0
    nearer = before if share < 0.5 else after
    here, there = before.position, after.position
    if here == there:
        return nearer
    earth = _earth_between(before.earth, after.earth, share)
    return _Moment(captured_s, part_way(here, there, share), earth, nearer.told)


def _earth_between(
    before: EarthPosition | None, after: EarthPosition | None, share: float
) -> EarthPosition | None:
    if before is None or after is None:
        return after if before is None else before
    turn_deg = math.remainder(after.longitude_deg - before.longitude_deg, 360)
    return EarthPosition(
        before.latitude_deg + share * (after.latitude_deg - before.latitude_deg),
        math.remainder(before.longitude_deg + share * turn_deg, 360),
        _between(before.above_sea_m, after.above_sea_m, share),
        _between(before.unix_s, after.unix_s, share),
    )


def _between(before: float | None, after: float | None, share: float) -> float | None:
    return None if before is None or after is None else before + share * (after - before)


def _accuracy(told: Telemetry, lens: Lens) -> Accuracy:
    """The standard errors of the photo's pose, by the receiver's fix, the speed and the mount."""
    usual, gps = Accuracy(), told.gps
    fix_m = usual.position_m  # to each side
    if gps is not None and gps.error_m is not None:
        fix_m = gps.error_m / math.sqrt(2)
    elif gps is not None:
        fix_m = _FIX_M[gps.kind] * max(1.0, gps.hdop or 1.0)
    moved_m = _REPORT_S * (told.velocity.speed_m_s if told.velocity else 0.0)
    return Accuracy(
        position_m=round(math.hypot(fix_m, moved_m), 3),
        altitude_m=usual.altitude_m,
        tilt_deg=_GIMBAL_DEG if lens.on_gimbal else usual.tilt_deg,
        heading_deg=usual.heading_deg,
    )


def _away_m(earth: EarthPosition, place: tuple[float, float]) -> float:
    frame = LocalFrame(GeoPosition(earth.latitude_deg, earth.longitude_deg))
    return ground_distance_m(Position(0.0, 0.0), frame.position(GeoPosition(*place)))


def _place(earth: EarthPosition, told: Telemetry, geometry: PhotoGeometry | None) -> PhotoPlace:
    """The drone's place, and the direction of up in the photo, or else of the nose."""
    heading_deg, focal_35mm = told.heading_deg, None
    if geometry is not None:
        if (sight := _sure_sight(geometry)) is not None:
            heading_deg = sight.angles_deg[0]
        focal_35mm = _FILM_MM * geometry.lens.focal_in(geometry.size_px) / geometry.size_px[0]
    latitude_deg, longitude_deg = earth.latitude_deg, earth.longitude_deg
    return PhotoPlace(latitude_deg, longitude_deg, earth.above_sea_m, heading_deg, earth.unix_s, focal_35mm)


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
