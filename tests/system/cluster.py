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

from upwash.emulation.containers import IS_UP, write_computer_image
from upwash.real.trust.authority import make_keys

MEMBERS = ("m1", "m2", "m3")
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
class Site:
    """A network of /21, of which members have the first part and services another."""

    number: int

    @property
    def bridge(self) -> str:
        return f"upwash-c{self.number}"

    @property
    def subnet(self) -> int:
        """The third part of the network's address, 10.147.SUBNET.0."""
        return 80 + 8 * self.number

    @property
    def services(self) -> str:
        return f"10.147.{self.subnet + 4}.0/24"

    @property
    def bridge_address(self) -> str:
        return f"10.147.{self.subnet}.1"

    def address(self, member: str) -> str:
        return f"10.147.{self.subnet}.{11 + MEMBERS.index(member)}"


@dataclass(frozen=True)
class Words:
    """How a kind of engine is called."""

    daemon: str
    admin: str
    client: str
    trust: str
    folder: str


_MAX_SITES = 16
_WORDS = {
    "lxd": Words("lxd", "lxd", "lxc", "add", "/var/lib/lxd"),
    "incus": Words("/usr/libexec/incus/incusd", "incus admin", "incus", "add-certificate", "/var/lib/incus"),
}


@dataclass(frozen=True)
class OwnCluster:
    """Three members, the certificate that they all show, and one that they trust."""

    engine: OwnEngine
    site: Site
    engine_certificate: Path
    certificate: Path
    key: Path

    @property
    def urls(self) -> list[str]:
        return [f"https://{self.site.address(member)}:{_PORT}" for member in MEMBERS]

    def leader(self) -> str:
        """The member that leads the database."""
        client = _WORDS[self.engine.kind].client
        members = json.loads(_inside(self.engine, "m1", f"{client} cluster list --format json"))
        return next(str(member["server_name"]) for member in members if "database-leader" in member["roles"])

    def lose(self, member: str) -> None:
        """Takes the member away, with all that runs on it, as if its plug were pulled."""
        self.engine.command("stop", "--force", member)

    def silence(self, member: str) -> None:
        """Ends the member's engine, but nothing that runs in its containers."""
        _inside(self.engine, member, "kill -9 $(cat /run/engine.pid)")


@contextlib.contextmanager
def own_cluster(engine: OwnEngine) -> Iterator[OwnCluster]:
    """Three members of a fresh cluster, until the end of the block."""
    with _own_site() as site, tempfile.TemporaryDirectory(prefix="upwash-cluster-") as name:
        folder = Path(name)
        engine.command("image", "import", str(write_computer_image(folder)), "--alias", "member")
        try:
            for member in MEMBERS:
                _launch(engine, site, member)
            for member in MEMBERS:
                _start_engine(engine, member)
            _join_all(engine, site)
            yield _trusted(engine, site, folder)
        finally:
            for member in MEMBERS:
                with contextlib.suppress(subprocess.CalledProcessError):
                    engine.command("delete", "--force", member)


@contextlib.contextmanager
def _own_site() -> Iterator[Site]:
    """The first one whose bridge no other run of the tests has, or left behind."""
    site = next(site for site in map(Site, range(_MAX_SITES)) if _added(site.bridge))
    try:
        subprocess.run(("ip", "address", "add", f"{site.bridge_address}/21", "dev", site.bridge), check=True)
        subprocess.run(("ip", "link", "set", site.bridge, "up"), check=True)
        yield site
    finally:
        subprocess.run(("ip", "link", "delete", site.bridge), check=False)


def _added(bridge: str) -> bool:
    added = subprocess.run(
        ("ip", "link", "add", bridge, "type", "bridge"), stderr=subprocess.DEVNULL, check=False
    )
    return added.returncode == 0


def _launch(engine: OwnEngine, site: Site, member: str) -> None:
    engine.command("init", "member", member, "-s", "default")
    engine.command("config", "set", member, "security.nesting=true")
    engine.command(
        "config", "device", "add", member, "usr", "disk", "source=/usr", "path=/usr", "readonly=true"
    )
    engine.command(
        *("config", "device", "add", member, "eth0", "nic"),
        *("nictype=bridged", f"parent={site.bridge}", "name=eth0"),
    )
    engine.command("start", member)
    engine.command("exec", member, "--", *IS_UP)
    _inside(
        engine,
        member,
        f"ip address add {site.address(member)}/21 dev eth0; ip link set eth0 up; "
        "echo 1 >/proc/sys/net/ipv4/conf/eth0/forwarding",
    )


def _start_engine(engine: OwnEngine, member: str) -> None:
    words = _WORDS[engine.kind]
    start = f"setsid {words.daemon} --group root --logfile /run/engine.log >/dev/null 2>&1 </dev/null &"
    _inside(engine, member, f"{start} echo $! > /run/engine.pid; {words.admin} waitready --timeout=30")


def _join_all(engine: OwnEngine, site: Site) -> None:
    words, (first, *others) = _WORDS[engine.kind], MEMBERS
    init = f"{words.admin} init --preseed"
    _inside(engine, first, init, _FIRST.format(name=first, address=site.address(first), port=_PORT))
    for member in others:
        token = _inside(engine, first, f"{words.client} cluster add {member} --quiet").split()[-1]
        address = site.address(member)
        _inside(engine, member, init, _NEXT.format(name=member, address=address, port=_PORT, token=token))


def _trusted(engine: OwnEngine, site: Site, folder: Path) -> OwnCluster:
    words = _WORDS[engine.kind]
    make_keys(folder, drones=["client"])
    client = folder / "client.pem"
    trust = f"cat > /root/client.crt && {words.client} config trust {words.trust} /root/client.crt"
    _inside(engine, "m1", trust, client.read_text())
    shown = folder / "cluster.crt"
    shown.write_text(_inside(engine, "m1", f"cat {words.folder}/cluster.crt"))
    return OwnCluster(engine, site, shown, client, folder / "client.key")


def _inside(engine: OwnEngine, member: str, command: str, given: str = "") -> str:
    return engine.command(
        "exec", member, "--", "sh", "-c", f"export HOME=/root PATH=/usr/sbin:/usr/bin; {command}", given=given
    )
