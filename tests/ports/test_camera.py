"""The camera that shoots the files of a folder."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import pytest

from upwash.errors import UpwashError, UsageError
from upwash.ports import Camera
from upwash.real.camera import FolderCamera


def fill(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).write_bytes(name.encode())
    return folder


def shoot(camera: Camera, count: int) -> list[bytes]:
    async def shots() -> list[bytes]:
        return [await camera.take_photo() for _ in range(count)]

    return asyncio.run(shots())


def test_photos_come_in_name_order_and_start_over(tmp_path: Path) -> None:
    camera = FolderCamera(fill(tmp_path, "c.jpg", "a.JPG", "b.jpeg"), photo_s=0)
    assert shoot(camera, 5) == [b"a.JPG", b"b.jpeg", b"c.jpg", b"a.JPG", b"b.jpeg"]


def test_other_files_and_folders_are_no_photos(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").mkdir()
    camera = FolderCamera(fill(tmp_path, "photo.jpg", "truth.json", "photo.png"), photo_s=0)
    assert shoot(camera, 2) == [b"photo.jpg"] * 2


def test_a_photo_takes_its_time(tmp_path: Path) -> None:
    async def seconds() -> float:
        camera = FolderCamera(fill(tmp_path, "photo.jpg"), photo_s=0.05)
        clock = asyncio.get_running_loop().time
        start_s = clock()
        await camera.take_photo()
        return clock() - start_s

    assert asyncio.run(seconds()) >= 0.05


def test_a_cancelled_shot_is_not_skipped(tmp_path: Path) -> None:
    async def first_after_cancelling() -> bytes:
        camera = FolderCamera(fill(tmp_path, "a.jpg", "b.jpg"), photo_s=0.01)
        shot = asyncio.create_task(camera.take_photo())
        await asyncio.sleep(0)
        shot.cancel()
        await asyncio.gather(shot, return_exceptions=True)
        return await camera.take_photo()

    assert asyncio.run(first_after_cancelling()) == b"a.jpg"


def test_files_are_read_off_the_event_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    readers: list[threading.Thread] = []

    def read_bytes(_: Path) -> bytes:
        readers.append(threading.current_thread())
        return b"photo"

    monkeypatch.setattr(Path, "read_bytes", read_bytes)
    assert shoot(FolderCamera(fill(tmp_path, "photo.jpg"), photo_s=0), 1) == [b"photo"]
    assert readers != [threading.current_thread()]


def test_a_missing_folder_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no folder .*nowhere; name a folder that holds JPEG photos"):
        FolderCamera(tmp_path / "nowhere", photo_s=0)


def test_a_folder_without_photos_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"has no \*\.jpg or \*\.jpeg file; put JPEG photos in it"):
        FolderCamera(fill(tmp_path, "notes.txt"), photo_s=0)


def test_a_photo_that_is_gone_is_named(tmp_path: Path) -> None:
    camera = FolderCamera(fill(tmp_path, "photo.jpg"), photo_s=0)
    (tmp_path / "photo.jpg").unlink()
    with pytest.raises(UpwashError, match=r"photo\.jpg cannot be read: No such file"):
        shoot(camera, 1)
