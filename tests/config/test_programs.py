"""Programs in files: services and missions of the user's own, named by a path from the configuration's folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.config.daemon import read_daemon_config
from upwash.config.drone_file import read_drone_config
from upwash.errors import ConfigError

DRONE = """
[mission]
program = "mine.py:fly"
waypoints_m = [[0, 0]]
[[service]]
name = "gauge"
program = "PROGRAM"
local_call_s = 1.0
"""
DAEMON = """
listen = "127.0.0.1:0"
allow_without_certificates = true
[[service]]
name = "gauge"
program = "PROGRAM"
[[server]]
name = "s1"
"""
PROGRAMS = [
    ("services/gauge.py:Gauge", "{folder}/services/gauge.py:Gauge"),
    ("/opt/gauge.py:Gauge", "/opt/gauge.py:Gauge"),
    ("field.gauges:Gauge", "field.gauges:Gauge"),
]


def written(folder: Path, text: str, program: str) -> Path:
    file = folder / "config.toml"
    file.write_text(text.replace("PROGRAM", program))
    return file


@pytest.mark.parametrize(("program", "found"), PROGRAMS)
def test_a_services_file_counts_from_the_configurations_folder(
    program: str, found: str, tmp_path: Path
) -> None:
    drone = read_drone_config(written(tmp_path, DRONE, program))
    daemon = read_daemon_config(written(tmp_path, DAEMON, program))
    assert drone.services[0].program == daemon.images[0].program == found.format(folder=tmp_path)
    assert drone.mission.program == f"{tmp_path}/mine.py:fly"


@pytest.mark.parametrize(
    "device",
    [
        "/dev/video0",
        "rtsp://10.0.0.5/a/b",
        "videotestsrc ! appsink",
        "other.mp4",
        "x" * 300,
        "{folder}/film.mp4",
    ],
)
def test_a_film_counts_from_the_configurations_folder_and_other_sources_stay_as_they_are(
    device: str, tmp_path: Path
) -> None:
    (tmp_path / "film.mp4").touch()
    camera = '[camera]\ndevice = "{}"\n' + DRONE
    film = read_drone_config(written(tmp_path, camera.format("film.mp4"), "gauge.py:Gauge"))
    assert film.camera.device == f"{tmp_path}/film.mp4"
    source = device.format(folder=tmp_path)
    other = read_drone_config(written(tmp_path, camera.format(source), "gauge.py:Gauge"))
    assert other.camera.device == source


@pytest.mark.parametrize("program", ["gauge.py", "gauge.py:", "gauge/sh:Gauge", "Gauge", "gauge.py:a b"])
def test_what_names_no_class_is_refused(program: str, tmp_path: Path) -> None:
    for read, text in (read_drone_config, DRONE), (read_daemon_config, DAEMON):
        with pytest.raises(ConfigError, match=r'service\[0\]\.program: .*"path/to/file\.py:Class"'):
            read(written(tmp_path, text, program))
