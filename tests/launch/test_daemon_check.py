"""What `upwash serve --check` finds before a reload."""

from __future__ import annotations

import hashlib
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from upwash.launch.daemon_check import check
from upwash.launch.daemon_reload import ConfigFile
from upwash.real.trust.authority import make_keys, revoke

CONFIG = """
listen = "127.0.0.1:7070"
[runtime]
sandbox = "off"
[keys]
authority = "keys/authority.pem"
certificate = "keys/s1.pem"
key = "keys/s1.key"
[[service]]
name = "level"
program = "level.py:Level"
[[server]]
name = "s1"
"""
SERVICE = """
from upwash import service
@service
class Level:
    def read(self) -> int:
        return 1
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "level.py").write_text(SERVICE)
    (tmp_path / "server.toml").write_text(CONFIG)
    return tmp_path / "server.toml"


async def test_a_configuration_without_its_keys_is_checked_as_far_as_it_goes(file: Path) -> None:
    assert await check(file, None) == {}
    (file.parent / "level.py").write_text("import nosuchmodule")
    assert "nosuchmodule" in (await check(file, None))["configuration"]


async def test_keys_that_are_there_and_broken_are_refused(file: Path) -> None:
    make_keys(file.parent / "keys", servers=[["s1"]], drones=["d1"])
    listed = revoke(file.parent / "keys", ["d1"])
    assert await check(file, None) == {}
    listed.write_text("d1 is gone\n")
    assert "line 1 does not begin with a SHA-256 fingerprint" in (await check(file, None))["keys"]


async def test_what_needs_a_restart_is_said_of_each_key(file: Path) -> None:
    running = file.with_name("running.toml")
    running.write_text(CONFIG.replace("7070", "7071").replace("[runtime]", "lease_s = 9\n[runtime]"))
    assert (await check(file, running))["without a restart"].split("; ") == [
        "lease_s cannot change while the daemon runs: hand over to a new one by SIGUSR2, or restart it",
        "listen cannot change while the daemon runs: restart it",
    ]


def test_a_configuration_that_comes_through_a_pipe_is_read_once(file: Path) -> None:
    pipe = file.with_name("pipe")
    os.mkfifo(pipe)
    with ThreadPoolExecutor() as writing:
        written = writing.submit(pipe.write_text, CONFIG)
        config, digest = ConfigFile(pipe).read()
        written.result()
    assert config.listen == "127.0.0.1:7070"
    assert digest == hashlib.sha256(CONFIG.encode()).hexdigest()
