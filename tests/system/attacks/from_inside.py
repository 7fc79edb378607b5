"""What a hostile service costs its daemon: `python -m tests.system.attacks.from_inside` measures and prints."""

from __future__ import annotations

import asyncio
import contextlib
import re
import tempfile
import time
import urllib.request
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.system.daemons import MAX_MESSAGE_BYTES, Daemon, Guest, daemon, memory_bytes

from upwash.errors import LinkError
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.authority import keys_in, make_keys
from upwash.real.trust.credentials import fingerprint, read_credentials

SERVICE = Path(__file__).with_name("hostile_service.py")
PROGRAM = f"{SERVICE}:Hostile"
LEASE_S = 2.0
INVENTED = 20_000
PRINTED_BYTES = 30_000_000
_SCRAPE_S = 30.0
_ATTACKED_S = 8.0

# By a drone, at an endpoint, where the drone is known by that key.
Attack = Callable[[Guest, str, str], Awaitable[object]]


def config(keys: Path, *, slots: int = 1, sandbox: str = "off") -> str:
    """A daemon that runs the hostile service, with metrics and short leases."""
    return f"""
listen = "127.0.0.1:0"
metrics = "127.0.0.1:0"
lease_s = {LEASE_S}
drain_s = 1
runtime = {{ sandbox = "{sandbox}", sandbox_as_root = true }}
keys = {{ authority = "{keys}/authority.pem", certificate = "{keys}/s1.pem", key = "{keys}/s1.key" }}

[[service]]
name = "hostile"
program = "{PROGRAM}"

[[server]]
name = "s1"
slots = {slots}
"""


@dataclass
class Cost:
    """What an attack cost the daemon: memory, log, the slowest look at its metrics; and what they say afterwards."""

    grown_bytes: int = 0
    log_bytes: int = 0
    scrape_s: float = 0.0
    metrics: str = ""
    log: str = ""
    scrapes: int = 0


@asynccontextmanager
async def clients(at: Daemon, keys: Path) -> AsyncIterator[list[Guest]]:
    """The drones heron and stork at the daemon."""
    async with AsyncExitStack() as stack:
        drones = []
        for name in ("heron", "stork"):
            files = keys_in(keys, name)
            shown = read_credentials(files.authority, files.certificate, files.key)
            dialer = GrpcDialer(name, shown, max_message_bytes=MAX_MESSAGE_BYTES)
            drones.append(Guest(dialer, "s1", at.address, PROGRAM))
            stack.push_async_callback(drones[-1].close)
        yield drones


def key_of(keys: Path, drone: str) -> str:
    """What instances know the drone by."""
    return fingerprint(keys_in(keys, drone).certificate.read_bytes())


async def cost(at: Daemon, folder: Path, keys: Path, attack: Attack) -> Cost:
    """Has a call of heron's make the service attack, and looks at the daemon meanwhile, which must still answer."""
    async with clients(at, keys) as (heron, _):
        endpoint = (await heron.start("hostile")).endpoint
        assert await heron.call(endpoint, "echo", b"photo") == b"photo"
        log, found = folder / "stderr", Cost()
        resident, logged = memory_bytes(at.process.pid), log.stat().st_size
        attacking = asyncio.create_task(_suppressed(attack(heron, endpoint, key_of(keys, "heron"))))
        while not attacking.done() or not found.scrapes:
            began_s = time.perf_counter()
            found.metrics = await asyncio.to_thread(scrape, log)
            found.scrape_s = max(found.scrape_s, time.perf_counter() - began_s)
            found.scrapes += 1
        assert (await heron.availability("hostile")).available
        found.metrics = await asyncio.to_thread(scrape, log)
        found.grown_bytes = memory_bytes(at.process.pid) - resident
        found.log = log.read_text()
        found.log_bytes = log.stat().st_size - logged
        return found


async def _suppressed(attack: Awaitable[object]) -> None:
    with contextlib.suppress(LinkError, TimeoutError):  # its instance may be ended for it, or be slowed down
        async with asyncio.timeout(_ATTACKED_S):
            await attack


def scrape(log: Path) -> str:
    """The daemon's metrics, at the address that its log names."""
    address = re.findall("metrics at (http://[^ \n]+)", log.read_text())[-1]
    with urllib.request.urlopen(address, timeout=_SCRAPE_S) as answer:
        return str(answer.read().decode())


async def keeps_its_slot_silent_s(at: Daemon, keys: Path, *, most_s: float) -> float:
    """How long a drone that says nothing any more keeps its slot where the service says that it calls."""
    async with clients(at, keys) as (heron, stork):
        endpoint = (await heron.start("hostile")).endpoint
        await heron.call(endpoint, "forge_calls", ["heron", key_of(keys, "heron")], 0.05)
        silent_s = time.monotonic()
        while not (await stork.availability("hostile")).available:
            if time.monotonic() - silent_s > most_s:
                break
            await asyncio.sleep(0.05)
        return time.monotonic() - silent_s


ATTACKS: dict[str, Attack] = {
    f"{INVENTED} invented methods": lambda drone, at, key: drone.call(at, "invent_methods", key, INVENTED),
    "3,000 impossible times": lambda drone, at, key: drone.call(at, "claim_times", key, 1500),
    "20,000 messages out of turn": lambda drone, at, _: drone.call(at, "speak_out_of_turn", 20_000),
    "30 MB of long lines": lambda drone, at, _: drone.call(at, "print_much", PRINTED_BYTES, "x" * 900),
    "3 MB of short lines": lambda drone, at, _: drone.call(at, "print_much", PRINTED_BYTES // 10, "x"),
}


def main() -> None:
    """Prints the table."""
    print("| attack | memory, MB | log, kB | metrics at worst, ms |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        keys = Path(folder, "keys")
        make_keys(keys, servers=[["s1"]], drones=["heron", "stork"])
        for name, attack in ATTACKS.items():
            with daemon(Path(folder), config(keys), names="s1") as at:
                found = asyncio.run(cost(at, Path(folder), keys, attack))
            print(
                f"| {name} | {found.grown_bytes / 1e6:.1f} | {found.log_bytes / 1e3:.1f} "
                f"| {found.scrape_s * 1e3:.0f} |",
                flush=True,
            )
        with daemon(Path(folder), config(keys), names="s1") as at:
            kept_s = asyncio.run(keeps_its_slot_silent_s(at, keys, most_s=5 * LEASE_S))
        print(f"\na silent drone keeps its slot, of a lease of {LEASE_S} s, for {kept_s:.1f} s")


if __name__ == "__main__":
    main()
