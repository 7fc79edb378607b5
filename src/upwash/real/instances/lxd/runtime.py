"""Service instances in containers that are made once and then kept, stopped or frozen."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Sequence

from upwash.errors import EngineError
from upwash.ports import Answered, InstanceSpec, ignored
from upwash.real.instances.containers import FrozenInstances
from upwash.real.instances.control import Begin, begin_of
from upwash.real.instances.control_credentials import SERVICE_PORT
from upwash.real.instances.lxd.container import (
    Container,
    ContainerSettings,
    addresses,
    definition,
    in_order,
    known_container,
    new_container,
)
from upwash.real.instances.lxd.engine import THE_ONLY_ONE, Engine
from upwash.real.instances.lxd.image import newest_images
from upwash.real.instances.lxd.instance import ContainerInstance
from upwash.real.instances.service_image import ServiceImage
from upwash.real.link.door import Lead
from upwash.support.commands import command

_log = logging.getLogger("upwash.lxd")

_CREATE_S = 120.0  # unpacking an image onto a slow disk
_CREATE_ON_MEMBER_S = 20.0  # another member may be faster
_STOP_S = 10.0
_INSIDE = "unix:/tmp/instance.sock"  # in the container's own memory


class ContainerRuntime:
    """Starts each instance in a container of its own, on any member of a cluster that is online."""

    def __init__(
        self,
        engine: Engine,
        settings: ContainerSettings,
        *,
        freezes: bool,
        lead: Lead,
        max_message_bytes: int,
    ) -> None:
        self._engine = engine
        self._settings = settings
        self._freezes = freezes
        self._lead = lead
        self._max_message_bytes = max_message_bytes
        self._frozen: FrozenInstances[ContainerInstance] = FrozenInstances(_log)
        self._containers: list[Container] = []  # not asked for again: a cluster waits for its lost members
        self._taken: set[str] = set()  # addresses
        self.concurrency: dict[str, int] = {}  # of each service's image, once it is prepared
        self._suspects: set[str] = set()  # members that lost an instance and are not known to be offline yet

    async def prepare(self, servers: Collection[str], wanted: Sequence[tuple[str, str]]) -> None:
        """Ends what an earlier daemon left of these servers, and makes a container for each service wanted.

        Raises UsageError where no engine answers, EngineError where it refuses or an image is missing.
        """
        await self._engine.connect()
        images = {service: await self._image(service) for _, service in wanted}
        self.concurrency = {service: image.concurrency for service, image in images.items()}
        current = {
            (server, service): (images[service].fingerprint, self._settings.limits_of(service))
            for server, service in wanted
        }
        instances = await self._engine.instances()
        self._taken = addresses(instances)
        self._containers.clear()
        for container in filter(None, map(known_container, instances)):
            if container.server in servers:
                place = (container.server, container.service)
                is_first = place not in {(each.server, each.service) for each in self._containers}
                is_current = current.get(place) == (container.image, container.limits)
                if await self._recover(container, keep=is_first and is_current):
                    self._containers.append(container)
        for server, service in wanted:
            if (server, service) not in {(each.server, each.service) for each in self._containers}:
                await self._create_somewhere(server, images[service])
                _log.info("%s@%s has a container", service, server)

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> ContainerInstance:
        """Returns when the instance is healthy; raises InstanceError, with nothing left running."""
        image = await self._image(spec.service)
        frozen = await self._frozen.thawed(spec, image.fingerprint, called=called, answered=answered)
        if frozen is not None:
            return frozen
        return await self._start_somewhere(spec, image, called, answered)

    async def close(self) -> None:
        """Ends what was kept frozen; nothing runs afterwards."""
        await self._frozen.close()
        await self._engine.close()

    async def _image(self, service: str) -> ServiceImage:
        image = newest_images(await self._engine.images()).get(service)
        if image is None:
            raise EngineError(
                f"the container engine has no image of {service}: make and import one with {_packaged(service)}"
            )
        image.require_release(f"make it again with {_packaged(service)}")
        return image

    async def _recover(self, container: Container, *, keep: bool) -> bool:
        """Stops what runs in it, and deletes it unless it is to be kept; says whether it is there to be used."""
        try:
            if container.status != "Stopped":
                _log.info("%s was left by an earlier daemon: stopping it", container.name)
                await self._engine.change(container.name, "stop", wait_s=_STOP_S)
            if not keep:
                await self._engine.delete(container.name)
        except EngineError as error:
            _log.warning("%s is left as it is: %s", container.name, error)
            return False
        return keep

    async def _create_somewhere(self, server: str, image: ServiceImage) -> Container:
        """A new container on the first member that makes it; raises EngineError where none does."""
        online = await self._online()
        problem = EngineError("no member of the cluster is online")
        for member in in_order(online, self._containers, self._suspects):
            try:
                return await self._create(server, image, member)
            except EngineError as error:
                _log.warning("no container on %s: %s", member, error)
                problem = error
        raise problem

    async def _create(self, server: str, image: ServiceImage, member: str) -> Container:
        container = new_container(server, image, self._settings, member=member, taken=self._taken)
        self._taken.add(container.address)
        await self._engine.create(
            definition(container, self._settings, base=image.base, engine=self._engine.kind),
            member=member,
            wait_s=_CREATE_S if member == THE_ONLY_ONE else _CREATE_ON_MEMBER_S,
        )
        self._containers.append(container)
        return container

    async def _start_somewhere(
        self, spec: InstanceSpec, image: ServiceImage, called: Callable[[str], None], answered: Answered
    ) -> ContainerInstance:
        """In the container that is kept for it, or else in a new one elsewhere."""
        online = await self._online()
        for container in list(self._containers):
            is_its_own = (container.server, container.service, container.image) == (
                spec.server,
                spec.service,
                image.fingerprint,
            )
            if is_its_own and container.member in online and container.member not in self._suspects:
                try:
                    return await self._run(container, spec, image, called, answered)
                except EngineError as error:
                    _log.warning("%s cannot be used: %s", container.name, error)
                    self._suspect(container.member)
                    self._containers.remove(container)
        return await self._run(
            await self._create_somewhere(spec.server, image), spec, image, called, answered
        )

    async def _online(self) -> list[str]:
        online = await self._engine.members()
        self._suspects.intersection_update(online)  # one that was offline meanwhile is believed again
        return online

    def _suspect(self, member: str) -> None:
        if member != THE_ONLY_ONE:
            self._suspects.add(member)

    async def _run(
        self,
        container: Container,
        spec: InstanceSpec,
        image: ServiceImage,
        called: Callable[[str], None],
        answered: Answered,
    ) -> ContainerInstance:
        loop = asyncio.get_running_loop()
        paced_until_s = loop.time() + spec.start_pace_s
        instance = ContainerInstance(
            container,
            name=spec.name,
            engine=self._engine,
            lost=self._suspect,
            keep=self._keep if self._freezes else None,
            lead=self._lead,
        )
        try:
            await instance.begin(
                self._begin(spec, image), called=called, answered=answered, methods=image.methods
            )
            await asyncio.sleep(paced_until_s - loop.time())
        except BaseException:
            await instance.end()
            raise
        return instance

    def _keep(self, instance: ContainerInstance) -> None:
        self._frozen.keep(instance.container.server, instance.container.service, instance)

    def _begin(self, spec: InstanceSpec, image: ServiceImage) -> Begin:
        """What to be is the image's to say: the daemon need not have the service's program."""
        return begin_of(
            spec,
            image.program,
            listen=_INSIDE,
            outside=f"0.0.0.0:{SERVICE_PORT}",
            max_message_bytes=self._max_message_bytes,
            is_announced=True,
        )


def _packaged(service: str) -> str:
    """The command that makes the service's image, and has the engine of the configuration take it."""
    return command("upwash", "package", service, "--config", "CONFIG", "--output", "DIR", "--import")
