"""Photos of a camera at the autopilot are told once each, with the place that the autopilot reports."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from typing import Any

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.played import played
from tests.ports.scripted import FRAME, HOME_ABOVE_SEA_M, Script, scripted

from upwash.core.geo import Position, distance_m
from upwash.eventlog.fitting import fitted
from upwash.eventlog.schema import AutopilotPhoto, LinkTrouble
from upwash.sim.loop import run_virtually

HERE = Position(30.0, 40.0, 10.0)
GEO = FRAME.geo(HERE)
E7 = round(GEO.latitude_deg * 1e7), round(GEO.longitude_deg * 1e7)
ABOVE_SEA_M = HOME_ABOVE_SEA_M + 10.0
UNIX_S = 1_790_000_000


def tell(story: Callable[[Script], Awaitable[None]]) -> None:
    """Runs a story with a vehicle that has reported its place."""

    async def live() -> None:
        async with scripted() as script:
            await script.say(script.place(Position(0.0, 0.0, 0.0)))
            await story(script)

    run_virtually(live())


def feedback(number: int, *, flags: int = 0, unix_s: float = UNIX_S, place: tuple[int, int] = E7) -> Any:
    """What an ArduPilot says of a photo."""
    return mavlink.MAVLink_camera_feedback_message(
        round(unix_s * 1e6), 0, 1, number, *place, ABOVE_SEA_M, 10.0, 0.0, 0.0, 90.0, 0.0, flags
    )


def captured(number: int, *, result: int = 1, camera: int = 1) -> Any:
    """What a PX4 says of a photo; its altitude above the ground is a range finder's."""
    return mavlink.MAVLink_camera_image_captured_message(
        5000, UNIX_S * 10**6, camera, *E7, round(ABOVE_SEA_M * 1e3), 7_000, [1, 0, 0, 0], number, result, b""
    )


def photos(script: Script) -> list[AutopilotPhoto]:
    return [news for news in script.news if isinstance(news, AutopilotPhoto)]


@pytest.mark.parametrize("photo", [feedback(7), captured(7), captured(7, result=-1)])
@played(tell)
async def test_a_photo_has_its_number_place_and_time(script: Script, *, photo: Any) -> None:
    await script.say(photo)
    (told,) = photos(script)
    assert (told.camera, told.number, told.taken) == (1, 7, datetime.fromtimestamp(UNIX_S, UTC))
    assert (told.latitude_deg, told.longitude_deg) == pytest.approx((GEO.latitude_deg, GEO.longitude_deg))
    assert told.above_sea_m == ABOVE_SEA_M
    logged = msgspec.structs.replace(told, t=1.0)
    assert [entry for entry, _ in fitted(logged)] == [logged], "readers of the log accept it"
    assert told.position is not None
    assert distance_m(told.position, HERE) < 0.02


@played(tell)
async def test_each_photo_is_told_once(script: Script) -> None:
    await script.say(captured(1), captured(1), captured(2), captured(1, camera=2), captured(2, camera=2))
    assert [(told.camera, told.number) for told in photos(script)] == [(1, 1), (1, 2), (2, 1), (2, 2)]


@pytest.mark.parametrize("no_photo", [captured(1, result=0), feedback(1, flags=1), feedback(1, flags=2)])
@played(tell)
async def test_a_failed_capture_and_a_film_are_no_photos(script: Script, *, no_photo: Any) -> None:
    await script.say(no_photo)
    assert photos(script) == []


@played(tell)
async def test_what_the_autopilot_does_not_know_is_absent(script: Script) -> None:
    await script.say(feedback(1, unix_s=42.0, place=(0, 0)))
    assert photos(script) == [AutopilotPhoto(camera=1, number=1)]


@played(tell)
async def test_a_place_that_is_none_on_earth_is_dropped_and_told(script: Script) -> None:
    await script.say(feedback(1, place=(910_000_000, 0)))
    assert photos(script) == []
    (trouble,) = (news for news in script.news if isinstance(news, LinkTrouble) and "CAMERA" in news.why)
    assert "lat of CAMERA_FEEDBACK" in trouble.why
