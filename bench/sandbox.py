"""What a sandbox costs: `python -m bench.sandbox`.

The same 430 KB call, by mutual TLS over loopback, of a process without a sandbox and of one within.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from pathlib import Path
from statistics import median

import msgspec
from bench.program import command_line, machine

from upwash.core.admission.limits import DEFAULT_LIMITS
from upwash.ports import InstanceSpec, Program
from upwash.real.instances.local_instance import LocalInstance
from upwash.real.instances.runtime import ProcessRuntime, sockets_in
from upwash.real.instances.sandbox import find_sandbox
from upwash.real.link.door import leading, opened_door
from upwash.real.link.link import GrpcDialer, GrpcLink
from upwash.real.trust.authority import make_keys
from upwash.real.trust.credentials import Credentials, Trust, fingerprint, read_credentials
from upwash.rpc.protocol import service_path

REQUEST_BYTES = 430_000
MAX_MESSAGE_BYTES = 2**20
WARM_UP, ROUNDS, STARTS = 20, 200, 5
QUICK_ROUNDS, QUICK_STARTS = 2, 1
SPEC = InstanceSpec("s1", "echo", Program("bench.echo:Echo"), limits=DEFAULT_LIMITS)
BODY = msgspec.msgpack.encode({"photo": bytes(REQUEST_BYTES)})


async def main(rounds: int, starts: int) -> None:
    """Measures and prints."""
    print(f"request {REQUEST_BYTES} bytes, mutual TLS, loopback; {machine()}")
    sandbox = find_sandbox(readable=())
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
            await compare_runtimes(plain, boxed, keys["d1"], rounds, starts)


async def compare_runtimes(
    plain: ProcessRuntime, boxed: ProcessRuntime, drone: Credentials, rounds: int, starts: int
) -> None:
    """Starts instances of both, and has one of each called."""
    found = {
        "plain process": [await started(plain) for _ in range(starts)],
        "bubblewrap": [await started(boxed) for _ in range(starts)],
    }
    for title, instances in found.items():
        print(f"{title:16} ready after {median(start_s for _, start_s in instances):.2f} s")
    await compare(found["plain process"][0][0], found["bubblewrap"][0][0], drone, rounds)
    for instances in found.values():
        for instance, _ in instances:
            await instance.stop()


async def started(runtime: ProcessRuntime) -> tuple[LocalInstance, float]:
    """An instance, and how long it took until it could be called."""
    began_s = time.perf_counter()
    return await runtime.start(SPEC, called=lambda _: None), time.perf_counter() - began_s


async def compare(plain: LocalInstance, boxed: LocalInstance, drone: Credentials, rounds: int) -> None:
    """Calls the two in turn and prints the medians, and the median of the rounds' ratios."""
    dialer = GrpcDialer("d1", drone, max_message_bytes=MAX_MESSAGE_BYTES)
    links = []
    for instance in (plain, boxed):
        await instance.admit(frozenset({fingerprint(drone.certificate)}))
        links.append(dialer.dial(f"127.0.0.1{instance.endpoint}", server="s1"))
    for _ in range(min(rounds, WARM_UP)):
        for link in links:
            await call(link)
    found = [[await call(link) for link in links] for _ in range(rounds)]
    for title, delays_s in zip(("plain process", "bubblewrap"), zip(*found, strict=True), strict=True):
        print(f"{title:16} {median(delays_s) * 1e3:.2f} ms")
    more_s = median(boxed_s - plain_s for plain_s, boxed_s in found)
    ratio = median(boxed_s / plain_s for plain_s, boxed_s in found)
    print(f"in bubblewrap {more_s * 1e3:+.2f} ms, {ratio:.2f} times, medians of {rounds} rounds")
    for link in links:
        await link.close()


async def call(link: GrpcLink) -> float:
    """How long one call takes."""
    began_s = time.perf_counter()
    await link.request(service_path("echo", "measure"), BODY, timeout_s=10.0)
    return time.perf_counter() - began_s


if __name__ == "__main__":
    quick = command_line("sandbox", __doc__).parse_args().quick
    asyncio.run(main(*(QUICK_ROUNDS, QUICK_STARTS) if quick else (ROUNDS, STARTS)))
