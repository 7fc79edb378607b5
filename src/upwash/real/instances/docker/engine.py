"""The container engine, Docker or Podman, through Docker's own client library, which speaks to both.

The library blocks, so each request runs in a thread, with a bounded wait.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from upwash.errors import EngineError, UsageError
from upwash.support.loading import extra

_log = logging.getLogger("upwash.docker")

_ANSWER_S = 15.0
_PULL_S = 600.0
_REMOVALS = 3
_AGAIN_S = 0.3
_THREADS = 8
_LAST_WORDS = 20  # lines
_SAYS_OF_LIMITS = {"memory_bytes": "MemoryLimit", "processes": "PidsLimit", "cpus": "CpuCfsQuota"}
T = TypeVar("T")

REMEDY = (
    "is it running (`systemctl start docker`, `systemctl start podman.socket`), and may this user use it?"
)


@dataclass(frozen=True, slots=True)
class HeldImage:
    """An image that the engine holds."""

    id: str
    labels: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class HeldContainer:
    """A container that the engine holds."""

    id: str
    labels: Mapping[str, str]


class DockerEngine:
    """One engine of this machine, at the path of its socket."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="upwash-engine")
        self._client: Any = None

    async def connect(self) -> None:
        """Returns when the engine answers; raises UsageError with the remedy."""
        version = await self._ask_first(lambda api: api.version())
        names = [each["Name"] for each in version.get("Components") or ()]
        _log.info("%s %s answers", names[0] if names else "Docker", version["Version"])

    async def unenforced_limits(self) -> dict[str, str]:
        """Why limits of these names cannot hold for its containers; raises UsageError with the remedy."""
        info = await self._ask_first(lambda api: api.info())
        why = (
            f"the engine at {self.address} has no control group for it: give this machine or user the controllers "
            "cpu, memory and pids"
        )
        return {name: why for name, says in _SAYS_OF_LIMITS.items() if info.get(says) is False}

    async def image(self, reference: str) -> HeldImage | None:
        """The image of that name, if the engine holds it."""
        from docker.errors import ImageNotFound

        def ask(api: Any) -> HeldImage | None:
            try:
                found = api.inspect_image(reference)
            except ImageNotFound:
                return None
            return HeldImage(found["Id"], (found.get("Config") or {}).get("Labels") or {})

        return await self._ask(ask)

    async def pull(self, reference: str) -> str:
        """Fetches an image from its registry, if it can; returns the last that the engine said of it."""

        def ask(api: Any) -> list[dict[str, Any]]:
            return list(api.pull(reference, stream=True, decode=True))

        try:
            said = await self._ask(ask, wait_s=_PULL_S)
        except EngineError as error:
            return str(error)
        return next((str(each["error"]) for each in said if "error" in each), "fetched")

    async def import_image(self, file: Path) -> None:
        """Takes in an image file."""

        def post(api: Any) -> None:
            with file.open("rb") as content:
                for _ in api.load_image(content, quiet=True):
                    pass

        await self._ask(post, wait_s=_PULL_S)

    async def containers(self, label: str) -> list[HeldContainer]:
        """All containers with that label, running or not."""
        found = await self._ask(lambda api: api.containers(all=True, filters={"label": label}))
        return [HeldContainer(each["Id"], each.get("Labels") or {}) for each in found]

    async def create(self, definition: Mapping[str, object]) -> str:
        """Makes a container, and returns its id."""

        def create(api: Any) -> str:
            rest = {name: value for name, value in definition.items() if name != "host_config"}
            confinement = api.create_host_config(**definition["host_config"])  # type: ignore[arg-type]
            return str(api.create_container(**rest, host_config=confinement)["Id"])

        return await self._ask(create)

    async def start(self, container: str) -> None:
        """Starts a container."""
        await self._ask(lambda api: api.start(container))

    async def signal(self, container: str, name: str) -> None:
        """Sends its process 1 the signal of that name."""
        await self._ask(lambda api: api.kill(container, name))

    async def pause(self, container: str) -> None:
        """Freezes all its processes."""
        await self._ask(lambda api: api.pause(container))

    async def unpause(self, container: str) -> None:
        """Lets them go on."""
        await self._ask(lambda api: api.unpause(container))

    async def is_running(self, container: str) -> bool:
        """Whether it runs."""
        return bool((await self._ask(lambda api: api.inspect_container(container)))["State"].get("Running"))

    async def wait(self, container: str, *, wait_s: float) -> int:
        """Its exit code, once it has ended."""
        return int((await self._ask(lambda api: api.wait(container, timeout=wait_s)))["StatusCode"])

    async def said(self, container: str) -> tuple[str, str]:
        """The last lines of what it printed to its output and to its errors."""

        def ask(api: Any, **stream: bool) -> str:
            return str(api.logs(container, tail=_LAST_WORDS, **stream).decode(errors="replace"))

        return (
            await self._ask(functools.partial(ask, stdout=True, stderr=False)),
            await self._ask(functools.partial(ask, stdout=False, stderr=True)),
        )

    async def remove(self, container: str) -> None:
        """Kills it, if it runs, and deletes it; one that is gone is well."""
        from docker.errors import NotFound

        def remove(api: Any) -> None:
            with contextlib.suppress(NotFound):
                api.remove_container(container, force=True, v=True)

        for _ in range(_REMOVALS - 1):
            try:
                await self._ask(remove)
            except EngineError:  # of one that ends by itself meanwhile
                await asyncio.sleep(_AGAIN_S)
            else:
                return
        await self._ask(remove)

    async def close(self) -> None:
        """Waits for no more answers."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        if self._client is not None:
            self._client.close()

    async def _ask_first(self, ask: Callable[[Any], T]) -> T:
        with extra("docker"):
            import docker  # noqa: F401 - for a clear answer where it is missing
        try:
            return await self._ask(ask)
        except EngineError as error:
            raise UsageError(f"{error}: {REMEDY}") from error

    async def _ask(self, ask: Callable[[Any], T], *, wait_s: float = _ANSWER_S) -> T:
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._threads, functools.partial(self._ask_now, ask, wait_s))

    def _ask_now(self, ask: Callable[[Any], T], wait_s: float) -> T:
        """Runs in a thread; raises EngineError."""
        import docker
        from docker.errors import APIError, DockerException
        from requests import RequestException

        if not Path(self.address.removeprefix("unix:")).exists():
            raise EngineError(f"no engine answers at {self.address}")
        try:
            if self._client is None:
                self._client = docker.APIClient(self.address, version="auto", timeout=_ANSWER_S)
            if wait_s == _ANSWER_S:
                return ask(self._client)
            patient = docker.APIClient(self.address, version="auto", timeout=wait_s)
            try:
                return ask(patient)
            finally:
                patient.close()
        except APIError as error:
            raise EngineError(f"the engine at {self.address}: {error.explanation or error}") from error
        except (DockerException, RequestException, OSError) as error:
            raise EngineError(f"no engine answers at {self.address}") from error


def last_line(*texts: str) -> str:
    """The last words of a program that said something."""
    lines: Sequence[str] = [line for text in texts for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else "it said nothing"
