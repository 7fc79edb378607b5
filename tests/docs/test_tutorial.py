"""The tutorial does what it says: its files are made as it shows them, and its commands are run, in its order."""

from __future__ import annotations

import os
import re
import shlex
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from shutil import copytree
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
pytestmark = pytest.mark.xdist_group("tutorial")  # its pages are followed once
SERVER = "192.168.1.20:7070"  # where the tutorial has it
TERMINAL = re.compile(r"terminal \d+")


class Block(NamedTuple):
    """Fenced lines of a page, with the title that says what is done with them."""

    language: str
    title: str
    text: str


def blocks(page: str) -> Iterator[Block]:
    fenced = re.findall(
        r'^ *```(\w*)(?: title="([^"]*)")?\n(.*?)^ *```$',
        (DOCS / page).read_text(),
        flags=re.MULTILINE | re.DOTALL,
    )
    for each in fenced:
        yield Block(*each)


class Learner:
    """Follows pages in a folder, as a person would who reads them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.printed = ""
        self._printed_last: str | None = None  # None after commands that are not run

    def follow(self, page: str) -> None:
        """Does what the page says, but for the commands that each run in a terminal of their own."""
        for block in blocks(page):
            match block:
                case Block("sh", "", commands):
                    self._printed_last = "".join(map(self._run, commands.splitlines()))
                    self.printed += self._printed_last
                case Block("sh", _, _):
                    self._printed_last = None
                case Block("", _, shown):
                    if self._printed_last is not None:
                        assert_printed(shown, self._printed_last)
                case Block(_, title, text):
                    self._write(*title.partition(", ")[::2], text)

    def _run(self, command: str) -> str:
        if command.startswith("cd "):
            self.folder /= command.removeprefix("cd ")
            return ""
        return run(command, self.folder).stdout

    def _write(self, name: str, where: str, text: str) -> None:
        """A file that is there already shows the block, unless the title says where it goes."""
        file = self.folder / name
        if not where:
            if not file.exists():
                file.write_text(text)
            for line in text.splitlines():
                assert line in file.read_text().splitlines(), f"{name} has no line {line!r}"
            return
        lines = file.read_text().splitlines(keepends=True)
        table, _, instead_of = where.removeprefix("above ").partition(": instead of ")
        (at,) = (number for number, line in enumerate(lines) if line.strip() == table)
        if instead_of:
            at = next(n for n in range(at, len(lines)) if lines[n].startswith(f"{instead_of} ="))
            lines[at] = text
        else:
            lines.insert(at, text + "\n")
        file.write_text("".join(lines))


def assert_printed(shown: str, printed: str) -> None:
    """What a page shows, where "..." stands for the rest of a line."""
    at = 0
    for part in re.split(r"\.\.\.|\n", shown):
        words = " ".join(part.split())
        found = " ".join(printed.split()).find(words, at)
        assert found >= 0, f"{words!r} is not printed, or before what is shown above it:\n{printed}"
        at = found + len(words)


def at_hand(command: str) -> list[str]:
    """The command with this Python, and this upwash."""
    program, *arguments = shlex.split(command)
    return [sys.executable, *(["-m", "upwash"] if program == "upwash" else []), *arguments]


def environment() -> dict[str, str]:
    return os.environ | {"COLUMNS": "140", "PYTEST_ADDOPTS": "-p no:cacheprovider"}


@pytest.fixture(scope="module")
def learner(tmp_path_factory: pytest.TempPathFactory) -> Learner:
    """A learner at the end of the first lesson."""
    learner = Learner(tmp_path_factory.mktemp("tutorial"))
    learner.follow("tutorial-service.md")
    return learner


def test_the_first_page_simulates_and_reports(tmp_path: Path) -> None:
    (tmp_path / "scenarios").symlink_to(ROOT / "scenarios")
    learner = Learner(tmp_path)
    learner.follow("start.md")
    assert (learner.folder / "report.html").stat().st_size > 10_000


def test_services_of_ones_own_are_simulated_checked_and_tested(learner: Learner) -> None:
    assert "2 passed" in learner.printed
    assert "Calls of sharpness" in learner.printed


@pytest.mark.long
def test_it_flies_on_the_desk(learner: Learner, tmp_path: Path) -> None:
    """At ports of its own, with a vehicle that can be armed at once."""
    folder = copytree(learner.folder, tmp_path / "flown")
    shown = list(blocks("tutorial-service.md"))
    serve, vehicle, fly = (block.text for block in shown if TERMINAL.fullmatch(block.title))
    daemon_port, vehicle_port = free_port(), free_port()
    here = f"127.0.0.1:{daemon_port}"
    for name in ("drone.toml", "server.toml"):
        file = folder / name
        text = file.read_text().replace("127.0.0.1:7070", here).replace(":14550", f":{vehicle_port}")
        if name == "server.toml" and os.geteuid() == 0:  # docs/troubleshooting.md has this for a trial
            text = "runtime.sandbox_as_root = true\n" + text
        file.write_text(text)
    with ExitStack() as running:
        for command in (
            serve,
            f"{vehicle} --listen udp:127.0.0.1:{vehicle_port} --armable-after 1 --home 39.3666,22.9507",
        ):
            process = running.enter_context(
                subprocess.Popen(
                    at_hand(command), cwd=folder, stdout=subprocess.PIPE, text=True, env=environment()
                )
            )
            running.callback(process.terminate)
            assert process.stdout is not None
            assert " ready at " in process.stdout.readline()
        flown = run(fly, folder)
        asked = run(shown_command("tutorial-server.md", "upwash status").replace(SERVER, here), folder)
        checked = run(shown_command("tutorial-autopilot.md", "upwash check drone.toml --servers"), folder)
    assert re.search(r"calls: [1-9]\d* on the drone, [1-9]\d* on s1", flown.stdout)
    assert_printed([block.text for block in shown if not block.language][-1], flown.stdout)
    for page, done in (("tutorial-server.md", asked), ("tutorial-autopilot.md", checked)):
        (printed,) = (block.text for block in blocks(page) if not block.language)
        assert_printed(printed.replace(SERVER, here), done.stdout)


def shown_command(page: str, begin: str) -> str:
    (command,) = re.findall(rf"^ +({re.escape(begin)}.*)$", (DOCS / page).read_text(), flags=re.MULTILINE)
    return str(command)


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        at_hand(command), cwd=folder, capture_output=True, text=True, check=False, env=environment()
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port: int = found.getsockname()[1]
        return port
