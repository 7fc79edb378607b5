"""What every Camera, Journal and Notifier does."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from tests.events import event, written

from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.ports import Camera, Journal, Notifier
from upwash.real.camera.camera import FolderCamera
from upwash.real.camera.video import VideoCamera
from upwash.real.host.journal import FileJournal
from upwash.sim.camera import ModelCamera, RenderedCamera
from upwash.sim.journal import MemoryJournal
from upwash.sim.loop import run_virtually

JPEG = b"\xff\xd8\xff"
LENS = Lens(70.0)


@contextlib.asynccontextmanager
async def a_camera(kind: str, folder: Path) -> AsyncIterator[Camera]:
    match kind:
        case "model":
            yield ModelCamera(photo_s=0.1)
        case "rendered":
            yield RenderedCamera(1, photo_s=0.1, in_thread=False)
        case "folder":
            (folder / "photo.jpg").write_bytes(JPEG + b" and so on")
            yield FolderCamera(folder, photo_s=0.1, lens=LENS)
        case "video":
            with contextlib.closing(
                await VideoCamera.open(str(write_video(folder / "video.avi")), lens=LENS)
            ) as camera:
                yield camera


def write_video(file: Path) -> Path:
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 20, (64, 48))
    for brightness in range(0, 250, 10):
        writer.write(np.full((48, 64, 3), brightness, np.uint8))
    writer.release()
    return file


@pytest.mark.parametrize("kind", ["model", "rendered", "folder", "video"])
def test_a_photo_is_a_jpeg_of_a_known_time(kind: str, tmp_path: Path) -> None:
    async def shoot() -> None:
        clock = asyncio.get_running_loop().time
        async with a_camera(kind, tmp_path) as camera:
            asked_s = clock()
            photo = await camera.take_photo(Position(1, 2, 10))
            assert photo.jpeg.startswith(JPEG)
            assert asked_s <= photo.captured_s <= clock()
            assert photo.source
            if kind in {"folder", "video"}:
                assert photo.lens == LENS

    (run_virtually if kind in {"model", "rendered"} else asyncio.run)(shoot())


@pytest.mark.parametrize("kind", ["model", "rendered", "folder"])
def test_a_photo_takes_its_time(kind: str, tmp_path: Path) -> None:
    async def seconds() -> float:
        clock = asyncio.get_running_loop().time
        async with a_camera(kind, tmp_path) as camera:
            began_s = clock()
            await camera.take_photo(Position(1, 2, 10))
            return clock() - began_s

    virtual = kind != "folder"
    took_s = (run_virtually if virtual else asyncio.run)(seconds())
    assert took_s == pytest.approx(0.1, abs=1e-6 if virtual else 0.09)


class Found(msgspec.Struct):
    label: str


async def happen(journal: Journal, notifier: Notifier) -> None:
    journal.record(event("armed"))
    await asyncio.sleep(0.1)
    journal.record(event("vehicle_limits", highest_m=0.5, home={"east_m": 1.0, "north_m": 2.0}))
    await notifier.notify([Found("hot-spot")], Position(1.0, 2.0, 3.0))


def in_memory(_: Path) -> list[dict[str, Any]]:
    async def run() -> list[dict[str, Any]]:
        journal = MemoryJournal()
        journal.begin()
        await happen(journal, journal)
        return written(journal.events)

    return run_virtually(run())


def in_a_file(folder: Path) -> list[dict[str, Any]]:
    async def run() -> None:
        with contextlib.closing(FileJournal(folder / "log.jsonl")) as journal:
            await happen(journal, journal)

    asyncio.run(run())
    opened, *events = map(msgspec.json.decode, (folder / "log.jsonl").read_bytes().splitlines())
    assert opened["event"] == "log_opened"
    return events


@pytest.mark.parametrize("record", [in_memory, in_a_file])
def test_events_are_kept_in_order_with_their_time_and_facts(
    record: Callable[[Path], list[dict[str, Any]]], tmp_path: Path
) -> None:
    events = record(tmp_path)
    times_s = [event.pop("t") for event in events]
    assert times_s[0] == pytest.approx(0.0, abs=0.05)
    assert 0.09 < times_s[1] - times_s[0] < 1.0
    assert events == [
        {"event": "armed"},
        {
            "event": "vehicle_limits",
            "home": {"east_m": 1.0, "north_m": 2.0, "altitude_m": 0.0},
            "highest_m": 0.5,
            "fences": [],
        },
        {
            "event": "notified",
            "message": [{"label": "hot-spot"}],
            "at": {"east_m": 1.0, "north_m": 2.0, "altitude_m": 3.0},
        },
    ]
