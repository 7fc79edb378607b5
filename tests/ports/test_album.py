"""Kept photos say where and how they were taken, to those who read EXIF, XMP or OpenDroneMap's geo.txt."""

from __future__ import annotations

import io
import re
from pathlib import Path

import exifread
import pytest
from tests.report.test_findings import jpeg

from upwash.core.camera.georeference import PhotoGeometry, Sight
from upwash.core.camera.lens import Lens
from upwash.core.geo import EarthPosition, Position
from upwash.core.vehicle.telemetry import Attitude
from upwash.errors import NotWritten, UsageError
from upwash.ports import KeptPhoto
from upwash.real.camera.album import FolderAlbum
from upwash.support.exif import PhotoPlace, with_place, with_pose

EARTH = EarthPosition(-20.5, 130.25, 432.1, 1_770_000_000.0)
SHOT = KeptPhoto(jpeg(), "/dev/video0", EARTH, angles_deg=(90.0, 10.0, -2.5), errors_m=(1.5, 1.0))


async def test_each_photo_is_a_file_with_a_line(tmp_path: Path) -> None:
    album = FolderAlbum(tmp_path / "photos")
    names = [await album.keep(photo) for photo in (SHOT, KeptPhoto(jpeg(), "DJI 7.JPG", EARTH))]
    assert names == ["00001.jpg", "00002-DJI_7.jpg"]
    assert (tmp_path / "photos" / "geo.txt").read_text().splitlines() == [
        "EPSG:4326",
        "00001.jpg 130.25000000 -20.50000000 432.10 90.00 10.00 -2.50 1.50 1.00",
        "00002-DJI_7.jpg 130.25000000 -20.50000000 432.10",
    ]


async def test_each_flight_has_a_folder_of_its_own_and_a_resumed_one_goes_on_in_its_last(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "kept"
    for _ in range(2):
        assert await FolderAlbum(folder).keep(SHOT) == "00001.jpg"
    assert await FolderAlbum(folder, resumes=True).keep(KeptPhoto(jpeg(), "a.jpg", EARTH)) == "00002-a.jpg"
    assert await FolderAlbum(folder, resumes=True).keep(SHOT) == "00003.jpg"
    named = {file.relative_to(tmp_path).as_posix() for file in tmp_path.rglob("*.jpg")}
    assert named == {"kept/00001.jpg", "kept-2/00001.jpg", "kept-2/00002-a.jpg", "kept-2/00003.jpg"}
    lines = (tmp_path / "kept-2" / "geo.txt").read_text().splitlines()
    assert [line.split()[0] for line in lines] == ["EPSG:4326", "00001.jpg", "00002-a.jpg", "00003.jpg"]


async def test_a_photo_that_was_not_kept_leaves_no_gap_in_the_numbers(tmp_path: Path) -> None:
    album = FolderAlbum(tmp_path / "kept")
    await album.keep(SHOT)
    (tmp_path / "kept").rename(tmp_path / "gone")
    (tmp_path / "kept").touch()
    with pytest.raises(NotWritten):
        await album.keep(SHOT)
    (tmp_path / "kept").unlink()
    (tmp_path / "gone").rename(tmp_path / "kept")
    assert await album.keep(SHOT) == "00002.jpg"


async def test_a_photo_without_a_place_has_no_line(tmp_path: Path) -> None:
    await FolderAlbum(tmp_path).keep(KeptPhoto(jpeg(), "x.jpg"))
    assert not (tmp_path / "geo.txt").exists()


@pytest.mark.parametrize(
    "source", ["../../etc/x.jpg", "a\nb.jpg", "\0.jpg", "é" * 300 + ".jpg", "", "rtsp://u:p@h/x"]
)
async def test_no_source_leads_out_of_the_folder(tmp_path: Path, source: str) -> None:
    name = await FolderAlbum(tmp_path / "a").keep(KeptPhoto(jpeg(), source, EARTH))
    assert re.fullmatch(r"[\w-]+\.jpg", name)
    assert [file.name for file in tmp_path.iterdir()] == ["a"]
    assert len((tmp_path / "a" / "geo.txt").read_text().splitlines()) == 2


async def test_a_folder_that_cannot_be_is_refused_and_a_full_one_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"camera\.keep"):
        FolderAlbum(tmp_path / "file" / "photos")
    album = FolderAlbum(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    (tmp_path / "gone").touch()
    with pytest.raises(NotWritten):
        await album.keep(SHOT)


def test_others_read_the_place_the_lens_and_the_angles() -> None:
    photo = with_place(jpeg(), PhotoPlace(-20.5, 130.25, 432.1, 90.0, 1_770_000_000.0, focal_35mm=29.8))
    posed = with_pose(photo, (90.0, 10.0, -2.5), (1.5, 1.0))
    tags = exifread.process_file(io.BytesIO(posed), details=True)
    assert exifread.utils.get_gps_coords(tags) == pytest.approx((-20.5, 130.25))
    assert float(tags["GPS GPSAltitude"].values[0]) == pytest.approx(432.1)
    assert tags["EXIF FocalLengthIn35mmFilm"].values == [30]
    assert b'Camera:Yaw="90.00" Camera:Pitch="10.00" Camera:Roll="-2.50"' in posed
    assert posed.endswith(jpeg()[100:])
    assert with_pose(posed, (0.0, 0.0, 0.0), (1.0, 1.0)) == posed, "XMP that is there stays"


@pytest.mark.parametrize(
    ("attitude", "tilt_deg", "angles_deg"),
    [
        (Attitude(0.0, 0.0, 45.0), 90.0, (45.0, 0.0, 0.0)),
        (Attitude(0.0, 0.0, 45.0), 60.0, (45.0, 30.0, 0.0)),
        (Attitude(0.0, 12.0, 0.0), 90.0, (0.0, 12.0, 0.0)),
        (Attitude(-7.0, 0.0, 200.0), 90.0, (200.0, 0.0, -7.0)),
    ],
)
def test_the_angles_are_those_of_mapping_programs(
    attitude: Attitude, tilt_deg: float, angles_deg: tuple[float, float, float]
) -> None:
    photo = PhotoGeometry(
        position=Position(0.0, 0.0, 30.0),
        size_px=(8, 6),
        lens=Lens(fov_deg=60.0, tilt_deg=tilt_deg),
        attitude=attitude,
    )
    sight = photo.sight
    assert isinstance(sight, Sight)
    assert sight.angles_deg == pytest.approx(angles_deg, abs=1e-9)
