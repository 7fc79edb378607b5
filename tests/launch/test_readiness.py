"""What keeps a configured drone from flying is found without reaching for anything."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.errors import UpwashError
from upwash.launch.heard import heard
from upwash.launch.readiness import refusals, require_ready
from upwash.launch.survey import services_in_trouble

SERVICES = """
from upwash import service
from upwash.services import Detection

def hover(drone):
    drone.autopilot.hover(1.0)

@service
class Sound:
    def call(self) -> None: ...

@service
class Unsound:
    def __init__(self) -> None:
        raise FileNotFoundError("no model.onnx")

    def call(self) -> None: ...

@service
class Shortsighted:
    def look(self, photo: bytes) -> int:
        raise ValueError("no such layer")

@service
class Spotter:
    def __init__(self) -> None:
        import sys
        print("head of mine", file=sys.stderr, flush=True)
        print("warning: scores are gone", file=sys.stderr, flush=True)

    def look(self, photo: bytes) -> list[Detection]:
        box = Detection(left_px=0, top_px=0, width_px=1, height_px=1, label="a", score=0.5)
        return [box] * (len(photo) - 1)

@service
class Late:
    def __init__(self) -> None:
        import time
        time.sleep(60.0)

    def call(self) -> None: ...
"""
SERVER = {"name": "s1", "east_m": 0, "north_m": 0, "range_m": 50, "remote_call_s": 1.0}


MISSION = {"waypoints_m": [[0, 0]], "home": {"latitude_deg": 39.0, "longitude_deg": 22.0}}


def configured(folder: Path, **tables: Any) -> DroneConfig:
    """A drone that could fly, but for what the tables change."""
    (folder / "services.py").write_text(SERVICES)
    (folder / "photos").mkdir(exist_ok=True)
    (folder / "photos" / "1.jpg").touch()
    document = {
        "mission": MISSION,
        "autopilot": {"connection": "udpout:127.0.0.1:1"},
        "camera": {"folder": "photos"},
        "service": [{"name": "sound", "program": "services.py:Sound", "local_call_s": 10.0}],
        "server": [{**SERVER, "address": "127.0.0.1:1"}],
        **tables,
    }
    return drone_config(document, folder / "drone.toml")


@pytest.mark.parametrize(
    ("tables", "kinds"),
    [
        ({}, []),
        ({"mission": {"waypoints_m": [[0, 0]]}}, ["no-home"]),
        ({"autopilot": {}}, ["no-connection"]),
        ({"autopilot": {"connection": "tcp:h:1", "signing_key": "nowhere"}}, ["signing-key"]),
        ({"server": [SERVER]}, ["no-address"]),
        ({"server": [{**SERVER, "address": "10.0.0.1:1"}]}, ["no-keys"]),
        ({"keys": {"authority": "a", "certificate": "b", "key": "c"}}, ["certificate"]),
        ({"camera": {}}, ["no-camera"]),
        ({"camera": {}, "mission": {**MISSION, "program": "services.py:hover"}}, []),
        ({"camera": {"folder": "paintings"}}, ["no-camera"]),
        ({"camera": {"folder": "photos", "terrain": "services.py"}}, ["no-terrain"]),
        *(
            ({"camera": {**camera, "calibration": calibration}}, ["no-calibration"])
            for camera in ({"folder": "photos"}, {"device": 0})
            for calibration in ("nowhere", "services.py")
        ),
        ({"camera": {"folder": "photos", "keep": "services.py/kept"}}, ["no-folder"]),
        ({"camera": {"folder": "photos", "keep": "new/{time}"}}, []),
        ({"user": {"command": ["sh", "-c", "true"]}}, []),
        ({"user": {"command": ["./services.py"]}}, ["handover"]),  # cannot be run
        ({"user": {"webhook": "https://h/x", "token_file": "nowhere"}}, ["handover"]),
        ({"user": {"webhook": "https://h/x", "token_file": "services.py"}}, ["handover"]),  # no token
        ({"mission": {"waypoints_m": [[0, 0]]}, "camera": {}}, ["no-home", "no-camera"]),
    ],
)
def test_every_reason_is_told_and_a_flight_meets_the_first(
    tmp_path: Path, tables: dict[str, Any], kinds: list[str]
) -> None:
    config = configured(tmp_path, **tables)
    found = list(refusals(config))
    assert [each.kind for each in found] == kinds
    if found:
        with pytest.raises(UpwashError) as refused:
            require_ready(config)
        assert str(refused.value) == str(found[0].error)


async def test_a_service_that_fails_on_a_photo_of_the_camera_is_named(tmp_path: Path) -> None:
    services = [{"name": "shortsighted", "program": "services.py:Shortsighted", "local_call_s": 1.0}]
    (error,) = await services_in_trouble(configured(tmp_path, service=services), {"1.jpg": b"photo"})
    assert "shortsighted.look failed on 1.jpg" in str(error) and "no such layer" in str(error)


async def test_what_services_print_and_find_in_photos_is_told(tmp_path: Path) -> None:
    services = [{"name": "spotter", "program": "services.py:Spotter", "local_call_s": 1.0}]
    told: list[str] = []
    with heard() as said:
        photos = {"1.jpg": b"1", "2.jpg": b"22"}
        assert not await services_in_trouble(configured(tmp_path, service=services), photos, told.append)
    assert told == ["spotter.look: 1 box in 1 of 2 photos, scores 0.50 to 0.50, median 0.50"]
    assert said.lines == ["spotter: head of mine"]
    assert said.warnings == ["spotter: scores are gone"]


async def test_a_service_that_starts_too_slowly_is_named_with_the_key_that_says_so(tmp_path: Path) -> None:
    services = [{"name": "late", "program": "services.py:Late", "local_call_s": 1.0}]
    config = configured(tmp_path, service=services, start_timeout_s=0.5)
    (error,) = await services_in_trouble(config, {})
    assert "late@drone was not ready within 0.5 s: raise start_timeout_s" in str(error)


async def test_services_that_do_not_start_on_this_computer_are_named(tmp_path: Path) -> None:
    services = [
        {"name": "sound", "program": "services.py:Sound", "local_call_s": 1.0},
        {"name": "unsound", "program": "services.py:Unsound", "local_call_s": 1.0},
    ]
    (error,) = await services_in_trouble(configured(tmp_path, service=services), {})
    assert "unsound" in str(error)
    assert "no model.onnx" in str(error)
