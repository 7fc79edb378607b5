"""A lens from a calibration file, as OpenCV and ROS write it."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

from upwash.core.camera.lens import Lens
from upwash.errors import UsageError
from upwash.support.input_files import read_file, text_of, why_unreadable
from upwash.support.loading import extra

if TYPE_CHECKING:
    import cv2

_LARGEST_BYTES = 1_000_000
_HEADER = "%YAML:1.0\n---\n"  # OpenCV asks for it, and ROS leaves it out
_DISTORTIONS = 5  # k1, k2, p1, p2, k3
_LEAST_FOV_DEG, _MOST_FOV_DEG = 1.0, 170.0
_OPENING = re.compile(r"[\[{:]|-(?=\s)|<(?=[A-Za-z_])")
_MOST_OPENED = 5000  # a calibration has 10 to 100
_MOST_NUMBERS = 100  # of a matrix
_CALIBRATED = 0.003  # of the focal length


def read_calibration(file: Path) -> Lens:
    """The lens of a file with `image_width`, `image_height`, `camera_matrix` and `distortion_coefficients`.

    Raises UsageError for a file that cannot be read, or has another model of distortion.
    """
    with extra("detector"):
        import cv2
    try:
        content = read_file(file, most_bytes=_LARGEST_BYTES)
    except (OSError, ValueError) as error:
        why = f"cannot be read: {why_unreadable(error)}; check the path"
        raise UsageError(f"camera.calibration: {file} {why}") from error
    try:
        text = text_of(content)
    except UnicodeDecodeError as error:
        raise UsageError(f"camera.calibration: {file} cannot be read: it is no text") from error
    if not text.lstrip().startswith(("%YAML", "<?xml", "{")):
        text = _HEADER + text
    try:
        if sum(1 for _ in _OPENING.finditer(text)) > _MOST_OPENED:  # OpenCV crashes where it nests deeply
            raise ValueError(
                f"it has more than {_MOST_OPENED:,} brackets, braces, colons, dashes or elements"
            )
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        return _lens(storage)
    except (cv2.error, SystemError, ValueError) as error:
        why = str(error) if type(error) is ValueError else "it is no YAML, XML or JSON as OpenCV reads them"
        raise UsageError(f"camera.calibration: {file} is no calibration: {why}") from error


def _lens(storage: cv2.FileStorage) -> Lens:
    width, height = (_number(storage.getNode(name)) for name in ("image_width", "image_height"))
    matrix = _numbers(storage.getNode("camera_matrix"))
    if not (0 < width < math.inf and 0 < height < math.inf) or len(matrix) != 9 or not matrix[0] > 0:
        raise ValueError("it needs image_width, image_height, and a camera_matrix of nine numbers")
    bends = _numbers(storage.getNode("distortion_coefficients"))
    while bends and bends[-1] == 0:
        bends.pop()
    model = storage.getNode("distortion_model")
    if len(bends) > _DISTORTIONS or (not model.empty() and model.string() not in {"", "plumb_bob"}):
        raise ValueError("its distortion is not that of k1, k2, p1, p2 and k3: calibrate with that model")
    if not all(math.isfinite(number) for number in (*matrix, *bends)):
        raise ValueError("it has numbers that are not finite")
    fov_deg = math.degrees(2 * math.atan(width / 2 / matrix[0]))
    if not _LEAST_FOV_DEG <= fov_deg <= _MOST_FOV_DEG:
        raise ValueError(f"its focal length of {matrix[0]:g} pixels does not fit its width of {width:g}")
    return Lens(
        fov_deg=fov_deg,
        centre=(matrix[2] / width, matrix[5] / height),
        distortion=tuple(bends),
        scale_error=_CALIBRATED,
    )


def _numbers(node: cv2.FileNode) -> list[float]:
    """The numbers of a matrix or a list."""
    data = node.getNode("data") if node.isMap() else node
    if data.isSeq() and data.size() > _MOST_NUMBERS:
        raise ValueError(f"it has a list of more than {_MOST_NUMBERS} numbers")
    return [_number(data.at(index)) for index in range(data.size())] if data.isSeq() else []


def _number(node: cv2.FileNode) -> float:
    """The number; 0 where the file has none."""
    if not (node.isReal() or node.isInt() or node.empty() or node.isNone()):
        raise ValueError("it has no number where one is needed, as for image_width")
    return node.real()
