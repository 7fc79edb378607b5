"""Image messages of ROS 2, of rclpy or of a bag → JPEGs; nothing of ROS is imported."""

from __future__ import annotations

import math
from typing import Any

from upwash.errors import CameraError
from upwash.services.photo import MAX_PHOTO_PIXELS, NotAPhoto, in_8_bits, jpeg_of, other_format, stretched
from upwash.support.loading import extra
from upwash.support.text import printable

_JPEG_QUALITY = 95
_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG"
_ROWS = {
    "nv12": 1.5,
    "nv21": 1.5,
}  # for each row of pixels: half as many rows of colours follow the grey ones
_LEAST_SPAN = 1.0  # of floats: a kelvin of a thermal camera, a metre of a depth camera
# Of `sensor_msgs/image_encodings`: the bytes of a channel, the channels, and the conversion to OpenCV's order.
ENCODINGS: dict[str, tuple[int, int, str]] = {
    "rgb8": (1, 3, "RGB2BGR"),
    "bgr8": (1, 3, ""),
    "8UC3": (1, 3, ""),
    "rgba8": (1, 4, "RGBA2BGR"),
    "bgra8": (1, 4, "BGRA2BGR"),
    "mono8": (1, 1, ""),
    "8UC1": (1, 1, ""),
    "mono16": (2, 1, ""),
    "16UC1": (2, 1, ""),
    "32FC1": (4, 1, ""),
    "rgb16": (2, 3, "RGB2BGR"),
    "bgr16": (2, 3, ""),
    "bayer_rggb8": (1, 1, "BayerBG2BGR"),
    "bayer_bggr8": (1, 1, "BayerRG2BGR"),
    "bayer_gbrg8": (1, 1, "BayerGR2BGR"),
    "bayer_grbg8": (1, 1, "BayerGB2BGR"),
    "yuv422": (1, 2, "YUV2BGR_UYVY"),
    "uyvy": (1, 2, "YUV2BGR_UYVY"),
    "yuv422_yuy2": (1, 2, "YUV2BGR_YUY2"),
    "yuyv": (1, 2, "YUV2BGR_YUY2"),
    "nv12": (1, 1, "YUV2BGR_NV12"),
    "nv21": (1, 1, "YUV2BGR_NV21"),
}


def jpeg_of_message(topic: str, message: Any) -> bytes:
    """The JPEG of a CompressedImage or an Image; raises CameraError for an image that is no photo, and UsageError.

    A compressed JPEG is passed on as it is. `message` has the fields of the ROS message, of rclpy or of a bag.
    """
    try:
        if hasattr(message, "encoding"):
            return _encoded(message)
        data = message.data.tobytes()
        if data.startswith(_JPEG):
            return bytes(data)
        if data.startswith(_PNG):
            with extra("detector"):
                return jpeg_of(data)
    except NotAPhoto as error:
        raise CameraError(topic, str(error)) from error
    kind = other_format(data) or f"{len(data)} bytes"
    raise CameraError(
        topic,
        f"an image of format {printable(message.format, 60)!r} is {kind}, not a JPEG or PNG: have image_transport "
        "publish `compressed` (depth and video have other transports)",
    )


def _encoded(image: Any) -> bytes:
    if image.encoding not in ENCODINGS:
        raise NotAPhoto(
            f"images are of the encoding {printable(image.encoding, 60)!r}, which is none of "
            f"{', '.join(ENCODINGS)}: have the camera's driver convert them"
        )
    size, channels, conversion = ENCODINGS[image.encoding]
    high, wide, step, data = image.height, image.width, image.step, image.data
    least, rows_high = wide * channels * size, math.ceil(_ROWS.get(image.encoding, 1) * high)
    if not 0 < high * wide <= MAX_PHOTO_PIXELS or step < least or len(data) < step * rows_high:
        raise NotAPhoto(
            f"an image says that it has {wide} x {high} pixels of {image.encoding} in rows of {step} bytes, and has "
            f"{len(data):,} bytes"
        )
    with extra("detector"):
        import cv2
        import numpy as np
    rows = np.frombuffer(data, np.uint8, count=step * rows_high).reshape(rows_high, step)[:, :least]
    order = ">" if image.is_bigendian else "<"
    kind = "f" if image.encoding == "32FC1" else "u"
    pixels = np.ascontiguousarray(rows).view(f"{order}{kind}{size}").reshape(rows_high, wide, channels)
    if kind == "f":
        pixels = stretched(pixels, least_span=_LEAST_SPAN)
    elif size > 1:
        pixels = in_8_bits(pixels.astype(np.uint16))
    try:
        if conversion:
            pixels = cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{conversion}"))
        whole, jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    except cv2.error as error:
        raise NotAPhoto(f"OpenCV cannot convert an image of {image.encoding}: {error.err}") from error
    if not whole:
        raise NotAPhoto(f"OpenCV cannot write an image of {image.encoding} as a JPEG")
    return bytes(jpeg.tobytes())
