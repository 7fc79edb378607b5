"""How a running edge daemon takes an operator's orders: the list of revoked certificates, keys, and configuration.

Laws:
- every order has an answer in the log at once, and a last line that says what was taken and what was refused;
- revocations come first, then keys; neither waits for the other or for the configuration to be right;
- nothing that an operator names is waited for without limit, and code of services runs in processes of its own;
- a new order ends the order that is under way, and does all of it;
- a part that is refused stays as it was.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, Protocol, TypeVar

from msgspec.structs import replace

from upwash.config.daemon import DaemonConfig, DaemonKeysConfig, daemon_config
from upwash.config.reading import MOST_BYTES, document_of
from upwash.core.admission.server import ServerOffer
from upwash.core.admission.watchdog import CALL_LIMIT_S
from upwash.errors import UpwashError, UsageError
from upwash.launch.daemon_keys import DaemonKeys, read_credentials_of, read_revoked_of, warn_without_list
from upwash.launch.daemon_services import DaemonServices, Services
from upwash.launch.in_force import CONFIGURATION, KEYS, REVOCATIONS, InForce, revoked_now, service_part
from upwash.real.host.service_manager import ServiceManager
from upwash.real.link.door import Door
from upwash.real.trust.credentials import Credentials
from upwash.server.daemon import EdgeServer
from upwash.server.instances import Image
from upwash.support.background import begin, end, in_thread
from upwash.support.input_files import read_named_file

_log = logging.getLogger("upwash.serving")
T = TypeVar("T")

_READ_S = 5.0  # for a file of configuration or keys; a disk elsewhere may not answer
_SOON_S = 1.0  # after which the log says what a reload waits for
_PACES = 10.0  # a call may take this multiple of the slowest pace


class InThread(Protocol):
    """Does work that may block, in a thread of that name."""

    def __call__(self, work: Callable[[], T], *, name: str) -> Coroutine[Any, Any, T]:
        """The result of the work, or its failure."""


@dataclass(frozen=True, slots=True)
class ConfigFile:
    """The file of a daemon's configuration."""

    path: Path

    def read(self) -> tuple[DaemonConfig, str]:
        """The configuration, and the SHA-256 of the file; raises ConfigError."""
        content = read_named_file(self.path, most_bytes=MOST_BYTES)  # once, as it may be a pipe
        config = daemon_config(document_of(content, self.path), self.path)
        return config, hashlib.sha256(content).hexdigest()


class Reloads:
    """Takes orders to reload, until cancelled; `pass_on` has others reload too, whose orders come here."""

    def __init__(
        self,
        file: ConfigFile,
        config: DaemonConfig,
        *,
        edge: EdgeServer,
        services: DaemonServices,
        keys: DaemonKeys,
        door: Door | None,
        manager: ServiceManager,
        in_force: InForce,
        pass_on: Callable[[], None] = lambda: None,
        reading: InThread = in_thread,
    ) -> None:
        self.config = config  # in force
        self.is_leaving = False  # another daemon has the place of this daemon: revocations alone count
        self.count = 0
        self._file = file
        self._edge = edge
        self._services = services
        self._keys = keys
        self._door = door
        self._manager = manager
        self._in_force = in_force
        self._pass_on = pass_on
        self._reading = reading
        self._listed = config.keys  # where the list of revoked certificates was read last
        self._asked = asyncio.Event()
        self._doing = ""  # what a reload under way waits for
        self._waiting: list[asyncio.Future[Mapping[str, str]]] = []

    def ask(self, by: str) -> asyncio.Future[Mapping[str, str]]:
        """Order a reload; the result has the parts that it refused, and why."""
        self.count += 1
        if self._doing:
            _log.warning("%s orders a reload: the one under way, which %s, ends for it", by, self._doing)
        else:
            _log.info("%s orders a reload: revocations come first", by)
        self._in_force.begin_reload(by)
        self._pass_on()
        self._asked.set()
        self._waiting.append(asyncio.get_running_loop().create_future())
        return self._waiting[-1]

    async def run(self) -> NoReturn:
        """Carry the orders out; a defect in that is raised."""
        work: asyncio.Task[None] | None = None
        asked = begin(self._asked.wait())
        try:
            while True:
                await asyncio.wait([asked, *([work] if work else [])], return_when=asyncio.FIRST_COMPLETED)
                if work is not None and work.done():
                    work.result()
                    work = None
                if asked.done():
                    self._asked.clear()
                    asked = begin(self._asked.wait())
                    await end(work)
                    work = begin(self._reload())
        finally:
            await end(asked, work)

    async def check(self) -> Mapping[str, str]:
        """The parts that a reload would refuse now, and why; nothing changes."""
        refused: dict[str, str] = {}
        config, why = await _tried(self._read_config())
        if why:
            refused[CONFIGURATION] = why
        of = self.config if config is None else config[0]
        for part, read in (
            (REVOCATIONS, self._read_revoked(of.keys, self._keys.revoked)),
            (KEYS, self._read_keys(of)),
        ):
            _, why = await _tried(read)
            if why:
                refused[part] = why
        if config is not None:
            services, why = await _tried(self._look_at_services(config[0]))
            if services is None:
                refused[CONFIGURATION] = why
            else:
                refused |= {service_part(name): stays for name, stays in services.stay.items()}
        return refused

    # --- one reload -------------------------------------------------------------------------------------------

    async def _reload(self) -> None:
        self._manager.reloading()
        self._doing = "reads the list of revoked certificates"
        known = self._keys.revoked
        why = await self._renew_revoked(self._listed, known)
        self._doing = "reads the configuration"
        read, refused = await _tried(self._read_config())
        wanted = self.config if read is None else read[0]
        if wanted.keys and self._listed and wanted.keys != self._listed:
            why = await self._renew_revoked(wanted.keys, known)
        if why:
            self._in_force.refuse(REVOCATIONS, why)
            _log.error(
                "the list of revoked certificates is refused, and %s as before: %s", self._revoked, why
            )
        if not self.is_leaving:
            await self._renew_rest(read, refused)
        self._in_force.end_reload()
        self._manager.ready()
        self._doing = ""
        self._answer()

    async def _renew_rest(self, read: tuple[DaemonConfig, str] | None, why: str) -> None:
        """Keys and configuration; with a configuration that is refused, keys are read where they were before."""
        unfit = "" if read is None else "; ".join(needs_restart(self.config, read[0]))
        fits = None if read is None or unfit else read
        self._doing = "reads the keys"
        await self._renew_keys(self.config if fits is None else replace(self.config, keys=fits[0].keys))
        if fits is not None:
            services, why = await _tried(self._look_patiently(fits[0]))
            if services is not None:
                self._take(*fits, services)
                return
        why = unfit or why
        self._in_force.refuse(CONFIGURATION, why)
        _log.error("%s; the old configuration stays: %s", self._revoked, why)

    async def _renew_revoked(self, keys: DaemonKeysConfig | None, known: frozenset[str]) -> str:
        """Refuse the certificates of the list; return why the list, which had the `known` ones, is not taken."""
        listed, why = await _tried(self._read_revoked(keys, known))
        if listed is None:
            return why
        before = self._keys.revoked
        self._keys.take_revoked(listed)
        self._listed = keys
        if self._door:
            await self._door.trust(self._keys.trust())
        self._edge.revoke(listed)
        self._in_force.take(REVOCATIONS, self._keys.digest_of_revoked)
        if before - listed:
            _log.warning(
                "%d certificates are not revoked any more, as the list lacks them", len(before - listed)
            )
        if listed != before:
            _log.info("%s, %d of them since before", self._revoked, len(before & listed))
        return ""

    async def _renew_keys(self, config: DaemonConfig) -> None:
        read, why = await _tried(self._read_keys(config))
        if read is None:
            self._in_force.refuse(KEYS, why)
            _log.error("the old keys stay: %s", why)
            return
        self._keys.take_credentials(config, read[0])
        self.config = config
        if self._door:
            await self._door.trust(self._keys.trust())
        self._in_force.take(KEYS, self._keys.digest)

    def _take(self, new: DaemonConfig, digest: str, services: Services) -> None:
        self.config = replace(new, keys=self.config.keys)
        changed = self._services.take(new, services)
        self._edge.reload(offers(new, services.images), images=services.images)
        self._in_force.take(CONFIGURATION, digest)
        note_services(self._in_force, services)
        for name, why in services.stay.items():
            _log.error("%s stays in its former version: %s", name, why)
        warn_without_list(new)
        _log.info(
            "the configuration was read again; %s; services that changed: %s%s",
            self._revoked,
            ", ".join(changed) or "none",
            f"; refused: {', '.join(refused)}" if (refused := self._in_force.refused) else "",
        )

    @property
    def _revoked(self) -> str:
        return revoked_now(len(self._keys.revoked))

    def _answer(self) -> None:
        waiting, self._waiting = self._waiting, []
        for asked in waiting:
            if not asked.done():
                asked.set_result(self._in_force.refused)

    # --- what is read -----------------------------------------------------------------------------------------

    async def _read_config(self) -> tuple[DaemonConfig, str]:
        return await self._read(self._file.read, what=str(self._file.path))

    async def _read_revoked(self, keys: DaemonKeysConfig | None, known: frozenset[str]) -> frozenset[str]:
        if keys is None:
            return frozenset()
        return await self._read(lambda: read_revoked_of(keys, known), what=str(keys.list_of_revoked))

    async def _read_keys(self, config: DaemonConfig) -> tuple[Credentials | None]:
        return (await self._read(lambda: read_credentials_of(config), what="the keys"),)

    async def _look_patiently(self, config: DaemonConfig) -> Services:
        """Look at services, and have the log say which of them are waited for."""
        look = begin(self._look_at_services(config))
        try:
            await asyncio.wait([look], timeout=_SOON_S)
            if not look.done():
                names = ", ".join(sorted(self._services.looking))
                self._doing = f"waits for the code of {names}"
                _log.info("the reload %s, for %g s at most", self._doing, config.start_timeout_s)
            return await look
        finally:
            await end(look)

    async def _look_at_services(self, config: DaemonConfig) -> Services:
        if why := "; ".join(needs_restart(self.config, config)):
            raise UsageError(why)
        return await self._services.anew(config)

    async def _read(self, work: Callable[[], T], *, what: str) -> T:
        """The result of work that reads files; raises UsageError after a time, and leaves its thread behind."""
        try:
            async with asyncio.timeout(_READ_S):
                return await self._reading(work, name=f"reading {what}")
        except TimeoutError:
            raise UsageError(f"{what} cannot be read within {_READ_S:g} s: look at its disk") from None
        except OSError as error:
            raise UsageError(f"{what} cannot be read: {error.strerror}") from None


async def _tried(work: Coroutine[Any, Any, T]) -> tuple[T | None, str]:
    """The result of the work, or why there is none."""
    try:
        return await work, ""
    except UpwashError as error:
        return None, str(error)


def note_services(in_force: InForce, services: Services) -> None:
    """Note the versions of services, and those that stay in their former version."""
    in_force.forget_services_but(services.images.keys())
    for name, image in services.images.items():
        in_force.take(service_part(name), image.version)
    for name, why in services.stay.items():
        in_force.refuse(service_part(name), why)


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


def needs_restart(old: DaemonConfig, new: DaemonConfig) -> list[str]:
    """What of a new configuration a daemon cannot take while it runs."""
    problems = []
    if [at.name for at in old.identities] != [at.name for at in new.identities]:
        problems.append("the servers of a running daemon cannot change: restart it")
    if (old.keys is None) != (new.keys is None):
        problems.append("a daemon that runs cannot begin or cease to use certificates: restart it")
    if old.runtime.has_images and old.images != new.images:
        problems.append("the services of containers are prepared at the start: restart it")
    names = sorted(set(old.__struct_fields__) - {"images", "identities", "keys"})
    changed = [name for name in names if getattr(old, name) != getattr(new, name)]
    for name in changed:
        how = "restart it" if name == "listen" else "hand over to a new one by SIGUSR2, or restart it"
        problems.append(f"{name} cannot change while the daemon runs: {how}")
    return problems
