"""What a container costs: from the request for a service to its first answer, and call by call, against a process.

`python -m bench.containers --engine unix:/var/lib/lxd/unix.socket`, as a user who may use that engine. It imports an
image of bench/echo.py's service, and makes and deletes containers for a server named bench. See docs/containers.md.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from ipaddress import IPv4Network
from pathlib import Path
from statistics import median

from bench.echo import Echo
from bench.program import command_line, machine

from upwash.missions.bundled import load_service_alone
from upwash.packaging.image import Recipe, package
from upwash.ports import Instance, InstanceSpec, Program, Runtime
from upwash.real.authority import make_keys
from upwash.real.credentials import fingerprint, read_credentials
from upwash.real.door import leading, opened_door
from upwash.real.link import GrpcDialer, GrpcLink
from upwash.real.lxd.container import ContainerSettings
from upwash.real.lxd.engine import Engine, EngineAddress
from upwash.real.lxd.runtime import ContainerRuntime
from upwash.real.runtime import ProcessRuntime, sockets_in
from upwash.real.trust import Trust
from upwash.rpc.protocol import service_path
from upwash.rpc.service import spec_of

SERVER = "bench"
PROGRAM = "bench.echo:Echo"
REQUEST_BYTES = 430_000
STARTS, QUICK_STARTS = 5, 1
WARM_UP_CALLS = 20
CALLS, QUICK_CALLS = 200, 2
MOST_OVER_PROCESS = 1.1
MAX_MESSAGE_BYTES = 2**24
SPEC = InstanceSpec(SERVER, "echo", Program(PROGRAM))
MEASURE = spec_of(Echo).methods["measure"]


@dataclass(frozen=True)
class Bench:
    """The runtimes that are compared, and the drone that calls."""

    process: ProcessRuntime
    stopped: ContainerRuntime
    frozen: ContainerRuntime
    dialer: GrpcDialer
    drone: frozenset[str]  # what instances know it by

    def dial(self, instance: Instance) -> GrpcLink:
        """A link to an instance, which gives a bare port where it is on this host's loopback."""
        endpoint = instance.endpoint
        return self.dialer.dial(
            f"127.0.0.1{endpoint}" if endpoint.startswith(":") else endpoint, server=SERVER
        )


async def main(engine: str, subnet: IPv4Network, *, starts: int, calls: int) -> None:
    """Measures and prints; a missed limit is printed as such and is no failure."""
    print(machine())
    async with opened(engine, subnet) as bench:
        print(f"\nfrom the request to the first answer, {starts} times: median (least to most)")
        for title, runtime, before in (
            ("process", bench.process, None),
            ("container, new", bench.stopped, lambda: bench.stopped.prepare([SERVER], [])),
            ("container, stopped", bench.stopped, None),
            ("container, frozen", bench.frozen, None),
        ):
            report(title, await start_repeatedly(bench, runtime, before, times=starts))
        await compare_calls(bench, times=calls)


async def start_repeatedly(
    bench: Bench, runtime: Runtime, before: Callable[[], Awaitable[None]] | None, *, times: int
) -> list[float]:
    """How long each start took; the first is left out where it only prepares the others."""
    photo = os.urandom(1000)
    found: list[float] = []
    for _ in range(times + (before is None)):
        if before is not None:
            await before()
        began_s = time.perf_counter()
        instance = await runtime.start(SPEC, called=lambda _: None)
        await instance.admit(bench.drone)
        link = bench.dial(instance)
        await call(link, photo)
        found.append(time.perf_counter() - began_s)
        await link.close()
        await instance.stop()
    return found[-times:]


async def compare_calls(bench: Bench, *, times: int) -> None:
    """Compares calls into a container with calls into a process, in turns."""
    photo = os.urandom(REQUEST_BYTES)
    instances = [
        await runtime.start(SPEC, called=lambda _: None) for runtime in (bench.process, bench.frozen)
    ]
    links = [bench.dial(instance) for instance in instances]
    for instance in instances:
        await instance.admit(bench.drone)
    rounds = [[await call(link, photo) for link in links] for _ in range(WARM_UP_CALLS + times)][
        WARM_UP_CALLS:
    ]
    for link, instance in zip(links, instances, strict=True):
        await link.close()
        await instance.stop()
    print(f"\na call of {REQUEST_BYTES} bytes, {times} times in turns: median")
    for title, delays in zip(("process", "container"), zip(*rounds, strict=True), strict=True):
        print(f"{title:24}{median(delays) * 1e3:8.2f} ms")
    ratio = median(contained / alone for alone, contained in rounds)
    verdict = "PASS" if ratio <= MOST_OVER_PROCESS else "MISS"
    print(f"{verdict}: container / process = {ratio:.3f}, at most {MOST_OVER_PROCESS:.2f}")


async def call(link: GrpcLink, photo: bytes) -> float:
    """How long one call took."""
    _, request = MEASURE.encode((photo,), {})
    began_s = time.perf_counter()
    reply = await link.request(service_path("echo", "measure"), request, timeout_s=10.0)
    delay_s = time.perf_counter() - began_s
    if int(MEASURE.result(MEASURE.decode(reply))) != len(photo):  # type: ignore[call-overload]
        raise SystemExit("the service answered something else than it was asked")
    return delay_s


def report(title: str, found: list[float]) -> None:
    """Prints one line of the table."""
    print(f"{title:24}{median(found):7.3f} s ({min(found):.3f} to {max(found):.3f})", flush=True)


@contextlib.asynccontextmanager
async def opened(address: str, subnet: IPv4Network) -> AsyncIterator[Bench]:
    """Runtimes with the image imported, and nothing left of them afterwards."""
    engines = [Engine([EngineAddress(address)], project="default") for _ in range(2)]
    for engine in engines:
        await engine.connect()
    with tempfile.TemporaryDirectory(prefix="upwash-bench-") as name:
        folder = Path(name)
        make_keys(folder, servers=[[SERVER]], drones=["drone"])
        server, drone = (
            read_credentials(folder / "authority.pem", folder / f"{holder}.pem", folder / f"{holder}.key")
            for holder in (SERVER, "drone")
        )
        await engines[0].import_image(
            package(Recipe(load_service_alone(PROGRAM)), folder, report=lambda _: None)
        )
        async with opened_door(Trust(server)) as door:
            lead = leading(door, "127.0.0.1")
            process = ProcessRuntime(sockets_in(folder), lead=lead, max_message_bytes=MAX_MESSAGE_BYTES)
            stopped, frozen = (
                ContainerRuntime(
                    engine,
                    ContainerSettings(subnet),
                    freezes=freezes,
                    lead=lead,
                    max_message_bytes=MAX_MESSAGE_BYTES,
                )
                for engine, freezes in zip(engines, (False, True), strict=True)
            )
            dialer = GrpcDialer("drone", drone, max_message_bytes=MAX_MESSAGE_BYTES)
            try:
                yield Bench(process, stopped, frozen, dialer, frozenset({fingerprint(drone.certificate)}))
            finally:
                await frozen.close()
                await stopped.prepare([SERVER], [])
                await stopped.close()


if __name__ == "__main__":
    parser = command_line("containers", __doc__)
    parser.add_argument("--engine", default="unix:/var/lib/lxd/unix.socket", help="where the engine is")
    parser.add_argument(
        "--subnet", type=IPv4Network, default=IPv4Network("10.147.75.0/24"), help="for containers"
    )
    asked = parser.parse_args()
    starts, calls = (QUICK_STARTS, QUICK_CALLS) if asked.quick else (STARTS, CALLS)
    asyncio.run(main(asked.engine, asked.subnet, starts=starts, calls=calls))
