"""What a sandbox or a container costs: from the request for a service to its first answer, and call by call.

`python -m bench.containers --docker unix:/run/podman/podman.sock --lxd unix:/var/lib/lxd/unix.socket`, as a user who
may use these engines; `--incus` as well. Engines that are not named are left out. Processes are always measured, and
the sandbox where there is one. Starts and calls are taken in turns. It imports an image of bench/echo.py's service,
and makes and deletes containers for a server named bench. See docs/containers.md.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import tempfile
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from ipaddress import IPv4Network
from pathlib import Path
from statistics import median

from bench.echo import Echo
from bench.program import command_line, machine

from upwash.config.runtime import ContainerNetworkConfig, EngineConfig, RuntimeConfig
from upwash.core.admission.limits import DEFAULT_LIMITS
from upwash.errors import UsageError
from upwash.missions.bundled import load_service_alone
from upwash.packaging.image import Recipe, package
from upwash.ports import Instance, InstanceSpec, Program, Runtime
from upwash.real.instances.containers import reference_of
from upwash.real.instances.docker.container import DockerSettings
from upwash.real.instances.docker.engine import DockerEngine
from upwash.real.instances.docker.runtime import DockerRuntime
from upwash.real.instances.lxd.engine import Engine
from upwash.real.instances.lxd.runtime import LxdRuntime
from upwash.real.instances.runtime import ProcessRuntime, sockets_in
from upwash.real.instances.sandbox import find_sandbox
from upwash.real.link.door import Lead, leading, opened_door
from upwash.real.link.link import GrpcDialer, GrpcLink
from upwash.real.trust.authority import make_keys
from upwash.real.trust.credentials import Trust, fingerprint, read_credentials
from upwash.rpc.protocol import service_path
from upwash.rpc.service import spec_of

SERVER = "bench"
PROGRAM = "bench.echo:Echo"
REQUEST_BYTES = 430_000
STARTS, QUICK_STARTS = 5, 1
WARM_UP_CALLS = 20
CALLS, QUICK_CALLS = 200, 2
MAX_MESSAGE_BYTES = 2**24
SPEC = InstanceSpec(SERVER, "echo", Program(PROGRAM), limits=DEFAULT_LIMITS)
MEASURE = spec_of(Echo).methods["measure"]


@dataclass(frozen=True)
class Bench:
    """The runtimes that are compared, by what they are called, and the drone that calls."""

    runtimes: dict[str, Runtime]
    dialer: GrpcDialer
    drone: frozenset[str]  # what instances know it by

    def dial(self, instance: Instance) -> GrpcLink:
        """A link to an instance, which gives a bare port where it is on this host's loopback."""
        endpoint = instance.endpoint
        return self.dialer.dial(
            f"127.0.0.1{endpoint}" if endpoint.startswith(":") else endpoint, server=SERVER
        )


async def main(addresses: dict[str, str], subnet: IPv4Network, *, starts: int, calls: int) -> None:
    """Measures and prints."""
    print(machine())
    async with opened(addresses, subnet) as bench:
        print(f"\nfrom the request to the first answer, {starts} times in turns: median (least to most)")
        for title, found in (await start_repeatedly(bench, times=starts)).items():
            print(f"{title:24}{median(found):7.3f} s ({min(found):.3f} to {max(found):.3f})", flush=True)
        await compare_calls(bench, times=calls)


async def start_repeatedly(bench: Bench, *, times: int) -> dict[str, list[float]]:
    """How long each start took; the first of each is left out, which only prepares the others."""
    photo = os.urandom(1000)
    found: dict[str, list[float]] = {title: [] for title in bench.runtimes}
    for _ in range(times + 1):
        for title, runtime in bench.runtimes.items():
            began_s = time.perf_counter()
            instance = await runtime.start(SPEC, called=lambda _: None)
            await instance.admit(bench.drone)
            link = bench.dial(instance)
            await call(link, photo)
            found[title].append(time.perf_counter() - began_s)
            await link.close()
            await instance.stop()
    return {title: delays[1:] for title, delays in found.items()}


async def compare_calls(bench: Bench, *, times: int) -> None:
    """Compares calls with calls into a process, in turns."""
    photo = os.urandom(REQUEST_BYTES)
    compared = {title: each for title, each in bench.runtimes.items() if "stopped" not in title}
    instances = [await runtime.start(SPEC, called=lambda _: None) for runtime in compared.values()]
    links = [bench.dial(instance) for instance in instances]
    for instance in instances:
        await instance.admit(bench.drone)
    rounds = [[await call(link, photo) for link in links] for _ in range(WARM_UP_CALLS + times)][
        WARM_UP_CALLS:
    ]
    for link, instance in zip(links, instances, strict=True):
        await link.close()
        await instance.stop()
    print(
        f"\na call of {REQUEST_BYTES} bytes, {times} times in turns: median, and of the ratios to a process"
    )
    for title, delays, ratios in zip(
        compared,
        zip(*rounds, strict=True),
        zip(*([each / one[0] for each in one] for one in rounds), strict=True),
        strict=True,
    ):
        print(f"{title:24}{median(delays) * 1e3:8.2f} ms{median(ratios):8.3f}")


async def call(link: GrpcLink, photo: bytes) -> float:
    """How long one call took."""
    _, request = MEASURE.encode((photo,), {})
    began_s = time.perf_counter()
    reply = await link.request(service_path("echo", "measure"), request, timeout_s=10.0)
    delay_s = time.perf_counter() - began_s
    if int(MEASURE.result(MEASURE.decode(reply))) != len(photo):  # type: ignore[call-overload]
        raise SystemExit("the service gave a wrong answer")
    return delay_s


@contextlib.asynccontextmanager
async def opened(addresses: dict[str, str], subnet: IPv4Network) -> AsyncIterator[Bench]:
    """Runtimes with the image imported, and nothing left of them afterwards."""
    async with contextlib.AsyncExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="upwash-bench-")))
        make_keys(folder, servers=[[SERVER]], drones=["drone"])
        server, drone = (
            read_credentials(folder / "authority.pem", folder / f"{holder}.pem", folder / f"{holder}.key")
            for holder in (SERVER, "drone")
        )
        lead = leading(await stack.enter_async_context(opened_door(Trust(server))), "127.0.0.1")
        runtimes: dict[str, Runtime] = dict(processes(folder, lead))
        subnets = dict(
            zip(("lxd", "incus"), subnet.subnets(), strict=True)
        )  # neither knows the other's addresses
        for name, address in addresses.items():
            for freezes in (False, True):
                title = f"{name}, {'frozen' if freezes else 'stopped'}"
                site = (
                    docker_containers(address, folder, lead, freezes=freezes)
                    if name == "docker"
                    else lxd_containers(address, subnets[name], folder, lead, freezes=freezes)
                )
                runtimes[title] = await stack.enter_async_context(site)
        dialer = GrpcDialer("drone", drone, max_message_bytes=MAX_MESSAGE_BYTES)
        yield Bench(runtimes, dialer, frozenset({fingerprint(drone.certificate)}))


def processes(folder: Path, lead: Lead) -> dict[str, ProcessRuntime]:
    """Without a sandbox, and in one if this machine has it."""
    found = {
        "process": ProcessRuntime(sockets_in(folder), lead=lead, max_message_bytes=MAX_MESSAGE_BYTES),
    }
    try:
        sandbox = find_sandbox(readable=(Path(__file__).parents[1],))
    except UsageError as error:
        print(f"no sandbox here: {error}")
    else:
        (folder / "sandboxed").mkdir()
        found["sandbox"] = ProcessRuntime(
            sockets_in(folder / "sandboxed"), lead=lead, max_message_bytes=MAX_MESSAGE_BYTES, sandbox=sandbox
        )
    return found


@contextlib.asynccontextmanager
async def docker_containers(
    address: str, folder: Path, lead: Lead, *, freezes: bool
) -> AsyncIterator[DockerRuntime]:
    """Containers of Docker or Podman."""
    engine = DockerEngine(address)
    sockets = Path(tempfile.mkdtemp(prefix="d-", dir=folder))
    runtime = DockerRuntime(
        engine,
        DockerSettings(sockets),
        {"echo": reference_of("echo")},
        listen=sockets_in(sockets),
        freezes=freezes,
        lead=lead,
        max_message_bytes=MAX_MESSAGE_BYTES,
    )
    try:
        await engine.connect()
        image = package(Recipe(load_service_alone(PROGRAM), format="docker"), folder, report=lambda _: None)
        await engine.import_image(image)
        await runtime.prepare({"": ["echo"]})
        yield runtime
    finally:
        await runtime.close()


@contextlib.asynccontextmanager
async def lxd_containers(
    address: str, subnet: IPv4Network, folder: Path, lead: Lead, *, freezes: bool
) -> AsyncIterator[LxdRuntime]:
    """Containers of LXD or Incus."""
    config = RuntimeConfig(
        kind="lxd",
        idle="freeze" if freezes else "stop",
        engine=EngineConfig(addresses=(address,)),
        network=ContainerNetworkConfig(subnet=str(subnet)),
    )
    engine = Engine(config)
    runtime = LxdRuntime(engine, config, {}, lead=lead, max_message_bytes=MAX_MESSAGE_BYTES)
    try:
        await engine.connect()
        await engine.import_image(package(Recipe(load_service_alone(PROGRAM)), folder, report=lambda _: None))
        yield runtime
        await runtime.prepare({SERVER: []})  # deletes its containers
    finally:
        await runtime.close()


if __name__ == "__main__":
    parser = command_line("containers", __doc__)
    for engine in ("docker", "lxd", "incus"):
        parser.add_argument(f"--{engine}", metavar="ADDRESS", help="where that engine is, such as unix:/path")
    parser.add_argument(
        "--subnet",
        type=IPv4Network,
        default=IPv4Network("10.147.75.0/24"),
        help="for containers of LXD and Incus",
    )
    asked = parser.parse_args()
    starts, calls = (QUICK_STARTS, QUICK_CALLS) if asked.quick else (STARTS, CALLS)
    given = {name: getattr(asked, name) for name in ("docker", "lxd", "incus") if getattr(asked, name)}
    asyncio.run(main(given, asked.subnet, starts=starts, calls=calls))
