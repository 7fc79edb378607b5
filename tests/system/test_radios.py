"""The real NetworkManager, with cables for radios, in namespaces of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from tests.played import played
from tests.programs import write_drone
from tests.system.radios import Field

from upwash.cli.main import main
from upwash.errors import NetworkError
from upwash.eventlog.schema import Event, LeftOver
from upwash.real.network.network import ManagedNetwork
from upwash.real.network.networkmanager import connect_networkmanager
from upwash.real.network.profiles import survey_networks
from upwash.sim.journal import MemoryJournal

pytestmark = [pytest.mark.system, pytest.mark.root]

JOIN_S = 20.0  # on a busy machine; it takes hundredths of a second


def play(scene: Callable[[ManagedNetwork, MemoryJournal], Awaitable[None]]) -> list[Event]:
    """Plays the scene with a drone that may use both radios; returns what it logged."""

    async def live() -> list[Event]:
        journal = MemoryJournal()
        journal.begin()
        network = ManagedNetwork(["radio1", "radio2"], ["s1-net", "s2-net"], journal)
        try:
            await network.open()
            await scene(network, journal)
        finally:
            await network.close()
        return list(journal.events)

    return asyncio.run(live())


@pytest.mark.usefixtures("field")
async def test_the_manager_sees_the_radios_and_nothing_of_this_machine() -> None:
    manager = await connect_networkmanager(lambda _: None)
    try:
        seen = [device.interface for device in await manager.devices()]
    finally:
        await manager.close()
    assert sorted(seen) == ["lo", "radio1", "radio2"]


def test_networks_are_joined_one_after_the_other_and_left(field: Field) -> None:
    async def scene(network: ManagedNetwork, _: MemoryJournal) -> None:
        for number in (1, 2, 1):
            await network.join(f"s{number}-net", timeout_s=JOIN_S)
            assert f"10.91.{number}." in field.addresses()
            field.run("ping", "-c1", "-w2", f"10.91.{number}.1")
            await network.leave()
            assert "10.91." not in field.addresses()

    assert play(scene) == []


def test_what_an_earlier_flight_left_joined_is_left_before_the_next(field: Field) -> None:
    field.run("nmcli", "connection", "up", "s1-net")

    async def scene(network: ManagedNetwork, _: MemoryJournal) -> None:
        await network.join("s2-net", timeout_s=JOIN_S)
        assert "10.91.1." not in field.addresses()

    (event,) = play(scene)
    assert isinstance(event, LeftOver)
    assert event.network == "s1-net"


@played(play)
async def test_a_network_that_gives_no_address_cannot_be_joined(
    network: ManagedNetwork, *, field: Field
) -> None:
    field.stop_dhcp(1)
    with pytest.raises(NetworkError, match="s1-net cannot be joined: no address: nothing answered by DHCP"):
        await network.join("s1-net", timeout_s=JOIN_S)
    await network.join("s2-net", timeout_s=JOIN_S)


@played(play)
async def test_a_network_without_a_carrier_cannot_be_joined(network: ManagedNetwork, *, field: Field) -> None:
    field.cut_cable(1)
    with pytest.raises(NetworkError, match="s1-net cannot be joined: no carrier"):
        await network.join("s1-net", timeout_s=JOIN_S)
    field.mend_cable(1)
    await network.join("s1-net", timeout_s=JOIN_S)


@played(play)
async def test_a_carrier_that_goes_is_noticed_at_once(network: ManagedNetwork, *, field: Field) -> None:
    await network.join("s1-net", timeout_s=JOIN_S)
    lost = asyncio.create_task(network.lost())
    await asyncio.sleep(0)
    assert not lost.done()
    field.cut_cable(1)
    async with asyncio.timeout(5.0):  # the connection itself goes on for several seconds more
        assert await lost == "its carrier is gone"
    assert "s1-net" in field.active()
    await network.leave()
    assert "s1-net" not in field.active()


async def test_two_radios_are_used_at_once_and_do_not_disturb_each_other(field: Field) -> None:
    journal = MemoryJournal()
    journal.begin()
    networks = ["s1-net", "s2-net"]
    first, second = (ManagedNetwork([f"radio{number}"], networks, journal) for number in (1, 2))
    try:
        for number, network in enumerate((first, second), start=1):
            await network.open()
            await network.join(f"s{number}-net", timeout_s=JOIN_S)
        assert "10.91.1." in field.addresses() and "10.91.2." in field.addresses()
        lost = asyncio.create_task(second.lost())
        await first.leave()
        field.run("ping", "-c1", "-w2", "10.91.2.1")
        assert not lost.done()
        field.cut_cable(2)
        assert await lost
    finally:
        await first.close()
        await second.close()


def test_a_manager_that_is_killed_loses_the_network_and_the_next_one_is_tidied_up(field: Field) -> None:
    async def scene(network: ManagedNetwork, _: MemoryJournal) -> None:
        await network.join("s1-net", timeout_s=JOIN_S)
        field.kill_manager()
        assert await network.lost() == "NetworkManager has stopped"
        await network.leave()
        with pytest.raises(NetworkError, match="NetworkManager is not on the system bus"):
            await network.join("s2-net", timeout_s=JOIN_S)
        field.start_manager()
        await network.join("s2-net", timeout_s=JOIN_S)
        assert "10.91.1." not in field.addresses()

    assert "leave_failed" in [event.kind for event in play(scene)]


def test_the_rule_of_the_page_lets_its_user_join_and_nobody_else(field: Field) -> None:
    def join_as(user: str) -> str:
        person = ["setpriv", f"--reuid={user}", "--regid=nogroup", "--clear-groups", "--"]
        bus = ["env", "DBUS_SYSTEM_BUS_ADDRESS=unix:path=/run/field/bus"]
        script = "nmcli connection up s1-net 2>&1 || true"
        return field.run(*person, *bus, "sh", "-c", script)

    asked = "dbus-send --system --print-reply --dest=org.freedesktop.DBus / org.freedesktop.DBus.NameHasOwner"
    field.run(
        "sh", "-c", f"until {asked} string:org.freedesktop.PolicyKit1 | grep -q true; do sleep 0.05; done"
    )
    assert "Not authorized to control networking" in join_as("daemon")
    assert "successfully activated" in join_as("nobody")


def test_check_prints_what_is_ready_and_the_remedy_for_the_rest(
    field: Field, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = {"east_m": 0.0, "north_m": 0.0, "range_m": 50.0, "remote_call_s": {"light": 0.3, "heavy": 0.3}}
    file = write_drone(
        tmp_path,
        network={"kind": "networkmanager", "interfaces": ["radio1", "radio2"]},
        service=[{"name": "detector", "local_call_s": {"light": 1.0, "heavy": 3.0}}],
        server=[place | {"name": name, "network": f"{name}-net"} for name in ("s1", "s2")],
    )
    assert main(["check", str(file), "--networks"]) == 0
    assert "no such interface" not in capsys.readouterr().out
    field.run("nmcli", "connection", "modify", "s2-net", "connection.autoconnect", "yes")
    assert main(["check", str(file), "--networks"]) == 1
    said = capsys.readouterr().out
    assert (
        "s2: joins itself whenever it can: `nmcli connection modify s2-net connection.autoconnect no`" in said
    )


def test_the_survey_finds_what_one_of_two_radios_could_not_join(field: Field) -> None:
    def surveyed() -> list[str]:
        findings = asyncio.run(survey_networks(["radio1", "radio2"], {"s1": "s1-net"}, radios=2))
        return [finding.trouble for finding in findings if finding.trouble]

    field.run("nmcli", "connection", "modify", "s1-net", "connection.interface-name", "radio1")
    (trouble,) = surveyed()
    assert trouble.startswith("is for radio1 alone, and either radio may have to join it: ")
    field.run("sh", "-c", trouble.partition("`")[2].rstrip("`"))
    assert surveyed() == []


def test_the_survey_finds_them_ready(field: Field) -> None:
    findings = asyncio.run(
        survey_networks(["radio1", "radio2"], {"s1": "s1-net", "s2": "s2-net", "s3": "s3-net"})
    )
    assert [finding.subject for finding in findings if finding.trouble] == ["s3"]
    assert [finding.found for finding in findings[1:4]] == [
        "Ethernet, idle",
        "Ethernet, idle",
        "s1-net, 802-3-ethernet, on radio1",
    ]
