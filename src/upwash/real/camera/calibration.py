"""A lens from a calibration file, as OpenCV and ROS write it, and editors and YAML libraries write it again."""

from __future__ import annotations

import json
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

_LARGEST_BYTES = 100_000
_DIRECTIVE = re.compile(r"%YAML[^\n]*\n")  # OpenCV's "%YAML:1.0" is none of YAML
_MATRIX_TAG = "tag:yaml.org,2002:opencv-matrix"
_WHOLE_EXPONENT = re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+")  # "1e-05", a text in YAML 1.1, is what C++ writes
_DISTORTIONS = 5  # k1, k2, p1, p2, k3
_LEAST_FOV_DEG, _MOST_FOV_DEG = 1.0, 170.0
_OPENING = re.compile(r"[\[{:]|-(?=\s)|<(?=[A-Za-z_])")
_MOST_OPENED = 5000  # a calibration has 10 to 100
_MOST_NUMBERS = 100  # of a matrix
_KEYS = ("image_width", "image_height", "camera_matrix", "distortion_coefficients", "distortion_model")
_CALIBRATED = 0.003  # of the focal length
_MODELS = frozenset({"", "plumb_bob", "rational_polynomial"})  # the last with k4 to k6 of 0 is the first


def read_calibration(file: Path) -> Lens:
    """The lens of a file with `image_width`, `image_height`, `camera_matrix` and `distortion_coefficients`.

    The lens fits photos of any size with the same ratio. Raises UsageError for a file that cannot be read, has
    another model of distortion, or is of another picture than its size.
    """
    with extra("detector"):
        import cv2
        import yaml
    try:
        content = read_file(file, most_bytes=_LARGEST_BYTES)
    except (OSError, ValueError) as error:
        why = f"cannot be read: {why_unreadable(error)}; check the path"
        raise UsageError(f"camera.calibration: {file} {why}") from error
    try:
        text = text_of(content)
    except UnicodeDecodeError as error:
        raise UsageError(f"camera.calibration: {file} cannot be read: it is no text") from error
    try:
        if sum(1 for _ in _OPENING.finditer(text)) > _MOST_OPENED:  # OpenCV crashes where it nests deeply
            raise ValueError(
                f"it has more than {_MOST_OPENED:,} brackets, braces, colons, dashes or elements"
            )
        if not text.lstrip().startswith(("<?xml", "{")):
            text = _as_json(text)
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        return _lens(storage)
    except (cv2.error, SystemError, ValueError, RecursionError, yaml.YAMLError) as error:
        why = str(error) if type(error) is ValueError else "it is no YAML, XML or JSON"
        raise UsageError(f"camera.calibration: {file} is no calibration: {why}") from error


def _as_json(text: str) -> str:
    """The same in the JSON that OpenCV reads; raises YAMLError, or ValueError for what JSON cannot have."""
    import yaml

    class Loader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML has no types
        """Reads plain values, and a matrix of OpenCV as the mapping that it is."""

    Loader.add_constructor(_MATRIX_TAG, lambda loader, node: loader.construct_mapping(node, deep=True))
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", _WHOLE_EXPONENT, list("-+0123456789"))
    document = _DIRECTIVE.sub("", text.lstrip(), count=1)
    if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(document, Loader)):
        raise ValueError("it has aliases, which can grow without bound: write each value where it is used")
    read = yaml.load(document, Loader)  # noqa: S506 - a SafeLoader
    known = {name: read[name] for name in _KEYS if name in read} if isinstance(read, dict) else {}
    try:
        return json.dumps(known, allow_nan=False, default=str)
    except ValueError:
        raise ValueError("it has numbers that are not finite") from None


def _lens(storage: cv2.FileStorage) -> Lens:
    width, height = (_number(storage.getNode(name)) for name in ("image_width", "image_height"))
    matrix = _numbers(storage.getNode("camera_matrix"))
    if not (0 < width < math.inf and 0 < height < math.inf) or len(matrix) != 9 or not matrix[0] > 0:
        raise ValueError("it needs image_width, image_height, and a camera_matrix of nine numbers")
    bends = _numbers(storage.getNode("distortion_coefficients"))
    while bends and bends[-1] == 0:
        bends.pop()
    model = storage.getNode("distortion_model")
    if len(bends) > _DISTORTIONS or (not model.empty() and model.string() not in _MODELS):
        raise ValueError("its distortion is not that of k1, k2, p1, p2 and k3: calibrate with that model")
    if not all(math.isfinite(number) for number in (*matrix, *bends)):
        raise ValueError("it has numbers that are not finite")
    fov_deg = math.degrees(2 * math.atan(width / 2 / matrix[0]))
    if not _LEAST_FOV_DEG <= fov_deg <= _MOST_FOV_DEG:
        raise ValueError(f"its focal length of {matrix[0]:g} pixels does not fit its width of {width:g}")
    if not (0 < matrix[2] < width and 0 < matrix[5] < height):
        raise ValueError(
            f"its optical axis meets the picture at {matrix[2]:g}, {matrix[5]:g}, outside its {width:g} x {height:g} "
            "pixels: the matrix is of another picture; calibrate again, or correct image_width and image_height"
        )
    return Lens(
        fov_deg=fov_deg,
        centre=(matrix[2] / width, matrix[5] / height),
        ratio=width / height,
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
