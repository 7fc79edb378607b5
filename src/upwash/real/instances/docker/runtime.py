"""Service instances in containers of Docker or Podman, each made when it is started."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Collection, Mapping

from upwash.errors import EngineError
from upwash.ports import InstanceSpec
from upwash.real.instances.containers import (
    ContainerRuntime,
    HeldImage,
    ServiceImage,
    image_of,
    labelled_image,
    packaging,
)
from upwash.real.instances.control import begin_of
from upwash.real.instances.docker.container import SERVER, DockerContainer, DockerSettings, describe, run
from upwash.real.instances.docker.engine import DockerEngine
from upwash.real.instances.instance_control import ControlledInstance, InstanceCallbacks, starting
from upwash.real.instances.local_instance import LocalInstance
from upwash.real.link.door import Lead

_log = logging.getLogger("upwash.docker")


class DockerInstance(LocalInstance):
    """A service in a container of Docker or Podman."""

    async def freeze(self) -> None:
        """Suspend the container; raises EngineError."""
        await self._container.pause()

    async def thaw(self) -> None:
        """Let a frozen container go on; raises EngineError."""
        await self._container.unpause()

    @property
    def _container(self) -> DockerContainer:
        assert isinstance(self._running, DockerContainer)  # noqa: S101 - it has begun
        return self._running


class DockerRuntime(ContainerRuntime):
    """Runs instances in containers of Docker or Podman, from the image that `images` names for each service.

    Callers come to a socket that listens at `listen(spec)`, through the door if there is a way to `lead` them.
    """

    def __init__(
        self,
        engine: DockerEngine,
        settings: DockerSettings,
        images: Mapping[str, str],
        *,
        listen: Callable[[InstanceSpec], str],
        freezes: bool,
        lead: Lead | None,
        max_message_bytes: int,
    ) -> None:
        super().__init__(engine.close, freezes=freezes, lead=lead, max_message_bytes=max_message_bytes)
        self._engine = engine
        self._settings = settings
        self._references = images
        self._listen = listen
        self._images: dict[str, ServiceImage] = {}  # by service, as their programs describe them
        self._server = ""  # the label of containers that only describe their image

    async def prepare(self, services: Mapping[str, Collection[str]]) -> None:
        """Remove containers that an earlier daemon left of these servers, and describe each service's image.

        An image that the engine does not hold is fetched. Raises UsageError if no engine answers, EngineError if it
        refuses or an image is missing or cannot run.
        """
        await self._engine.connect()
        for container, server in (await self._engine.containers(SERVER)).items():
            if server in services:
                _log.info("container %s was left by an earlier daemon: removing it", container[:12])
                await self._engine.remove(container)
        self._server = min(services, default="")
        for service in dict.fromkeys(name for names in services.values() for name in names):
            self.concurrency[service] = (await self._image(service)).concurrency

    async def _start(
        self, spec: InstanceSpec, image: ServiceImage, callbacks: InstanceCallbacks
    ) -> ControlledInstance:
        instance = DockerInstance(
            spec, functools.partial(run, self._engine, image, self._settings), callbacks
        )
        begin = begin_of(
            spec,
            image.program,  # the daemon need not have the service's program
            listen=self._listen(spec),
            max_message_bytes=self._max_message_bytes,
            is_announced=self._lead is not None,
        )
        async with starting(instance):
            await instance.begin(begin, is_apart=True)
        return instance

    async def _image(self, service: str) -> ServiceImage:
        reference = self._references[service]
        held = await self._engine.image(reference)
        if held is None:
            _log.info("fetching the image %s", reference)
            why = await self._engine.pull(reference)
            held = await self._engine.image(reference)
            if held is None:
                raise EngineError(
                    f"there is no image {reference} for {service}: make one with {packaging(service)}, "
                    f"or name another with service.image ({why})"
                )
        known = self._images.get(service)
        if known is None or known.fingerprint != held.id:
            self._images[service] = known = await self._described(service, reference, held)
        return known

    async def _described(self, service: str, reference: str, held: HeldImage) -> ServiceImage:
        labelled = labelled_image(held)
        if labelled is None:
            raise EngineError(
                f"{reference} is no image of a service: give it labels upwash.service={service} and "
                "upwash.program=PATH:CLASS"
            )
        told = await describe(self._engine, labelled, self._settings, server=self._server)
        image = image_of(HeldImage(held.id, {**held.labels, **told, "upwash.service": labelled.service}))
        if image is None or told.get("upwash.service") != service or image.service != service:
            raise EngineError(f"{reference} is an image of {told.get('upwash.service')}, not of {service}")
        image.require_release("make it again with that release")
        return image
