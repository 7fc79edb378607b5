"""A lens from a calibration file, as OpenCV and ROS write it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.core.camera.lens import Lens
from upwash.errors import UsageError
from upwash.support.loading import extra

if TYPE_CHECKING:
    import cv2

_LARGEST_BYTES = 1_000_000
_HEADER = "%YAML:1.0\n---\n"  # OpenCV asks for it, and ROS leaves it out
_DISTORTIONS = 5  # k1, k2, p1, p2, k3
_CALIBRATED = 0.003  # of the focal length


def read_calibration(file: Path) -> Lens:
    """The lens of a file with `image_width`, `image_height`, `camera_matrix` and `distortion_coefficients`.

    Raises UsageError for a file that cannot be read, or has another model of distortion.
    """
    with extra("detector"):
        import cv2
    try:
        if file.stat().st_size > _LARGEST_BYTES:
            raise UsageError(
                f"camera.calibration: {file} is larger than any calibration: name the right file"
            )
        text = file.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no text"
        raise UsageError(f"camera.calibration: {file} cannot be read: {why}") from error
    if not text.lstrip().startswith(("%YAML", "<?xml", "{")):
        text = _HEADER + text
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        return _lens(storage)
    except (cv2.error, SystemError, ValueError) as error:
        why = str(error) if type(error) is ValueError else "it is no YAML, XML or JSON as OpenCV reads them"
        raise UsageError(f"camera.calibration: {file} is no calibration: {why}") from error


def _lens(storage: cv2.FileStorage) -> Lens:
    width, height = (storage.getNode(name).real() for name in ("image_width", "image_height"))
    matrix = _numbers(storage.getNode("camera_matrix"))
    if not (width > 0 and height > 0) or len(matrix) != 9 or not matrix[0] > 0:
        raise ValueError("it needs image_width, image_height, and a camera_matrix of nine numbers")
    bends = _numbers(storage.getNode("distortion_coefficients"))
    while bends and bends[-1] == 0:
        bends.pop()
    model = storage.getNode("distortion_model")
    if len(bends) > _DISTORTIONS or (not model.empty() and model.string() not in {"", "plumb_bob"}):
        raise ValueError("its distortion is not that of k1, k2, p1, p2 and k3: calibrate with that model")
    if not all(math.isfinite(number) for number in (*matrix, *bends)):
        raise ValueError("it has numbers that are not finite")
    return Lens(
        fov_deg=math.degrees(2 * math.atan(width / 2 / matrix[0])),
        centre=(matrix[2] / width, matrix[5] / height),
        distortion=tuple(bends),
        scale_error=_CALIBRATED,
    )


def _numbers(node: cv2.FileNode) -> list[float]:
    """The numbers of a matrix or a list."""
    data = node.getNode("data") if node.isMap() else node
    return [data.at(index).real() for index in range(data.size())] if data.isSeq() else []
