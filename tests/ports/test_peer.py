"""Whom a port that anyone may send to listens to and answers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from tests.ports.memory import AGILE
from tests.ports.steps import take_off
from tests.ports.test_autopilot import FRAME, IMPATIENT
from tests.system.attacks.flown import Router, free_port

from upwash.core.geo import Position
from upwash.mavlink.packets import PacketReader
from upwash.mavlink.signing import Signing
from upwash.real.mavlink import connect_autopilot
from upwash.real.mavlink.receiver import MessageReceiver, Peer, from_autopilot
from upwash.vehicle.server import serve_vehicle

VEHICLE, RESTARTED, ELSEWHERE = ("10.0.0.1", 5000), ("10.0.0.1", 5001), ("10.0.0.2", 5000)
KEY, OTHER_KEY = bytes(range(32)), bytes(32)
NOW_S = 1.8e9


def beat(system: int = 1, component: int = 1) -> bytes:
    codec = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    return bytes(mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3).pack(codec))


def signed_beat(key: bytes = KEY, *, at_s: float = NOW_S) -> bytes:
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return Signing(key, unix_s=lambda: at_s).pack(mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 3, 3), codec)


class Port:
    """A peer that follows system 1, and what was heard of it."""

    def __init__(self, signing: Signing | None = None) -> None:
        self.heard: list[Any] = []
        self.overheard: list[int] = []
        hearing = MessageReceiver(
            self.heard.append,
            self._follows,
            signing,
            overheard=lambda message: self.overheard.append(message.get_srcSystem()),
        )
        self.peer = Peer(hearing, moved_after_s=10.0, signed=signing is not None)

    def _follows(self, message: Any) -> bool:
        return from_autopilot(message) and message.get_srcSystem() == 1


def test_nobody_is_answered_for_what_is_no_heartbeat_of_an_autopilot() -> None:
    port = Port()
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    text = bytes(mavlink.MAVLink_statustext_message(6, b"hello").pack(codec))
    for data in (
        b"",
        b"\x00",
        b"\xfd" * 300,
        text,
        beat(component=191),
        beat(system=2),
        beat(system=2) + text,
        beat()[:-1],
    ):
        port.peer.take(data, ELSEWHERE, 0.0)
    assert port.peer.answered is None
    assert port.heard == []
    assert port.peer.ignored == 8


def test_nonsense_is_not_even_read_while_there_is_no_peer(monkeypatch: pytest.MonkeyPatch) -> None:
    port = Port()
    read: list[bytes] = []

    def note(_: PacketReader, data: bytes) -> list[Any]:
        read.append(data)
        return []

    monkeypatch.setattr(PacketReader, "read", note)
    for data in b"\x00", b"\xfe\x00" * 700, b"\xfd" * 1400, bytes(1400):
        port.peer.take(data, ELSEWHERE, 0.0)
    assert read == []
    port.peer.take(b"cut off" + beat(), VEHICLE, 0.0)
    assert len(read) == 1


def test_others_are_dropped_while_the_peer_is_heard() -> None:
    port = Port()
    port.peer.take(beat(), VEHICLE, 0.0)
    for second in range(1, 60):
        port.peer.take(beat(), RESTARTED, second - 0.5)
        port.peer.take(beat(), ELSEWHERE, second - 0.4)
        port.peer.take(beat(), VEHICLE, float(second))
    assert port.peer.answered == VEHICLE
    assert len(port.heard) == 60


def test_half_a_message_of_another_does_not_spoil_the_peers_next() -> None:
    port = Port()
    port.peer.take(beat(), VEHICLE, 0.0)
    port.peer.take(beat()[:9], ELSEWHERE, 20.0)
    port.peer.take(beat(), VEHICLE, 20.1)
    port.peer.take(beat()[:9], VEHICLE, 20.2)
    port.peer.take(beat(), VEHICLE, 20.3)
    assert len(port.heard) == 3


def test_a_vehicle_that_fell_silent_is_found_at_another_port_of_its_host_only() -> None:
    port = Port()
    port.peer.take(beat(), VEHICLE, 0.0)
    port.peer.take(beat(), RESTARTED, 10.0)
    assert port.peer.answered == VEHICLE
    port.peer.take(beat(), ELSEWHERE, 10.1)
    port.peer.take(beat(system=2), RESTARTED, 10.1)
    assert port.peer.answered == VEHICLE
    port.peer.take(beat(), RESTARTED, 10.2)
    assert port.peer.answered == RESTARTED
    port.peer.take(beat(), VEHICLE, 10.3)
    assert len(port.heard) == 2


def test_what_is_not_believed_keeps_no_silent_peer() -> None:
    port = Port(Signing(KEY, unix_s=lambda: NOW_S))
    port.peer.take(signed_beat(), VEHICLE, 0.0)
    for second in range(1, 11):
        port.peer.take(beat(), VEHICLE, float(second))
    port.peer.take(signed_beat(at_s=NOW_S + 11), ELSEWHERE, 11.0)
    assert port.peer.answered == ELSEWHERE
    assert len(port.heard) == 2


def test_only_the_holder_of_the_key_becomes_the_peer_where_messages_are_signed() -> None:
    port = Port(Signing(KEY, unix_s=lambda: NOW_S))
    for data in beat(), signed_beat(OTHER_KEY):
        port.peer.take(data, ELSEWHERE, 0.0)
    assert port.peer.answered is None
    port.peer.take(signed_beat(), VEHICLE, 0.0)
    assert port.peer.answered == VEHICLE


def test_a_vehicle_whose_time_is_behind_is_answered_and_not_believed_until_it_has_ours() -> None:
    port = Port(Signing(KEY, unix_s=lambda: NOW_S))
    port.peer.take(signed_beat(at_s=NOW_S - 86_400), VEHICLE, 0.0)
    assert port.heard == []
    assert port.peer.answered == VEHICLE
    assert port.peer.address is None
    port.peer.take(signed_beat(at_s=NOW_S - 1), VEHICLE, 1.0)
    assert port.peer.address == VEHICLE
    assert len(port.heard) == 1


def test_vehicles_at_other_addresses_are_overheard_at_a_pace_that_a_flood_does_not_raise() -> None:
    port = Port()
    for address, system in (ELSEWHERE, 2), (VEHICLE, 1), (RESTARTED, 3):
        port.peer.take(beat(system=system), address, 0.0 if system < 3 else 0.05)
    assert port.overheard == [2, 3]
    for number in range(1000):
        port.peer.take(beat(system=4), ELSEWHERE, 1.0 + number / 1000)
    assert len(port.overheard) < 30
    assert port.peer.answered == VEHICLE


def test_who_has_not_the_key_is_not_overheard_where_messages_are_signed() -> None:
    port = Port(Signing(KEY, unix_s=lambda: NOW_S))
    port.peer.take(signed_beat(), VEHICLE, 0.0)
    for number, data in enumerate((beat(), signed_beat(OTHER_KEY), signed_beat())):
        port.peer.take(data, ELSEWHERE, 1.0 + number)
    assert port.overheard == [1]
    port.peer.take(signed_beat(at_s=NOW_S + 1), VEHICLE, 5.0)
    assert len(port.heard) == 2, "what was overheard does not count as sent before"


def test_a_long_datagram_introduces_nobody() -> None:
    port = Port()
    long = beat() + bytes(2049 - len(beat()))
    port.peer.take(long, ELSEWHERE, 0.0)
    assert port.peer.answered is None
    port.peer.take(long[:-1], ELSEWHERE, 0.0)
    assert port.peer.answered == ELSEWHERE


async def test_a_router_that_goes_on_from_another_port_is_found_again() -> None:
    port = free_port()
    patience = replace(IMPATIENT.patience, dead_after_s=0.6, lost_after_s=5.0)
    vehicle = await serve_vehicle("tcp:127.0.0.1:0", AGILE)
    async with Router(port).running(vehicle.address) as router:
        autopilot = await connect_autopilot(
            f"udpin:127.0.0.1:{port}",
            frame=FRAME,
            ground_speed_m_s=20.0,
            settings=replace(IMPATIENT, patience=patience),
        )
        await take_off(autopilot, 3.0)
        await router.restart()
        await autopilot.goto(Position(5.0, 0.0, 3.0))
        await autopilot.close()
    await vehicle.close()
