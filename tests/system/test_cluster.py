"""One daemon with a cluster of three machines, of which it loses some."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import pytest
from tests.doors import led, reached
from tests.engines import Kind, OwnEngine
from tests.system.cluster import OwnCluster, own_cluster
from tests.system.daemons import MAX_MESSAGE_BYTES, shown

from upwash.config import RuntimeConfig
from upwash.config.runtime import ContainerNetworkConfig, EngineConfig
from upwash.errors import InstanceError
from upwash.ports import InstanceSpec, Program
from upwash.real.instances.lxd.engine import Engine
from upwash.real.instances.lxd.instance import LxdInstance
from upwash.real.instances.lxd.runtime import LxdRuntime
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.authority import make_keys
from upwash.real.trust.credentials import Credentials, fingerprint
from upwash.rpc.protocol import service_path
from upwash.rpc.service import load_service, spec_of

pytestmark = [pytest.mark.root, pytest.mark.system, pytest.mark.timeout(300)]

_log = logging.getLogger(__name__)

SERVERS = ("s1", "s2", "s3")


def of(kind: Kind) -> object:
    return pytest.param(kind, marks=pytest.mark.xdist_group(kind))


@pytest.fixture(params=[of("lxd"), of("incus")])
def cluster(request: pytest.FixtureRequest) -> Iterator[OwnCluster]:
    engine: OwnEngine = request.getfixturevalue(request.param)
    with own_cluster(engine) as cluster:
        yield cluster


def test_what_a_lost_member_ran_runs_on_another_and_the_rest_goes_on(
    cluster: OwnCluster, services: Path, tmp_path: Path, workbench_image: Path
) -> None:
    make_keys(tmp_path, servers=[SERVERS], drones=["heron"])

    known = shown(tmp_path, "heron")
    heron = frozenset({fingerprint(known.certificate)})
    dialer = GrpcDialer("heron", known, max_message_bytes=MAX_MESSAGE_BYTES)
    echo = spec_of(load_service(f"{services}:Workbench")).methods["echo"]

    async def call(instance: LxdInstance, server: str) -> object:
        link = dialer.dial(reached(instance.endpoint), server=server)
        try:
            _, request = echo.encode((b"photo",), {})
            reply = await link.request(service_path("workbench", "echo"), request, timeout_s=5.0)
            return echo.result(echo.decode(reply))
        finally:
            await link.close()

    async def use(runtime: LxdRuntime) -> None:
        async def start(server: str) -> tuple[LxdInstance, str]:
            instance = await runtime.start(
                InstanceSpec(server, "workbench", Program("")), called=lambda _: None
            )
            assert isinstance(instance, LxdInstance)
            await instance.admit(heron)
            return instance, instance.container.member

        started = {server: await start(server) for server in SERVERS}
        assert len({member for _, member in started.values()}) == 3, "each has a member of its own"
        leader = cluster.leader()
        lost_server, lost_member = next(
            (server, member) for server, (_, member) in started.items() if member != leader
        )
        lost, _ = started.pop(lost_server)

        await asyncio.to_thread(cluster.lose, lost_member)
        lost_s = time.monotonic()
        async with asyncio.timeout(15.0):
            assert await lost.exited() == "the container is gone, or cannot be reached"
        _log.info("noticed %.2f s after its member was lost", time.monotonic() - lost_s)
        await lost.stop()
        began_s = time.monotonic()
        async with asyncio.timeout(30.0):
            again, member = await start(lost_server)
        assert member != lost_member
        assert await call(again, lost_server) == b"photo"
        _log.info("the first answer from another member came after %.2f s", time.monotonic() - began_s)
        for server, (instance, _) in started.items():
            assert await call(instance, server) == b"photo"

        for survivor in {member for _, member in started.values()}:
            await asyncio.to_thread(cluster.silence, survivor)  # nobody answers for the cluster any more
        for server, (instance, _) in started.items():
            await instance.admit(heron)
            assert await call(instance, server) == b"photo"
        with pytest.raises(InstanceError, match=r"engine does not answer"):
            async with asyncio.timeout(60.0):
                await start("s1")
        for instance in (again, *(instance for instance, _ in started.values())):
            await instance.stop()

    asyncio.run(with_runtime(cluster, shown(tmp_path, "s1"), workbench_image, use))


async def with_runtime(
    cluster: OwnCluster, credentials: Credentials, image: Path, use: Callable[[LxdRuntime], Awaitable[None]]
) -> None:
    config = RuntimeConfig(
        kind="lxd",
        idle="stop",
        engine=EngineConfig(
            addresses=tuple(cluster.urls),
            certificate=cluster.certificate,
            key=cluster.key,
            engine_certificate=cluster.engine_certificate,
        ),
        network=ContainerNetworkConfig(subnet=cluster.site.services, interface="eth0"),
    )
    engine = Engine(config)
    async with led(credentials) as lead:
        runtime = LxdRuntime(engine, config, {}, lead=lead, max_message_bytes=MAX_MESSAGE_BYTES)
        try:
            await engine.connect()
            await engine.import_image(image)
            await runtime.prepare({server: ["workbench"] for server in SERVERS})
            await use(runtime)
        finally:
            await runtime.close()
