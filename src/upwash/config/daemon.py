"""The edge daemon's configuration: where it listens, what it can start, whom it acts as."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from upwash.config import values
from upwash.config.problems import Problem, address_problems, metrics_problems, name_problems, unknown
from upwash.config.reading import Document, convert, read_document, refuse_first
from upwash.config.runtime import (
    Cpus,
    Devices,
    DiskBytes,
    MemoryBytes,
    Processes,
    RuntimeConfig,
    device_problems,
    runtime_problems,
)
from upwash.config.shorthand import each_table, image_written_out
from upwash.errors import ConfigError
from upwash.support.text import counted

_REVOKED = "revoked.txt"

# Instances report a drone's calls once a second: a shorter lease could end between two reports.
LeaseSeconds = Annotated[float, Meta(ge=2, description="a number of at least 2, in seconds")]


class DaemonKeysConfig(values.KeysConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A daemon's certificates and key, and the list of the certificates that it refuses."""

    revoked: values.FilePath | None = None
    """The list of certificates that are refused; default: `revoked.txt` beside `authority`, if it is there."""

    @property
    def list_of_revoked(self) -> Path:
        """The list's file, which need not be there unless it is named."""
        return self.revoked or self.authority.with_name(_REVOKED)


class ImageConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A service that can be started here."""

    name: values.Name
    """The service's name, as its class declares it."""
    program: values.ImportPath | None = None
    """The service's class, `path/to/file.py:Class` or `package.module:Class`; not needed for a bundled service."""
    command: values.Command = ()
    """A program and its arguments that compute the calls, in [any language](services.md#other-languages)."""
    settings: values.Settings | None = None
    """What the constructor of its class takes; in a container that of its image counts."""
    image: values.Text | None = None
    """The image of Docker or Podman; default: `upwash-NAME`, which `upwash package` makes."""
    pace_s: values.SecondsByKey = {}
    """The least time of a call, in seconds: stands in for a slower computer."""
    start_pace_s: values.NotNegative = 0.0
    """The least time of a start, in seconds."""
    call_limit_s: values.Positive | None = None
    """The daemon replaces an instance that a call keeps busy for longer, in seconds; default: 60, or ten times the
    longest of `pace_s`. Once calls are answered, five times the longest answer is enough, from 20 s on."""
    memory_bytes: MemoryBytes | None = None
    """Memory of an instance; default: `runtime.memory_bytes`."""
    processes: Processes | None = None
    """Processes and threads of an instance; default: `runtime.processes`."""
    disk_bytes: DiskBytes | None = None
    """Files of an instance; default: `runtime.disk_bytes`."""
    cpus: Cpus | None = None
    """Processors of an instance; default: `runtime.cpus`."""
    devices: Devices | None = None
    """Devices of this machine that the service may use; default: `runtime.devices`."""


class IdentityConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A server that the daemon acts as."""

    name: values.Name
    """The server's name, as in its certificate."""
    slots: values.Slots = "auto"
    """Drones that the server serves at a time; `auto`: as measured."""
    turn_s: values.TurnSeconds = 30.0
    """The shortest time that a drone keeps its slot while others wait, in seconds."""
    images: values.Names
    """The services that it runs; default: all of the file."""


class PeerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A server that another daemon of the operator acts as, which drones go on to from here, or come from."""

    name: values.Name
    """The server's name, as in its certificate."""
    address: values.Text
    """Of its daemon, over a wire."""


PortRange = Annotated[
    tuple[Annotated[int, Meta(ge=1, le=65535)], Annotated[int, Meta(ge=1, le=65535)]],
    Meta(description="the first and the last port of a range, such as [7100, 7119]"),
]


class DaemonConfig(
    Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    rename={"images": "service", "identities": "server", "peers": "peer"},
):
    """One edge daemon."""

    listen: values.Text = "0.0.0.0:7070"
    """`host:port`, or `unix:path`; no host, or `*`, is every address of the computer; port 0 takes any free one."""
    instance_ports: PortRange | None = None
    """The first and the last port at which drones reach services, at least one for each service of each server;
    default: any free ones."""
    outside_ports: PortRange | None = None
    """The numbers of `instance_ports` as drones see them behind a router or container that maps ports."""
    max_message_bytes: values.MessageBytes = 16_777_216
    """The largest request and result of a call."""
    lease_s: LeaseSeconds = 30.0
    """The silence after which a drone loses its slot, in seconds."""
    idle_stop_s: values.Positive = 600.0
    """The time without a call and without a drone on the server after which an instance is stopped, in seconds."""
    start_timeout_s: values.Positive = values.START_TIMEOUT_S
    """The longest start of an instance, in seconds."""
    drain_s: values.Positive = 10.0
    """The time for running calls when the daemon or their service stops, in seconds."""
    hold_s: values.Positive = 60.0
    """The longest time that a slot is held for a drone at a peer's request, in seconds."""
    announce: bool = False
    """Drones find the servers by multicast DNS: their configurations say `address = "mdns"`."""
    allow_without_certificates: bool = False
    """For trying things out, on loopback or a unix socket only."""
    metrics: values.Text | None = None
    """The daemon offers its [metrics](metrics.md) to Prometheus at this address, `host:port`. Probes learn there
    whether the daemon is [alive and ready](servers.md#ports-and-health)."""
    metrics_hosts: values.Names = ()
    """Further names of this computer that a Prometheus may use, such as `host.docker.internal`."""
    keys: DaemonKeysConfig | None = None
    runtime: RuntimeConfig = RuntimeConfig()
    images: Annotated[
        tuple[ImageConfig, ...],
        Meta(min_length=1, description="tables that each begin with [[service]], at least one"),
    ]
    identities: Annotated[
        tuple[IdentityConfig, ...],
        Meta(min_length=1, description="tables that each begin with [[server]], at least one"),
    ]
    peers: Annotated[tuple[PeerConfig, ...], Meta(description="tables that each begin with [[peer]]")] = ()


def read_daemon_config(path: Path) -> DaemonConfig:
    """The configuration in the file; raises ConfigError."""
    return daemon_config(read_document(path), path)


def daemon_config(document: Document, file: Path) -> DaemonConfig:
    """The configuration in the document of that file; raises ConfigError."""
    if "mission" in document:
        raise ConfigError(str(file), "mission", "this is a drone's configuration: name the daemon's file")
    tables = _written_out(document, file.absolute().parent)
    config = convert(tables, DaemonConfig, file=file, as_written=document)
    refuse_first(file, _problems(config))
    return config


def _written_out(document: Document, folder: Path) -> Document:
    services, servers = document.get("service"), document.get("server")
    if not isinstance(services, list) or not isinstance(servers, list):
        return document
    tables = [service for service in services if isinstance(service, dict)]
    names = [table["name"] for table in tables if isinstance(table.get("name"), str)]
    return document | {
        "service": each_table(services, lambda service: image_written_out(service, folder)),
        "server": each_table(servers, lambda server: {"images": names} | server),
    }


def _problems(config: DaemonConfig) -> Iterator[Problem]:
    over_network = not config.listen.startswith("unix:")
    is_reached = config.keys is not None and over_network  # by drones
    yield from _access_problems(config)
    if config.announce and not is_reached:
        yield "announce", 'needs [keys], by which drones know the server, and a "host:port" to listen on'
    yield from metrics_problems(config.metrics, config.metrics_hosts)
    yield from runtime_problems(config.runtime)
    if config.runtime.kind == "lxd" and not is_reached:
        problem = '"lxd" needs [keys] and a "host:port" to listen on: containers are called over the network'
        yield "runtime.kind", problem
    for index, service in enumerate(config.images):
        yield from device_problems(f"service[{index}].devices", service.devices or (), config.runtime)
    names = [image.name for image in config.images]
    yield from name_problems("service", names)
    yield from name_problems("server", [identity.name for identity in config.identities])
    for index, identity in enumerate(config.identities):
        for image in identity.images:
            if image not in names:
                yield f"server[{index}].images", unknown("service", image, names)
    yield from _port_problems(config, is_reached=is_reached)
    yield from name_problems("peer", [peer.name for peer in config.peers])
    for index, peer in enumerate(config.peers):
        if peer.name in [identity.name for identity in config.identities]:
            yield f"peer[{index}].name", f"{peer.name} is this daemon itself: name servers of other daemons"
        yield from address_problems(f"peer[{index}].address", peer.address)
        if not is_reached and not values.is_on_this_machine(peer.address):
            problem = f'"{peer.address}" is another machine: give [keys], and a "host:port" to listen on'
            yield f"peer[{index}].address", problem


def _port_problems(config: DaemonConfig, *, is_reached: bool) -> Iterator[Problem]:
    if config.instance_ports is None:
        if config.outside_ports is not None:
            yield "outside_ports", "needs instance_ports, which those ports lead to"
        return
    key, (first, last), outside = "instance_ports", config.instance_ports, config.outside_ports
    instances, ports = sum(len(identity.images) for identity in config.identities), last - first + 1
    if not is_reached:
        problem = 'needs [keys] and a "host:port" to listen on: without them instances have no such ports'
        yield key, problem
    elif last < first:
        yield key, f"ends at {last}, before its first port {first}: give the first and the last"
    elif ports < instances:
        yield (
            key,
            f"{counted(ports, 'port')} cannot serve {counted(instances, 'instance')}, one of each service on each "
            f"server: end at {first + instances - 1} or later",
        )
    elif first <= int(config.listen.rpartition(":")[2] or 0) <= last:
        yield key, f'has the daemon\'s own port of listen = "{config.listen}" in it: give others'
    elif outside is not None and outside[1] - outside[0] + 1 != ports:
        yield "outside_ports", f"expected {ports} ports, as many as instance_ports has"


def _access_problems(config: DaemonConfig) -> Iterator[Problem]:
    key = "allow_without_certificates"
    if not values.is_listening_address(config.listen):
        yield "listen", f'expected "host:port" or "unix:path", found "{config.listen}"'
    elif config.keys is None and not config.allow_without_certificates:
        yield (
            "keys",
            "missing: add [keys] with authority, certificate and key, or allow_without_certificates = true on a "
            "loopback address",
        )
    elif config.keys is not None and config.allow_without_certificates:
        yield key, "contradicts [keys]: remove one of the two"
    elif config.allow_without_certificates and not values.is_on_this_machine(config.listen):
        yield (
            key,
            f'would let anyone in at "{config.listen}": listen on "127.0.0.1:7070" or "unix:path", or give [keys] '
            "instead",
        )
