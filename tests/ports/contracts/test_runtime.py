"""What every Runtime does: the model on virtual time, and processes."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from upwash.core.estimates import Operation
from upwash.errors import LinkError, Refused
from upwash.ports import Dialer, InstanceSpec, Program, Runtime
from upwash.protocol import service_path
from upwash.real.link import GrpcDialer
from upwash.real.runtime import ProcessRuntime
from upwash.service import load_service, spec_of
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.loop import run_virtually
from upwash.sim.runtime import ModelRuntime
from upwash.sim.world import Wire

HERON = frozenset({"heron"})


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

    async def call(self, endpoint: str) -> object:
        """Calls the workbench's `work` over a link of its own."""
        method = spec_of(load_service(self.spec.program.path)).methods["work"]
        _, request = method.encode(("light",), {})
        link = self.dialer.dial(endpoint, server="s1")
        try:
            reply = await link.request(service_path("workbench", "work"), request, timeout_s=10.0)
        finally:
            await link.close()
        return method.result(method.decode(reply))


Use = Callable[[Callable[[Site], Awaitable[None]]], None]


@pytest.fixture(params=["model", "process"])
def use(request: pytest.FixtureRequest, services: Path, tmp_path: Path) -> Use:
    """Does something at a site of one of the twins."""
    program = f"{services}:Workbench"
    spec = InstanceSpec("s1", "workbench", Program(program))

    def model() -> Site:
        switchboard = Switchboard({})
        runtime = ModelRuntime({"workbench": spec_of(load_service(program))}, Sure(), switchboard)
        return Site(runtime, ModelDialer("heron", switchboard, Wire()), spec)

    def process() -> Site:
        runtime = ProcessRuntime(
            lambda _: f"unix:{tmp_path}/s1.sock", credentials=None, max_message_bytes=1_000_000
        )
        return Site(runtime, GrpcDialer("heron", None, max_message_bytes=1_000_000), spec)

    def used(what: Callable[[Site], Awaitable[None]]) -> None:
        async def at_site() -> None:
            await what(model() if request.param == "model" else process())

        (run_virtually if request.param == "model" else asyncio.run)(at_site())

    return used


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
            await instance.admit(HERON)
            assert isinstance(await site.call(instance.endpoint), str)
            async with asyncio.timeout(5.0):
                await told.wait()
            assert callers == ["heron"]
            await instance.admit(frozenset({"stork"}))
            with pytest.raises(Refused, match="heron"):
                await site.call(instance.endpoint)
        finally:
            await instance.stop()

    use(visit)


def test_a_stopped_instance_is_gone_and_stopping_it_again_does_nothing(use: Use) -> None:
    async def visit(site: Site) -> None:
        instance = await site.runtime.start(site.spec, called=lambda _: None)
        await instance.admit(HERON)
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
            await instance.admit(HERON)
            await site.call(instance.endpoint)
            await instance.stop()

    use(visit)
