"""Docker or Podman through Docker's own client library; each request runs in a thread, with a time limit."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

from upwash.errors import EngineError, UsageError
from upwash.real.instances.containers import HeldImage
from upwash.support.loading import extra

_log = logging.getLogger("upwash.docker")

_ANSWER_S = 15.0
_PULL_S = 600.0
_REMOVALS = 3
_AGAIN_S = 0.3
_THREADS = 8
_LAST_WORDS = 20  # lines
_KEYS_OF_LIMITS = {"memory_bytes": "MemoryLimit", "processes": "PidsLimit", "cpus": "CpuCfsQuota"}
T = TypeVar("T")

REMEDY = (
    "is it running (`systemctl start docker`, `systemctl start podman.socket`), and may this user use it?"
)


class DockerEngine:
    """One engine of this machine, at the path of its socket."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="upwash-engine")
        self._client: Any = None

    async def connect(self) -> None:
        """Return when the engine answers; raises UsageError with the remedy."""
        version = await self._ask_first(lambda api: api.version())
        names = [component["Name"] for component in version.get("Components") or ()]
        _log.info("%s %s answers", names[0] if names else "Docker", version["Version"])

    async def unenforced_limits(self) -> dict[str, str]:
        """Why limits of these names cannot hold for containers; raises UsageError with the remedy."""
        info = await self._ask_first(lambda api: api.info())
        why = (
            f"the engine at {self.address} has no control group for it: give this machine or user the controllers "
            "cpu, memory and pids"
        )
        return {name: why for name, key in _KEYS_OF_LIMITS.items() if info.get(key) is False}

    async def image(self, reference: str) -> HeldImage | None:
        """The image of that name, if the engine holds it."""
        from docker.errors import ImageNotFound

        def inspect(api: Any) -> HeldImage | None:
            try:
                found = api.inspect_image(reference)
            except ImageNotFound:
                return None
            return HeldImage(found["Id"], (found.get("Config") or {}).get("Labels") or {})

        return await self.ask(inspect)

    async def pull(self, reference: str) -> str:
        """Fetch an image from its registry; returns the engine's error, or "fetched"."""

        def pull(api: Any) -> list[dict[str, Any]]:
            return list(api.pull(reference, stream=True, decode=True))

        try:
            steps = await self.ask(pull, wait_s=_PULL_S)
        except EngineError as error:
            return str(error)
        return next((str(step["error"]) for step in steps if "error" in step), "fetched")

    async def import_image(self, file: Path) -> None:
        """Import an image file."""

        def load(api: Any) -> None:
            with file.open("rb") as content:
                for _ in api.load_image(content, quiet=True):
                    pass

        await self.ask(load, wait_s=_PULL_S)

    async def containers(self, label: str) -> dict[str, str]:
        """The value of that label by the id of each container that has it, running or not."""
        found = await self.ask(lambda api: api.containers(all=True, filters={"label": label}))
        return {container["Id"]: container["Labels"][label] for container in found}

    async def create(self, definition: Mapping[str, object]) -> str:
        """Make a container; returns its id."""

        def create(api: Any) -> str:
            rest = {name: value for name, value in definition.items() if name != "host_config"}
            confinement = api.create_host_config(**definition["host_config"])  # type: ignore[arg-type]
            return str(api.create_container(**rest, host_config=confinement)["Id"])

        return await self.ask(create)

    async def wait(self, container: str, *, wait_s: float) -> int:
        """The container's exit code once it has ended."""
        return int((await self.ask(lambda api: api.wait(container, timeout=wait_s)))["StatusCode"])

    async def output(self, container: str) -> tuple[str, str]:
        """The last lines of the container's output and of its errors."""

        def logs(api: Any, **stream: bool) -> str:
            return str(api.logs(container, tail=_LAST_WORDS, **stream).decode(errors="replace"))

        return (
            await self.ask(functools.partial(logs, stdout=True, stderr=False)),
            await self.ask(functools.partial(logs, stdout=False, stderr=True)),
        )

    async def remove(self, container: str) -> None:
        """Delete a container if it exists, running or not."""
        from docker.errors import NotFound

        def remove(api: Any) -> None:
            with contextlib.suppress(NotFound):
                api.remove_container(container, force=True, v=True)

        for _ in range(_REMOVALS - 1):
            with contextlib.suppress(EngineError):  # of a container that ends by itself meanwhile
                return await self.ask(remove)
            await asyncio.sleep(_AGAIN_S)
        return await self.ask(remove)

    async def close(self) -> None:
        """Hang up, without waiting for replies."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        if self._client is not None:
            self._client.close()

    async def ask(self, work: Callable[[Any], T], *, wait_s: float = _ANSWER_S) -> T:
        """What `work` returns, given the client library's interface to the engine; raises EngineError."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._threads, self._ask_now, work, wait_s)

    async def _ask_first(self, work: Callable[[Any], T]) -> T:
        with extra("docker"):
            import docker  # noqa: F401 - for a clear error if it is missing
        try:
            return await self.ask(work)
        except EngineError as error:
            raise UsageError(f"{error}: {REMEDY}") from error

    def _ask_now(self, work: Callable[[Any], T], wait_s: float) -> T:
        import docker
        from docker.errors import APIError, DockerException
        from requests import RequestException

        if not Path(self.address.removeprefix("unix:")).exists():
            raise EngineError(f"no engine answers at {self.address}")
        try:
            if self._client is None:
                self._client = docker.APIClient(self.address, version="auto", timeout=_ANSWER_S)
            if wait_s == _ANSWER_S:
                return work(self._client)
            with contextlib.closing(
                docker.APIClient(self.address, version="auto", timeout=wait_s)
            ) as patient:
                return work(patient)
        except APIError as error:
            raise EngineError(f"the engine at {self.address}: {error.explanation or error}") from error
        except (DockerException, RequestException, OSError) as error:
            raise EngineError(f"no engine answers at {self.address}") from error


def last_line(*texts: str) -> str:
    """The last line of a program's output that is not blank."""
    lines = [line for text in texts for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else "it printed nothing"
