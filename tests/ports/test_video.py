"""The camera behind OpenCV, on a stream that this test serves: frames whose brightness counts them."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from upwash.core.geo import Position
from upwash.errors import CameraError, UsageError
from upwash.ports import Photo
from upwash.real.camera import video
from upwash.real.camera.video import VideoCamera, read_frames

HERE = Position(0, 0, 10)
FRAMES_PER_S = 20
STEP = 10  # of brightness, from frame to frame


class Stream:
    """What the stream does, and which frame it sent last; `address` is its URL."""

    def __init__(self) -> None:
        self.address = ""
        self.sent = 0
        self.connections = 0
        self.flowing = threading.Event()
        self.flowing.set()
        self.breaks_after: int | None = None  # frames, of each connection


@pytest.fixture
def stream() -> Iterator[Stream]:
    stream, ended = Stream(), threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            stream.connections += 1
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            with contextlib.suppress(OSError):
                self.send_frames()

        def send_frames(self) -> None:
            left = stream.breaks_after
            while not ended.is_set() and left != 0:
                if stream.flowing.wait(0.05):
                    stream.sent += 1  # before it is: the camera may be quicker than the next line
                    frame = np.full((48, 64, 3), stream.sent * STEP % 250, np.uint8)
                    jpeg = cv2.imencode(".jpg", frame)[1].tobytes()
                    head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                    self.wfile.write(head.encode() + jpeg + b"\r\n")
                    left = None if left is None else left - 1
                    ended.wait(1 / FRAMES_PER_S)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    stream.address = f"http://127.0.0.1:{server.server_port}/stream.mjpg"
    serving = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    serving.start()
    yield stream
    ended.set()
    server.shutdown()
    serving.join()
    server.server_close()


@contextlib.asynccontextmanager
async def camera_on(source: int | str) -> AsyncIterator[VideoCamera]:
    with contextlib.closing(await VideoCamera.open(source)) as camera:
        yield camera


def frame_of(photo: Photo) -> int:
    """Which frame of the stream it is, counted from 1 and modulo 25."""
    image = cv2.imdecode(np.frombuffer(photo.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    return round(float(image.mean()) / STEP)


async def test_a_photo_is_the_newest_frame_and_not_one_from_a_buffer(stream: Stream) -> None:
    behind = []
    async with camera_on(stream.address) as camera:
        for _ in range(3):
            await asyncio.sleep(0.4)  # eight frames that nobody asks for
            photo = await camera.take_photo(HERE)
            behind.append((stream.sent - frame_of(photo)) % 25)
    assert max(behind) <= 3  # of which the way through the decoder takes one or two


def test_a_photo_knows_when_its_frame_came(stream: Stream) -> None:
    async def shoot() -> tuple[float, Photo, float]:
        async with camera_on(stream.address) as camera:
            clock = asyncio.get_running_loop().time
            asked_s = clock()
            return asked_s, await camera.take_photo(HERE), clock()

    asked_s, photo, got_s = asyncio.run(shoot())
    assert asked_s <= photo.captured_s <= got_s
    assert photo.source == stream.address


def test_of_a_late_stream_a_photo_is_what_was_there_when_it_was_asked_for(stream: Stream) -> None:
    async def shoot() -> tuple[float, Photo, float]:
        with contextlib.closing(await VideoCamera.open(stream.address, latency_s=0.5)) as camera:
            clock = asyncio.get_running_loop().time
            asked_s = clock()
            return asked_s, await camera.take_photo(HERE), clock()

    asked_s, photo, got_s = asyncio.run(shoot())
    assert asked_s <= photo.captured_s <= got_s - 0.5


@pytest.mark.skipif(video._has_gstreamer(), reason="this OpenCV has GStreamer")
async def test_a_pipeline_without_gstreamer_is_refused_with_the_remedy() -> None:
    with pytest.raises(
        UsageError, match="this OpenCV was built without GStreamer: use Debian's python3-opencv"
    ):
        await VideoCamera.open("videotestsrc ! videoconvert ! appsink")


class Source:
    """A source as OpenCV gives it."""

    isOpened = grab = lambda *_: True  # noqa: N815 - OpenCV's name
    set = get = release = lambda *_: 9.0

    def __init__(self, *_: object) -> None:
        """Opened."""


async def test_frames_of_a_thermal_camera_show_hot_spots(monkeypatch: pytest.MonkeyPatch) -> None:
    class Thermal(Source):
        def retrieve(self) -> tuple[bool, object]:
            frame = np.full((48, 64), 29_500, np.uint16)
            frame[10:30, 10:30] = 31_800  # hundredths of a kelvin: 45 degrees
            return True, frame

    monkeypatch.setattr(cv2, "VideoCapture", Thermal)
    async with camera_on("/dev/video0") as camera:
        photo = await camera.take_photo(HERE)
    shown = cv2.imdecode(np.frombuffer(photo.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown is not None
    assert shown[20, 20] > 250
    assert shown[40, 50] < 5


async def test_frames_with_more_bits_are_refused_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    class Depth(Source):
        def retrieve(self) -> tuple[bool, object]:
            return True, np.full((48, 64), 3.5, np.float32)

    monkeypatch.setattr(cv2, "VideoCapture", Depth)
    monkeypatch.setattr(video, "_FIRST_FRAME_S", 0.2)
    with pytest.raises(CameraError, match=r"its frames have 32 bits a pixel.*give 8 .*format=GRAY8"):
        await VideoCamera.open("/dev/video0")


@dataclass
class Frames:
    """A live stream of 50 frames a second, whose photos are their numbers, and the clock that it moves.

    Those that are `kept_back` come with the first after them; `at` a frame something happens while it is waited for.
    """

    kept_back: range = range(0)
    has_times: bool = False
    decodes_s: Sequence[float] = ()  # the first photos
    at: dict[int, Callable[[], object]] = field(default_factory=dict)
    frame: int = 0
    now_s: float = 0.0
    interval_s, trouble = None, ""

    @property
    def stamp_s(self) -> float:
        return PERIOD_S * self.frame if self.has_times else 0.0

    def next(self) -> bool:
        self.frame += 1
        self.at.get(self.frame, lambda: None)()
        due = self.kept_back.stop if self.frame in self.kept_back else self.frame
        self.now_s = max(self.now_s + 0.002, PERIOD_S * due)
        return self.frame < 200

    def jpeg(self) -> bytes:
        first_s, *self.decodes_s = [*self.decodes_s, 0.0]
        self.now_s += first_s
        return bytes([self.frame])

    def time(self) -> float:
        return self.now_s

    def call_soon_threadsafe(self, call: Callable[[Photo], None], photo: Photo) -> None:
        call(photo)


PERIOD_S = 0.02


def read_by(camera: VideoCamera, frames: Frames, monkeypatch: pytest.MonkeyPatch, *asked: int) -> list[Photo]:
    """The photos that were asked for, each while that frame was waited for."""
    photos = [asyncio.get_running_loop().create_future() for _ in asked]
    for photo, at in zip(photos, asked, strict=True):
        before = frames.at.get(at, lambda: None)

        def ask(photo: asyncio.Future[Photo] = photo, before: Callable[[], object] = before) -> None:
            before()
            camera._requests.append((frames.now_s, photo))

        frames.at[at] = ask
    monkeypatch.setattr(camera, "_loop", frames)
    camera._read_frames(frames)  # type: ignore[arg-type]
    return [photo.result() for photo in photos]


async def test_a_frame_that_a_stalled_stream_kept_back_is_no_photo(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = Frames(kept_back=range(15, 50))

    def stalls() -> None:
        frames.now_s = 0.65

    frames.at[15] = stalls
    (photo,) = read_by(VideoCamera("/dev/video0"), frames, monkeypatch, 15)
    assert PERIOD_S * photo.jpeg[0] >= 0.65 - PERIOD_S


async def test_a_frame_that_waited_while_the_reader_was_held_up_is_known_to_be_old(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames = Frames(has_times=True, decodes_s=[1.2])  # as of a computer that is busy
    camera = VideoCamera("/dev/video0", oldest_s=0.5)
    held_up, *others = read_by(camera, frames, monkeypatch, 21, 22, 90, 140)
    assert held_up.jpeg[0] >= 21
    for photo in others:
        assert photo.captured_s == pytest.approx(PERIOD_S * photo.jpeg[0], abs=2 * PERIOD_S)


async def test_a_device_may_be_named_by_its_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "_FIRST_FRAME_S", 0.5)
    with pytest.raises(CameraError, match=r"/dev/video99.*no frame within 0\.5 s"):
        await VideoCamera.open("/dev/video99")


def test_a_stream_that_hangs_is_an_error_in_bounded_time(
    stream: Stream, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "_FRAME_S", 0.5)

    async def shoot() -> Photo:
        async with camera_on(stream.address) as camera:
            stream.flowing.clear()
            await asyncio.sleep(0.2)
            return await camera.take_photo(HERE)

    began_s = time.monotonic()
    with pytest.raises(CameraError, match=r"no frame within 0.5 s: .*; see that it is connected"):
        asyncio.run(shoot())
    assert time.monotonic() - began_s < 10


async def test_a_stream_that_breaks_is_opened_again(stream: Stream, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "_REOPEN_S", 0.05)
    stream.breaks_after = 10
    async with camera_on(stream.address) as camera:
        while stream.connections < 3:
            await camera.take_photo(HERE)


@pytest.mark.parametrize(
    ("source", "remedy"),
    [
        (97, "see that it is connected"),
        ("/nowhere/video.avi", "there is no such file: check the path"),
        ("/nowhere/" + "x" * 300, "there is no such file"),
        (__file__, "it is no whole film that FFmpeg reads: copy it again"),
        ("http://127.0.0.1:9/none", "see that it is connected"),
    ],
)
async def test_a_camera_that_is_not_there_is_an_error_in_bounded_time(
    source: int | str, remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "_FIRST_FRAME_S", 0.5)
    with pytest.raises(
        CameraError, match=rf"camera {source}: no frame within 0.5 s: it does not open.*; {remedy}"
    ):
        await VideoCamera.open(source)


async def test_a_password_in_a_url_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "_FIRST_FRAME_S", 0.2)
    with pytest.raises(CameraError) as raised:
        await VideoCamera.open("http://pilot:secret@127.0.0.1:9/none")
    assert raised.value.camera == "http://127.0.0.1:9/none"
    assert "secret" not in str(raised.value)


def test_a_video_file_starts_over_at_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "_REOPEN_S", 0.01)
    file = tmp_path / "flight.avi"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 50, (64, 48))
    for frame in range(1, 6):
        writer.write(np.full((48, 64, 3), frame * STEP, np.uint8))
    writer.release()

    async def frames() -> list[int]:
        async with camera_on(str(file)) as camera:
            return [frame_of(await camera.take_photo(HERE)) for _ in range(12)]

    seen = asyncio.run(frames())
    assert set(seen) <= {1, 2, 3, 4, 5}
    assert any(later < earlier for earlier, later in itertools.pairwise(seen))


def test_the_first_frames_of_a_film_are_photos_to_measure_with(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 50, (64, 48))
    for brightness in (0, 100, 200):
        writer.write(np.full((48, 64, 3), brightness, np.uint8))
    writer.release()
    frames = read_frames(tmp_path / "film.avi", most=2)
    assert list(frames) == ["frame 1", "frame 2"]
    shown = [cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE) for jpeg in frames.values()]
    assert [round(float(frame.mean()), -1) for frame in shown if frame is not None] == [0, 100]
    assert len(read_frames(tmp_path / "film.avi", most=9)) == 3
    with pytest.raises(CameraError, match="it is no whole film that FFmpeg reads: copy it again"):
        read_frames(Path(__file__), most=1)


def test_only_a_film_is_played_at_its_own_pace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", Source)  # which has 9 frames, 9 a second
    for name in ("film.mp4", "camera.sdp"):
        (tmp_path / name).touch()
    os.mkfifo(tmp_path / "camera.mjpg")
    live: list[int | str] = [
        *(0, "/dev/video0", "rtsp://camera/stream", "v4l2src ! appsink"),
        *(str(tmp_path / name) for name in ("camera.sdp", "camera.mjpg")),
    ]
    assert [video._Capture(source).interval_s for source in live] == [None] * 6
    assert video._Capture(str(tmp_path / "film.mp4")).interval_s == pytest.approx(1 / 9)
    monkeypatch.setattr(Source, "get", lambda *_: 0.0)  # as a stream of unknown length
    assert video._Capture(str(tmp_path / "film.mp4")).interval_s is None


def test_a_film_keeps_its_pace_and_says_once_that_it_falls_behind() -> None:
    pace, now_s = video.FilmPace(0.1, 0.0), 0.0
    for _ in range(50):
        now_s += pace.pause_s(now_s) + 0.04  # of decoding
        assert not pace.falls_behind(now_s)
    assert now_s == pytest.approx(5.04)
    said = []
    for _ in range(50):
        now_s += pace.pause_s(now_s) + 0.2
        said.append(pace.falls_behind(now_s))
    assert sum(said) == 1
    assert video.FilmPace(None, 0.0).pause_s(5.0) == 0.0
