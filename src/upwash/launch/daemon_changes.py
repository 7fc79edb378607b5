"""How a running edge daemon gives its place to another daemon."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
from dataclasses import dataclass

from upwash.config.daemon import DaemonConfig
from upwash.core.admission.clients import Client
from upwash.core.admission.instances import InstanceState
from upwash.errors import UpwashError
from upwash.launch.daemon_keys import DaemonKeys
from upwash.launch.daemon_reload import Reloads
from upwash.real.host.service_manager import ServiceManager
from upwash.real.link.hand_over import HandedOver, Served, Used, hand_over
from upwash.server.daemon import EdgeServer

_log = logging.getLogger("upwash.serving")

_COMING_S = 30.0  # for a daemon to come up, beside its services


@dataclass(frozen=True, slots=True)
class RunningDaemon:
    """A daemon that runs; drones connect at the socket `outside`, which is None without certificates."""

    config: DaemonConfig
    edge: EdgeServer
    keys: DaemonKeys
    reloads: Reloads
    outside: socket.socket | None
    manager: ServiceManager

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
            reloads_before = self.reloads.count
            try:
                process = await hand_over(
                    self.outside,
                    self.config.listen,
                    self._served(),
                    {at.name: Used(at.drones, at.teams) for at in self.edge.standing().servers},
                    self.keys.revoked,
                    environment=self.manager.environment,
                    timeout_s=self.config.start_timeout_s + _COMING_S,
                )
            except (UpwashError, OSError) as error:
                _log.error("this daemon stays: %s", error)
            except Exception:  # noqa: BLE001 - a defect must not take the drones' leases
                _log.exception("this daemon stays: a defect in handing over")
            else:
                self.manager.main_is(process)
                self.reloads.is_leaving = True
                if self.reloads.count > reloads_before:  # which the other may have begun too early to know of
                    os.kill(process, signal.SIGHUP)
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
