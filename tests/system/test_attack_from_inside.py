"""A hostile service says and prints what it likes: its daemon's memory, log, metrics and leases stay as they are."""

from __future__ import annotations

import asyncio
import contextlib
import re
from pathlib import Path

import pytest
from tests.system.attacks.from_inside import (
    ATTACKS,
    LEASE_S,
    clients,
    config,
    cost,
    keeps_its_slot_silent_s,
)
from tests.system.daemons import Guest, daemon, eventually
from tests.waiting import wait_for

from upwash.errors import LinkError

pytestmark = [pytest.mark.system, pytest.mark.long]

MOST_GROWN_BYTES = 20_000_000
MOST_LOGGED_BYTES = 150_000
MOST_SCRAPE_S = 1.5


@pytest.mark.parametrize("name", ATTACKS)
def test_it_costs_the_daemon_next_to_nothing(name: str, tmp_path: Path, keys: Path) -> None:
    with daemon(tmp_path, config(keys), names="s1") as at:
        found = asyncio.run(cost(at, tmp_path, keys, ATTACKS[name]))
    assert found.grown_bytes <= MOST_GROWN_BYTES
    assert found.log_bytes <= MOST_LOGGED_BYTES
    assert found.scrape_s <= MOST_SCRAPE_S
    assert "invented" not in found.metrics
    seconds = re.findall(r"upwash_service_seconds_sum\{.*\} (.*)", found.metrics)
    assert len(seconds) <= 2
    assert all(0.0 <= float(each) < 60.0 for each in seconds)


def test_what_it_says_keeps_no_silent_drones_slot(tmp_path: Path, keys: Path) -> None:
    with daemon(tmp_path, config(keys), names="s1") as at:
        kept_s = asyncio.run(keeps_its_slot_silent_s(at, keys, most_s=5 * LEASE_S))
    assert LEASE_S * 0.9 <= kept_s <= LEASE_S * 2


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
def test_it_is_ended_with_the_reason_and_started_again(
    attack: str, arguments: tuple[object, ...], reason: str, tmp_path: Path, keys: Path
) -> None:
    async def visit(heron: Guest) -> None:
        endpoint = (await heron.start("hostile")).endpoint
        with pytest.raises(LinkError):
            while True:  # it may answer before its daemon has read what it said, or before it is ended
                with contextlib.suppress(ConnectionError):  # its own, as its line was cut while it spoke
                    await heron.call(endpoint, attack, *arguments)
        await eventually(lambda: heron.start("hostile"), lambda reply: reply.endpoint not in ("", endpoint))
        again = (await heron.start("hostile")).endpoint
        assert await heron.call(again, "echo", b"photo") == b"photo"

    async def run() -> None:
        async with clients(at, keys) as (heron, _):
            await visit(heron)

    with daemon(tmp_path, config(keys), names="s1") as at:
        asyncio.run(run())
        wait_for(lambda: f"hostile@s1 is gone: {reason}" in (tmp_path / "stderr").read_text())
