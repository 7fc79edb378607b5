"""A hostile service says and prints what it likes: its daemon's memory, log, metrics and leases stay as they are."""

from __future__ import annotations

import asyncio
import contextlib
import re
import time
import urllib.request
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from tests.played import played
from tests.system.daemons import Daemon, Guest, config, daemon, eventually, guests, memory_bytes, shown

from upwash.errors import LinkError
from upwash.real.trust.credentials import fingerprint

pytestmark = [pytest.mark.system, pytest.mark.long]

PROGRAM = f"{Path(__file__).parent}/attacks/hostile_service.py:Hostile"
LEASE_S = 2.0
INVENTED = 20_000
PRINTED_BYTES = 30_000_000
ATTACKED_S = 8.0
MOST_GROWN_BYTES = 20_000_000
MOST_LOGGED_BYTES = 150_000
MOST_SCRAPE_S = 1.5

Scene = Callable[[Daemon, Guest, Guest, str], Awaitable[None]]
# By a drone, at an endpoint, where the drone is known by that key.
Attack = Callable[[Guest, str, str], Awaitable[object]]


@pytest.fixture
def attacked(tmp_path: Path, keys: Path) -> Callable[[Scene], None]:
    """Plays a scene of a daemon that runs the hostile service, of heron and stork, and what heron is known by."""
    hostile = {"name": "hostile", "program": PROGRAM}
    settings = {"metrics": "127.0.0.1:0", "lease_s": LEASE_S, "drain_s": 1, "service": [hostile]}

    def play(scene: Scene) -> None:
        async def live(at: Daemon) -> None:
            drones = [(name, shown(keys, name), "s1") for name in ("heron", "stork")]
            async with guests(at, PROGRAM, *drones) as (heron, stork):
                await scene(at, heron, stork, fingerprint(shown(keys, "heron").certificate))

        text = config(keys, server=[{"name": "s1", "slots": 1}], **settings)
        with daemon(tmp_path, text, names="s1") as at:
            asyncio.run(live(at))

    return play


def scrape(at: Daemon) -> str:
    """The daemon's metrics, at the address that its log names."""
    address = re.findall("metrics at (http://[^ \n]+)", at.said())[-1]
    with urllib.request.urlopen(address, timeout=30.0) as answer:
        return str(answer.read().decode())


async def suppressed(attack: Awaitable[object]) -> None:
    with contextlib.suppress(LinkError, TimeoutError):  # its instance may be ended for it, or be slowed down
        async with asyncio.timeout(ATTACKED_S):
            await attack


@pytest.mark.parametrize(
    "attack",
    [
        lambda drone, at, key: drone.call(at, "invent_methods", key, INVENTED),
        lambda drone, at, key: drone.call(at, "claim_times", key, 1500),
        lambda drone, at, _: drone.call(at, "speak_out_of_turn", 20_000),
        lambda drone, at, _: drone.call(at, "print_much", PRINTED_BYTES, "x" * 900),
        lambda drone, at, _: drone.call(at, "print_much", PRINTED_BYTES // 10, "x"),
    ],
    ids=["invented methods", "impossible times", "messages out of turn", "long lines", "short lines"],
)
@played("attacked")
async def test_it_costs_the_daemon_next_to_nothing(
    at: Daemon, heron: Guest, _: Guest, key: str, *, attack: Attack
) -> None:
    endpoint = (await heron.start("hostile")).endpoint
    assert await heron.call(endpoint, "echo", b"photo") == b"photo"
    resident, logged = memory_bytes(at.process.pid), len(at.said())
    attacking = asyncio.create_task(suppressed(attack(heron, endpoint, key)))
    scrapes_s: list[float] = []
    while not attacking.done() or not scrapes_s:
        began_s = time.perf_counter()
        await asyncio.to_thread(scrape, at)
        scrapes_s.append(time.perf_counter() - began_s)
    assert (await heron.availability("hostile")).available
    metrics = await asyncio.to_thread(scrape, at)
    assert memory_bytes(at.process.pid) - resident <= MOST_GROWN_BYTES
    assert len(at.said()) - logged <= MOST_LOGGED_BYTES
    assert max(scrapes_s) <= MOST_SCRAPE_S
    assert "invented" not in metrics
    seconds = re.findall(r"upwash_service_seconds_sum\{.*\} (.*)", metrics)
    assert len(seconds) <= 2
    assert all(0.0 <= float(second) < 60.0 for second in seconds)


@played("attacked")
async def test_what_it_says_keeps_no_silent_drones_slot(
    _: Daemon, heron: Guest, stork: Guest, key: str
) -> None:
    endpoint = (await heron.start("hostile")).endpoint
    await heron.call(endpoint, "forge_calls", ["heron", key], 0.05)
    silent_s = time.monotonic()
    await eventually(lambda: stork.availability("hostile"), lambda answer: answer.available)
    assert LEASE_S * 0.9 <= time.monotonic() - silent_s <= LEASE_S * 2


@pytest.mark.parametrize(
    ("attack", "arguments", "reason"),
    [
        ("invent_methods", ("heron", 20_000), "it sent too much over its control line"),
        ("speak_out_of_turn", (1,), "it sent a message out of turn"),
        ("fail_at_length", (), "it sent a message that cannot be decoded"),
        ("cut_the_line", (), "it sent a message that cannot be decoded"),
        ("leave", (255,), "ended with code 255"),
        ("leave", (200,), "ended with code 200"),
    ],
)
@played("attacked")
async def test_it_is_ended_with_the_reason_and_started_again(
    at: Daemon, heron: Guest, *, attack: str, arguments: tuple[object, ...], reason: str
) -> None:
    endpoint = (await heron.start("hostile")).endpoint
    with pytest.raises(LinkError):
        while True:  # it may answer before its daemon has read what it said, or before it is ended
            with contextlib.suppress(ConnectionError):  # its own, as its line was cut while it spoke
                await heron.call(endpoint, attack, *arguments)
    await eventually(lambda: heron.start("hostile"), lambda reply: reply.endpoint not in ("", endpoint))
    again = (await heron.start("hostile")).endpoint
    assert await heron.call(again, "echo", b"photo") == b"photo"
    at.has_said(f"hostile@s1 is gone: {reason}")
