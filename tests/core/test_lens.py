"""What a photo shows of the ground: its corners by altitude, field of view and direction."""

from __future__ import annotations

import math

import pytest

from upwash.core.geo import Position
from upwash.core.lens import Lens

SIZE_PX = (1600, 1200)
RIGHT_ANGLE = Lens(90.0)  # as wide as twice the altitude


@pytest.mark.parametrize(
    ("nose_deg", "upper_left"),
    [(0.0, (-20.0, 15.0)), (90.0, (15.0, 20.0)), (180.0, (20.0, -15.0)), (270.0, (-15.0, -20.0))],
)
def test_what_is_left_and_up_in_a_photo_turns_with_the_nose(
    nose_deg: float, upper_left: tuple[float, float]
) -> None:
    at = Position(100.0, 50.0, 20.0)
    corners = RIGHT_ANGLE.footprint_m(at, SIZE_PX, nose_deg)
    assert corners is not None
    first, _, third, _ = [(east - at.east_m, north - at.north_m) for east, north in corners]
    assert first == pytest.approx(upper_left)
    assert third == pytest.approx((-upper_left[0], -upper_left[1])), "opposite"


def test_the_corners_are_clockwise() -> None:
    corners = RIGHT_ANGLE.footprint_m(Position(0.0, 0.0, 20.0), SIZE_PX, 30.0)
    assert corners is not None
    area = sum(
        (east * other_north - other_east * north) / 2
        for (east, north), (other_east, other_north) in zip(corners, [*corners[1:], corners[0]], strict=True)
    )
    assert area == pytest.approx(-40.0 * 30.0)


def test_a_lens_of_its_own_direction_does_not_turn_with_the_nose() -> None:
    fixed = Lens(60.0, up_deg=0.0)
    at = Position(0.0, 0.0, 10.0)
    corners = fixed.footprint_m(at, SIZE_PX, None)
    assert corners == fixed.footprint_m(at, SIZE_PX, 123.0)
    assert corners is not None
    assert corners[1][0] - corners[0][0] == pytest.approx(2 * 10.0 * math.tan(math.radians(30.0)))


@pytest.mark.parametrize(
    ("altitude_m", "size_px", "nose_deg"),
    [(20.0, SIZE_PX, None), (0.0, SIZE_PX, 0.0), (-3.0, SIZE_PX, 0.0), (20.0, (0, 9), 0.0)],
)
def test_what_is_unknown_has_no_corners(
    altitude_m: float, size_px: tuple[int, int], nose_deg: float | None
) -> None:
    assert RIGHT_ANGLE.footprint_m(Position(0.0, 0.0, altitude_m), size_px, nose_deg) is None
