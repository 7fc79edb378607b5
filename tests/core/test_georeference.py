"""Where an object on a photo lies: against OpenCV's own projection, and the error that is stated of each place."""

from __future__ import annotations

import math
import random
from itertools import product
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.camera.georeference import Accuracy, Ground, PhotoGeometry, Place, Sight, Unplaced
from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.core.vehicle.telemetry import Attitude

SIZE = (1600, 1200)
HERE = Position(100.0, -50.0, 30.0)
LEVEL = Attitude(0.0, 0.0, 0.0)


def geometry(**changed: object) -> PhotoGeometry:
    usual = PhotoGeometry(position=HERE, size_px=SIZE, lens=Lens(fov_deg=62.0), attitude=LEVEL)
    return msgspec.structs.replace(usual, **changed)


def sight(photo: PhotoGeometry) -> Sight:
    found = photo.sight
    assert isinstance(found, Sight)
    return found


def place(photo: PhotoGeometry, x_px: float, y_px: float, *size_px: float) -> Place:
    found = sight(photo).place_of(x_px, y_px, *size_px)
    assert isinstance(found, Place)
    return found


def pixel_of(photo: PhotoGeometry, target: Position) -> tuple[float, float]:
    """The pixel of a place by OpenCV, with rotations as matrices: another way than the code under test."""
    cv2 = pytest.importorskip("cv2")
    np = pytest.importorskip("numpy")
    attitude, lens = photo.attitude, photo.lens
    assert attitude is not None

    def about(axis: int, angle_deg: float) -> Any:
        vector = np.zeros(3)
        vector[axis] = math.radians(angle_deg)
        return cv2.Rodrigues(vector)[0]

    vehicle = about(2, attitude.yaw_deg) @ about(1, attitude.pitch_deg) @ about(0, attitude.roll_deg)
    mount = about(2, lens.turned_deg) @ about(1, -lens.tilt_deg)
    optical = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # its columns: right, down and ahead in the photo
    north_east_down = np.array(
        [
            target.north_m - photo.position.north_m,
            target.east_m - photo.position.east_m,
            photo.position.altitude_m - target.altitude_m,
        ]
    )
    to_camera = (vehicle @ mount @ optical).T
    focal_px = lens.focal_in(photo.size_px)
    matrix = np.array([[focal_px, 0, 800.0], [0, focal_px, 600.0], [0, 0, 1]])
    bent = np.array((*lens.distortion, 0, 0, 0, 0, 0)[:5], dtype=float)
    pixels, _ = cv2.projectPoints(
        (to_camera @ north_east_down).reshape(1, 3), np.zeros(3), np.zeros(3), matrix, bent
    )
    return float(pixels[0, 0, 0]), float(pixels[0, 0, 1])


@pytest.mark.parametrize("distortion", [(), (-0.12, 0.04, 0.001, -0.002, 0.003)])
@pytest.mark.parametrize("tilt_deg", [90.0, 60.0])
@pytest.mark.parametrize("turned_deg", [0.0, 25.0])
def test_a_place_is_where_opencv_projects_it_from(
    tilt_deg: float, turned_deg: float, distortion: tuple[float, ...]
) -> None:
    lens = Lens(focal_px=1300.0, tilt_deg=tilt_deg, turned_deg=turned_deg, distortion=distortion)
    for roll_deg, pitch_deg, yaw_deg in product((-8.0, 5.0), (-6.0, 10.0), (0.0, 75.0, 200.0)):
        photo = geometry(lens=lens, attitude=Attitude(roll_deg, pitch_deg, yaw_deg))
        axis = sight(photo).line_to(800, 600)
        assert axis is not None
        for aside in (-6.0, 0.0, 7.0):
            target = Position(HERE.east_m + axis[0] + aside, HERE.north_m + axis[1] - aside / 2, 0.0)
            found = place(photo, *pixel_of(photo, target)).position
            assert (found.east_m, found.north_m) == pytest.approx((target.east_m, target.north_m), abs=1e-4)


def test_sloping_ground_moves_the_place() -> None:
    ground = Ground(altitude_m=4.0, slope_east=0.2, slope_north=-0.1)
    photo = geometry(ground=ground, attitude=Attitude(3.0, -4.0, 120.0))
    east_m, north_m = 7.0, -5.0
    target = Position(HERE.east_m + east_m, HERE.north_m + north_m, 4.0 + 0.2 * east_m - 0.1 * north_m)
    found = place(photo, *pixel_of(photo, target)).position
    assert (found.east_m, found.north_m, found.altitude_m) == pytest.approx(
        (target.east_m, target.north_m, target.altitude_m), abs=1e-4
    )


@pytest.mark.parametrize(
    ("yaw_deg", "upper_left"),
    [(0.0, (-20.0, 15.0)), (90.0, (15.0, 20.0)), (180.0, (20.0, -15.0)), (270.0, (-15.0, -20.0))],
)
def test_the_footprint_turns_with_the_nose(yaw_deg: float, upper_left: tuple[float, float]) -> None:
    above = Position(100.0, -50.0, 20.0)
    corners = geometry(
        position=above, lens=Lens(fov_deg=90.0), attitude=Attitude(0.0, 0.0, yaw_deg)
    ).footprint_m()
    assert corners is not None
    first, _, third, _ = [(east - above.east_m, north - above.north_m) for east, north in corners]
    assert first == pytest.approx(upper_left)
    assert third == pytest.approx((-upper_left[0], -upper_left[1])), "opposite"


def test_the_corners_are_clockwise() -> None:
    corners = geometry(lens=Lens(fov_deg=90.0), attitude=Attitude(5.0, -7.0, 30.0)).footprint_m()
    assert corners is not None
    assert (
        sum(
            east * other_north - other_east * north
            for (east, north), (other_east, other_north) in zip(
                corners, [*corners[1:], corners[0]], strict=True
            )
        )
        < -2 * 60 * 40
    )


def test_a_camera_that_is_always_level_does_not_turn_with_the_vehicle() -> None:
    lens = Lens(fov_deg=62.0, up_deg=0.0)
    turned = geometry(lens=lens, attitude=Attitude(9.0, 9.0, 123.0))
    assert (
        turned.footprint_m() == geometry(lens=lens, attitude=None).footprint_m() == geometry().footprint_m()
    )


@pytest.mark.parametrize(
    ("photo", "why"),
    [
        (geometry(position=Position(0.0, 0.0, 0.0)), "above the ground"),
        (geometry(position=Position(0.0, 0.0, math.nan)), "above the ground"),
        (geometry(ground=Ground(altitude_m=31.0)), "above the ground"),
        (geometry(lens=Lens(fov_deg=62.0, tilt_deg=0.0)), "horizon"),
        (geometry(lens=Lens(fov_deg=62.0, tilt_deg=-60.0)), "horizon"),
        (geometry(attitude=Attitude(180.0, 0.0, 0.0)), "horizon"),
        (geometry(lens=Lens(fov_deg=62.0, distortion=(-9.0, 0.0))), "distortion"),
        (geometry(ground=Ground(slope_north=-50.0)), "horizon"),
    ],
)
def test_what_has_no_place_says_why(photo: PhotoGeometry, why: str) -> None:
    ready = photo.sight
    assert photo.footprint_m() is None
    found = ready.place_of(900.0, 300.0) if isinstance(ready, Sight) else ready
    assert isinstance(found, Unplaced)
    assert why in found.why


@pytest.mark.parametrize("x_px", [-1.0, 1601.0, math.nan, math.inf])
def test_a_box_beside_the_photo_has_no_place(x_px: float) -> None:
    assert isinstance(sight(geometry()).place_of(x_px, 10.0), Unplaced)


def test_without_an_attitude_the_place_says_what_it_assumes_and_is_less_sure() -> None:
    known = place(geometry(), 1500.0, 600.0)
    by_heading = place(geometry(attitude=None, heading_deg=0.0), 1500.0, 600.0)
    by_nothing = place(geometry(attitude=None), 1500.0, 600.0)
    assert known.position == by_heading.position == by_nothing.position
    assert (known.assumes, by_heading.assumes) == ("", "that the drone was level")
    assert "north" in by_nothing.assumes
    assert known.error_m < by_heading.error_m < by_nothing.error_m
    assert by_nothing.error_m > math.hypot(16.0, 0.0), "the object may lie on any side of the drone"


def test_an_object_that_the_edge_cuts_off_is_less_sure() -> None:
    inside = place(geometry(), 1400.0, 600.0, 190.0, 100.0)
    cut = place(geometry(), 1504.0, 600.0, 190.0, 100.0)
    assert cut.error_m > inside.error_m + 0.5


@pytest.mark.parametrize("altitude_m", [10.0, 60.0])
@pytest.mark.parametrize("tilt_deg", [90.0, 75.0, 60.0])
@pytest.mark.parametrize("position_m", [0.0, 1.5])
def test_the_stated_error_holds_in_95_of_100(altitude_m: float, tilt_deg: float, position_m: float) -> None:
    """The true pose differs from the reported one by the stated errors; a photo's pixels show the true one."""
    rng = random.Random(7)
    sure = Accuracy(position_m=position_m, altitude_m=0.5, tilt_deg=1.0, heading_deg=2.0)
    inside = 0
    number = 1500
    for _ in range(number):
        told = geometry(
            position=Position(0.0, 0.0, altitude_m),
            lens=Lens(fov_deg=62.0, tilt_deg=tilt_deg),
            attitude=Attitude(rng.uniform(-10, 10), rng.uniform(-10, 10), rng.uniform(0, 360)),
            accuracy=sure,
            ground=Ground(error_m=0.0),
        )
        attitude = told.attitude
        assert attitude is not None
        true = msgspec.structs.replace(
            told,
            position=Position(
                rng.gauss(0, position_m), rng.gauss(0, position_m), altitude_m + rng.gauss(0, 0.5)
            ),
            attitude=Attitude(
                attitude.roll_deg + rng.gauss(0, 1.0),
                attitude.pitch_deg + rng.gauss(0, 1.0),
                attitude.yaw_deg + rng.gauss(0, 2.0),
            ),
        )
        pixel = rng.uniform(0, SIZE[0]), rng.uniform(0, SIZE[1])
        lies, stated = place(true, *pixel), place(told, *pixel)
        away_m = math.dist(
            (lies.position.east_m, lies.position.north_m), (stated.position.east_m, stated.position.north_m)
        )
        inside += away_m <= stated.error_m
    assert 0.93 <= inside / number <= 0.99


@given(st.data())
def test_any_geometry_of_a_log_has_places_or_says_why(data: st.DataObject) -> None:
    """What the types of the log allow: extreme, and never an exception or an endless error."""
    number, angle, sure = st.floats(-1e9, 1e9), st.floats(-360, 360), st.floats(0, 1e6)
    photo = PhotoGeometry(
        position=Position(data.draw(number), data.draw(number), data.draw(number)),
        size_px=(data.draw(st.integers(1, 1_000_000)), data.draw(st.integers(1, 1_000_000))),
        lens=Lens(
            fov_deg=data.draw(st.none() | st.floats(1, 170)),
            focal_px=data.draw(st.none() | st.floats(1e-6, 1e6)),
            centre=(data.draw(number), data.draw(number)),
            distortion=tuple(data.draw(st.lists(number, max_size=5))),
            tilt_deg=data.draw(angle),
        ),
        attitude=data.draw(st.none() | st.builds(Attitude, number, number, number)),
        heading_deg=data.draw(st.none() | number),
        ground=Ground(
            data.draw(number),
            data.draw(st.floats(-100, 100)),
            data.draw(st.floats(-100, 100)),
            data.draw(sure),
        ),
        accuracy=Accuracy(*(data.draw(sure) for _ in range(4))),
    )
    photo.footprint_m()
    if isinstance(ready := photo.sight, Sight):
        found = ready.place_of(*(data.draw(st.floats(0, 1e6)) for _ in range(4)))
        assert isinstance(found, Unplaced) or math.isfinite(found.error_m + found.apart_m)
        assert all(map(math.isfinite, ready.angles_deg))


def test_a_geometry_survives_the_log() -> None:
    photo = geometry(lens=Lens(focal_px=900.0, distortion=(0.1,)), ground=Ground(slope_east=0.1))
    assert msgspec.json.decode(msgspec.json.encode(photo), type=PhotoGeometry) == photo
