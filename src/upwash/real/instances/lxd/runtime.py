"""Service instances in containers of LXD or Incus, which are made once and then kept, stopped or frozen."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping

from upwash.config.runtime import RuntimeConfig
from upwash.core.admission.limits import DEFAULT_LIMITS, Limits
from upwash.errors import EngineError
from upwash.ports import InstanceSpec
from upwash.real.instances.containers import ContainerRuntime, ServiceImage, newest_images, packaging
from upwash.real.instances.control import begin_of
from upwash.real.instances.control_credentials import SERVICE_PORT
from upwash.real.instances.instance_control import ControlledInstance, InstanceCallbacks, starting
from upwash.real.instances.lxd.container import (
    LxdContainer,
    addresses,
    definition,
    in_order,
    known_container,
    new_container,
)
from upwash.real.instances.lxd.engine import NO_CLUSTER, Engine
from upwash.real.instances.lxd.instance import LxdInstance
from upwash.real.link.door import Lead

_log = logging.getLogger("upwash.lxd")

_CREATE_S = 120.0  # unpacking an image onto a slow disk
_CREATE_ON_MEMBER_S = 20.0  # another member may be faster
_STOP_S = 10.0
_INSIDE = "unix:/tmp/instance.sock"  # in the container's own memory


class LxdRuntime(ContainerRuntime):
    """Runs instances in containers of LXD or Incus, on any member of a cluster that is online."""

    def __init__(
        self,
        engine: Engine,
        config: RuntimeConfig,
        limits: Mapping[str, Limits],
        *,
        lead: Lead,
        max_message_bytes: int,
    ) -> None:
        super().__init__(
            engine.close, freezes=config.idle == "freeze", lead=lead, max_message_bytes=max_message_bytes
        )
        self._engine = engine
        self._config = config
        self._limits = limits  # by service
        self._containers: list[LxdContainer] = []  # listed once: a cluster waits for its lost members
        self._taken: set[str] = set()  # addresses
        self._suspects: set[str] = set()  # members that lost an instance and may still count as online

    async def prepare(self, services: Mapping[str, Collection[str]]) -> None:
        """Stop what an earlier daemon left of these servers, and make a container for each of their services.

        Raises UsageError if no engine answers, EngineError if it refuses or an image is missing.
        """
        await self._engine.connect()
        wanted = [(server, service) for server, names in services.items() for service in names]
        images = {service: await self._image(service) for _, service in wanted}
        self.concurrency = {service: image.concurrency for service, image in images.items()}
        current = {
            (server, service): (images[service].fingerprint, self._limits.get(service, DEFAULT_LIMITS))
            for server, service in wanted
        }
        instances = await self._engine.instances()
        self._taken = addresses(instances)
        self._containers.clear()
        made = set[tuple[str, str]]()
        for container in filter(None, map(known_container, instances)):
            place = (container.server, container.service)
            is_current = current.get(place) == (container.image, container.limits)
            if container.server in services and await self._recover(
                container, keep=is_current and place not in made
            ):
                self._containers.append(container)
                made.add(place)
        for server, service in wanted:
            if (server, service) not in made:
                await self._create_somewhere(server, images[service])
                _log.info("%s@%s has a container", service, server)

    async def _image(self, service: str) -> ServiceImage:
        image = newest_images(await self._engine.images()).get(service)
        if image is None:
            raise EngineError(
                f"the container engine has no image of {service}: make and import one with {packaging(service)}"
            )
        image.require_release(f"make it again with {packaging(service)}")
        return image

    async def _recover(self, container: LxdContainer, *, keep: bool) -> bool:
        """Stop a container, and delete it unless `keep`; returns whether it can be used."""
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

    async def _create_somewhere(self, server: str, image: ServiceImage) -> LxdContainer:
        online = await self._online()
        problem = EngineError("no member of the cluster is online")
        for member in in_order(online, self._containers, self._suspects):
            try:
                return await self._create(server, image, member)
            except EngineError as error:
                _log.warning("no container on %s: %s", member, error)
                problem = error
        raise problem

    async def _create(self, server: str, image: ServiceImage, member: str) -> LxdContainer:
        limits, subnet = self._limits.get(image.service, DEFAULT_LIMITS), self._config.network.subnet
        container = new_container(server, image, limits, subnet=subnet, member=member, taken=self._taken)
        self._taken.add(container.address)
        await self._engine.create(
            definition(container, self._config, base=image.base, engine=self._engine.kind),
            member=member,
            wait_s=_CREATE_S if member == NO_CLUSTER else _CREATE_ON_MEMBER_S,
        )
        self._containers.append(container)
        return container

    async def _start(
        self, spec: InstanceSpec, image: ServiceImage, callbacks: InstanceCallbacks
    ) -> ControlledInstance:
        begin = begin_of(
            spec,
            image.program,  # the daemon need not have the service's program
            listen=_INSIDE,
            outside=f"0.0.0.0:{SERVICE_PORT}",
            max_message_bytes=self._max_message_bytes,
            is_announced=True,
        )

        async def run(container: LxdContainer) -> LxdInstance:
            instance = LxdInstance(container, spec, callbacks, engine=self._engine, lost=self._suspect)
            async with starting(instance):
                await instance.begin(begin)
            return instance

        online = await self._online()
        made_for = (spec.server, spec.service, image.fingerprint)
        for container in list(self._containers):
            is_its_own = (container.server, container.service, container.image) == made_for
            if is_its_own and container.member in online and container.member not in self._suspects:
                try:
                    return await run(container)
                except EngineError as error:
                    _log.warning("%s cannot be used: %s", container.name, error)
                    self._suspect(container.member)
                    self._containers.remove(container)
        return await run(await self._create_somewhere(spec.server, image))

    async def _online(self) -> list[str]:
        online = await self._engine.members()
        self._suspects.intersection_update(online)  # a member that was offline meanwhile is trusted again
        return online

    def _suspect(self, member: str) -> None:
        if member != NO_CLUSTER:
            self._suspects.add(member)
