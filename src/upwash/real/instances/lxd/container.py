"""A container of LXD or Incus: its limits, its one network address, and the marks by which a daemon finds it."""

from __future__ import annotations

import secrets
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from ipaddress import IPv4Network

from upwash.config.runtime import RuntimeConfig
from upwash.core.admission.limits import Limits
from upwash.errors import EngineError
from upwash.real.instances.containers import ServiceImage, container_name
from upwash.real.instances.control_credentials import ControlCredentials, new_control_credentials
from upwash.real.instances.lxd.engine import EngineInstance
from upwash.real.instances.lxd.init import CREDENTIALS, SCRATCH_BYTES

_SERVER, _SERVICE, _IMAGE = "user.upwash.server", "user.upwash.service", "user.upwash.image"
_NIC = "eth0"
_LIMIT_KEYS = {
    "memory_bytes": "limits.memory",
    "processes": "limits.processes",
    "cpus": "limits.cpu",
    "disk_bytes": f"environment.{SCRATCH_BYTES}",
}
# The key that hides the engine from programs in the container.
_GUEST_INTERFACE = {"lxd": "security.devlxd", "incus": "security.guestapi"}


@dataclass(frozen=True, slots=True)
class LxdContainer:
    """A container of one server's service, made from one image."""

    name: str
    server: str
    service: str
    image: str
    member: str
    status: str
    address: str
    credentials: ControlCredentials
    limits: Limits


def new_container(
    server: str,
    image: ServiceImage,
    limits: Limits,
    *,
    subnet: str,
    member: str,
    taken: Collection[str],
) -> LxdContainer:
    """A container to create, with a free address; raises EngineError if no address is left."""
    return LxdContainer(
        name=container_name(image.service, server),
        server=server,
        service=image.service,
        image=image.fingerprint,
        member=member,
        status="Stopped",
        address=_free_address(IPv4Network(subnet), taken),
        credentials=new_control_credentials(),
        limits=limits,
    )


def known_container(instance: EngineInstance) -> LxdContainer | None:
    """The container that an engine reports; None if upwash did not make it."""
    config, nic = instance.config, instance.devices.get(_NIC, {})
    if not {_SERVER, _SERVICE, _IMAGE, f"environment.{CREDENTIALS}"} <= config.keys():
        return None
    return LxdContainer(
        name=instance.name,
        server=config[_SERVER],
        service=config[_SERVICE],
        image=config[_IMAGE],
        member=instance.member,
        status=instance.status,
        address=nic.get("ipv4.address", ""),
        credentials=ControlCredentials.from_text(config[f"environment.{CREDENTIALS}"]),
        # Without limits that have a unit, which upwash never writes.
        limits=Limits(
            **{name: int(config[key]) for name, key in _LIMIT_KEYS.items() if config.get(key, "").isdecimal()}
        ),
    )


def definition(
    container: LxdContainer, config: RuntimeConfig, *, base: str, engine: str
) -> dict[str, object]:
    """A container's definition: unprivileged, with limits, its image and its address only."""
    devices: dict[str, Mapping[str, str]] = {
        "root": {"type": "disk", "path": "/", "pool": config.engine.pool},
        # No bridge, no DHCP, no neighbours: a cable to the host, which answers ARP for the address.
        _NIC: {
            "type": "nic",
            "nictype": "routed",
            "name": _NIC,
            "ipv4.address": container.address,
            **({"parent": config.network.interface} if config.network.interface else {}),
        },
    }
    if base == "host":
        devices["usr"] = {"type": "disk", "path": "/usr", "source": "/usr", "readonly": "true"}
    settings = {
        "security.privileged": "false",
        "security.nesting": "false",
        _GUEST_INTERFACE[engine]: "false",
        "boot.autostart": "false",
        f"environment.{CREDENTIALS}": container.credentials.text(),
        _SERVER: container.server,
        _SERVICE: container.service,
        _IMAGE: container.image,
    }
    for name, key in _LIMIT_KEYS.items():
        most = getattr(container.limits, name)
        if most is not None:
            settings[key] = str(most)
    return {
        "name": container.name,
        "type": "container",
        "description": f"{container.service}@{container.server} of upwash",
        "source": {"type": "image", "fingerprint": container.image},
        "profiles": list(config.engine.profiles),
        "config": settings,
        "devices": devices,
    }


def in_order(
    online: Collection[str], containers: Collection[LxdContainer], suspects: Collection[str]
) -> list[str]:
    """The members to try, in order: suspects last, members with few containers first."""
    held = [container.member for container in containers]
    return sorted(online, key=lambda member: (member in suspects, held.count(member), member))


def addresses(instances: Collection[EngineInstance]) -> set[str]:
    """The addresses of all instances, also of other programs' instances."""
    devices = [device for instance in instances for device in instance.devices.values()]
    return {device["ipv4.address"] for device in devices if "ipv4.address" in device}


def _free_address(subnet: IPv4Network, taken: Collection[str]) -> str:
    """A random free address: neighbours may still have the last container's address in their caches."""
    free = [str(address) for address in subnet.hosts() if str(address) not in taken]
    if not free:
        raise EngineError(f"every address of {subnet} is taken: give runtime.network a larger subnet")
    return secrets.choice(free)
