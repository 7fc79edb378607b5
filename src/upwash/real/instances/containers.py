"""What containers have in common, whichever engine runs them: their images, names and runtime."""

from __future__ import annotations

import functools
import logging
import re
import secrets
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version

import msgspec

from upwash.errors import EngineError, InstanceError
from upwash.ports import Answered, InstanceSpec, Program, ignored
from upwash.real.instances.instance_control import ControlledInstance, InstanceCallbacks
from upwash.real.link.door import Lead
from upwash.support.text import command

_log = logging.getLogger("upwash.containers")

_LONGEST_PART = 16  # characters
_PREFIX = "upwash."
_settings = msgspec.json.Decoder(dict[str, object])
_words = msgspec.json.Decoder(tuple[str, ...])


@dataclass(frozen=True, slots=True)
class HeldImage:
    """An image that an engine holds, with its labels or properties."""

    id: str
    labels: Mapping[str, str]
    imported_at: str = ""


@dataclass(frozen=True, slots=True)
class ServiceImage:
    """A service's image, by its packager's labels: program, base system, Python and upwash.

    An instance computes `concurrency` calls at a time.
    """

    service: str
    program: Program
    base: str
    python: str
    release: str
    fingerprint: str = ""
    methods: frozenset[str] = frozenset()
    concurrency: int = 1

    def properties(self) -> dict[str, str]:
        """The labels of the image."""
        return {
            "description": f"{self.service}, a service of upwash",
            f"{_PREFIX}service": self.service,
            f"{_PREFIX}program": self.program.path,
            f"{_PREFIX}settings": msgspec.json.encode(self.program.settings, order="sorted").decode(),
            f"{_PREFIX}command": msgspec.json.encode(self.program.command).decode(),
            f"{_PREFIX}base": self.base,
            f"{_PREFIX}python": self.python,
            f"{_PREFIX}release": self.release,
            f"{_PREFIX}methods": ",".join(sorted(self.methods)),
            f"{_PREFIX}concurrency": str(self.concurrency),
        }

    def require_release(self, remedy: str) -> None:
        """Raises EngineError, with the remedy, unless the image was made with this release of upwash."""
        own = version("upwash")
        if self.release != own:
            raise EngineError(
                f"the image of {self.service} was made with upwash {self.release}, and this is {own}: {remedy}"
            )


def image_of(held: HeldImage) -> ServiceImage | None:
    """The service's image; None for other images, and for images of early versions, which lack labels."""
    said = {name.removeprefix(_PREFIX): value for name, value in held.labels.items()}
    concurrency = said.get("concurrency", "")
    if not said.get("service") or not concurrency.isdecimal():
        return None
    try:
        settings = _settings.decode(said.get("settings") or "{}")
        words = _words.decode(said.get("command") or "[]")
    except msgspec.MsgspecError:
        return None
    return ServiceImage(
        said["service"],
        Program(said.get("program", ""), settings, words),
        said.get("base", ""),
        said.get("python", ""),
        said.get("release", ""),
        held.id,
        frozenset(filter(None, said.get("methods", "").split(","))),
        int(concurrency),
    )


def labelled_image(held: HeldImage) -> ServiceImage | None:
    """The image of a Dockerfile, where the labels `upwash.service` and `upwash.program` suffice; None for others."""
    labels = {name: value for name, value in held.labels.items() if value}
    image = image_of(HeldImage(held.id, {f"{_PREFIX}concurrency": "1", **labels}))
    return image if image and image.program.path else None


def newest_images(images: Iterable[HeldImage]) -> Mapping[str, ServiceImage]:
    """The image of each service that was imported last, by the service's name."""
    found = filter(None, map(image_of, sorted(images, key=lambda image: image.imported_at)))
    return {image.service: image for image in found}


def packaging(service: str) -> str:
    """The command that makes the service's image and imports it into the configured engine."""
    return command("upwash", "package", service, "--config", "CONFIG", "--output", "DIR", "--import")


def slug(name: str) -> str:
    """The name in small letters, digits and hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def reference_of(service: str) -> str:
    """The name under which Docker or Podman holds the packaged image of a service."""
    return f"upwash-{slug(service)}:latest"


def container_name(service: str, server: str) -> str:
    """A new container's name, which is also a valid host name."""
    parts = (slug(name)[:_LONGEST_PART] or "x" for name in (service, server))
    return f"upwash-{'-'.join(parts)}-{secrets.token_hex(3)}"


class ContainerRuntime(ABC):
    """Starts each instance in a container; if it `freezes`, it keeps one frozen for each server and service."""

    def __init__(
        self,
        hang_up: Callable[[], Awaitable[None]],
        *,
        freezes: bool,
        lead: Lead | None,
        max_message_bytes: int,
    ) -> None:
        self._hang_up = hang_up  # on the engine
        self.concurrency: dict[str, int] = {}  # of each service's image, once it is prepared
        self._freezes = freezes
        self._lead = lead
        self._max_message_bytes = max_message_bytes
        self._frozen: dict[tuple[str, str], tuple[str, ControlledInstance]] = {}  # with their images

    async def start(
        self, spec: InstanceSpec, *, called: Callable[[str], None], answered: Answered = ignored
    ) -> ControlledInstance:
        """An instance that is ready to serve; raises InstanceError, and leaves nothing behind then."""
        image = await self._image(spec.service)
        fingerprint, frozen = self._frozen.pop((spec.server, spec.service), ("", None))
        if frozen is not None:
            if fingerprint == image.fingerprint:
                try:
                    await frozen.resume(called=called, answered=answered)
                except InstanceError as error:
                    _log.warning("%s cannot be thawed and is started anew: %s", spec.name, error)
                else:
                    return frozen
            await frozen.end()
        keep = functools.partial(self._keep, image.fingerprint) if self._freezes else None
        callbacks = InstanceCallbacks(called, answered, self._lead, keep)
        return await self._start(replace(spec, methods=image.methods), image, callbacks)

    async def close(self) -> None:
        """End the frozen instances, and hang up on the engine."""
        for _, instance in self._frozen.values():
            await instance.end()
        self._frozen.clear()
        await self._hang_up()

    def _keep(self, image: str, instance: ControlledInstance) -> None:
        self._frozen[instance.spec.server, instance.spec.service] = (image, instance)

    @abstractmethod
    async def prepare(self, services: Mapping[str, Collection[str]]) -> None:
        """End what an earlier daemon left of these servers, and check the image of each of their services.

        Raises UsageError if no engine answers, EngineError if it refuses or an image is missing or cannot run.
        """

    @abstractmethod
    async def _image(self, service: str) -> ServiceImage:
        """The service's image as the engine holds it now; raises EngineError."""

    @abstractmethod
    async def _start(
        self, spec: InstanceSpec, image: ServiceImage, callbacks: InstanceCallbacks
    ) -> ControlledInstance:
        """An instance in a container that runs from now on."""
