"""What every Runtime does: the model on virtual time, processes, and containers, stopped or frozen when idle."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from tests.doors import led
from tests.engines import OwnEngine
from tests.podman import OwnPodman

from upwash.config.runtime import ContainerNetworkConfig, EngineConfig, RuntimeConfig
from upwash.core.operation import Operation
from upwash.errors import InstanceError, LinkError, NoLease, NotBegun, UsageError
from upwash.ports import AnsweredCall, Dialer, InstanceSpec, Program, Runtime
from upwash.real.instances.containers import reference_of
from upwash.real.instances.docker.container import DockerSettings
from upwash.real.instances.docker.engine import DockerEngine
from upwash.real.instances.docker.runtime import DockerRuntime
from upwash.real.instances.lxd.engine import Engine
from upwash.real.instances.lxd.runtime import LxdRuntime
from upwash.real.instances.runtime import ProcessRuntime, sockets_in
from upwash.real.instances.sandbox import Sandbox, find_sandbox
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.credentials import Credentials, fingerprint
from upwash.rpc.protocol import service_path
from upwash.rpc.service import Reply, load_service, spec_of
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.runtime import ModelledComputer, ModelRuntime

CALL_S = 0.5


class Sure:
    """A computer on which everything takes no time."""

    async def start(self, spec: InstanceSpec) -> None:
        """At once."""

    async def compute(self, spec: InstanceSpec, operation: Operation, *, less: bool = False) -> float:
        """At once."""
        return asyncio.get_running_loop().time()


class Slow(Sure):
    """A computer on which a call takes half a second."""

    async def compute(self, spec: InstanceSpec, operation: Operation, *, less: bool = False) -> float:
        """Half a second."""
        await asyncio.sleep(CALL_S)
        return await super().compute(spec, operation)


class Pairs(Sure):
    """A computer on which a call waits until another one is computed beside it, and then takes a second."""

    def __init__(self) -> None:
        self.most = 0
        self._both = asyncio.Barrier(2)
        self._under_way = 0

    async def compute(self, spec: InstanceSpec, operation: Operation, *, less: bool = False) -> float:
        """Takes a second, of two calls at a time."""
        self._under_way += 1
        self.most = max(self.most, self._under_way)
        async with asyncio.timeout(10.0):
            await self._both.wait()
        await asyncio.sleep(1.0)
        self._under_way -= 1
        return await super().compute(spec, operation)


@dataclass(frozen=True)
class Witness:
    """Answers as the duet does."""

    computer: Pairs

    def play(self) -> int:
        """How many calls were ever computed at once."""
        return self.computer.most


@dataclass(frozen=True)
class Site:
    """A runtime, and how what it starts is reached."""

    runtime: Runtime
    dialer: Dialer
    spec: InstanceSpec
    heron: frozenset[str] = frozenset({"heron"})  # what instances know the drone by
    host: str = "127.0.0.1"  # whose ports endpoints are, if they are ports
    arguments: tuple[object, ...] = ("light",)

    async def call(self, endpoint: str) -> object:
        """Calls what there is to be called, over a link of its own."""
        (name,) = self.spec.methods
        method = spec_of(load_service(self.spec.program.path)).methods[name]
        _, request = method.encode(self.arguments, {})
        link = self.dialer.dial(
            f"{self.host}{endpoint}" if endpoint.startswith(":") else endpoint, server="s1"
        )
        try:
            path = service_path(self.spec.service, name)
            reply = await link.request(path, request, timeout_s=10.0)
        finally:
            await link.close()
        return method.result(method.decode(reply))

    async def ask(self, endpoint: str, *, may_queue_s: float | None = None) -> Reply:
        """The reply to a call that may wait in the queue for as long, over a link of its own."""
        (name,) = self.spec.methods
        _, request = spec_of(load_service(self.spec.program.path)).methods[name].encode(self.arguments, {})
        link = self.dialer.dial(endpoint, server="s1")
        try:
            reply = await link.request(
                service_path(self.spec.service, name), request, timeout_s=10.0, may_queue_s=may_queue_s
            )
        finally:
            await link.close()
        assert isinstance(reply, Reply)
        return reply


Sites = AbstractAsyncContextManager[Site]


def on(engine: str) -> tuple[pytest.MarkDecorator, ...]:
    return pytest.mark.root, pytest.mark.system, pytest.mark.xdist_group(engine)


MODEL = pytest.param("model", marks=pytest.mark.virtual)
SANDBOX = pytest.param("sandbox", marks=pytest.mark.sandbox)


@pytest.fixture(
    params=[
        MODEL,
        "process",
        SANDBOX,
        *(
            pytest.param(f"{state} container of {engine}", marks=on(engine))
            for engine in ("podman", "lxd", "incus")
            for state in ("stopped", "frozen")
        ),
    ]
)
def site(request: pytest.FixtureRequest, services: Path, tmp_path: Path) -> Sites:
    """A site of each of the twins."""
    program = Program(f"{services}:Workbench")
    spec = InstanceSpec("s1", "workbench", program, methods=frozenset({"work"}))
    match request.param.split():
        case ["model"]:
            return modelled(spec, Sure())
        case ["process"]:
            return processes(spec, tmp_path)
        case ["sandbox"]:
            return processes(spec, tmp_path, found_sandbox())
        case [state, _, _, "podman"]:
            podman, images = map(request.getfixturevalue, ("podman", "docker_images"))
            return docker_containers(podman, images, spec, tmp_path, freezes=state == "frozen")
        case [state, _, _, kind]:
            names = (kind, "workbench_image", "credentials")
            engine, image, shown = map(request.getfixturevalue, names)
            return containers(engine, image, shown, spec, freezes=state == "frozen")
        case _:
            raise AssertionError(request.param)


@pytest.fixture(params=[MODEL, "process", SANDBOX])
def duets(request: pytest.FixtureRequest, services: Path, tmp_path: Path) -> Sites:
    """A site where the service is a duet, whose instances take two calls at a time."""
    spec = InstanceSpec("s1", "duet", Program(f"{services}:Duet"), methods=frozenset({"play"}))
    if request.param == "model":
        pairs = Pairs()
        return modelled(spec, pairs, objects={"duet": Witness(pairs)}, arguments=())
    return processes(spec, tmp_path, found_sandbox() if request.param == "sandbox" else None, arguments=())


@pytest.fixture(params=[MODEL, "process", SANDBOX])
def slow_site(request: pytest.FixtureRequest, services: Path, tmp_path: Path) -> Sites:
    """A site where each call takes half a second."""
    program, pace_s = Program(f"{services}:Workbench"), {"": CALL_S}
    spec = InstanceSpec("s1", "workbench", program, pace_s=pace_s, methods=frozenset({"work"}))
    if request.param == "model":
        return modelled(spec, Slow())
    return processes(spec, tmp_path, found_sandbox() if request.param == "sandbox" else None)


@asynccontextmanager
async def modelled(spec: InstanceSpec, computer: ModelledComputer, **site: Any) -> AsyncIterator[Site]:
    switchboard, objects = Switchboard({}), site.pop("objects", {})
    described = spec_of(load_service(spec.program.path))
    runtime = ModelRuntime({spec.service: described}, computer, switchboard, objects=objects)
    yield Site(runtime, ModelDialer("heron", switchboard), spec, host="", **site)


@asynccontextmanager
async def processes(
    spec: InstanceSpec, folder: Path, sandbox: Sandbox | None = None, **site: Any
) -> AsyncIterator[Site]:
    runtime = ProcessRuntime(
        lambda _: f"unix:{folder}/s1.sock",
        max_message_bytes=1_000_000,
        sandbox=sandbox,
    )
    yield Site(runtime, GrpcDialer("heron", None, max_message_bytes=1_000_000), spec, **site)


def found_sandbox() -> Sandbox:
    try:
        return find_sandbox(readable=())
    except UsageError as error:
        pytest.skip(str(error))


@asynccontextmanager
async def containers(
    own: OwnEngine, image: Path, shown: Callable[[str], Credentials], spec: InstanceSpec, *, freezes: bool
) -> AsyncIterator[Site]:
    config = RuntimeConfig(
        kind="lxd",
        idle="freeze" if freezes else "stop",
        engine=EngineConfig(addresses=(f"unix:{own.socket}",)),
        network=ContainerNetworkConfig(subnet=own.subnet),
    )
    engine = Engine(config)
    async with led(shown("s1")) as lead:
        runtime = LxdRuntime(engine, config, {}, lead=lead, max_message_bytes=1_000_000)
        try:
            await engine.connect()
            await engine.import_image(image)
            await runtime.prepare({"s1": ["workbench"]})
            heron = shown("heron")
            dialer = GrpcDialer("heron", heron, max_message_bytes=1_000_000)
            yield Site(runtime, dialer, spec, frozenset({fingerprint(heron.certificate)}))
        finally:
            await runtime.close()


@asynccontextmanager
async def docker_containers(
    podman: OwnPodman, images: list[Path], spec: InstanceSpec, folder: Path, *, freezes: bool
) -> AsyncIterator[Site]:
    engine = DockerEngine(f"unix://{podman.socket}")
    runtime = DockerRuntime(
        engine,
        DockerSettings(folder),
        {"workbench": reference_of("workbench")},
        listen=sockets_in(folder),
        freezes=freezes,
        lead=None,
        max_message_bytes=1_000_000,
    )
    try:
        await engine.connect()
        for image in images:
            await engine.import_image(image)
        await runtime.prepare({"s1": ["workbench"]})
        yield Site(runtime, GrpcDialer("heron", None, max_message_bytes=1_000_000), spec)
    finally:
        await runtime.close()


async def test_an_instance_says_whose_a_call_was_and_what_it_took(site: Site) -> None:
    told: asyncio.Queue[AnsweredCall] = asyncio.Queue()
    instance = await site.runtime.start(site.spec, called=lambda _: None, answered=told.put_nowait)
    try:
        await instance.admit(site.heron)
        for _ in range(2):
            began_s = asyncio.get_running_loop().time()
            await site.call(instance.endpoint)
            async with asyncio.timeout(5.0):
                call = await told.get()
            assert (call.drone, call.method) == (*site.heron, "work")
            assert min(call.queued_s, call.took_s) >= 0.0
            assert call.queued_s + call.took_s <= asyncio.get_running_loop().time() - began_s
        assert told.empty()
    finally:
        await instance.stop()


async def test_an_instance_answers_those_who_are_admitted_and_says_who_called(site: Site) -> None:
    callers: list[str] = []
    told = asyncio.Event()

    def called(drone: str) -> None:
        callers.append(drone)
        told.set()

    instance = await site.runtime.start(site.spec, called=called)
    try:
        with pytest.raises(NoLease, match="heron"):
            await site.call(instance.endpoint)
        assert callers == []
        await instance.admit(site.heron)
        assert isinstance(await site.call(instance.endpoint), str)
        async with asyncio.timeout(5.0):
            await told.wait()
        assert callers == list(site.heron)
        await instance.admit(frozenset({"stork"}))
        with pytest.raises(NoLease, match="heron"):
            await site.call(instance.endpoint)
    finally:
        await instance.stop()


async def test_as_many_calls_as_the_service_declares_are_computed_at_once_and_no_more(duets: Site) -> None:
    told: asyncio.Queue[AnsweredCall] = asyncio.Queue()
    instance = await duets.runtime.start(duets.spec, called=lambda _: None, answered=told.put_nowait)
    try:
        await instance.admit(duets.heron)
        most = await asyncio.gather(*(duets.call(instance.endpoint) for _ in range(4)))
        assert set(most) == {2}
        async with asyncio.timeout(5.0):
            calls = [await told.get() for _ in range(4)]
        assert {call.drone for call in calls} == duets.heron
        assert all(min(call.queued_s, call.took_s) >= 0.0 for call in calls)
    finally:
        await instance.stop()


async def test_an_instance_tells_its_queue_and_begins_no_call_too_late(slow_site: Site) -> None:
    instance = await slow_site.runtime.start(slow_site.spec, called=lambda _: None)
    ask = functools.partial(slow_site.ask, instance.endpoint)
    try:
        await instance.admit(slow_site.heron)
        first = asyncio.create_task(ask())
        await asyncio.sleep(0.3 * CALL_S)
        began_s = asyncio.get_running_loop().time()
        with pytest.raises(NotBegun):  # nobody knows yet how long calls take, and so it waits
            await ask(may_queue_s=0.2 * CALL_S)
        assert asyncio.get_running_loop().time() - began_s >= 0.19 * CALL_S
        alone = await first
        assert alone.queued_s < 0.1 and alone.queue_s == 0.0

        first, second = asyncio.create_task(ask()), asyncio.create_task(ask(may_queue_s=5.0))
        await asyncio.sleep(0.3 * CALL_S)
        with pytest.raises(NotBegun) as told:
            await ask(may_queue_s=0.1)
        assert 0.5 * CALL_S < told.value.queue_s < 2 * CALL_S
        replies = sorted([await first, await second], key=lambda reply: reply.queued_s)
        assert replies[0].queued_s < 0.5 * CALL_S < replies[1].queued_s < 2 * CALL_S
        assert replies[1].queue_s == 0.0 < replies[0].queue_s < 2 * CALL_S
    finally:
        await instance.stop()


async def test_an_instance_gives_a_sign_of_life_until_it_is_gone(site: Site) -> None:
    instance = await site.runtime.start(site.spec, called=lambda _: None)
    try:
        await instance.admit(site.heron)
        for _ in range(2):
            async with asyncio.timeout(10.0):
                await instance.health()
        await site.call(instance.endpoint)
        await instance.drain("replaced")  # also one that would be kept frozen ends
    finally:
        await instance.stop()
    with pytest.raises(InstanceError):
        await instance.health()


async def test_a_stopped_instance_is_gone_and_stopping_it_again_does_nothing(site: Site) -> None:
    instance = await site.runtime.start(site.spec, called=lambda _: None)
    await instance.admit(site.heron)
    exited = asyncio.create_task(instance.exited())
    await asyncio.sleep(0)
    assert not exited.done()
    await instance.stop()
    assert await exited
    await instance.stop()
    with pytest.raises(LinkError):
        await site.call(instance.endpoint)


async def test_it_can_be_started_again(site: Site) -> None:
    for _ in range(2):
        instance = await site.runtime.start(site.spec, called=lambda _: None)
        await instance.admit(site.heron)
        await site.call(instance.endpoint)
        await instance.stop()


async def test_an_instance_that_was_drained_answers_no_call_any_more_and_the_next_one_does(
    site: Site,
) -> None:
    instance = await site.runtime.start(site.spec, called=lambda _: None)
    await instance.admit(site.heron)
    await site.call(instance.endpoint)
    await instance.drain("this server is shutting down")
    with pytest.raises(LinkError):
        await site.call(instance.endpoint)
    await instance.stop()
    another = await site.runtime.start(site.spec, called=lambda _: None)
    await another.admit(site.heron)
    await site.call(another.endpoint)
    await another.stop()
