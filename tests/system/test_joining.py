"""Joining networks by a NetworkManager that does as its script says: the troubles of WiFi, and its own."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import Any

import pytest
from dbus_fast import Variant
from tests.events import written
from tests.system.fake_networkmanager import (
    ETHERNET,
    EVERYTHING,
    NAME,
    FakeDevice,
    FakeManager,
    FakeProfile,
    running,
)

from upwash.errors import NetworkError, UsageError
from upwash.real.network import SurveyFinding
from upwash.real.network.network import ManagedNetwork
from upwash.real.network.networkmanager import connect_networkmanager
from upwash.real.network.profiles import survey_networks
from upwash.sim.journal import MemoryJournal

pytestmark = [
    pytest.mark.system,
    pytest.mark.root,
    pytest.mark.usefixtures("private_bus"),
    pytest.mark.timeout(60),
]

LOOK_S = 5.0  # longer than anything here takes, shorter than a test may


def profile(name: str, **about: Any) -> FakeProfile:
    return FakeProfile(name, f"{name}-uuid", **about)


@dataclass
class Stage:
    manager: FakeManager
    network: ManagedNetwork
    journal: MemoryJournal

    async def joins(self, network: str) -> None:
        await self.network.join(network, timeout_s=LOOK_S)

    async def refuses(self, network: str, why: str) -> None:
        with pytest.raises(NetworkError, match=why):
            await self.joins(network)

    def events(self, name: str) -> list[dict[str, Any]]:
        return [event for event in written(self.journal.events) if event["event"] == name]


@contextlib.asynccontextmanager
async def stage(
    *profiles: FakeProfile,
    devices: tuple[FakeDevice, ...] = (),
    prepare: Callable[[FakeManager], None] | None = None,
) -> AsyncIterator[Stage]:
    """A drone that may use wlan1 for what the profiles are of, and is on the ground with wlan0."""
    everything = devices or (FakeDevice("wlan1"), FakeDevice("wlan0"))
    async with running(*everything, profiles=profiles) as manager:
        if prepare:
            prepare(manager)
        journal = MemoryJournal()
        journal.begin()
        networks = [each.name for each in profiles if each.name != "home"]
        network = ManagedNetwork(["wlan1"], networks, journal)
        try:
            await network.open()
            yield Stage(manager, network, journal)
        finally:
            await network.close()


@pytest.mark.parametrize(
    ("reason", "why"),
    [
        (7, "its secret is missing or wrong"),
        (53, "it is not in the air here"),
        (5, "no address: nothing answered by DHCP"),
        (60, "another network was activated on the interface"),
        (39, "someone disconnected it"),
        (36, "the interface was taken out"),
        (99, r"NetworkManager gave the reasons 99 \(device\) and 3 \(connection\)"),
    ],
)
async def test_why_a_network_cannot_be_joined(reason: int, why: str) -> None:
    async with stage(profile("s1-net", fails=reason), profile("s2-net")) as on:
        await on.refuses("s1-net", f"s1-net cannot be joined: {why}")
        assert on.manager.active == []
        await on.joins("s2-net")
        assert on.manager.active == ["s2-net"]


async def test_a_secret_that_was_right_is_not_blamed_when_the_access_point_goes() -> None:
    gone = profile("s1-net")
    async with stage(gone) as on:
        await on.joins("s1-net")
        await on.network.leave()
        gone.fails = 7
        await on.refuses("s1-net", "the access point did not answer; its secret was right")


@pytest.mark.parametrize("trouble", [{"is_stuck": True}, {"lacks_address": True}])
async def test_what_takes_too_long_is_given_up_and_does_not_go_on(trouble: dict[str, bool]) -> None:
    async with stage(profile("s1-net", **trouble)) as on:
        with pytest.raises(NetworkError, match=r"s1-net was not joined within 0\.1 s: it had no address yet"):
            await on.network.join("s1-net", timeout_s=0.1)
        assert on.manager.active == []


async def test_a_join_that_is_cancelled_does_not_go_on() -> None:
    async with stage(profile("s1-net", is_stuck=True)) as on:
        joining = asyncio.create_task(on.network.join("s1-net", timeout_s=LOOK_S))
        await on.manager.until(lambda: on.manager.active != [])
        joining.cancel()
        await asyncio.gather(joining, return_exceptions=True)
        assert on.manager.active == []


async def test_a_carrier_that_is_gone_is_a_lost_network_though_the_manager_still_holds_on_to_it() -> None:
    async with stage(profile("s1-net")) as on:
        await on.joins("s1-net")
        on.manager.take_off_the_air("s1-net")
        assert await on.network.lost() == "its carrier is gone"
        assert on.manager.active == ["s1-net"]
        await on.network.leave()
        assert on.manager.active == []


async def test_a_connection_that_is_ended_by_someone_else_is_lost_with_the_reason() -> None:
    async with stage(profile("s1-net")) as on:
        await on.joins("s1-net")
        (connection,) = on.manager.connections
        on.manager.end(connection, device_reason=36)
        assert await on.network.lost() == "the interface was taken out"


# --- profiles and interfaces --------------------------------------------------------------------------------


async def test_a_network_without_a_profile_is_said_to_have_none() -> None:
    async with stage(profile("s1-net")) as on:
        await on.refuses("s9-net", "no connection profile s9-net is on this drone")
        await on.joins("s1-net")


async def test_profiles_are_known_by_their_uuid_too_which_alone_tells_namesakes_apart() -> None:
    async with stage(FakeProfile("s1-net", "one"), FakeProfile("s1-net", "two")) as on:
        await on.refuses("s1-net", r"2 connection profiles are called s1-net: .*one, two")
        await on.joins("two")


async def test_a_profile_for_an_interface_that_is_not_upwashs_is_not_activated() -> None:
    section = {"connection": {"interface-name": Variant("s", "wlan0")}}
    async with stage(profile("s1-net", settings=section)) as on:
        await on.refuses("s1-net", r"for wlan0, which is not among network\.interfaces")
        assert "ActivateConnection" not in on.manager.calls


async def test_a_wired_profile_is_not_activated_on_a_radio() -> None:
    async with stage(profile("s1-net", kind="802-3-ethernet")) as on:
        await on.refuses("s1-net", "needs an interface that is not there: 802-3-ethernet")


async def test_a_vpn_needs_no_interface_and_has_reasons_of_its_own() -> None:
    refused = profile("s2-net", kind="vpn", fails_itself=10)
    async with stage(profile("s1-net", kind="vpn"), refused) as on:
        await on.joins("s1-net")
        assert [place for _, place, _ in on.manager.connections.values()] == ["/"]
        await on.network.leave()
        assert on.manager.active == []
        await on.refuses("s2-net", "s2-net cannot be joined: its secret is wrong")


async def test_a_user_without_the_right_is_told_of_the_rule() -> None:
    async with stage(profile("s1-net")) as on:
        on.manager.refusal = (f"{NAME}.PermissionDenied", "Not authorized to control networking.")
        await on.refuses("s1-net", r"Not authorized .* docs/networks\.md has the polkit rule")


async def test_idle_radios_look_for_networks_and_others_do_not() -> None:
    async with stage(profile("s1-net")) as on:
        await on.manager.until(lambda: "RequestScan" in on.manager.calls)
        assert on.manager.calls.count("RequestScan") == 1, "wlan0 is nobody's business"


# --- before the flight --------------------------------------------------------------------------------------


async def test_what_an_earlier_flight_left_joined_is_left_and_nothing_else() -> None:
    def prepare(manager: FakeManager) -> None:
        manager.activate(1, device=1)
        manager.activate(2, device=2)

    async with stage(profile("s1-net"), profile("s2-net"), prepare=prepare) as on:
        assert [event["network"] for event in on.events("left_over")] == ["s1-net"]
        await on.manager.until(lambda: "s1-net" not in on.manager.active)
        assert on.manager.active == ["s2-net"], "wlan0 is nobody's business"


@pytest.mark.parametrize(
    ("device", "trouble"),
    [
        (FakeDevice("wlan9"), "no such interface; NetworkManager knows wlan9"),
        (
            FakeDevice("wlan1", state=10),
            "NetworkManager leaves it alone: `nmcli device set wlan1 managed yes`",
        ),
        (FakeDevice("wlan1", state=20), "its radio is switched off"),
    ],
)
async def test_an_interface_that_cannot_be_used_is_told_before_the_flight(
    device: FakeDevice, trouble: str
) -> None:
    with pytest.raises(UsageError, match=rf"network\.interfaces: wlan1: {trouble}"):
        async with stage(profile("s1-net"), devices=(device,)):
            pass


async def test_an_interface_with_another_network_is_not_taken_over() -> None:
    def prepare(manager: FakeManager) -> None:
        manager.activate(1, device=1)

    with pytest.raises(UsageError, match="wlan1: home is active on it: name another interface, or free it"):
        async with stage(profile("home"), profile("s1-net"), prepare=prepare):
            pass


# --- a manager in trouble -----------------------------------------------------------------------------------


@pytest.mark.parametrize("ignored", [EVERYTHING, frozenset({"ActivateConnection"})])
async def test_a_manager_that_hangs_costs_the_time_allowed_and_is_forgiven(ignored: frozenset[str]) -> None:
    async with stage(profile("s1-net")) as on:
        on.manager.ignored = ignored
        with pytest.raises(NetworkError, match=r"s1-net was not joined within 0\.2 s"):
            await on.network.join("s1-net", timeout_s=0.2)
        on.manager.ignored = frozenset()
        await on.joins("s1-net")


async def test_a_manager_that_hangs_while_a_network_is_left_is_logged_and_tidied_up_after() -> None:
    async with stage(profile("s1-net"), profile("s2-net")) as on:
        await on.joins("s1-net")
        on.manager.ignored = EVERYTHING
        await on.network.leave()
        (failed,) = on.events("leave_failed")
        assert failed["network"] == "s1-net"
        assert failed["why"].startswith(("NetworkManager did not answer DeactivateConnection", "it is still"))
        on.manager.ignored = frozenset()
        await on.joins("s2-net")
        assert on.manager.active == ["s2-net"]
        assert [event["network"] for event in on.events("left_over")] == ["s1-net"]


async def test_a_restart_of_the_manager_loses_the_network_which_is_left_under_its_new_path() -> None:
    async with stage(profile("s1-net")) as on:
        await on.joins("s1-net")
        await on.manager.restart()
        assert await on.network.lost() == "NetworkManager has stopped"
        await on.network.leave()
        await on.manager.until(lambda: on.manager.active == [])
        await on.joins("s1-net")


async def test_without_a_manager_the_remedy_is_told() -> None:
    async with stage(profile("s1-net")) as on:
        await on.manager.stop()
        await on.refuses("s1-net", "NetworkManager is not on the system bus: install it")
        await on.manager.start()
        await on.joins("s1-net")


async def test_without_a_bus_the_remedy_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", "unix:path=/nowhere/bus")
    with pytest.raises(NetworkError, match=r"the system bus cannot be reached \(.*\): is D-Bus installed"):
        await connect_networkmanager(lambda _: None)


# --- the survey ---------------------------------------------------------------------------------------------


def look(
    *devices: FakeDevice, profiles: tuple[FakeProfile, ...], may_join: str = "yes"
) -> dict[str, SurveyFinding]:
    async def survey() -> list[SurveyFinding]:
        async with running(*devices, profiles=profiles) as manager:
            manager.may_join = may_join
            servers = {"s1": "s1-net", "s2": "s2-net"}
            return await survey_networks(["wlan1", "eth1"], servers)

    return {finding.subject: finding for finding in asyncio.run(survey())}


CAREFUL = {
    "connection": {"autoconnect": Variant("b", False)},
    "ipv4": {"never-default": Variant("b", True)},
    "ipv6": {"method": Variant("s", "disabled")},
}


def test_a_survey_of_what_is_ready() -> None:
    found = look(
        FakeDevice("wlan1"),
        FakeDevice("eth1", kind=ETHERNET, flags=0x1),
        profiles=(
            profile("s1-net", settings=CAREFUL),
            profile("s2-net", kind="802-3-ethernet", settings=CAREFUL),
        ),
    )
    assert list(found) == ["NetworkManager", "wlan1", "eth1", "s1", "s2"]
    assert all(finding.trouble == "" for finding in found.values())
    assert found["eth1"].found == "Ethernet, idle, no carrier now"
    assert found["s2"].found == "s2-net, 802-3-ethernet, on eth1"


def test_a_survey_of_what_is_not_ready() -> None:
    found = look(
        FakeDevice("wlan1"),
        profiles=(profile("s1-net", settings={"802-11-wireless-security": {"psk-flags": Variant("u", 1)}}),),
        may_join="auth",
    )
    assert "docs/networks.md has the polkit rule" in found["NetworkManager"].trouble
    assert found["eth1"].trouble == "no such interface; NetworkManager knows wlan1"
    assert found["s1"].trouble.endswith(
        "`nmcli connection modify s1-net connection.autoconnect no ipv4.never-default yes "
        "ipv6.never-default yes 802-11-wireless-security.psk-flags 0`"
    )
    assert "no connection profile s2-net" in found["s2"].trouble
