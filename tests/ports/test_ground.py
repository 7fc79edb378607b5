"""Files about the camera and the ground: a calibration, and a grid of altitudes."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
import yaml
from rasterio.transform import from_origin

from upwash.core.geo import GeoPosition, LocalFrame, Position
from upwash.errors import UsageError
from upwash.real.camera.calibration import read_calibration
from upwash.real.camera.terrain import Terrain

ROS = """
image_width: 1600
image_height: 1200
camera_name: down
camera_matrix: {rows: 3, cols: 3, data: [800.0, 0.0, 792.0, 0.0, 801.0, 612.0, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.1, 0.02, 0.001, 0.0, 0.0]}
"""
HOME = GeoPosition(47.3, 8.5)


def by_opencv(file: Path) -> None:
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1600)
    storage.write("image_height", 1200)
    storage.write("camera_matrix", np.array([[800.0, 0, 792], [0, 801, 612], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array([[-0.1, 0.02, 0.001, 0.0, 0.0]]))
    storage.release()


def by_ros(file: Path) -> None:
    file.write_text(ROS)


def by_an_editor(file: Path) -> None:
    file.write_text("---\n" + yaml.safe_dump(yaml.safe_load(ROS)))


def by_a_driver_with_k6(file: Path) -> None:
    zeros = ROS.replace("plumb_bob", "rational_polynomial").replace("cols: 5", "cols: 8")
    file.write_text(zeros.replace("0.001, 0.0, 0.0]", "1e-03, 0e+00, 0.0, 0.0, 0.0, 0.0]"))


@pytest.mark.parametrize("write", [by_opencv, by_ros, by_an_editor, by_a_driver_with_k6])
def test_a_calibration_is_read(tmp_path: Path, write: Callable[[Path], None]) -> None:
    write(tmp_path / "camera.yaml")
    lens = read_calibration(tmp_path / "camera.yaml")
    assert lens.fov_deg == pytest.approx(90.0)
    assert lens.focal_in((800, 600)) == pytest.approx(400.0)
    assert lens.centre == pytest.approx((0.495, 0.51))
    assert lens.distortion == (-0.1, 0.02, 0.001)
    assert lens.direction(396.0, 306.0, (800, 600)) == pytest.approx((0.0, 0.0))
    assert lens.fits((800, 600)) and lens.fits((1640, 1232)) and not lens.fits((1600, 900))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "image_width"),
        ("[1, 2", "no YAML"),
        ("\x00\x01" * 50, "calibration"),
        (ROS.replace("plumb_bob", "equidistant"), "that model"),
        (ROS.replace("792.0", "1601.0"), r"outside its 1600 x 1200 pixels"),
        (ROS.replace("image_width: 1600", "image_width: 2026-01-01"), "no number"),
        ("a: &a [1, 2]\ncamera_matrix: [*a, *a]\n", "aliases"),
        (ROS.replace("800.0", ".nan"), "not finite"),
        (ROS.replace("image_width: 1600", "image_width: -3"), "image_width"),
        (ROS.replace("0.0, 0.0, 1.0]}", "]}"), "calibration"),
        ("x" * 1_000_001, "larger"),
        (ROS.replace("image_width: 1600", "image_width: wide"), "image_width"),
        (ROS.replace("image_width: 1600", "image_width: .Inf"), "not finite"),
        (ROS.replace("-0.1", "a"), "no number"),
        (ROS.replace("-0.1", "[1]"), "no number"),
        (ROS.replace("800.0", "1e300"), "does not fit"),
        (ROS.replace("800.0", "1e-300"), "does not fit"),
        ("a: " + "[" * 6_000, "more than 5,000"),
        ('{"a":' * 6_000, "more than 5,000"),
        ('<?xml version="1.0"?><opencv_storage>' + "<a>" * 6_000, "more than 5,000"),
    ],
)
def test_what_is_no_calibration_is_refused(tmp_path: Path, text: str, why: str) -> None:
    (tmp_path / "camera.yaml").write_text(text)
    with pytest.raises(UsageError, match=why):
        read_calibration(tmp_path / "camera.yaml")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_calibration_may_be_text_as_windows_writes_it(encoding: str, tmp_path: Path) -> None:
    (tmp_path / "camera.yaml").write_text(ROS.replace("\n", "\r\n"), encoding)
    assert read_calibration(tmp_path / "camera.yaml").fov_deg == pytest.approx(90.0)


@pytest.mark.parametrize(
    "make", [lambda _: None, os.mkfifo, Path.mkdir, lambda file: file.symlink_to("/dev/zero")]
)
def test_a_calibration_that_is_no_file_is_refused(make: Callable[[Path], object], tmp_path: Path) -> None:
    make(tmp_path / "camera.yaml")
    with pytest.raises(UsageError, match=r"camera\.yaml cannot be read: "):
        read_calibration(tmp_path / "camera.yaml")


def grid(file: Path, *, hole: bool = False, nodata: float | None = -9999.0, crs: str = "EPSG:4326") -> Path:
    """A hill side of 1 in 10 towards the east, 400 m above the sea at home, around HOME."""
    step_deg, side = 0.0001, 100
    east_m, _ = LocalFrame(HOME).metres_per_degree()
    columns = (np.arange(side) + 0.5 - side / 2) * step_deg * east_m
    heights = np.tile(400.0 + 0.1 * columns, (side, 1)).astype(np.float32)
    if hole:
        heights[:, 60:] = -9999.0
    corner = from_origin(
        HOME.longitude_deg - side / 2 * step_deg, HOME.latitude_deg + side / 2 * step_deg, step_deg, step_deg
    )
    with rasterio.open(
        file, "w", driver="GTiff", height=side, width=side, count=1, dtype="float32", crs=crs,
        transform=corner, nodata=nodata,
    ) as opened:  # fmt: skip
        opened.write(heights, 1)
    return file


@pytest.mark.parametrize("nodata", [-9999.0, None])
def test_the_ground_is_a_plane_through_the_grid(nodata: float | None, tmp_path: Path) -> None:
    with closing(Terrain(grid(tmp_path / "hill.tif", nodata=nodata), HOME)) as terrain:
        ground = terrain.ground(Position(100.0, 50.0, 40.0))
    assert ground.altitude_m == pytest.approx(10.0, abs=0.6)
    assert ground.slope_east == pytest.approx(0.1, abs=0.02)
    assert ground.slope_north == pytest.approx(0.0, abs=0.01)
    assert 1.0 <= ground.error_m < 1.5


@pytest.mark.parametrize("place", [Position(3000.0, 0.0, 20.0), Position(150.0, 0.0, 20.0)])
def test_where_the_grid_ends_the_ground_is_level_and_says_so(tmp_path: Path, place: Position) -> None:
    with closing(Terrain(grid(tmp_path / "hill.tif", hole=True), HOME)) as terrain:
        ground = terrain.ground(place)
    assert (ground.altitude_m, ground.slope_east) == (0.0, 0.0)
    assert "does not reach" in ground.assumes
    assert ground.error_m == 5.0


def test_what_is_no_grid_or_lies_elsewhere_is_refused(tmp_path: Path) -> None:
    (tmp_path / "no.tif").write_bytes(b"II*\0" + bytes(100))
    with pytest.raises(UsageError, match="no grid that GDAL reads"):
        Terrain(tmp_path / "no.tif", HOME)
    elsewhere = grid(tmp_path / "hill.tif")
    with closing(Terrain(elsewhere, HOME)):
        pass  # the first grid opens the database of PROJ, for good
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(UsageError, match=r"mission\.home") as refused:
        Terrain(elsewhere, GeoPosition(10.0, 10.0))
    assert len(list(Path("/proc/self/fd").iterdir())) == before, f"closed, though {refused} holds it"


LOCAL = 'LOCAL_CS["field",UNIT["metre",1]]'


def cut(file: Path) -> None:
    grid(file)
    os.truncate(file, file.stat().st_size // 2)


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (os.mkfifo, "is no file"),
        (Path.touch, "is no grid that GDAL reads"),
        (cut, r"cannot be read at mission\.home"),
        (lambda file: grid(file, crs=LOCAL), r"cannot be read at mission\.home"),
    ],
    ids=["pipe", "empty", "cut off", "not on the Earth"],
)
def test_a_terrain_that_cannot_be_read_is_refused(
    make: Callable[[Path], object], why: str, tmp_path: Path
) -> None:
    make(tmp_path / "hill.tif")
    with pytest.raises(UsageError, match=rf"camera\.terrain: .*hill\.tif {why}"):
        Terrain(tmp_path / "hill.tif", HOME)
