"""The camera that shoots the files of a folder, and the one that renders what lies below."""

from __future__ import annotations

import asyncio
import os
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from upwash.core.geo import Position
from upwash.errors import CameraError, UsageError
from upwash.ports import Camera, Photo
from upwash.real.camera import camera
from upwash.real.camera.camera import FolderCamera, read_photos
from upwash.sim.camera import RenderedCamera
from upwash.sim.loop import run_virtually

HERE = Position(0, 0, 10)


def fill(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).write_bytes(name.encode())
    return folder


def shoot(camera: Camera, count: int) -> list[bytes]:
    async def shots() -> list[bytes]:
        return [(await camera.take_photo(HERE)).jpeg for _ in range(count)]

    return asyncio.run(shots())


def test_photos_come_in_name_order_and_start_over(tmp_path: Path) -> None:
    camera = FolderCamera(fill(tmp_path, "c10.jpg", "c2.jpg", "a.JPG", "b.jpeg"), photo_s=0)
    assert shoot(camera, 5) == [b"a.JPG", b"b.jpeg", b"c2.jpg", b"c10.jpg", b"a.JPG"]


def test_other_files_and_folders_are_no_photos(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").mkdir()
    os.mkfifo(tmp_path / "b.jpg")
    (tmp_path / "c.jpg").symlink_to("d.jpg")
    (tmp_path / "d.jpg").symlink_to("c.jpg")
    (tmp_path / "e.jpg").symlink_to("nowhere.jpg")
    camera = FolderCamera(fill(tmp_path, "photo.jpg", "truth.json", "photo.tif"), photo_s=0)
    assert shoot(camera, 2) == [b"photo.jpg"] * 2


def test_a_png_becomes_a_jpeg_of_the_same_pixels(tmp_path: Path) -> None:
    thermal = np.full((40, 60), 29_500, np.uint16)
    thermal[:, 30:] = 31_800
    (tmp_path / "a.PNG").write_bytes(cv2.imencode(".png", thermal)[1].tobytes())
    (tmp_path / "b.png").write_bytes((tmp_path / "a.PNG").read_bytes()[:20])
    fill(tmp_path, "c.jpg")
    (tmp_path / "d.png").write_bytes(b"\xff\xd8\xff")
    camera = FolderCamera(tmp_path, photo_s=0)
    pixels = cv2.imdecode(np.frombuffer(shoot(camera, 1)[0], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert pixels is not None
    assert (pixels[20, 10], pixels[20, 50]) == (0, 255)
    with pytest.raises(CameraError, match=r"b\.png cannot be read: the PNG is cut off after 20 bytes"):
        shoot(camera, 1)
    assert shoot(camera, 2) == [b"c.jpg", b"\xff\xd8\xff"]


def test_a_name_that_is_no_utf_8_is_shown_as_far_as_it_is(tmp_path: Path) -> None:
    Path(os.fsdecode(os.fsencode(tmp_path) + b"/for\xeat.jpg")).write_bytes(b"photo")
    photo = asyncio.run(FolderCamera(tmp_path, photo_s=0).take_photo(HERE))
    assert (photo.source, photo.jpeg) == ("for\ufffdt.jpg", b"photo")
    assert read_photos(tmp_path, most=1) == {"for\ufffdt.jpg": b"photo"}


def test_a_photo_that_became_a_pipe_does_not_hold_the_flight_up(tmp_path: Path) -> None:
    camera = FolderCamera(fill(tmp_path, "photo.jpg"), photo_s=0)
    (tmp_path / "photo.jpg").unlink()
    os.mkfifo(tmp_path / "photo.jpg")
    with pytest.raises(CameraError, match=r"photo\.jpg cannot be read: it is no file any more"):
        shoot(camera, 1)


def test_hidden_files_are_no_photos(tmp_path: Path) -> None:
    folder = fill(tmp_path, "._DJI_0001.JPG", ".trashed-1.jpg", ".DS_Store", "Thumbs.db", "DJI_0001.JPG")
    assert shoot(FolderCamera(folder, photo_s=0), 2) == [b"DJI_0001.JPG"] * 2
    assert read_photos(folder, most=9) == {"DJI_0001.JPG": b"DJI_0001.JPG"}


def test_no_more_photos_are_read_than_are_wanted(tmp_path: Path) -> None:
    assert list(read_photos(fill(tmp_path, "c.jpg", "a.jpg", "b.jpg"), most=2)) == ["a.jpg", "b.jpg"]


@pytest.mark.parametrize("in_flight", [False, True])
async def test_a_photo_takes_its_time_and_its_shutter_opens_at_once_in_flight(
    tmp_path: Path, *, in_flight: bool
) -> None:
    camera = FolderCamera(fill(tmp_path, "photo.jpg"), photo_s=0.05, in_flight=in_flight)
    clock = asyncio.get_running_loop().time
    start_s = clock()
    photo = await camera.take_photo(HERE)
    assert clock() - start_s >= 0.05
    assert (photo.captured_s - start_s < 0.05) == in_flight


async def test_a_cancelled_shot_is_not_skipped(tmp_path: Path) -> None:
    camera = FolderCamera(fill(tmp_path, "a.jpg", "b.jpg"), photo_s=0.01)
    shot = asyncio.create_task(camera.take_photo(HERE))
    await asyncio.sleep(0)
    shot.cancel()
    await asyncio.gather(shot, return_exceptions=True)
    assert (await camera.take_photo(HERE)).jpeg == b"a.jpg"


def test_files_are_read_off_the_event_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    readers: list[threading.Thread] = []

    def read_bytes(_: Path) -> bytes:
        readers.append(threading.current_thread())
        return b"photo"

    monkeypatch.setattr(Path, "read_bytes", read_bytes)
    assert shoot(FolderCamera(fill(tmp_path, "photo.jpg"), photo_s=0), 1) == [b"photo"]
    assert readers != [threading.current_thread()]


def test_a_drive_that_does_not_answer_holds_up_neither_flight_nor_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = threading.Event()
    monkeypatch.setattr(Path, "read_bytes", lambda _: bytes(answers.wait(30)))
    monkeypatch.setattr(camera, "_READ_S", 0.05)
    began_s = time.monotonic()
    with pytest.raises(CameraError, match=r"photo\.jpg was not read within 0\.05 s; see that its drive"):
        shoot(FolderCamera(fill(tmp_path, "photo.jpg"), photo_s=0), 1)
    assert time.monotonic() - began_s < 10
    answers.set()


def test_a_missing_folder_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no folder .*nowhere; name a folder that holds JPEG or PNG photos"):
        FolderCamera(tmp_path / "nowhere", photo_s=0)


def test_a_folder_that_cannot_be_read_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"cannot be read: File name too long; let this user read it"):
        FolderCamera(tmp_path / ("a" * 300), photo_s=0)


def test_a_folder_without_photos_is_refused_at_once(tmp_path: Path) -> None:
    none = r"has no \*\.jpg, \*\.jpeg or \*\.png file; "
    with pytest.raises(UsageError, match=none + "put photos in it"):
        FolderCamera(fill(tmp_path, "notes.txt"), photo_s=0)
    with pytest.raises(UsageError, match=none + r"save its \.TIF, \.heic files as PNG or JPEG"):
        FolderCamera(fill(tmp_path, "a.TIF", "b.TIF", "c.heic"), photo_s=0)


def test_a_photo_that_is_gone_is_named(tmp_path: Path) -> None:
    camera = FolderCamera(fill(tmp_path, "photo.jpg"), photo_s=0)
    (tmp_path / "photo.jpg").unlink()
    with pytest.raises(CameraError, match=r"photo\.jpg cannot be read: No such file"):
        shoot(camera, 1)


def test_a_file_too_large_for_a_photo_is_refused(tmp_path: Path) -> None:
    folder = fill(tmp_path, "photo.jpg")
    with (folder / "photo.jpg").open("r+b") as photo:
        photo.truncate(10**10)
    with pytest.raises(
        CameraError,
        match=r"photo\.jpg cannot be read: it has 10000 MB, and no photo more than 100; put it back",
    ):
        read_photos(folder, most=1)


# --- rendered photos -------------------------------------------------------------------------------


def photos_from(*places: Position, park_seed: int = 3) -> list[Photo]:
    async def fly() -> list[Photo]:
        camera = RenderedCamera(park_seed, photo_s=0.5, in_thread=False)
        return [await camera.take_photo(place) for place in places]

    return run_virtually(fly())


def test_what_is_on_a_rendered_photo_depends_on_where_the_drone_is() -> None:
    here, there, back = photos_from(Position(0, 0, 15), Position(40, 0, 15), Position(0, 0, 15))
    assert here.truth and there.truth and back.truth
    assert len(here.truth) == len(back.truth) != len(there.truth)
    assert here.jpeg != back.jpeg  # the wind and the sensor are never the same
    (elsewhere,) = photos_from(Position(0, 0, 15), park_seed=4)
    assert elsewhere.truth != here.truth


def test_a_rendered_photo_takes_its_time_on_either_clock() -> None:
    async def shoot(in_thread: bool) -> float:
        camera = RenderedCamera(3, photo_s=0.5, in_thread=in_thread)
        clock = asyncio.get_running_loop().time
        began_s = clock()
        photo = await camera.take_photo(HERE)
        assert photo.captured_s == pytest.approx(began_s, abs=0.01)
        return clock() - began_s

    assert run_virtually(shoot(in_thread=False)) == pytest.approx(0.5)
    assert asyncio.run(shoot(in_thread=True)) >= 0.5


async def test_rendering_does_not_hold_up_the_flight() -> None:
    camera = RenderedCamera(3, photo_s=0.0, in_thread=True)
    shot = asyncio.create_task(camera.take_photo(HERE))
    ticks = 0
    while not shot.done():
        await asyncio.sleep(0.01)
        ticks += 1
    assert ticks > 3


def test_without_opencv_a_rendered_camera_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [name for name in sys.modules if name.startswith("upwash.services.solar_park")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "cv2", None)
    monkeypatch.delattr("upwash.services.solar_park", raising=False)
    with pytest.raises(UsageError, match=r"pip install 'upwash\[detector\]'"):
        RenderedCamera(3, photo_s=0.0, in_thread=False)
