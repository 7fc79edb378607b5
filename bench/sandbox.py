"""What a sandbox costs: the same 430 KB call, by mutual TLS over loopback, of a process without one and with one."""

from __future__ import annotations

import asyncio
import os
import tempfile
import time
from pathlib import Path
from statistics import median

import msgspec

from upwash.ports import InstanceSpec, Program
from upwash.protocol import service_path
from upwash.real.credentials import Credentials, fingerprint, make_keys, read_credentials
from upwash.real.door import leading, opened_door
from upwash.real.limits import Limits
from upwash.real.link import GrpcDialer, GrpcLink
from upwash.real.runtime import ProcessInstance, ProcessRuntime, sockets_in
from upwash.real.sandbox import find_sandbox
from upwash.real.trust import Trust

REQUEST_BYTES = 430_000
MAX_MESSAGE_BYTES = 2**20
WARM_UP, ROUNDS, STARTS = 20, 200, 5
SPEC = InstanceSpec("s1", "echo", Program("bench.echo:Echo"))
BODY = msgspec.msgpack.encode({"photo": bytes(REQUEST_BYTES)})


async def main() -> None:
    """Measures and prints."""
    load = ", ".join(f"{load:.2f}" for load in os.getloadavg())
    print(f"request {REQUEST_BYTES} bytes, mutual TLS, loopback; {os.cpu_count()} cores, load {load}")
    sandbox = find_sandbox(Limits(2**31, 256, 2**28), readable=())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_keys(folder, servers=[["s1"]], drones=["d1"])
        keys = {
            each: read_credentials(folder / "authority.pem", folder / f"{each}.pem", folder / f"{each}.key")
            for each in ("s1", "d1")
        }
        async with opened_door(Trust(keys["s1"])) as door:
            plain, boxed = (
                ProcessRuntime(
                    sockets_in(folder),
                    lead=leading(door, "127.0.0.1"),
                    max_message_bytes=MAX_MESSAGE_BYTES,
                    sandbox=around,
                )
                for around in (None, sandbox)
            )
            await compare_runtimes(plain, boxed, keys["d1"])


async def compare_runtimes(plain: ProcessRuntime, boxed: ProcessRuntime, drone: Credentials) -> None:
    """Starts instances of both, and has one of each called."""
    found = {
        "plain process": [await started(plain) for _ in range(STARTS)],
        "bubblewrap": [await started(boxed) for _ in range(STARTS)],
    }
    for title, starts in found.items():
        print(f"{title:16} ready after {median(start_s for _, start_s in starts):.2f} s")
    await compare(found["plain process"][0][0], found["bubblewrap"][0][0], drone)
    for starts in found.values():
        for instance, _ in starts:
            await instance.stop()


async def started(runtime: ProcessRuntime) -> tuple[ProcessInstance, float]:
    """An instance, and how long it took until it could be called."""
    began_s = time.perf_counter()
    return await runtime.start(SPEC, called=lambda _: None), time.perf_counter() - began_s


async def compare(plain: ProcessInstance, boxed: ProcessInstance, drone: Credentials) -> None:
    """Calls the two in turn and prints the medians, and the median of the rounds' ratios."""
    dialer = GrpcDialer("d1", drone, max_message_bytes=MAX_MESSAGE_BYTES)
    links = []
    for instance in (plain, boxed):
        await instance.admit(frozenset({fingerprint(drone.certificate)}))
        links.append(dialer.dial(f"127.0.0.1{instance.endpoint}", server="s1"))
    for _ in range(WARM_UP):
        for link in links:
            await call(link)
    rounds = [[await call(link) for link in links] for _ in range(ROUNDS)]
    for title, delays_s in zip(("plain process", "bubblewrap"), zip(*rounds, strict=True), strict=True):
        print(f"{title:16} {median(delays_s) * 1e3:.2f} ms")
    more_s = median(boxed_s - plain_s for plain_s, boxed_s in rounds)
    ratio = median(boxed_s / plain_s for plain_s, boxed_s in rounds)
    print(f"in bubblewrap {more_s * 1e3:+.2f} ms, {ratio:.2f} times, medians of {ROUNDS} rounds")
    for link in links:
        await link.close()


async def call(link: GrpcLink) -> float:
    """How long one call takes."""
    began_s = time.perf_counter()
    await link.request(service_path("echo", "measure"), BODY, timeout_s=10.0)
    return time.perf_counter() - began_s


if __name__ == "__main__":
    asyncio.run(main())
