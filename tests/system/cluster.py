"""A cluster of three machines that are containers of a test's own engine, on a bridge of their own."""

from __future__ import annotations

import contextlib
import json
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.engines import OwnEngine

from upwash.emulation.computer_image import IS_UP, write_computer_image
from upwash.real.credentials import make_keys

MEMBERS = {"m1": "10.147.80.11", "m2": "10.147.80.12", "m3": "10.147.80.13"}
SITE = "10.147.80.0/21"  # the bridge's network, as of a site; services get a part of it
SERVICES = "10.147.84.0/24"
_BRIDGE, _BRIDGE_ADDRESS = "upwash-c0", "10.147.80.1/21"
_PORT = 8443

_FIRST = """\
config: {{core.https_address: "{address}:{port}"}}
cluster: {{enabled: true, server_name: {name}}}
storage_pools: [{{name: default, driver: dir}}]
profiles: [{{name: default, devices: {{}}}}]
"""
_NEXT = """\
cluster: {{enabled: true, server_name: {name}, server_address: "{address}:{port}", cluster_token: "{token}"}}
"""


@dataclass(frozen=True)
class OwnCluster:
    """Three members, the certificate that they all show, and one that they trust."""

    engine: OwnEngine
    engine_certificate: Path
    certificate: Path
    key: Path

    @property
    def urls(self) -> list[str]:
        return [f"https://{address}:{_PORT}" for address in MEMBERS.values()]

    def leader(self) -> str:
        """The member that leads the database."""
        members = json.loads(_inside(self.engine, "m1", "lxc cluster list --format json"))
        return next(str(each["server_name"]) for each in members if "database-leader" in each["roles"])

    def lose(self, member: str) -> None:
        """Takes the member away, with all that runs on it, as if its plug were pulled."""
        self.engine.command("stop", "--force", member)

    def silence(self, member: str) -> None:
        """Ends the member's engine, but nothing that runs in its containers."""
        _inside(self.engine, member, "kill -9 $(cat /run/lxd.pid)")


@contextlib.contextmanager
def own_cluster(engine: OwnEngine) -> Iterator[OwnCluster]:
    """Three members of a fresh cluster, until the end of the block."""
    with _bridge(), tempfile.TemporaryDirectory(prefix="upwash-cluster-") as name:
        folder = Path(name)
        engine.command("image", "import", str(write_computer_image(folder)), "--alias", "member")
        try:
            for member, address in MEMBERS.items():
                _launch(engine, member, address)
            for member in MEMBERS:
                _start_engine(engine, member)
            _join_all(engine)
            yield _trusted(engine, folder)
        finally:
            for member in MEMBERS:
                with contextlib.suppress(subprocess.CalledProcessError):
                    engine.command("delete", "--force", member)


@contextlib.contextmanager
def _bridge() -> Iterator[None]:
    subprocess.run(("ip", "link", "add", _BRIDGE, "type", "bridge"), check=True)
    try:
        subprocess.run(("ip", "address", "add", _BRIDGE_ADDRESS, "dev", _BRIDGE), check=True)
        subprocess.run(("ip", "link", "set", _BRIDGE, "up"), check=True)
        yield
    finally:
        subprocess.run(("ip", "link", "delete", _BRIDGE), check=False)


def _launch(engine: OwnEngine, member: str, address: str) -> None:
    engine.command("init", "member", member, "-s", "default")
    engine.command("config", "set", member, "security.nesting=true")
    engine.command(
        "config", "device", "add", member, "usr", "disk", "source=/usr", "path=/usr", "readonly=true"
    )
    engine.command(
        *("config", "device", "add", member, "eth0", "nic"),
        *("nictype=bridged", f"parent={_BRIDGE}", "name=eth0"),
    )
    engine.command("start", member)
    engine.command("exec", member, "--", *IS_UP)
    _inside(
        engine,
        member,
        f"ip address add {address}/21 dev eth0; ip link set eth0 up; "
        "echo 1 >/proc/sys/net/ipv4/conf/eth0/forwarding",
    )


def _start_engine(engine: OwnEngine, member: str) -> None:
    start = "setsid lxd --group root --logfile /var/log/lxd/lxd.log >/dev/null 2>&1 </dev/null &"
    _inside(engine, member, f"{start} echo $! > /run/lxd.pid; lxd waitready --timeout=30")


def _join_all(engine: OwnEngine) -> None:
    (first, address), *others = MEMBERS.items()
    _inside(engine, first, "lxd init --preseed", _FIRST.format(name=first, address=address, port=_PORT))
    for member, address in others:
        token = _inside(engine, first, f"lxc cluster add {member} --quiet").split()[-1]
        preseed = _NEXT.format(name=member, address=address, port=_PORT, token=token)
        _inside(engine, member, "lxd init --preseed", preseed)


def _trusted(engine: OwnEngine, folder: Path) -> OwnCluster:
    make_keys(folder, drones=["client"])
    client = folder / "client.pem"
    _inside(
        engine, "m1", "cat > /root/client.crt && lxc config trust add /root/client.crt", client.read_text()
    )
    shown = folder / "cluster.crt"
    shown.write_text(_inside(engine, "m1", "cat /var/lib/lxd/cluster.crt"))
    return OwnCluster(engine, shown, client, folder / "client.key")


def _inside(engine: OwnEngine, member: str, command: str, given: str = "") -> str:
    return engine.command(
        "exec", member, "--", "sh", "-c", f"export HOME=/root PATH=/usr/sbin:/usr/bin; {command}", given=given
    )
