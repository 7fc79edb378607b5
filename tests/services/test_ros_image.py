"""Raw images of ROS 2 as JPEGs: the encodings whose pixels are no bytes in a row."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from upwash.errors import CameraError
from upwash.services.ros_image import jpeg_of_message

HIGH, WIDE = 48, 64


def message(encoding: str, pixels: Any) -> SimpleNamespace:
    return SimpleNamespace(
        encoding=encoding,
        height=HIGH,
        width=WIDE,
        step=pixels.strides[0],
        is_bigendian=0,
        data=pixels.tobytes(),
    )


def photo(encoding: str, pixels: Any) -> Any:
    jpeg = jpeg_of_message("/camera", message(encoding, pixels))
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED)


@pytest.mark.parametrize(("encoding", "strongest"), [("nv12", 0), ("nv21", 2)])
def test_the_two_colours_of_a_semi_planar_image_are_in_the_order_of_its_encoding(
    encoding: str, strongest: int
) -> None:
    pixels = np.full((HIGH * 3 // 2, WIDE), 128, np.uint8)
    pixels[HIGH:, 0::2] = 200  # blue in nv12, red in nv21
    seen = photo(encoding, pixels)
    assert seen.shape == (HIGH, WIDE, 3)
    assert seen[HIGH // 2, WIDE // 2].argmax() == strongest


def test_a_semi_planar_image_without_its_colours_is_refused() -> None:
    with pytest.raises(CameraError, match="64 x 48 pixels of nv12"):
        jpeg_of_message("/camera", message("nv12", np.full((HIGH, WIDE), 128, np.uint8)))


def test_floats_have_the_darkest_and_brightest_as_black_and_white_and_no_noise_is_spread() -> None:
    heat = np.full((HIGH, WIDE), 295.0, np.float32)
    heat[10:20, 10:20] = 330.0
    heat[40, 40] = np.nan
    seen = photo("32FC1", heat)
    assert seen[15, 15] > 250 and seen[30, 30] < 5
    faint = np.full((HIGH, WIDE), 295.0, np.float32)
    faint[:, ::2] = 295.01
    assert np.ptp(photo("32FC1", faint)) < 10


def test_floats_of_which_none_is_finite_are_no_photo() -> None:
    with pytest.raises(CameraError, match="no finite number"):
        jpeg_of_message("/camera", message("32FC1", np.full((HIGH, WIDE), np.inf, np.float32)))
