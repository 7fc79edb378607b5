"""What containers have in common, whichever engine holds them: their names, and instances that are kept frozen."""

from __future__ import annotations

import logging
import re
import secrets
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from upwash.errors import InstanceError
from upwash.ports import Answered, InstanceSpec

_LONGEST_PART = 16  # characters


def slug(name: str) -> str:
    """The name in small letters, digits and hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def container_name(service: str, server: str) -> str:
    """A name for a new container, as it may stand in a host's name."""
    parts = (slug(name)[:_LONGEST_PART] or "x" for name in (service, server))
    return f"upwash-{'-'.join(parts)}-{secrets.token_hex(3)}"


class FreezableInstance(Protocol):
    """An instance that can be frozen; `image` is the id of that of which its container is made."""

    @property
    def image(self) -> str:
        """The id of its image."""

    async def resume(self, *, called: Callable[[str], None], answered: Answered) -> None:
        """Has it serve again; raises InstanceError."""

    async def end(self) -> None:
        """Stops it, frozen or not."""


I = TypeVar("I", bound=FreezableInstance)  # noqa: E741


class FrozenInstances(Generic[I]):
    """Instances that are frozen instead of stopped: at most one of each service on each server."""

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._kept: dict[tuple[str, str], I] = {}

    def keep(self, server: str, service: str, instance: I) -> None:
        """Takes an instance that was frozen."""
        self._kept[server, service] = instance

    async def thawed(
        self, spec: InstanceSpec, image: str, *, called: Callable[[str], None], answered: Answered
    ) -> I | None:
        """The frozen instance, serving again; None where there is none of that image that can. Others end."""
        frozen = self._kept.pop((spec.server, spec.service), None)
        if frozen is None:
            return None
        if frozen.image == image:
            try:
                await frozen.resume(called=called, answered=answered)
            except InstanceError as error:
                self._log.warning("%s cannot be thawed and is started anew: %s", spec.name, error)
            else:
                return frozen
        await frozen.end()
        return None

    async def close(self) -> None:
        """Ends them all."""
        for instance in self._kept.values():
            await instance.end()
        self._kept.clear()
