"""Service instances in containers of Docker or Podman, each made when it is started."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

from upwash.errors import EngineError
from upwash.ports import Answered, InstanceSpec, ignored
from upwash.real.instances.containers import FrozenInstances
from upwash.real.instances.control import Begin, begin_of
from upwash.real.instances.docker.container import SERVER, ContainerSettings, describe, run
from upwash.real.instances.docker.engine import DockerEngine
from upwash.real.instances.docker.image import labelled_image
from upwash.real.instances.docker.instance import ContainerInstance
from upwash.real.instances.service_image import ServiceImage, image_of
from upwash.real.link.door import Lead
from upwash.support.commands import command

_log = logging.getLogger("upwash.docker")


class ContainerRuntime:
    """Starts each instance in a container of its own, of the image that `images` names for its service.

    Callers come to a socket that listens at `listen(spec)`, through the door if there is a way to `lead` them.
    """

    def __init__(
        self,
        engine: DockerEngine,
        settings: ContainerSettings,
        images: Mapping[str, str],
        *,
        listen: Callable[[InstanceSpec], str],
        freezes: bool,
        lead: Lead | None,
        max_message_bytes: int,
    ) -> None:
        self._engine = engine
        self._settings = settings
        self._references = images
        self._listen = listen
        self._freezes = freezes
        self._lead = lead
        self._max_message_bytes = max_message_bytes
        self._frozen: FrozenInstances[ContainerInstance] = FrozenInstances(_log)
        self._images: dict[str, ServiceImage] = {}  # by service, as their programs describe them
        self._server = ""  # by which containers that only describe their image are known again
        self.concurrency: dict[str, int] = {}  # of each service's image, once it is prepared

    async def prepare(self, servers: Collection[str], services: Collection[str]) -> None:
        """Removes what an earlier daemon left of these servers, and looks at each service's image.

        An image that the engine does not hold is fetched. Raises UsageError where no engine answers, EngineError
        where it refuses, or an image is missing or cannot run.
        """
        await self._engine.connect()
        for container in await self._engine.containers(SERVER):
            if container.labels[SERVER] in servers:
                _log.info("container %s was left by an earlier daemon: removing it", container.id[:12])
                await self._engine.remove(container.id)
        self._server = min(servers, default="")
        for service in services:
            self.concurrency[service] = (await self._image(service)).concurrency

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> ContainerInstance:
        """Returns when the instance is ready to serve; raises InstanceError, leaving nothing behind."""
        loop = asyncio.get_running_loop()
        image = await self._image(spec.service)
        frozen = await self._frozen.thawed(spec, image.fingerprint, called=called, answered=answered)
        if frozen is not None:
            return frozen
        paced_until_s = loop.time() + spec.start_pace_s
        instance = ContainerInstance(
            replace(spec, methods=image.methods),
            lambda spec, handed: run(self._engine, image, self._settings, spec, handed),
            image=image.fingerprint,
            keep=self._keep if self._freezes else None,
            called=called,
            answered=answered,
            lead=self._lead,
        )
        try:
            await instance.begin(self._begin(spec, image), is_apart=True)
            await asyncio.sleep(paced_until_s - loop.time())
        except BaseException:
            await instance.end()
            raise
        return instance

    async def close(self) -> None:
        """Ends what was kept frozen; nothing runs afterwards."""
        await self._frozen.close()
        await self._engine.close()

    async def _image(self, service: str) -> ServiceImage:
        """The image that the engine now holds for the service, described anew where it is another one than before."""
        reference = self._references[service]
        held = await self._engine.image(reference)
        if held is None:
            _log.info("fetching the image %s", reference)
            why = await self._engine.pull(reference)
            held = await self._engine.image(reference)
            if held is None:
                raise EngineError(
                    f"there is no image {reference} for {service}: make one with "
                    f"{command('upwash', 'package', service, '--config', 'CONFIG', '--output', 'DIR', '--import')}, "
                    f"or name another with service.image ({why})"
                )
        known = self._images.get(service)
        if known is None or known.fingerprint != held.id:
            self._images[service] = known = await self._described(service, reference, held.labels, held.id)
        return known

    async def _described(
        self, service: str, reference: str, labels: Mapping[str, str], fingerprint: str
    ) -> ServiceImage:
        labelled = labelled_image(labels, fingerprint)
        if labelled is None:
            raise EngineError(
                f"{reference} is no image of a service: give it labels upwash.service={service} and "
                "upwash.program=PATH:CLASS"
            )
        told = await describe(self._engine, labelled, self._settings, server=self._server)
        image = image_of({**dict(labels), **told, "upwash.service": labelled.service}, fingerprint)
        if image is None or told.get("upwash.service") != service or image.service != service:
            raise EngineError(f"{reference} is an image of {told.get('upwash.service')}, not of {service}")
        image.require_release("make it again with that release")
        return image

    def _begin(self, spec: InstanceSpec, image: ServiceImage) -> Begin:
        """What to be is the image's to say: the daemon need not have the service's program."""
        return begin_of(
            spec,
            image.program,
            listen=self._listen(spec),
            max_message_bytes=self._max_message_bytes,
            is_announced=self._lead is not None,
        )

    def _keep(self, instance: ContainerInstance) -> None:
        self._frozen.keep(instance.spec.server, instance.spec.service, instance)
