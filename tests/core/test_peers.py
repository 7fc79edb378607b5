"""Slots held for drones that are expected: what a peer gets for a drone, and what a drone may ask of its server."""

from __future__ import annotations

import math

import pytest

from upwash.core.admission.admission import AdmissionController, AdmissionSettings, Available
from upwash.core.admission.clients import Client, LeaseStatus, Role
from upwash.core.admission.instances import StartInstance
from upwash.core.admission.leases import Admit
from upwash.core.admission.server import Command, Denied, ServerOffer
from upwash.core.admission.usage import LeaseEnded

S1 = Client("s1", "51", Role.SERVER)
D1, D2 = Client("d1", "d1"), Client("d2", "d2")


def peer_host(*, slots: int = 1) -> AdmissionController:
    """s2, whose peers are s1 and s3; a slot is held for 60 s at most."""
    settings = AdmissionSettings(lease_s=30.0, idle_stop_s=600.0, hold_s=60.0)
    return AdmissionController(
        {"s2": ServerOffer(frozenset({"detector"}), slots)}, settings, peers=["s1", "s3"]
    )


def hold(
    machine: AdmissionController,
    drone: Client = D1,
    *,
    peer: Client = S1,
    for_s: float = 40.0,
    now_s: float = 0.0,
) -> tuple[Denied | None, list[Command]]:
    return machine.hold("s2", ["detector"], drone, peer=peer, for_s=for_s, now_s=now_s)


# ---- at the server that the drone comes to


def test_a_slot_is_held_and_the_service_started_for_a_drone_that_is_expected() -> None:
    machine = peer_host()
    answer, commands = hold(machine)
    assert answer is None
    assert commands == [Admit("s2", frozenset({"d1"})), StartInstance("s2", "detector", 1)]
    assert isinstance(machine.availability("s2", [], D2, now_s=39.9)[0], Denied)
    machine.at("s2").ready("detector", 1, ":9000", now_s=12.0)
    available, _ = machine.availability("s2", ["detector"], D1, now_s=39.9)
    assert available == Available({"detector": ":9000"}, waiting=1)
    machine.look(now_s=60.0)
    assert machine.leases("s2") == {"d1"}, "it came: the lease is its own, and lasts as any other"


def test_a_drone_that_does_not_come_loses_the_slot() -> None:
    machine = peer_host()
    hold(machine)
    assert machine.look(now_s=39.9) == []
    unused = LeaseEnded("s2", "d1", 40.0, calls=0, computed_s=0.0, held_by="s1")
    assert machine.look(now_s=40.0) == [unused, Admit("s2", frozenset())]


@pytest.mark.parametrize("for_s", [60.1, 1e9, math.inf, math.nan])
def test_no_slot_is_held_for_longer_than_the_daemon_allows(for_s: float) -> None:
    machine = peer_host()
    hold(machine, for_s=for_s)
    machine.look(now_s=60.0)
    assert machine.leases("s2") == set()


def test_word_may_come_again_and_the_services_are_started_once() -> None:
    machine = peer_host()
    hold(machine)
    assert hold(machine, now_s=20.0) == (None, [])
    machine.look(now_s=59.9)
    assert machine.leases("s2") == {"d1"}


@pytest.mark.parametrize(
    ("peer", "why"),
    [
        (Client("s4", "54", Role.SERVER), "s4 is no peer of this daemon"),
        (Client("d2", "d2"), "d2 is no peer of this daemon"),
        (Client("s3", "d3", Role.DRONE), "s3 is no daemon"),
        (Client("s3", "0c", Role.OPERATOR), "s3 is no daemon"),
    ],
)
def test_only_the_daemons_that_are_named_may_ask(peer: Client, why: str) -> None:
    machine = peer_host()
    answer, commands = hold(machine, peer=peer)
    assert isinstance(answer, Denied)
    assert answer.why.startswith(why)
    assert commands == []


def test_it_is_refused_where_the_drone_itself_would_be() -> None:
    machine = peer_host()
    assert machine.hold("s2", ["counter"], D1, peer=S1, for_s=9.0, now_s=0.0) == (
        Denied("s2 has no image of counter"),
        [],
    )
    machine.availability("s2", [], D2, now_s=0.0)
    assert hold(machine) == (Denied("s2 has no free slot: 1 of 1 in use"), [])
    machine.revoke(frozenset({"d1"}), now_s=0.0)
    assert hold(machine) == (Denied("the certificate of d1 is revoked"), [])
    machine.revoke(frozenset({"51"}), now_s=0.0)
    assert hold(machine) == (Denied("the certificate of s1 is revoked"), [])
    machine.revoke(frozenset(), now_s=0.0)
    machine.close("shutting down")
    assert hold(machine) == (Denied("shutting down"), [])


def test_a_peer_gets_half_of_the_slots_and_leaves_the_others_to_drones_that_are_here() -> None:
    machine = peer_host(slots=4)
    invented = [Client(f"x{number}", f"x{number}") for number in range(4)]
    answers = [hold(machine, drone)[0] for drone in invented]
    assert answers == [None, None, *[Denied("s1 has 2 slots held, half of all")] * 2]
    assert hold(machine, invented[0])[0] is None, "again, for the same drone"
    assert isinstance(machine.availability("s2", [], D1, now_s=1.0)[0], Available)
    assert hold(machine, D2, peer=Client("s3", "53", Role.SERVER))[0] is None


def test_a_peer_whose_drones_never_come_is_refused_for_a_while() -> None:
    machine = peer_host()
    for number in range(3):
        assert hold(machine, Client(f"x{number}", f"x{number}"), now_s=50.0 * number)[0] is None
    assert hold(machine, now_s=150.0)[0] == Denied("the last 3 drones that s1 expected did not come")
    assert isinstance(hold(machine, now_s=749.0)[0], Denied)
    assert hold(machine, now_s=750.0)[0] is None


def test_a_drone_that_comes_clears_the_peer() -> None:
    machine = peer_host()
    for number in range(6):
        invented = Client(f"x{number}", f"x{number}")
        assert hold(machine, invented, now_s=50.0 * number)[0] is None
        if number == 2:
            machine.availability("s2", [], invented, now_s=50.0 * number + 1)
            machine.leave("s2", invented, now_s=0.0)


def test_a_peer_takes_no_lease_from_a_drone_that_is_here() -> None:
    machine = peer_host()
    machine.availability("s2", [], D1, now_s=0.0)
    assert hold(machine, Client("d1", "another"))[0] == Denied("d1 is here already, with another certificate")
    hold(machine, for_s=1.0)
    assert machine.look(now_s=29.9) == [], "its own lease is not made shorter"


def test_a_daemon_itself_is_not_served() -> None:
    machine = peer_host()
    answer, _ = machine.availability("s2", [], S1, now_s=0.0)
    assert answer == Denied("s1 is a server, and s2 serves drones")
    assert machine.send_ahead("s2", "s3", S1, for_s=9.0, now_s=0.0)[0] == answer


def test_an_operator_sees_for_whom_a_slot_is_held() -> None:
    machine = peer_host()
    hold(machine)
    shown = machine.show(Client("alice", "0c", Role.OPERATOR), now_s=10.0)
    assert not isinstance(shown, Denied)
    assert shown[0][0].leases == [LeaseStatus("d1", "d1", 30.0, held_by="s1")]


# ---- at the server that the drone comes from


def visited() -> AdmissionController:
    """The host with d1 on s2 from 0 s on."""
    machine = peer_host(slots=2)
    machine.availability("s2", [], D1, now_s=0.0)
    return machine


def test_a_drone_that_is_served_may_send_word_to_one_peer_at_a_time() -> None:
    machine = visited()
    assert machine.send_ahead("s2", "s1", D1, for_s=25.0, now_s=0.0) == (None, [])
    assert machine.send_ahead("s2", "s1", D1, for_s=25.0, now_s=1.0) == (None, [])
    refused, _ = machine.send_ahead("s2", "s3", D1, for_s=25.0, now_s=10.0)
    assert refused == Denied("d1 has a slot of s1 held for another 16 s")
    assert machine.send_ahead("s2", "s3", D1, for_s=25.0, now_s=26.0) == (None, [])


def test_leaving_and_coming_again_gives_no_second_slot() -> None:
    machine = visited()
    machine.send_ahead("s2", "s1", D1, for_s=50.0, now_s=0.0)
    machine.leave("s2", D1, now_s=0.0)
    machine.availability("s2", [], D1, now_s=1.0)
    assert isinstance(machine.send_ahead("s2", "s3", D1, for_s=50.0, now_s=2.0)[0], Denied)


def test_a_slot_that_the_peer_refused_is_none() -> None:
    machine = visited()
    machine.send_ahead("s2", "s1", D1, for_s=25.0, now_s=0.0)
    machine.not_held("s3", D1)
    machine.not_held("s1", D2)
    assert isinstance(machine.send_ahead("s2", "s3", D1, for_s=25.0, now_s=0.0)[0], Denied)
    machine.not_held("s1", D1)
    assert machine.send_ahead("s2", "s3", D1, for_s=25.0, now_s=0.0) == (None, [])


def test_a_second_wish_that_is_refused_or_short_does_not_undo_the_first() -> None:
    machine = visited()
    machine.send_ahead("s2", "s1", D1, for_s=25.0, now_s=0.0)
    machine.send_ahead("s2", "s1", D1, for_s=40.0, now_s=1.0)
    machine.not_held("s1", D1)
    machine.send_ahead("s2", "s1", D1, for_s=0.0, now_s=2.0)
    assert isinstance(machine.send_ahead("s2", "s3", D1, for_s=9.0, now_s=24.9)[0], Denied)
    assert machine.send_ahead("s2", "s3", D1, for_s=9.0, now_s=25.0) == (None, [])


def test_a_drone_that_is_not_served_sends_no_word() -> None:
    machine = visited()
    for drone in (D2, Client("d1", "another")):
        assert machine.send_ahead("s2", "s1", drone, for_s=9.0, now_s=0.0)[0] == Denied(
            f"{drone.name} has no lease on s2"
        )
    assert machine.send_ahead("s2", "s9", D1, for_s=9.0, now_s=0.0)[0] == Denied(
        "s9 is no peer of this daemon"
    )
    assert machine.send_ahead("s9", "s1", D1, for_s=9.0, now_s=0.0)[0] == Denied(
        "no server s9 here; this daemon is s2"
    )
