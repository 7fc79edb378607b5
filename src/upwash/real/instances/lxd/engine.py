"""LXD or Incus through pylxd; each request runs in a thread, with a time limit.

pylxd's models are not used: they send each request twice, and warn of unknown attributes. Several addresses are the
members of one cluster; the first that answers is used.
"""

from __future__ import annotations

import asyncio
import functools
import logging
import socket
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote

from upwash.config.runtime import EngineConfig, RuntimeConfig
from upwash.errors import EngineError, UsageError
from upwash.real.instances.containers import HeldImage
from upwash.real.trust.secrets import read_secret
from upwash.support.loading import extra

_log = logging.getLogger("upwash.lxd")

_CONNECT_S = 3.0
_ANSWER_S = 10.0
_LIST_S = 45.0
_THREADS = 8
_RETRY_S = 0.05
_BUSY = "Instance is busy running"  # it ends by itself, for example
_DONE_ALREADY = {"start": ["already running"], "stop": ["already stopped", "is not running"]}
T = TypeVar("T")

NO_CLUSTER = "none"  # the member's name on an engine without a cluster


@dataclass(frozen=True, slots=True)
class EngineInstance:
    """A container that the engine holds."""

    name: str
    status: str  # Running, Stopped, Frozen, Error
    member: str  # of the cluster, or NO_CLUSTER
    config: Mapping[str, str]
    devices: Mapping[str, Mapping[str, str]]


class Engine:
    """The configured project of one engine, or of one cluster of engines."""

    def __init__(self, config: RuntimeConfig) -> None:
        self.kind = ""  # "lxd" or "incus", once it is connected
        self._addresses = list(config.engine_addresses)
        self._config = config.engine
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="upwash-engine")
        self._clients: dict[str, Any] = {}  # the engine's interface below /1.0

    async def connect(self) -> None:
        """Return when an engine answers that trusts this program; raises UsageError with the remedy."""
        with extra("lxd"):
            import pylxd  # noqa: F401 - for a clear error if it is missing
        if self._config.key:
            read_secret(self._config.key)  # pylxd would take one that others can read
        try:
            info = await self._ask(lambda api: api.get().json()["metadata"])
        except EngineError as error:
            raise UsageError(str(error)) from error
        if info["auth"] != "trusted":
            raise UsageError(
                f"the engine at {self._addresses[0]} does not trust this program's certificate: "
                "add it there, as with `lxc config trust add`"
            )
        environment = info["environment"]
        self.kind = environment["server"]
        _log.info("%s %s answers", environment["server"], environment["server_version"])

    async def images(self) -> list[HeldImage]:
        """All images of the project."""
        found = await self._ask(lambda api: api.images.get(params={"recursion": 1}).json()["metadata"])
        return [HeldImage(image["fingerprint"], image["properties"], image["uploaded_at"]) for image in found]

    async def import_image(self, file: Path) -> None:
        """Import an image file, unless the engine holds that image."""

        def post(api: Any) -> Any:
            with file.open("rb") as content:
                return api.images.post(data=content, headers={"X-LXD-public": "false"}).json()

        await self._work(post, wait_s=120.0, done_already=("already exists",))

    async def instances(self) -> list[EngineInstance]:
        """All containers of the project; of containers on a lost member little more than the names."""

        def get(api: Any) -> Any:
            # A cluster asks each member that it believes to be online, and waits for lost members.
            return api.instances.get(params={"recursion": 1}, timeout=(_CONNECT_S, _LIST_S)).json()

        return [
            EngineInstance(
                found["name"],
                found["status"],
                found["location"],
                found.get("config") or {},
                found.get("expanded_devices") or {},
            )
            for found in (await self._ask(get))["metadata"]
        ]

    async def members(self) -> list[str]:
        """The members of the cluster that are online; NO_CLUSTER alone without a cluster."""

        def get(api: Any) -> Any:
            if not api.cluster.get().json()["metadata"]["enabled"]:
                return [{"server_name": NO_CLUSTER, "status": "Online"}]
            return api.cluster.members.get(params={"recursion": 1}).json()["metadata"]

        found = await self._ask(get)
        return sorted(member["server_name"] for member in found if member["status"] == "Online")

    async def create(self, definition: Mapping[str, object], *, member: str, wait_s: float) -> None:
        """Create a container on that member."""
        params = {} if member == NO_CLUSTER else {"target": member}
        await self._work(lambda api: api.instances.post(json=definition, params=params).json(), wait_s=wait_s)

    async def change(self, name: str, action: str, *, wait_s: float) -> None:
        """Start, stop (at once), freeze or unfreeze a container, unless it is in that state already."""
        state = {"action": action, "force": True, "timeout": int(wait_s)}
        await self._work(
            lambda api: api.instances[name].state.put(json=state).json(),
            wait_s=wait_s,
            done_already=_DONE_ALREADY.get(action, ()),
        )

    async def delete(self, name: str) -> None:
        """Delete a stopped container."""

        def delete(api: Any) -> Any:
            # pylxd's own delete does not return the operation to wait for.
            address = api.instances[name]._api_endpoint
            return api.session.delete(
                address, params={"project": self._config.project}, timeout=_ANSWER_S
            ).json()

        await self._work(delete, wait_s=30.0)

    async def close(self) -> None:
        """Hang up, without waiting for replies."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for api in self._clients.values():
            api.session.close()

    async def _work(
        self, begin: Callable[[Any], Any], *, wait_s: float, done_already: Sequence[str] = ()
    ) -> None:
        """Have the engine run an operation, as soon as the container is not busy.

        Raises EngineError if the operation fails or takes too long.
        """
        loop = asyncio.get_running_loop()
        give_up_s = loop.time() + wait_s
        while problem := await self._attempt(begin, wait_s):
            if any(words in problem for words in done_already):
                return
            if _BUSY not in problem or loop.time() > give_up_s:
                raise EngineError(problem)
            await asyncio.sleep(_RETRY_S)

    async def _attempt(self, begin: Callable[[Any], Any], wait_s: float) -> str:
        """Why the operation failed; empty if it succeeded."""

        def run(api: Any) -> Any:
            answer = begin(api)
            if not answer.get("operation"):
                return answer
            operation = answer["operation"].partition("?")[0].rpartition("/")[2]
            waited = api.operations[operation].wait.get(
                params={"timeout": int(wait_s)}, timeout=(_CONNECT_S, wait_s + _ANSWER_S)
            )
            return waited.json()["metadata"]

        try:
            result = await self._ask(run)
        except EngineError as error:
            return str(error)
        if result.get("status") == "Running":
            return f"{result['description']}: not done within {wait_s:.0f} s"
        return str(result.get("err") or result.get("error") or "")

    async def _ask(self, ask: Callable[[Any], T]) -> T:
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._threads, functools.partial(self._ask_any, ask))

    def _ask_any(self, ask: Callable[[Any], T]) -> T:
        from pylxd.exceptions import ClientConnectionFailed, LXDAPIException
        from requests import RequestException

        problem: EngineError | None = None
        for address in list(self._addresses):
            try:
                if address not in self._clients:
                    self._clients[address] = _client(address, self._config).api
                answer = ask(self._clients[address])
            except LXDAPIException as error:
                raise EngineError(str(error)) from error
            except (ClientConnectionFailed, RequestException, OSError) as error:
                unreachable = _unreachable(address, error)
                _log.warning("%s", unreachable)
                problem = problem or unreachable
                continue
            self._addresses = sorted(self._addresses, key=lambda known: known != address)
            return answer
        assert problem is not None  # noqa: S101 - there is at least one address
        raise problem


def _client(address: str, config: EngineConfig) -> Any:
    import pylxd
    from pylxd.client import get_session_for_url

    if address.startswith("unix:"):
        path = address.removeprefix("unix:")
        with socket.socket(socket.AF_UNIX) as probe:  # its errors are plainer than pylxd's
            probe.connect(path)
        url = f"http+unix://{quote(path, safe='')}"
        session = get_session_for_url(url)
    else:
        url, own = address, (str(config.certificate), str(config.key))
        session = get_session_for_url(url, verify=str(config.engine_certificate), cert=own)
    session.trust_env = False  # or environment variables could replace the engine's certificate
    return pylxd.Client(
        endpoint=url, session=session, timeout=(_CONNECT_S, _ANSWER_S), project=config.project
    )


def _unreachable(address: str, error: Exception) -> EngineError:
    where = address.removeprefix("unix:")
    match error:
        case FileNotFoundError():
            return EngineError(
                f"{where}: no such socket: install LXD (`apt install lxd`, then `lxd init`) or Incus, "
                "or name its socket in runtime.engine.addresses"
            )
        case PermissionError():
            return EngineError(
                f"{where}: this user may not use the container engine: let it into the socket's group, "
                "such as `adduser USER lxd` (incus-admin for Incus), and begin a new session"
            )
        case _:
            return EngineError(f"{where}: the container engine does not answer ({error}): is it running?")
