"""The demonstration, flown for real against two servers whose services run in containers, and shot at."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from tests.children import children
from tests.engines import Kind, OwnEngine
from tests.programs import printed
from tests.system.test_demonstration import Demonstration, started
from tests.waiting import wait_for

pytestmark = [pytest.mark.root, pytest.mark.system, pytest.mark.timeout(400)]

RUNTIME = """\
[runtime]
kind = "lxd"
network.subnet = "{subnet}"
engine.addresses = ["unix:{socket}"]
"""
DAEMON = """\
listen = "127.0.0.1:0"
keys = { authority = "a", certificate = "b", key = "c" }
service = [{ name = "detector" }]
server = [{ name = "s1" }]
"""


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param("lxd", marks=pytest.mark.xdist_group("lxd")),
        pytest.param("incus", marks=[pytest.mark.xdist_group("incus"), pytest.mark.nightly]),
    ],
)
def test_a_mission_survives_the_kill_of_a_container_and_of_a_daemon_in_mid_call(
    kind: Kind, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    engine: OwnEngine = request.getfixturevalue(kind)
    runtime = RUNTIME.format(subnet=engine.subnet, socket=engine.socket)
    (tmp_path / "runtime.toml").write_text(runtime)
    (tmp_path / "daemon.toml").write_text(DAEMON + runtime)
    of_daemon = ("--config", str(tmp_path / "daemon.toml"))
    printed("upwash", "package", "detector", "--output", str(tmp_path), *of_daemon, "--import")
    assert "detector" in printed("upwash", "images", *of_daemon)

    for folder in (tmp_path, tmp_path / "again"):  # a busy machine may start a container as the drone goes
        with started(folder, "--runtime", str(tmp_path / "runtime.toml")) as flight:
            if (hung := next_call_hangs(flight, engine, "s1")) is None:
                continue
            os.kill(hung, signal.SIGKILL)
            if next_call_hangs(flight, engine, "s2") is None:
                continue
            (daemon,) = [each for each in flight.daemons() if each.command.rstrip().endswith("s2.toml")]
            os.kill(daemon.pid, signal.SIGKILL)
            result = flight.finish()
            break
    else:
        pytest.fail("in two flights a server got no second call")
    failed = [event["server"] for event in flight.events() if event["event"] == "remote_failed"]
    assert {"s1", "s2"} <= set(failed), "each call in progress was cut"
    assert (
        result.completed and result.totals.calls == 12
    )  # by the drone, or by the server where it was back first
    assert set(result.totals.remote) == {"s1", "s2"}
    wait_for(lambda: engine.running() == [], within_s=15.0)


def next_call_hangs(flight: Demonstration, engine: OwnEngine, server: str) -> int | None:
    """Stops the server's service after its first call, while the drone uses it, until it is called again.

    Returns the id of its container's first process; None, at the end of the flight, if no other call follows.
    """
    flight.wait_for(
        lambda event: (event["event"] == "call" and event["place"] == server) or has_passed(event)
    )
    if any(map(has_passed, flight.events())):
        flight.finish()
        return None
    (container,) = [name for name in engine.running() if f"-{server}-" in name]
    init = engine.process_1(container)
    (service,) = children(init)
    while True:
        os.kill(service, signal.SIGSTOP)
        seen = len(flight.events())
        flight.wait_for(
            lambda event: (
                is_sent_to(server, event) or is_of(server, event, "deselected") or has_passed(event)
            ),
            since=seen,
        )
        if any(is_sent_to(server, event) for event in flight.events()[seen:]):
            return init
        os.kill(service, signal.SIGCONT)  # the daemon would replace it before the drone is back
        flight.wait_for(
            lambda event: is_of(server, event, "started", "found_running") or has_passed(event), since=seen
        )
        if any(map(has_passed, flight.events()[seen:])):
            flight.finish()
            return None


def is_sent_to(server: str, event: dict[str, Any]) -> bool:
    return (event["event"], event.get("decision"), event.get("server")) == ("decided", "remote", server)


def has_passed(event: dict[str, Any]) -> bool:
    """Whether the drone makes no more calls."""
    return bool(event["event"] == "mission_completed")


def is_of(server: str, event: dict[str, Any], *kinds: str) -> bool:
    return event["event"] in kinds and event["server"] == server
