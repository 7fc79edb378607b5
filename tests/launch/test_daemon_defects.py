"""Defects in what a daemon does beside its requests: it ends with an error, or stays, but never serves half."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import pytest

from upwash.launch import daemon, daemon_changes
from upwash.launch.daemon_reload import Reloads
from upwash.real.host.service_manager import ServiceManager
from upwash.real.trust.authority import make_keys
from upwash.server.daemon import EdgeServer

ALONE = """
listen = "unix:{folder}/d"
allow_without_certificates = true
runtime.sandbox = "off"
[[server]]
name = "s1"
slots = 1
[[service]]
name = "workbench"
program = "tests.services_for_tests:Workbench"
"""
WITH_KEYS = """
listen = "127.0.0.1:0"
runtime.sandbox = "off"
[keys]
authority = "{folder}/keys/authority.pem"
certificate = "{folder}/keys/s1.pem"
key = "{folder}/keys/s1.key"
[[server]]
name = "s1"
slots = 1
[[service]]
name = "workbench"
program = "tests.services_for_tests:Workbench"
"""


async def fail(*_: Any, **__: Any) -> NoReturn:
    await asyncio.sleep(0)
    raise LookupError("a defect")


def serve(text: str, folder: Path, ready: Callable[[str, str], None] = lambda *_: None) -> None:
    file = folder / "daemon.toml"
    file.write_text(text.format(folder=folder))

    async def main() -> None:
        async with asyncio.timeout(20.0):
            await daemon.serve(file, ready=ready, manager=ServiceManager(""))

    asyncio.run(main())


@pytest.mark.parametrize("defective", ["edge", "reload", "expiry"])
def test_a_daemon_whose_background_fails_ends_with_that_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, defective: str
) -> None:
    match defective:
        case "edge":
            monkeypatch.setattr(EdgeServer, "run", fail)
        case "reload":
            monkeypatch.setattr(Reloads, "run", fail)
        case "expiry":
            monkeypatch.setattr(daemon, "watch_expiry", fail)
    with pytest.raises(LookupError, match="a defect"):
        serve(ALONE, tmp_path)


def test_the_program_of_a_daemon_that_fails_says_why_and_exits_with_an_error(tmp_path: Path) -> None:
    file = tmp_path / "daemon.toml"
    file.write_text(ALONE.format(folder=tmp_path))
    program = (
        "import sys; from upwash.server.daemon import EdgeServer; from tests.launch.test_daemon_defects import fail;"
        "EdgeServer.run = fail; from upwash.__main__ import main; sys.exit(main())"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program, "serve", "--config", str(file)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60.0,
    )
    assert ended.returncode == 1, "for the service manager, which starts it again"
    assert "LookupError: a defect" in ended.stderr


def test_a_defect_in_handing_over_leaves_the_daemon_serving(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    make_keys(tmp_path / "keys", servers=[["s1"]], drones=[])
    monkeypatch.setattr(daemon_changes, "hand_over", fail)

    class StaysThenStops(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if "this daemon stays" in record.getMessage():
                os.kill(os.getpid(), signal.SIGTERM)

    logging.getLogger("upwash.serving").addHandler(stopper := StaysThenStops())
    try:
        serve(WITH_KEYS, tmp_path, ready=lambda *_: os.kill(os.getpid(), signal.SIGUSR2))
    finally:
        logging.getLogger("upwash.serving").removeHandler(stopper)
    assert "this daemon stays: a defect in handing over" in caplog.text
    assert "has taken this daemon's place" not in caplog.text
