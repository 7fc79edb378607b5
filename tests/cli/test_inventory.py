"""Many servers at one glance: who is asked, what counts as wrong, and what is told of those that differ."""

from __future__ import annotations

import asyncio
import io
import json
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import MappingProxyType

import pytest
from rich.console import Console

from upwash.cli.inventory import ServerView, print_views, views
from upwash.cli.main import main
from upwash.config.inventory import ListedServer, read_inventory
from upwash.core.admission.admission import AdmissionController
from upwash.core.admission.clients import Client
from upwash.core.admission.server import ServerOffer
from upwash.errors import ConfigError, LinkError, Unreachable
from upwash.launch.daemon import serve
from upwash.real.host.service_manager import ServiceManager
from upwash.real.trust.authority import make_keys
from upwash.rpc.protocol import CertificateStatus, DaemonStatus, PartStatus, ReloadStatus, StatusReply

NOW = datetime(2026, 6, 1, 12, 0, 0, tzinfo=UTC)
YEAR = timedelta(days=365)
OLD, NEW = "0" * 64, "1" * 64
DAEMON = """
listen = "127.0.0.1:0"
[keys]
authority = "authority.pem"
certificate = "s1.pem"
key = "s1.key"
[runtime]
sandbox = "off"
[[service]]
name = "detector"
[[server]]
name = "s1"
"""


def reply(
    name: str,
    digests: Mapping[str, str] = MappingProxyType({}),
    *,
    ends: datetime = NOW + YEAR,
    closing: str = "",
    refused: str = "",
) -> StatusReply:
    """Of a daemon that acts as the server, with a drone that has its slot and one that waits."""
    host = AdmissionController({name: ServerOffer(frozenset(), slots=1)})
    for drone in ("heron", "tern"):
        host.availability(name, [], Client(drone), now_s=0.0)
    known = {"configuration": OLD, "keys": name, "revocations": OLD, **digests}
    parts = {part: PartStatus(digest, NOW, refused) for part, digest in known.items()}
    reload = ReloadStatus(NOW - timedelta(seconds=65), "process 1", NOW)
    daemon = DaemonStatus("0.1.0", "", OLD, "required", NOW, None, 0, parts, reload)
    certificates = [CertificateStatus(name, ends)]
    return StatusReply(9.0, host.servers(now_s=1.0), [], certificates, closing, daemon=daemon)


def seen(**replies: StatusReply | LinkError) -> dict[str, ServerView]:
    servers = [ListedServer(name=name, address=f"{name}:1") for name in replies]
    return {view.server: view for view in views(servers, list(replies.values()), NOW)}


def wrong(**replies: StatusReply | LinkError) -> dict[str, tuple[str, ...]]:
    return {name: view.wrong for name, view in seen(**replies).items() if view.wrong}


def test_each_server_has_one_line_and_one_that_is_silent_says_why() -> None:
    found = seen(s1=reply("s1"), s2=Unreachable("s2 at s2:1: connection refused"))
    console = Console(file=io.StringIO(), markup=False)
    print_views(list(found.values()), console)
    assert isinstance(console.file, io.StringIO)
    _, *lines = (line.split() for line in console.file.getvalue().splitlines())
    assert [" ".join(line) for line in lines] == [
        "s1 0.1.0 1 of 1 1 000000000000 000000000000 1 min 5 s ago until 2027-06-01",
        "s2 s2 at s2:1: connection refused",
        "well: 1 of 2",
    ]


@pytest.mark.parametrize("part", ["configuration", "revocations", "service detector"])
def test_a_server_that_missed_a_reload_differs_from_most(part: str) -> None:
    servers = {name: reply(name, {part: NEW}) for name in ("s1", "s2")} | {"s3": reply("s3", {part: OLD})}
    assert wrong(**servers) == {"s3": (f"{part}: not as on the other servers",)}


def test_without_a_majority_revocations_differ_everywhere_and_configurations_are_each_servers_own() -> None:
    own = {name: reply(name, {"configuration": name, "revocations": name}) for name in ("s1", "s2")}
    assert set(wrong(**own)) == {"s1", "s2"}
    assert {view.differs for view in seen(**own).values()} == {("revocations",)}


def test_a_daemon_with_two_servers_is_no_majority() -> None:
    servers = [
        ListedServer(name=name, address=at) for name, at in (("s1", "a:1"), ("s2", "a:1"), ("s3", "b:1"))
    ]
    replies = [reply("s1"), reply("s2"), reply("s3", {"configuration": NEW})]
    assert not any(view.differs for view in views(servers, replies, NOW))


def test_what_needs_an_operator_is_wrong() -> None:
    assert wrong(
        s1=reply("s1", closing="the daemon stops"),
        s2=reply("s2", ends=NOW + timedelta(days=29)),
        s3=reply("other"),
        s4=reply("s4"),
    ) == {
        "s1": ("the daemon stops",),
        "s2": ("the certificate of s2 ends in 29 d",),
        "s3": ("the daemon there acts as other",),
    }
    assert "revocations: the old stays: no such file" in wrong(s1=reply("s1", refused="no such file"))["s1"]


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("", "server"),
        ('[[server]]\nname = "s1"', "server[0].address"),
        ('[[server]]\nname = "s1"\naddress = "mdns"', "server[0].address"),
        ('[[server]]\nname = "s1"\naddress = "a:1"\n' * 2, "server[1].name"),
    ],
)
def test_a_list_that_cannot_be_is_refused_with_its_place(tmp_path: Path, text: str, key: str) -> None:
    (tmp_path / "boxes.toml").write_text(text)
    with pytest.raises(ConfigError) as refused:
        read_inventory(tmp_path / "boxes.toml")
    assert refused.value.key == key


def test_servers_are_asked_and_the_exit_code_says_whether_all_are_well(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_keys(tmp_path, servers=[["s1"], ["s2"]], operators=["operator"])
    (tmp_path / "server.toml").write_text(DAEMON)
    boxes = tmp_path / "boxes.toml"

    def ask(*servers: tuple[str, str]) -> int:
        boxes.write_text("".join(f'[[server]]\nname = "{name}"\naddress = "{at}"\n' for name, at in servers))
        return main(["status", "--inventory", str(boxes), "--keys", str(tmp_path), "--json"])

    async def story() -> tuple[int, int]:
        known = asyncio.get_running_loop().create_future()
        daemon = asyncio.create_task(
            serve(
                tmp_path / "server.toml",
                ready=lambda _, address: known.set_result(address),
                manager=ServiceManager(""),
            )
        )
        try:
            address = await known
            alone = await asyncio.to_thread(ask, ("s1", address))
            return alone, await asyncio.to_thread(ask, ("s1", address), ("s2", f"unix:{tmp_path}/none"))
        finally:
            daemon.cancel()
            await asyncio.gather(daemon, return_exceptions=True)

    assert asyncio.run(asyncio.wait_for(story(), 60.0)) == (0, 1)
    alone, both = map(json.loads, capsys.readouterr().out.splitlines())
    assert [view["wrong"] for view in alone] == [[]] and alone[0]["reply"]["servers"][0]["name"] == "s1"
    assert (
        both[0]["wrong"] == [] and both[1]["reply"] is None and "nobody serves there" in both[1]["wrong"][0]
    )
