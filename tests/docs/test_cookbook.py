"""The cookbook's files do what its recipes say, and the page shows them as they are."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import cv2
import pytest

from upwash.cli.main import main
from upwash.config.daemon import read_daemon_config

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "cookbook"
PAGE = (ROOT / "docs" / "cookbook.md").read_text()
SERVERS = sorted(FOLDER.glob("*_server.toml"))
DRONES = sorted(set(FOLDER.glob("*.toml")) - set(SERVERS))


@pytest.mark.parametrize("file", DRONES, ids=lambda file: file.stem)
def test_a_recipe_is_simulated_with_calls_on_the_server(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", str(file)]) == 0
    said = capsys.readouterr()
    assert re.search(r"\b[1-9]\d* (on (s1|cloud)|of 4\b)", said.out), said.out


@pytest.mark.parametrize("file", SERVERS, ids=lambda file: file.stem)
def test_a_servers_file_is_understood(file: Path) -> None:
    assert read_daemon_config(file).images


def test_the_page_shows_its_files_as_they_are() -> None:
    shown = re.findall(r'^```toml title="([^"]+)"\n(.*?)^```$', PAGE, flags=re.MULTILINE | re.DOTALL)
    assert shown
    for name, text in shown:
        assert text in (FOLDER / name).read_text(), f"the page shows another {name}"


def test_every_file_has_its_recipe() -> None:
    for file in FOLDER.iterdir():
        if file.suffix in (".toml", ".py"):
            assert file.name in PAGE, f"no recipe names {file.name}"


def test_the_marker_service_reads_a_code() -> None:
    drawn = cv2.QRCodeEncoder.create().encode("panel 17")
    large = cv2.resize(drawn, None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST)
    large = cv2.copyMakeBorder(large, *(40, 40, 40, 40), cv2.BORDER_CONSTANT, value=255)
    _, photo = cv2.imencode(".jpg", large)
    markers = runpy.run_path(str(FOLDER / "markers.py"))["Markers"]()
    assert markers.read(photo.tobytes()) == ["panel 17"]
