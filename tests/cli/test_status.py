"""What `upwash status` prints of a daemon's reply, of this release or of an earlier one."""

from __future__ import annotations

import io
import math
from typing import Any

import msgspec
import pytest
from rich.console import Console

from upwash.cli.exit_codes import ExitCode
from upwash.cli.main import main
from upwash.cli.status import print_status
from upwash.core.admission.admission import AdmissionController
from upwash.core.admission.clients import Client, DoorStatus, Role
from upwash.core.admission.limits import Limits
from upwash.core.admission.server import ServerOffer
from upwash.errors import Unreachable
from upwash.rpc.protocol import StatusReply, decode_reply

ALICE = Client("alice", "0c", role=Role.OPERATOR)


def printed(servers: Any, **more: Any) -> list[str]:
    """The lines for the servers, as they arrive over the wire."""
    reply = {"up_s": 1.0, "servers": servers, "refusals": [], "certificates": [], **more}
    sent = msgspec.msgpack.encode(msgspec.to_builtins(reply))
    console = Console(file=io.StringIO(), width=90, markup=False)
    print_status(decode_reply(sent, StatusReply, sender="s1"), console)
    assert isinstance(console.file, io.StringIO)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def test_drones_that_wait_follow_those_with_a_slot_in_the_order_of_their_turns() -> None:
    host = AdmissionController({"s1": ServerOffer(frozenset(), slots=1)}, peers=["s2"])
    host.availability("s1", [], Client("heron"), now_s=0.0)
    host.availability("s1", [], Client("heron"), now_s=10.0)
    for now_s in range(0, 32, 2):
        host.availability("s1", [], Client("egret"), now_s=float(now_s))
    for drone in ("avocet", "heron"):
        host.availability("s1", [], Client(drone), now_s=32.0)
    assert printed(host.servers(now_s=32.0))[2:] == [
        "s1: 1 of 1 slot in use, 2 drones wait",
        "  1 slot, as configured; a turn lasts 30 s, 1 has ended so far",
        "  egret: has a slot for 2 s, counts as having had 2 s; lease ends in 28 s",
        "  avocet: waits for 0 s, counts as having had 2 s",
        "  heron: waits for 0 s, counts as having had 30 s",
        "  drone    slot for    slots in all    calls    computing    last call",
        "  egret    2 s         2 s             0        0.0 s",
        "  heron                30 s            0        0.0 s",
    ]


def test_a_slot_that_is_held_names_the_peer_that_asked_and_turns_may_have_no_end() -> None:
    host = AdmissionController({"s1": ServerOffer(frozenset(), "auto", math.inf)}, peers=["s2"])
    peer = Client("s2", "02", role=Role.SERVER)
    host.hold("s1", [], Client("tern", "03"), peer=peer, for_s=9.0, now_s=0.0)
    assert printed(host.servers(now_s=1.0))[2:5] == [
        "s1: 1 of 1 slot in use",
        "  1 slot, as no service is offered; turns have no end",
        "  tern: has a slot for 1 s, counts as having had 1 s; lease ends in 8 s, certificate 03, held as s2 asked",
    ]


@pytest.mark.parametrize(
    ("slots", "why", "said"),
    [
        (224, "detector is not measured yet", "s1: 0 slots in use, not limited"),
        (224, "configured", "s1: 0 of 224 slots in use"),
        (7, "a drone keeps detector busy for 14 % of its time", "s1: 0 of 7 slots in use"),
    ],
)
def test_a_number_of_slots_that_no_crowd_reaches_is_no_limit(slots: int, why: str, said: str) -> None:
    instance = {"service": "detector", "state": "absent", "endpoint": "", "unused_s": 0.0}
    server = {"name": "s1", "slots": slots, "slots_why": why, "leases": [], "instances": [instance]}
    lines = printed([server])
    assert said in lines
    assert any(line.split("  ")[1:] and "starts on demand" in line for line in lines)


def test_it_says_how_often_another_version_took_over_and_why_the_last_one_did_not() -> None:
    host = AdmissionController({"s1": ServerOffer(frozenset({"scale"}), slots=1)})
    drone, outdated = Client("heron"), frozenset({("s1", "scale")})
    host.start("s1", "scale", drone, now_s=0.0)
    host.at("s1").ready("scale", 1, ":1", now_s=1.0)
    offers = {"s1": ServerOffer(frozenset({"scale"}), slots=1)}
    host.offer(offers, outdated=outdated)
    host.at("s1").ready("scale", 2, ":2", now_s=2.0)
    host.offer(offers, outdated=outdated)
    host.at("s1").gone("scale", 3, "no such model", now_s=3.0)
    assert printed(host.servers(now_s=3.0))[-2:] == [
        "  scale: another version took over 1 time",
        "  scale: the former version serves on, as the new one did not start: no such model",
    ]


def test_connections_that_were_refused_are_counted_by_their_reason() -> None:
    at_door = [DoorStatus("revoked", 12, "heron", 3.0), DoorStatus("no_certificate", 1, "10.0.0.9", 60.0)]
    assert printed([], at_door=at_door)[-2:] == [
        "at the door 12 connections refused, revoked: last heron, 3 s ago",
        "at the door 1 connection refused, no certificate: last 10.0.0.9, 1 min 0 s ago",
    ]


def test_a_daemon_that_knows_no_turns_is_shown_without_them() -> None:
    lease = {"drone": "heron", "certificate": "0a", "ends_in_s": 12.0, "held_by": ""}
    instance = {"service": "detector", "state": "running", "endpoint": ":40000", "unused_s": 3.0}
    assert printed([{"name": "s1", "slots": 2, "leases": [lease], "instances": [instance]}])[2:] == [
        "s1: 1 of 2 slots in use",
        "  heron: lease ends in 12 s, certificate 0a",
        "  instance    state      at        unused for",
        "  detector    running    :40000    3 s",
    ]


def test_the_limits_that_hold_are_shown_for_each_service() -> None:
    limits = {
        "detector": Limits(memory_bytes=3 * 2**29, processes=256, disk_bytes=2**28, cpus=1),
        "counter": Limits(),
    }
    assert printed([], limits=limits)[2:] == [
        "limits of each instance",
        "  counter: none",
        "  detector: 1.5 GiB of memory, 1 processor, 256 processes, 256 MiB of files",
    ]


def test_what_drones_used_is_shown_with_holders_first_and_summed_by_team() -> None:
    host = AdmissionController({"s1": ServerOffer(frozenset(), slots=2)})
    for drone in ("north-1", "north-2"):
        host.availability("s1", [], Client(drone), now_s=0.0)
    host.at("s1").usage.called("north-1", took_s=1.25, is_answered=True, now_s=3.0)
    host.at("s1").usage.called("north-2", took_s=2.0, is_answered=True, now_s=4.0)
    host.leave("s1", Client("north-1"), now_s=5.0)
    assert printed(host.servers(now_s=10.0))[5:] == [
        "  drone      slot for    slots in all    calls    computing    last call",
        "  north-2    10 s        10 s            1        2.0 s        6 s ago",
        "  north-1                5 s             1        1.2 s        7 s ago",
        "  team     slots    slots in all    calls    computing    last call",
        "  north    1        15 s            2        3.2 s        6 s ago",
    ]


def test_of_many_drones_the_latest_are_shown() -> None:
    host = AdmissionController({"s1": ServerOffer(frozenset(), slots=1)})
    for number in range(30):
        drone = Client(f"d{number:02}")
        host.availability("s1", [], drone, now_s=float(number))
        host.at("s1").usage.called(drone.key, took_s=1.0, is_answered=True, now_s=float(number))
        host.leave("s1", drone, now_s=float(number))
    shown = printed(host.servers(now_s=30.0))[5:]
    assert shown[0].startswith("  d29 ") and shown[-1] == "  and 10 more: see --json"
    assert len(shown) == 21


def test_a_daemon_is_asked_again_until_the_watch_is_stopped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    up = [StatusReply(up_s, [], [], []) for up_s in (5.0, 10.0)]
    replies: list[StatusReply | BaseException] = [
        up[0], Unreachable("it restarts"), up[1], KeyboardInterrupt(),
    ]  # fmt: skip

    async def ask(address: str, **_: object) -> StatusReply:
        if isinstance(reply := replies.pop(0), BaseException):
            raise reply
        return reply

    monkeypatch.setattr("upwash.cli.status.ask_status", ask)
    monkeypatch.setattr("upwash.cli.status._WATCH_S", 0.0)
    assert main(["status", "127.0.0.1:1", "--watch"]) == ExitCode.INTERRUPTED
    said = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert [line for line in said if line] == ["up for 5 s", "it restarts", "up for 10 s"]
