"""The page about a survey: its files, copied as it says, and its commands end with the client's document."""

from __future__ import annotations

import os
import re
import shlex
import shutil
from pathlib import Path

import pytest
from tests.docs.test_tutorial import SERVER, blocks, free_port
from tests.programs import ROOT, running, stand_in, upwash
from tests.surveys import transects, written
from tests.system.test_own_model import export_model, write_film

pytestmark = [pytest.mark.system, pytest.mark.long]
PAGE = "survey.md"


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    """The folder on the desk, with the files that the page takes for granted, makes and shows."""
    folder = tmp_path / "desk"
    folder.mkdir()
    written(folder, transects()[:12])
    export_model(folder / "best.onnx")
    write_film(folder / "film.mp4")
    here = f"127.0.0.1:{free_port()}"
    for block in blocks(PAGE):
        if block.language == "toml":
            text = block.text.replace(SERVER, here).replace("0.0.0.0:7070", here)
            (folder / block.title).write_text(text)
        if block.title == "desk":
            run(folder, block.text)
    if os.geteuid() == 0:  # docs/troubleshooting.md has this for a trial
        server = folder / "server.toml"
        server.write_text("runtime.sandbox_as_root = true\n" + server.read_text())
    return folder


def run(folder: Path, commands: str) -> str:
    said = ""
    for command in commands.splitlines():
        done = upwash(*shlex.split(command)[1:], folder=folder)
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
        said += done.stdout
    return said


def copied(desk: Path, to: str) -> Path:
    """A folder with the files that the page has the reader copy there."""
    page = (ROOT / "docs" / PAGE).read_text()
    (files,) = re.findall(rf"^\| the {to} \| (.*) \|$", page, re.MULTILINE)
    folder = desk.with_name(to)
    for name in re.findall(r"`(.*?)`", files):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(desk / name, folder / name)
    return folder


def test_a_plan_a_network_and_a_camera_end_as_a_document(desk: Path) -> None:
    drone, server = copied(desk, "drone"), copied(desk, "server")
    commands = [block.text for block in blocks(PAGE) if block.title == "drone"]
    with (
        running("serve", "--config", "server.toml", folder=server) as daemon,
        stand_in(drone, "--home", "39.3666,22.9507") as connection,
    ):
        assert daemon.stdout is not None
        assert any(" ready at " in line for line in daemon.stdout)
        said = run(drone, "".join(commands).replace("udpout:127.0.0.1:14550", connection))
    assert re.search(r"calls: \d+ on the drone, [1-9]\d* on s1", said)
    document = (drone / "inspection.html").read_text()
    assert "Roof of hall 3" in document
    assert document.count("lamp") >= 12  # one on each photo of the plan
