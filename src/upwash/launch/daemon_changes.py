"""How a running edge daemon follows another configuration, and gives its place to another daemon."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NoReturn

from upwash.config import DaemonConfig
from upwash.core.admission.clients import Client
from upwash.core.admission.instances import InstanceState
from upwash.core.admission.server import ServerOffer
from upwash.core.admission.watchdog import CALL_LIMIT_S
from upwash.errors import UpwashError, UsageError
from upwash.launch.daemon_keys import DaemonKeys
from upwash.launch.daemon_services import DaemonServices
from upwash.real.host.service_manager import ServiceManager
from upwash.real.link.door import Door
from upwash.real.link.hand_over import HandedOver, Served, Used, hand_over
from upwash.server.daemon import EdgeServer
from upwash.server.instances import Image

_log = logging.getLogger("upwash.serving")

_COMING_S = 30.0  # for a daemon to come up, beside its services
_PACES = 10.0  # a call may take this multiple of the slowest pace


@dataclass(frozen=True, slots=True)
class RunningDaemon:
    """A daemon that runs; drones connect at the socket `outside`, which is None without certificates."""

    config: DaemonConfig
    edge: EdgeServer
    services: DaemonServices
    keys: DaemonKeys
    door: Door | None
    outside: socket.socket | None
    manager: ServiceManager

    async def reload_at(self, hung_up: asyncio.Event, read_again: Callable[[], DaemonConfig]) -> NoReturn:
        """Follow the configuration at each hang-up; a configuration with an error changes nothing."""
        while True:
            await hung_up.wait()
            hung_up.clear()
            self.manager.reloading()
            try:
                new = await asyncio.to_thread(read_again)
                _refuse_restart(self.config, new)
                images = await self.services.anew(new)
                self.keys.renew(new)
            except UpwashError as error:
                _log.error("the old configuration stays: %s", error)
            else:
                await self._take(new, images)
            self.manager.ready()

    async def _take(self, new: DaemonConfig, images: Mapping[str, Image]) -> None:
        if self.door:
            await self.door.trust(self.keys.trust())
        changed = self.services.take(new, images)
        await self.edge.reload(
            offers(new, images), images=images, revoked=self.keys.revoked, certificates=self.keys.certificates
        )
        _log.info(
            "the configuration was read again; %d certificates are revoked; services that changed: %s",
            len(self.keys.revoked),
            ", ".join(changed) or "none",
        )

    async def hand_over_at(self, asked: asyncio.Event) -> None:
        """Return once another daemon has taken this daemon's place, as asked; what prevents it is logged."""
        while True:
            await asked.wait()
            asked.clear()
            if self.outside is None or self.config.runtime.kind != "process":
                _log.error(
                    "no other daemon can take this one's place, as that needs certificates, and services that are "
                    "processes: restart it"
                )
                continue
            _log.info("another daemon is to take this one's place")
            try:
                process = await hand_over(
                    self.outside,
                    self.config.listen,
                    self._served(),
                    {at.name: Used(at.drones, at.teams) for at in self.edge.standing().servers},
                    environment=self.manager.environment,
                    timeout_s=self.config.start_timeout_s + _COMING_S,
                )
            except (UpwashError, OSError) as error:
                _log.error("this daemon stays: %s", error)
            except Exception:  # noqa: BLE001 - a defect must not take the drones' leases
                _log.exception("this daemon stays: a defect in handing over")
            else:
                self.manager.main_is(process)
                _log.info(
                    "process %d has taken this daemon's place, which ends when its last lease does", process
                )
                return

    def _served(self) -> dict[str, Served]:
        return {
            server.name: Served(
                [(lease.drone, lease.certificate) for lease in server.leases if not lease.held_by],
                [
                    instance.service
                    for instance in server.instances
                    if instance.state == InstanceState.RUNNING
                ],
            )
            for server in self.edge.standing().servers
        }


async def take_up(edge: EdgeServer, before: HandedOver | None) -> None:
    """Serve the drones of the daemon before, with the services that ran there."""
    if before is None:
        return
    for server, served in before.servers.items():
        drones = [Client(name, certificate) for name, certificate in served.drones]
        await edge.take_up(server, drones, served.services)
    for server, used in before.usage().items():
        edge.take_up_usage(server, used.drones, used.teams)


def offers(config: DaemonConfig, images: Mapping[str, Image]) -> dict[str, ServerOffer]:
    """What each of the daemon's servers offers."""
    lanes = {name: image.lanes for name, image in images.items()}
    limits_s = {
        image.name: image.call_limit_s or max(CALL_LIMIT_S, _PACES * max(image.pace_s.values(), default=0.0))
        for image in config.images
    }
    return {
        at.name: ServerOffer(frozenset(at.images), at.slots, at.turn_s, lanes, limits_s)
        for at in config.identities
    }


def _refuse_restart(old: DaemonConfig, new: DaemonConfig) -> None:
    if [at.name for at in old.identities] != [at.name for at in new.identities]:
        raise UsageError("the servers of a running daemon cannot change: restart it")
    if (old.keys is None) != (new.keys is None):
        raise UsageError("a daemon that runs cannot begin or cease to use certificates: restart it")
    if old.runtime.kind != "process" and old.images != new.images:
        raise UsageError("the services of containers are prepared at the start: restart it")
    for name in sorted(set(old.__struct_fields__) - {"images", "identities", "keys"}):
        if getattr(old, name) != getattr(new, name):
            raise UsageError(f"{name} cannot change while the daemon runs: restart it")
