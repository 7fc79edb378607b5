"""What every Runtime does: the model on virtual time, processes, and containers, stopped or frozen when idle."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from ipaddress import IPv4Network
from pathlib import Path

import pytest
from tests.doors import led

from upwash.core.estimates import Operation
from upwash.errors import LinkError, Refused, UsageError
from upwash.ports import Dialer, InstanceSpec, Program, Runtime
from upwash.protocol import service_path
from upwash.real.credentials import Credentials, fingerprint
from upwash.real.limits import Limits
from upwash.real.link import GrpcDialer
from upwash.real.lxd.container import ContainerSettings
from upwash.real.lxd.engine import Engine, EngineAddress
from upwash.real.lxd.runtime import ContainerRuntime
from upwash.real.runtime import ProcessRuntime
from upwash.real.sandbox import Sandbox, find_sandbox
from upwash.service import load_service, spec_of
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.loop import run_virtually
from upwash.sim.runtime import ModelRuntime
from upwash.sim.world import Wire


class Sure:
    """A computer on which everything takes no time."""

    async def start(self, spec: InstanceSpec) -> None:
        """At once."""

    async def compute(self, spec: InstanceSpec, operation: Operation) -> None:
        """At once."""


@dataclass(frozen=True)
class Site:
    """A runtime, and how what it starts is reached."""

    runtime: Runtime
    dialer: Dialer
    spec: InstanceSpec
    heron: frozenset[str] = frozenset({"heron"})  # what instances know the drone by
    host: str = "127.0.0.1"  # whose ports endpoints are, if they are ports

    async def call(self, endpoint: str) -> object:
        """Calls the workbench's `work` over a link of its own."""
        method = spec_of(load_service(self.spec.program.path)).methods["work"]
        _, request = method.encode(("light",), {})
        link = self.dialer.dial(
            f"{self.host}{endpoint}" if endpoint.startswith(":") else endpoint, server="s1"
        )
        try:
            reply = await link.request(service_path("workbench", "work"), request, timeout_s=10.0)
        finally:
            await link.close()
        return method.result(method.decode(reply))


Use = Callable[[Callable[[Site], Awaitable[None]]], None]


def on(engine: str) -> tuple[pytest.MarkDecorator, ...]:
    return pytest.mark.root, pytest.mark.system, pytest.mark.xdist_group(engine)


@pytest.fixture(
    params=[
        "model",
        "process",
        pytest.param("sandbox", marks=pytest.mark.sandbox),
        *(
            pytest.param(f"{state} container of {engine}", marks=on(engine))
            for engine in ("lxd", "incus")
            for state in ("stopped", "frozen")
        ),
    ]
)
def use(request: pytest.FixtureRequest, services: Path, tmp_path: Path) -> Use:
    """Does something at a site of one of the twins."""
    program = f"{services}:Workbench"
    spec = InstanceSpec("s1", "workbench", Program(program), methods=frozenset({"work"}))

    @asynccontextmanager
    async def model() -> AsyncIterator[Site]:
        switchboard = Switchboard({})
        runtime = ModelRuntime({"workbench": spec_of(load_service(program))}, Sure(), switchboard)
        yield Site(runtime, ModelDialer("heron", switchboard, Wire()), spec, host="")

    @asynccontextmanager
    async def process(sandbox: Sandbox | None = None) -> AsyncIterator[Site]:
        runtime = ProcessRuntime(
            lambda _: f"unix:{tmp_path}/s1.sock",
            max_message_bytes=1_000_000,
            sandbox=sandbox,
        )
        yield Site(runtime, GrpcDialer("heron", None, max_message_bytes=1_000_000), spec)

    def site() -> AbstractAsyncContextManager[Site]:
        match request.param:
            case "model":
                return model()
            case "process":
                return process()
            case "sandbox":
                return process(found_sandbox())
            case other:
                state, _, _, kind = other.split()
                engine, image = (request.getfixturevalue(name) for name in (kind, "workbench_image"))
                shown: Callable[[str], Credentials] = request.getfixturevalue("credentials")
                return containers(engine.socket, image, shown, spec, freezes=state == "frozen")

    def used(what: Callable[[Site], Awaitable[None]]) -> None:
        async def at_site() -> None:
            async with site() as there:
                await what(there)

        (run_virtually if request.param == "model" else asyncio.run)(at_site())

    return used


def found_sandbox() -> Sandbox:
    try:
        return find_sandbox(Limits(2**31, 256, 2**24), readable=())
    except UsageError as error:
        pytest.skip(str(error))


@asynccontextmanager
async def containers(
    socket: Path, image: Path, shown: Callable[[str], Credentials], spec: InstanceSpec, *, freezes: bool
) -> AsyncIterator[Site]:
    engine = Engine([EngineAddress(f"unix:{socket}")], project="default")
    async with led(shown("s1")) as lead:
        runtime = ContainerRuntime(
            engine,
            ContainerSettings(IPv4Network("10.147.70.0/24")),
            freezes=freezes,
            lead=lead,
            max_message_bytes=1_000_000,
        )
        try:
            await engine.connect()
            await engine.import_image(image)
            await runtime.prepare(["s1"], [("s1", "workbench")])
            heron = shown("heron")
            dialer = GrpcDialer("heron", heron, max_message_bytes=1_000_000)
            yield Site(runtime, dialer, spec, frozenset({fingerprint(heron.certificate)}))
        finally:
            await runtime.close()


def test_an_instance_says_what_a_call_took(use: Use) -> None:
    async def visit(site: Site) -> None:
        told: asyncio.Queue[tuple[str, float]] = asyncio.Queue()
        instance = await site.runtime.start(
            site.spec, called=lambda _: None, answered=lambda *heard: told.put_nowait(heard)
        )
        try:
            await instance.admit(site.heron)
            for _ in range(2):
                began_s = asyncio.get_running_loop().time()
                await site.call(instance.endpoint)
                async with asyncio.timeout(5.0):
                    method, took_s = await told.get()
                assert method == "work"
                assert 0.0 <= took_s <= asyncio.get_running_loop().time() - began_s
            assert told.empty()
        finally:
            await instance.stop()

    use(visit)


def test_an_instance_answers_those_who_are_admitted_and_says_who_called(use: Use) -> None:
    async def visit(site: Site) -> None:
        callers: list[str] = []
        told = asyncio.Event()

        def called(drone: str) -> None:
            callers.append(drone)
            told.set()

        instance = await site.runtime.start(site.spec, called=called)
        try:
            with pytest.raises(Refused, match="heron"):
                await site.call(instance.endpoint)
            assert callers == []
            await instance.admit(site.heron)
            assert isinstance(await site.call(instance.endpoint), str)
            async with asyncio.timeout(5.0):
                await told.wait()
            assert callers == list(site.heron)
            await instance.admit(frozenset({"stork"}))
            with pytest.raises(Refused, match="heron"):
                await site.call(instance.endpoint)
        finally:
            await instance.stop()

    use(visit)


def test_a_stopped_instance_is_gone_and_stopping_it_again_does_nothing(use: Use) -> None:
    async def visit(site: Site) -> None:
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

    use(visit)


def test_it_can_be_started_again(use: Use) -> None:
    async def visit(site: Site) -> None:
        for _ in range(2):
            instance = await site.runtime.start(site.spec, called=lambda _: None)
            await instance.admit(site.heron)
            await site.call(instance.endpoint)
            await instance.stop()

    use(visit)


def test_an_instance_that_was_drained_answers_no_call_any_more_and_the_next_one_does(use: Use) -> None:
    async def visit(site: Site) -> None:
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

    use(visit)
