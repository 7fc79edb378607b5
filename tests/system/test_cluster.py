"""One daemon with a cluster of three machines, of which it loses some."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from tests.doors import led
from tests.engines import Kind, OwnEngine
from tests.system.cluster import OwnCluster, own_cluster
from tests.system.container_site import Site
from tests.system.daemons import MAX_MESSAGE_BYTES, shown

from upwash.config.runtime import ContainerNetworkConfig, EngineConfig, RuntimeConfig
from upwash.errors import EngineError, InstanceError
from upwash.real.instances.lxd.engine import Engine
from upwash.real.instances.lxd.instance import LxdInstance
from upwash.real.instances.lxd.runtime import LxdRuntime
from upwash.real.link.link import GrpcDialer
from upwash.real.trust.authority import make_keys
from upwash.real.trust.credentials import Credentials, fingerprint

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


@asynccontextmanager
async def runtime_of(cluster: OwnCluster, shows: Credentials, image: Path) -> AsyncIterator[LxdRuntime]:
    """A daemon's runtime with the members, which holds the image."""
    members = EngineConfig(
        addresses=tuple(cluster.urls),
        certificate=cluster.certificate,
        key=cluster.key,
        engine_certificate=cluster.engine_certificate,
    )
    network = ContainerNetworkConfig(subnet=cluster.site.services, interface="eth0")
    config = RuntimeConfig(kind="lxd", idle="stop", engine=members, network=network)
    engine = Engine(config)
    async with led(shows) as lead:
        runtime = LxdRuntime(engine, config, {}, lead=lead, max_message_bytes=MAX_MESSAGE_BYTES)
        try:
            await engine.connect()
            await engine.import_image(image)
            await runtime.prepare({server: ["workbench"] for server in SERVERS})
            yield runtime
        finally:
            await runtime.close()


async def test_what_a_lost_member_ran_runs_on_another_and_the_rest_goes_on(
    cluster: OwnCluster, services: Path, tmp_path: Path, workbench_image: Path
) -> None:
    make_keys(tmp_path, servers=[SERVERS], drones=["heron"])
    known = shown(tmp_path, "heron")
    dialer = GrpcDialer("heron", known, max_message_bytes=MAX_MESSAGE_BYTES)
    async with runtime_of(cluster, shown(tmp_path, "s1"), workbench_image) as runtime:
        site = Site(runtime, dialer, services, frozenset({fingerprint(known.certificate)}))

        async def start(server: str) -> tuple[LxdInstance, str]:
            instance = await site.start(server, "workbench")
            assert isinstance(instance, LxdInstance)
            return instance, instance.container.member

        async def start_again(server: str) -> tuple[LxdInstance, str]:
            """As the daemon does: while the members agree anew on their state, they may answer nobody for 10 s."""
            while True:
                try:
                    return await start(server)
                except EngineError as error:
                    _log.info("not started yet: %s", error)
                    await asyncio.sleep(1.0)

        async def require_answer(instance: LxdInstance, server: str) -> None:
            assert await site.call(instance, server, "echo", b"photo", timeout_s=5.0) == b"photo"

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
        async with asyncio.timeout(90.0):
            again, member = await start_again(lost_server)
        assert member != lost_member
        await require_answer(again, lost_server)
        _log.info("the first answer from another member came after %.2f s", time.monotonic() - began_s)
        for server, (instance, _) in started.items():
            await require_answer(instance, server)

        for survivor in {member for _, member in started.values()}:
            await asyncio.to_thread(cluster.silence, survivor)  # nobody answers for the cluster any more
        for server, (instance, _) in started.items():
            await instance.admit(site.heron)
            await require_answer(instance, server)
        with pytest.raises(InstanceError, match=r"engine does not answer"):
            async with asyncio.timeout(60.0):
                await start("s1")
        for instance in (again, *(instance for instance, _ in started.values())):
            await instance.stop()
