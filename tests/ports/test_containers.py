"""What a container is made of, where it is put, and what is said where no engine answers."""

from __future__ import annotations

import asyncio
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from upwash.config.runtime import ContainerNetworkConfig, EngineConfig, RuntimeConfig
from upwash.core.admission.limits import DEFAULT_LIMITS, Limits
from upwash.errors import EngineError, UsageError
from upwash.ports import Program
from upwash.real.instances.containers import HeldImage, ServiceImage, newest_images
from upwash.real.instances.control_credentials import ControlCredentials, new_control_credentials
from upwash.real.instances.lxd.container import (
    LxdContainer,
    addresses,
    definition,
    in_order,
    known_container,
    new_container,
)
from upwash.real.instances.lxd.engine import Engine, EngineInstance

SUBNET = "10.9.0.0/29"  # of six addresses
CONFIG = RuntimeConfig(kind="lxd")
DETECTOR = ServiceImage("detector", Program("package:Detector", {"threads": 2}), "host", "3.11", "1.0", "f00")


def held(container: LxdContainer, config: RuntimeConfig = CONFIG) -> EngineInstance:
    """The container as an engine tells of it, once it was created."""
    asked = definition(container, config, base="host", engine="lxd")
    return EngineInstance(container.name, "Stopped", container.member, asked["config"], asked["devices"])  # type: ignore[arg-type]


def made(server: str = "s1", *others: EngineInstance, member: str = "m1") -> LxdContainer:
    taken = addresses(others)
    return new_container(server, DETECTOR, DEFAULT_LIMITS, subnet=SUBNET, member=member, taken=taken)


def test_a_container_is_known_again_by_what_the_engine_keeps() -> None:
    container = made()
    assert known_container(held(container)) == container


def test_other_peoples_instances_are_left_alone() -> None:
    assert known_container(EngineInstance("web", "Running", "none", {"user.note": "mine"}, {})) is None


def test_containers_are_unprivileged_limited_and_have_one_address_and_no_other_network() -> None:
    limits = Limits(memory_bytes=2**28, processes=64, cpus=2)
    container = new_container("s1", DETECTOR, limits, subnet=SUBNET, member="m1", taken=())
    instance = held(container, RuntimeConfig(network=ContainerNetworkConfig(interface="wlan0")))
    assert known_container(instance) == container, (
        "its limits are known again, to be compared with wanted ones"
    )
    assert instance.config["security.privileged"] == instance.config["security.nesting"] == "false"
    assert (instance.config["limits.memory"], instance.config["limits.processes"]) == (str(2**28), "64")
    assert instance.config["limits.cpu"] == "2"
    (nic,) = [device for device in instance.devices.values() if device["type"] == "nic"]
    assert (nic["nictype"], nic["parent"]) == ("routed", "wlan0")
    assert instance.devices["usr"]["readonly"] == "true"


def test_no_two_containers_share_an_address_or_a_name_until_there_is_none_left() -> None:
    held_so_far: list[EngineInstance] = []
    for _ in range(6):
        held_so_far.append(held(made("s1", *held_so_far)))
    assert len({instance.devices["eth0"]["ipv4.address"] for instance in held_so_far}) == 6
    assert len({instance.name for instance in held_so_far}) == 6
    with pytest.raises(EngineError, match=r"every address of 10\.9\.0\.0/29 is taken"):
        made("s1", *held_so_far)


@pytest.mark.parametrize("server", ["s1", "Field_Station.Nord-7", "é" * 64, "-._"])
def test_any_servers_name_makes_a_host_name(server: str) -> None:
    name = made(server).name
    assert len(name) <= 63
    assert all(part.isascii() and part.isalnum() and part == part.lower() for part in name.split("-"))


def test_a_member_that_lost_an_instance_is_tried_last_and_the_one_with_the_fewest_first() -> None:
    held = [made(member=member) for member in ("m1", "m1", "m2")]
    assert in_order(["m1", "m2", "m3"], held, {"m3"}) == ["m2", "m1", "m3"]
    assert in_order(["m1", "m2", "m3"], held, set()) == ["m3", "m2", "m1"]


def test_of_several_images_the_one_that_was_imported_last_counts() -> None:
    images = [
        HeldImage(fingerprint, replace(DETECTOR, fingerprint="").properties(), uploaded_at)
        for fingerprint, uploaded_at in (
            ("old", "2026-01-01T10"),
            ("new", "2026-03-01T09"),
            ("older", "2025"),
        )
    ]
    someones = HeldImage("x", {"upwash.service": "detector"}, "2027")
    earlier = {key: value for key, value in DETECTOR.properties().items() if key != "upwash.concurrency"}
    assert newest_images([*images, someones, HeldImage("y", earlier, "2028")]) == {
        "detector": replace(DETECTOR, fingerprint="new")
    }


def test_a_leash_lets_in_its_holder_and_nobody_else() -> None:
    credentials, other = new_control_credentials(), new_control_credentials()
    assert ControlCredentials.from_text(credentials.text()) == credentials
    assert b"PRIVATE" not in credentials.certificate
    assert "PRIVATE" not in repr(credentials)

    async def says(held: ControlCredentials) -> bytes:
        async def greet(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(b"welcome\n")
            await writer.drain()
            writer.close()

        server = await asyncio.start_server(greet, "127.0.0.1", 0, ssl=credentials.context(is_server=True))
        async with server:
            host, port = server.sockets[0].getsockname()[:2]
            reader, writer = await asyncio.open_connection(host, port, ssl=held.context(is_server=False))
            try:
                return await reader.readline()
            finally:
                writer.close()

    assert asyncio.run(says(credentials)) == b"welcome\n"
    with pytest.raises(OSError, match=r"certificate verify failed|CERTIFICATE_VERIFY_FAILED"):
        asyncio.run(says(other))


def connect(url: str) -> None:
    async def run() -> None:
        engine = Engine(RuntimeConfig(kind="lxd", engine=EngineConfig(addresses=(url,))))
        try:
            await engine.connect()
        finally:
            await engine.close()

    asyncio.run(run())


def test_a_missing_engine_is_told_with_what_to_install(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"unix.socket: no such socket: install LXD .*runtime.engine"):
        connect(f"unix:{tmp_path}/unix.socket")


def test_an_engine_that_is_not_running_is_told(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as deaf:
        deaf.bind(str(tmp_path / "unix.socket"))
    with pytest.raises(UsageError, match=r"does not answer .*is it running"):
        connect(f"unix:{tmp_path}/unix.socket")
