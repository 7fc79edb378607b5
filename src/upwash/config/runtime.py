"""What a daemon's services run in: processes of the daemon's, or containers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Annotated, Literal

from msgspec import Meta, Struct

from upwash.config import values
from upwash.config.problems import Problem
from upwash.support.entry_points import INSTANCES, names

# A Python interpreter with gRPC needs this much.
MemoryBytes = Annotated[int, Meta(ge=2**26, description="an integer of at least 67108864 (64 MiB), in bytes")]
Processes = Annotated[int, Meta(ge=32, description="an integer of at least 32, threads included")]
Cpus = Annotated[int, Meta(ge=1, le=4096, description="an integer from 1 to 4096")]
DiskBytes = Annotated[int, Meta(ge=2**20, description="an integer of at least 1048576 (1 MiB), in bytes")]
Files = Annotated[tuple[values.FilePath, ...], Meta(description="an array of files and folders")]
EngineAddresses = Annotated[
    tuple[values.Text, ...], Meta(min_length=1, description='an array of "unix:/path" or "https://host:port"')
]

Devices = Annotated[
    tuple[values.Text, ...],
    Meta(description='an array of paths like "/dev/dri", or of names like "nvidia.com/gpu=all"'),
]
NVIDIA_CARD = re.compile(r"nvidia\.com/gpu=(all|\d{1,3})", re.ASCII)  # of the Container Device Interface
OWN_KINDS = ("docker", "lxd", "process")
_ADDRESSES = {"docker": "unix:/var/run/docker.sock", "lxd": "unix:/var/lib/lxd/unix.socket"}


class EngineConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which container engine, and what of it."""

    addresses: EngineAddresses | None = None
    """Of the engine; several are those of one cluster's members. Default: `unix:/var/lib/lxd/unix.socket`, or with
    `docker` `unix:/var/run/docker.sock`."""
    project: values.Name = "default"
    """The project of containers and images; of LXD or Incus."""
    pool: values.Name = "default"
    """The storage pool; of LXD or Incus."""
    profiles: values.Names = ()
    """Further profiles of containers; of LXD or Incus."""
    certificate: values.FilePath | None = None
    """Shown to an engine at an https address."""
    key: values.FilePath | None = None
    """The private key of that certificate."""
    engine_certificate: values.FilePath | None = None
    """The engine's own certificate."""
    settings: values.ClassSettings = {}
    """What the engine of a [plug-in](plug-ins.md) takes."""


class ContainerNetworkConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The addresses of containers, and the interface that answers for them."""

    subnet: values.Text = "10.147.70.0/24"
    """The network of the containers' addresses."""
    interface: values.Name | None = None
    """Where drones come from; without it containers are reached from this machine alone."""


class RuntimeConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What services run in, and what each instance may use at most."""

    kind: values.Text = "process"
    """Processes (`process`), or [containers](containers.md) of Docker or Podman (`docker`), of LXD or Incus (`lxd`),
    or of an engine that a [plug-in](plug-ins.md) brings under its name."""
    sandbox: Literal["auto", "required", "off"] = "auto"
    """The sandbox of processes: `auto`: if bubblewrap can make one; `required`: no start without one; `off`."""
    sandbox_as_root: bool = False
    """Whether root may make sandboxes, which are weaker."""
    readable: Files = ()
    """Files and folders, such as models, that services may read beside their own code."""
    memory_bytes: MemoryBytes | None = None
    """Memory of an instance, whose service names no limit of its own; default: 2_147_483_648, and
    4_294_967_296 of a service with an NVIDIA card."""
    processes: Processes | None = None
    """Processes and threads of an instance; default: 256."""
    disk_bytes: DiskBytes | None = None
    """Files of an instance; default: 268_435_456."""
    cpus: Cpus | None = None
    """Processors of an instance; default: all."""
    idle: Literal["stop", "freeze"] = "freeze"
    """What happens to an unused instance in a container."""
    devices: Devices = ()
    """[Devices](small-computers.md#a-graphics-card) of this machine for every service without its own. Names
    are those of the Container Device Interface. LXD and Incus have none."""
    engine: EngineConfig = EngineConfig()
    network: ContainerNetworkConfig = ContainerNetworkConfig()

    @property
    def is_of_plug_in(self) -> bool:
        """Whether a plug-in brings the engine."""
        return self.kind not in OWN_KINDS

    @property
    def has_images(self) -> bool:
        """Whether services are in images; otherwise their code is on this machine."""
        return self.kind in ("docker", "lxd")

    @property
    def engine_addresses(self) -> tuple[str, ...]:
        """Where the container engine is."""
        return self.engine.addresses or (_ADDRESSES.get(self.kind, _ADDRESSES["lxd"]),)


def runtime_problems(runtime: RuntimeConfig) -> Iterator[Problem]:
    """What is wrong with a runtime's table, beyond its types."""
    yield from device_problems("runtime.devices", runtime.devices, runtime)
    if runtime.is_of_plug_in:
        if runtime.kind not in (known := names(INSTANCES)):
            own = ", ".join(f'"{kind}"' for kind in OWN_KINDS)
            yield (
                "runtime.kind",
                f"expected one of {own}, or an engine of a plug-in that is installed here "
                f'({", ".join(known) or "none"}), found "{runtime.kind}"',
            )
        return
    if runtime.engine.settings:
        yield "runtime.engine.settings", f'kind = "{runtime.kind}" takes none: leave them out'
    if runtime.kind != "docker":
        yield from _lxd_problems(runtime)
        return
    key, addresses = "runtime.engine.addresses", runtime.engine_addresses
    if len(addresses) > 1:
        yield key, f"one address of Docker or Podman is enough, found {len(addresses)}"
    elif not addresses[0].startswith("unix:/"):
        yield f"{key}[0]", f'expected "unix:/path" of an engine on this machine, found "{addresses[0]}"'


def device_problems(key: str, devices: tuple[str, ...], runtime: RuntimeConfig) -> Iterator[Problem]:
    """What is wrong with the devices of a key, for services in that runtime."""
    if devices and runtime.kind == "lxd":
        problem = "containers of LXD or Incus get devices by a profile: name it in engine.profiles"
        yield key, problem
    for index, device in enumerate(devices if runtime.kind == "process" else ()):
        if NVIDIA_CARD.fullmatch(device):
            continue
        if not device.startswith("/dev/") or ".." in device.split("/"):
            yield (
                f"{key}[{index}]",
                f'expected a path below /dev, "nvidia.com/gpu=all" or "nvidia.com/gpu=0", found "{device}"',
            )


def _lxd_problems(runtime: RuntimeConfig) -> Iterator[Problem]:
    import ipaddress  # only needed where a daemon is configured

    engine, addresses = runtime.engine, runtime.engine_addresses
    for index, address in enumerate(addresses):
        if not address.startswith(("unix:/", "https://")):
            problem = f'expected "unix:/path" or "https://host:port", found "{address}"'
            yield f"runtime.engine.addresses[{index}]", problem
    if any(address.startswith("https://") for address in addresses):
        for name in ("certificate", "key", "engine_certificate"):
            if getattr(engine, name) is None:
                problem = "missing: an engine at an https address is shown and shows one"
                yield f"runtime.engine.{name}", problem
    try:
        subnet = ipaddress.IPv4Network(runtime.network.subnet)
    except ValueError as error:
        yield "runtime.network.subnet", f'expected a subnet like "10.147.70.0/24": {error}'
    else:
        if not 16 <= subnet.prefixlen <= 30:
            yield "runtime.network.subnet", f'expected a subnet from /16 to /30, found "{subnet}"'
