"""The bundled survey goes on where a photo fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.config.drone_file import drone_config
from upwash.core.geo import Position
from upwash.errors import CameraError
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate, simulate_fleet
from upwash.ports import Photo
from upwash.sim.camera import ModelCamera

WAYPOINTS = [[0, 0], [20, 0], [40, 0], [60, 0]]
CONFIG = drone_config(
    {
        "mission": {"waypoints_m": WAYPOINTS},
        "service": [{"name": "detector", "local_call_s": {"light": 3.0, "heavy": 10.0}}],
    },
    Path("scenario.toml"),
)


def told(run: Run) -> list[tuple[str, float]]:
    return [
        (str(event.message), event.at.east_m) for event in run.events if isinstance(event, schema.Notified)
    ]


def fail_at(monkeypatch: pytest.MonkeyPatch, east_m: float, times: int) -> None:
    """Has the camera give no photo there, so many times."""
    shoot, failed = ModelCamera.take_photo, [0]

    async def take_photo(camera: ModelCamera, at: Position) -> Photo:
        if abs(at.east_m - east_m) < 1.0 and failed[0] < times:
            failed[0] += 1
            raise CameraError("photos", "b.jpg cannot be read")
        return await shoot(camera, at)

    monkeypatch.setattr(ModelCamera, "take_photo", take_photo)


def test_a_photo_that_fails_once_is_taken_again(monkeypatch: pytest.MonkeyPatch) -> None:
    fail_at(monkeypatch, 20.0, times=1)
    run = simulate(CONFIG)
    assert run.failure == "" and run.result.completed
    assert len(run.result.calls) == len(WAYPOINTS)
    assert told(run) == []


def test_a_waypoint_without_a_photo_is_told_and_the_survey_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    fail_at(monkeypatch, 20.0, times=9)
    run = simulate(CONFIG)
    assert run.failure == "" and run.result.completed
    assert len(run.result.calls) == len(WAYPOINTS) - 1
    assert told(run) == [("no photo: camera photos: b.jpg cannot be read", 20.0)]


def test_photos_that_the_detector_cannot_read_are_told_and_the_survey_goes_on() -> None:
    (run,) = simulate_fleet([CONFIG], computing=True)  # with the made-up photos of a simulation
    assert run.failure == "" and run.result.completed
    assert [east_m for _, east_m in told(run)] == [east_m for east_m, _ in WAYPOINTS]
    assert all("JPEG" in words for words, _ in told(run))
