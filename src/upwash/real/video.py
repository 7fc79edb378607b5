"""A camera at the drone's computer or in its network, read through OpenCV."""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from upwash.core.geo import Position
from upwash.errors import CameraError, UsageError
from upwash.ports import Photo

if TYPE_CHECKING:
    from cv2.typing import MatLike

_JPEG_QUALITY = 95
_FIRST_FRAME_S = 10.0  # a USB camera takes a second or two, a stream may have to wait for a key frame
_FRAME_S = 5.0
_REOPEN_S = 1.0


@dataclass(frozen=True, slots=True)
class _Wish:
    """A photo that is waited for, of a frame that is no older than the wish."""

    asked_s: float
    photo: asyncio.Future[Photo]


class VideoCamera:
    """A Camera that reads a video device (0, 1, ...), a stream (a URL) or a video file, over and over.

    A thread reads every frame, so that none waits in a buffer; a photo is the first one that arrives after it was
    asked for. A source that fails is opened again, once a second.
    """

    def __init__(self, source: int | str) -> None:
        self._source = source
        self._loop = asyncio.get_running_loop()
        self._trouble = "it has not been opened yet"
        self._wishes: list[_Wish] = []
        self._closed = threading.Event()
        # A daemon: nothing frees a thread that a driver does not return to.
        self._thread = threading.Thread(target=self._read, name=f"camera {source}", daemon=True)

    @classmethod
    async def open(cls, source: int | str) -> VideoCamera:
        """The camera, once it has shown a frame; raises CameraError if it does not, UsageError without OpenCV."""
        try:
            await asyncio.to_thread(_silence_opencv)
        except ImportError as missing:
            raise UsageError(
                f"camera: a video device needs OpenCV ({missing}); pip install 'upwash[detector]'"
            ) from missing
        camera = cls(source)
        camera._thread.start()
        try:
            await camera._frame(_FIRST_FRAME_S)
        except BaseException:
            camera.close()
            raise
        return camera

    async def take_photo(self, at: Position) -> Photo:
        """Returns the next frame as a JPEG; raises CameraError if none comes within 5 s."""
        return await self._frame(_FRAME_S)

    def close(self) -> None:
        """Stops reading; the device is free as soon as its driver returns."""
        self._closed.set()

    async def _frame(self, timeout_s: float) -> Photo:
        wish = _Wish(self._loop.time(), self._loop.create_future())
        self._wishes.append(wish)
        try:
            return await asyncio.wait_for(wish.photo, timeout_s)
        except TimeoutError:
            raise CameraError(
                str(self._source),
                f"no frame within {timeout_s:g} s: {self._trouble}; see that it is connected, and that no other "
                "program uses it",
            ) from None
        finally:
            self._wishes.remove(wish)

    # --- in the thread ---

    def _read(self) -> None:
        while not self._closed.is_set():
            self._trouble = "it does not open, or not in time"
            capture = _open(self._source)
            try:
                if capture.isOpened():
                    self._read_frames(capture)
            finally:
                capture.release()
            self._closed.wait(_REOPEN_S)

    def _read_frames(self, capture: Any) -> None:
        self._trouble = "it is open, but its driver does not return"
        pause_s = _pause_s(self._source, capture)
        while not self._closed.wait(pause_s):
            if not capture.grab():
                self._trouble = "its frames have come to an end"
                return
            captured_s = self._loop.time()
            if self._wishes:
                whole, frame = capture.retrieve()
                if whole:
                    photo = Photo(_encoded(frame), captured_s, source=str(self._source))
                    with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                        self._loop.call_soon_threadsafe(self._hand_out, photo)

    # --- in the loop ---

    def _hand_out(self, photo: Photo) -> None:
        for wish in self._wishes:
            if photo.captured_s >= wish.asked_s and not wish.photo.done():
                wish.photo.set_result(photo)


def _open(source: int | str) -> Any:
    import cv2

    if isinstance(source, int):
        return cv2.VideoCapture(source)
    limit_ms = int(1000 * _FRAME_S)
    limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, limit_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, limit_ms]
    return cv2.VideoCapture(source, cv2.CAP_FFMPEG, limits)


def _pause_s(source: int | str, capture: Any) -> float:
    """Between two frames: a camera takes its own time, a file is read as fast as it was recorded."""
    import cv2

    is_file = isinstance(source, str) and Path(source).is_file()
    return 1 / max(1.0, capture.get(cv2.CAP_PROP_FPS)) if is_file else 0.0


def _encoded(frame: MatLike) -> bytes:
    import cv2

    _, jpeg = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return jpeg.tobytes()


def _silence_opencv() -> None:
    """Keeps its warnings off the terminal: what is wrong with a camera is said in a CameraError."""
    os.environ.setdefault(
        "OPENCV_FFMPEG_LOGLEVEL", "-8"
    )  # the only way to tell it; read at the first opening
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
