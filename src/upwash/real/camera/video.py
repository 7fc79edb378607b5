"""A camera at the drone's computer or in its network, read through OpenCV."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
import re
import threading
from collections.abc import Iterator
from pathlib import Path

from upwash.core.camera.frame_times import FrameTimes
from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.errors import CameraError, UsageError
from upwash.ports import Photo
from upwash.services.photo import in_8_bits
from upwash.support.background import thread
from upwash.support.camera_source import is_pipeline, shown_source
from upwash.support.loading import extra
from upwash.support.text import worded

_JPEG_QUALITY = 95
_FIRST_FRAME_S = 10.0  # a USB camera takes a second or two, a stream may have to wait for a key frame
_FRAME_S = 5.0
_REOPEN_S = 1.0
_LAST_FRAME_S = 1.0
_LEAST_BEHIND_S = 1.0
_CATCHES_UP_S = 3.0  # with the frames that came while FFmpeg studied the stream
_OPTIONS = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
# For named pipes and .sdp files: FFmpeg needs leave to open the stream that a file names, and studies it for 5 s.
_FOR_PIPES = "rtsp_transport;tcp|protocol_whitelist;file,crypto,data,udp,rtp|analyzeduration;1000000"

_log = logging.getLogger("upwash.camera")


class VideoCamera:
    """A Camera that reads a video device (0, "/dev/video0"), a stream (a URL), GStreamer's pipeline, or a video file.

    A thread reads every frame, so that none waits in a buffer; a photo is the first frame captured after the request.
    A frame counts as captured `latency_s` before it arrives, and earlier if a stalled stream or a buffer kept it
    back.
    No photo is more than `oldest_s` older than that latency. Only a film is played at its own pace: a regular file
    with a known number of frames. A source that fails, or a film that has ended, is opened again, once a second.
    """

    def __init__(
        self,
        source: int | str,
        *,
        latency_s: float = 0.0,
        oldest_s: float = math.inf,
        lens: Lens | None = None,
    ) -> None:
        self._source = source
        self._latency_s = latency_s
        self._oldest_s = oldest_s
        self._lens = lens
        self._name = shown_source(source)
        self._loop = asyncio.get_running_loop()
        self._trouble = "it has not been opened yet"
        self._requests: list[tuple[float, asyncio.Future[Photo]]] = []  # each with its time
        self._closed = threading.Event()
        # A thread that a driver does not return to must not hold up the program's end.
        self._thread = thread(self._read, name=f"camera {self._name}", failed=self._lose)

    @classmethod
    async def open(
        cls,
        source: int | str,
        *,
        latency_s: float = 0.0,
        oldest_s: float = math.inf,
        lens: Lens | None = None,
    ) -> VideoCamera:
        """The camera, after its first frame; raises CameraError if none comes, UsageError without OpenCV."""
        with extra("detector"):
            await asyncio.to_thread(_silence_opencv)
        if is_pipeline(source) and not _has_gstreamer():
            raise UsageError(
                "camera.device is a pipeline, and this OpenCV was built without GStreamer: use Debian's "
                "python3-opencv (a virtual environment with --system-site-packages), or the URL of a stream"
            )
        camera = cls(source, latency_s=latency_s, oldest_s=oldest_s, lens=lens)
        camera._thread.start()
        try:
            await camera._frame(_FIRST_FRAME_S + latency_s)
        except BaseException:
            camera.close()
            raise
        return camera

    async def take_photo(self, at: Position) -> Photo:
        """Returns the next frame as a JPEG; raises CameraError if none comes within 5 s and the latency."""
        return await self._frame(_FRAME_S + self._latency_s)

    def close(self) -> None:
        """Stops reading; waits a second at most for the driver, which then frees the device."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join(_LAST_FRAME_S)  # GStreamer aborts a program that ends while it reads

    async def _frame(self, timeout_s: float) -> Photo:
        photo: asyncio.Future[Photo] = self._loop.create_future()
        request = self._loop.time(), photo
        self._requests.append(request)
        try:
            return await asyncio.wait_for(photo, timeout_s)
        except TimeoutError:
            raise CameraError(
                self._name,
                f"no frame within {timeout_s:g} s: {self._trouble}; {_remedy(self._source)}",
            ) from None
        finally:
            self._requests.remove(request)

    # --- in the thread ---

    def _read(self) -> None:
        while not self._closed.is_set():
            self._trouble = "it does not open, or not in time"
            with contextlib.closing(_Capture(self._source)) as capture:
                if capture.is_open:
                    self._read_frames(capture)
            self._closed.wait(_REOPEN_S)

    def _lose(self, defect: Exception) -> None:
        self._trouble = f"a defect has ended the reading: {worded(defect)}"

    def _read_frames(self, capture: _Capture) -> None:
        self._trouble = "it is open, but shows nothing"
        times, pace = FrameTimes(), FilmPace(capture.interval_s, self._loop.time())
        opened_s = self._loop.time()
        while not self._closed.wait(pace.pause_s(self._loop.time())):
            waits_s = self._loop.time()
            if not capture.next():
                self._trouble = "its frames have come to an end"
                return
            arrived_s = self._loop.time()
            captured_s = (
                times.captured_s(arrived_s, waited_s=arrived_s - waits_s, stamp_s=capture.stamp_s)
                if capture.interval_s is None
                else arrived_s
            ) - self._latency_s
            if pace.falls_behind(arrived_s):
                _log.warning(
                    "camera %s: this computer plays the film slower than its %g frames a second",
                    self._name,
                    1 / pace.interval_s,
                )
            is_new = capture.interval_s is not None or times.caught_up or arrived_s > opened_s + _CATCHES_UP_S
            jpeg = capture.jpeg() if self._requests and is_new else None
            self._trouble = capture.trouble or self._trouble
            if jpeg is not None:
                photo = Photo(jpeg, captured_s, source=self._name, lens=self._lens)
                with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
                    self._loop.call_soon_threadsafe(self._hand_out, photo)

    # --- in the loop ---

    def _hand_out(self, photo: Photo) -> None:
        age_s = self._loop.time() - photo.captured_s - self._latency_s
        if age_s > self._oldest_s:
            self._trouble = (
                f"its frames are {age_s:.1f} s old, more than the {self._oldest_s:g} s of camera.photo_s"
            )
            return
        for asked_s, awaited in self._requests:
            if photo.captured_s >= asked_s and not awaited.done():
                awaited.set_result(photo)


class FilmPace:
    """When the next frame of a film is due; a live source, without an interval, is never waited for."""

    def __init__(self, interval_s: float | None, now_s: float) -> None:
        self.interval_s = interval_s or 0.0
        self._due_s = now_s
        self._is_said = False

    def pause_s(self, now_s: float) -> float:
        """The wait until the next frame, which then counts as shown."""
        self._due_s += self.interval_s
        return max(0.0, self._due_s - now_s) if self.interval_s else 0.0

    def falls_behind(self, now_s: float) -> bool:
        """Whether the film is a second behind, for the first time; the second is not made up for."""
        if not self.interval_s or now_s - self._due_s < _LEAST_BEHIND_S:
            return False
        self._due_s = now_s
        is_news, self._is_said = not self._is_said, True
        return is_news


class _Capture:
    """An opened source, frame by frame; `interval_s` is the time between two frames of a film, None if it is live."""

    def __init__(self, source: int | str) -> None:
        import cv2

        self.trouble = ""
        if isinstance(source, int) or source.startswith("/dev/"):
            kind = cv2.CAP_ANY if isinstance(source, int) else cv2.CAP_V4L2
            self._capture = cv2.VideoCapture(source, kind)
            self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        elif is_pipeline(source):
            self._capture = cv2.VideoCapture(source, cv2.CAP_GSTREAMER)
        else:
            limit_ms = int(1000 * _FRAME_S)
            limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, limit_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, limit_ms]
            with _options_for(source):
                self._capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, limits)
        self.is_open = self._capture.isOpened()
        is_film = _is_file(source) and self._capture.get(cv2.CAP_PROP_FRAME_COUNT) > 0
        self.interval_s = 1 / max(1.0, self._capture.get(cv2.CAP_PROP_FPS)) if is_film else None

    @property
    def stamp_s(self) -> float:
        """The time of the frame in the stream; 0 if the source has none."""
        import cv2

        return float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000

    def next(self) -> bool:
        """Waits for the next frame; returns False if there is none."""
        return self._capture.grab()

    def jpeg(self) -> bytes | None:
        """The frame as a JPEG; None if it cannot be decoded, or has more than 16 bits (see `trouble`)."""
        import cv2
        import numpy as np

        try:
            whole, frame = self._capture.retrieve()
            frame = in_8_bits(frame) if whole else frame
            if whole and frame.dtype != np.uint8:  # OpenCV would make a white photo of it
                self.trouble = (
                    f"its frames have {8 * frame.itemsize} bits a pixel, and a JPEG has 8: have the camera, or its "
                    "pipeline, give 8 (`video/x-raw,format=GRAY8`)"
                )
                return None
            whole, jpeg = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        except cv2.error:
            return None
        return jpeg.tobytes() if whole else None

    def close(self) -> None:
        self._capture.release()


def read_frames(film: Path, most: int) -> dict[str, bytes]:
    """The first `most` frames of a film as JPEGs, by number; raises CameraError if there is none."""
    with extra("detector"):
        _silence_opencv()
    frames: dict[str, bytes] = {}
    with contextlib.closing(_Capture(str(film))) as capture:
        while len(frames) < most and capture.next():
            if (jpeg := capture.jpeg()) is not None:
                frames[f"frame {len(frames) + 1}"] = jpeg
    if not frames:
        raise CameraError(str(film), f"it shows nothing; {_remedy(str(film))}")
    return frames


def _remedy(source: int | str) -> str:
    """What to do about a source that shows nothing."""
    connected = "see that it is connected, and that no other program uses it"
    if isinstance(source, int) or is_pipeline(source) or "://" in source or source.startswith("/dev/"):
        return connected
    try:
        is_there = Path(source).exists()
    except OSError:  # too long for a path
        is_there = False
    if not is_there:
        return "there is no such file: check the path"
    return (
        "it is no whole film that FFmpeg reads: copy it again, or name another"
        if _is_file(source)
        else connected
    )


@contextlib.contextmanager
def _options_for(source: str) -> Iterator[None]:
    """FFmpeg's options while a named pipe or an .sdp file is opened: OpenCV takes them from the environment alone."""
    needed = "://" not in source and not _is_file(source) and _OPTIONS not in os.environ
    if needed:
        os.environ[_OPTIONS] = _FOR_PIPES
    try:
        yield
    finally:
        if needed:
            del os.environ[_OPTIONS]


def _is_file(source: int | str) -> bool:
    """Whether the source is a regular file, and no description of a stream (.sdp)."""
    with contextlib.suppress(OSError):  # too long for a path
        return isinstance(source, str) and Path(source).is_file() and not source.lower().endswith(".sdp")
    return False


def _has_gstreamer() -> bool:
    import cv2

    return re.search(r"GStreamer:\s+YES", cv2.getBuildInformation()) is not None


def _silence_opencv() -> None:
    """Keeps OpenCV's warnings off the terminal, as a CameraError has the fault of a camera."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # it has no other way; read at the first opening
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # the only way before OpenCV 4.7; read at the import
    import cv2

    if hasattr(cv2.utils, "logging"):
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
