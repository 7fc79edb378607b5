"""The container engine, LXD or Incus, through pylxd: what is asked of it, each with a bounded wait.

pylxd blocks, so each request runs in a thread. Its models are left aside: they ask twice for everything and warn of
what they do not know. Several addresses are those of one cluster's members; the first that answers is used.
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

from upwash.errors import EngineError, UsageError
from upwash.real.trust.secrets import read_secret
from upwash.support.loading import extra

_log = logging.getLogger("upwash.lxd")

_CONNECT_S = 3.0
_ANSWER_S = 10.0
_LIST_S = 45.0
_THREADS = 8
_RETRY_S = 0.05
_BUSY = "Instance is busy running"  # it ends by itself, for instance
_DONE_ALREADY = {"start": ["already running"], "stop": ["already stopped", "is not running"]}
T = TypeVar("T")

THE_ONLY_ONE = "none"  # what an engine calls the place of a container where there is no cluster


@dataclass(frozen=True, slots=True)
class EngineAddress:
    """Where the engine is: the path of its socket, or an HTTPS address with what is shown and believed there."""

    url: str
    certificate: Path | None = None
    key: Path | None = None
    engine_certificate: Path | None = None


@dataclass(frozen=True, slots=True)
class EngineImage:
    """An image that the engine holds."""

    fingerprint: str
    properties: Mapping[str, str]
    uploaded_at: str


@dataclass(frozen=True, slots=True)
class EngineInstance:
    """A container that the engine holds."""

    name: str
    status: str  # Running, Stopped, Frozen, Error
    member: str  # of the cluster, or THE_ONLY_ONE
    config: Mapping[str, str]
    devices: Mapping[str, Mapping[str, str]]


class Engine:
    """One project of one engine, or of one cluster of engines."""

    def __init__(self, addresses: Sequence[EngineAddress], *, project: str) -> None:
        self.kind = ""  # "lxd" or "incus", once it is connected
        self._addresses = list(addresses)
        self._project = project
        self._threads = ThreadPoolExecutor(_THREADS, thread_name_prefix="upwash-engine")
        self._clients: dict[EngineAddress, Any] = {}

    async def connect(self) -> None:
        """Returns when an engine answers that trusts this program; raises UsageError with the remedy."""
        with extra("lxd"):
            import pylxd  # noqa: F401 - asked here once, for a clear answer
        for address in self._addresses:
            if address.key:
                read_secret(address.key)  # pylxd would take one that others can read
        try:
            info = await self._ask(lambda api: api.get().json()["metadata"])
        except EngineError as error:
            raise UsageError(str(error)) from error
        if info["auth"] != "trusted":
            raise UsageError(
                f"the engine at {self._addresses[0].url} does not trust this program's certificate: "
                "add it there, as with `lxc config trust add`"
            )
        environment = info["environment"]
        self.kind = environment["server"]
        _log.info("%s %s answers", environment["server"], environment["server_version"])

    async def images(self) -> list[EngineImage]:
        """All images of the project."""
        found = await self._ask(lambda api: api.images.get(params={"recursion": 1}).json()["metadata"])
        return [EngineImage(each["fingerprint"], each["properties"], each["uploaded_at"]) for each in found]

    async def import_image(self, file: Path) -> None:
        """Takes in an image file; one that is there already is left as it is."""

        def post(api: Any) -> Any:
            with file.open("rb") as content:
                return api.images.post(data=content, headers={"X-LXD-public": "false"}).json()

        await self._work(post, wait_s=120.0, done_already=("already exists",))

    async def instances(self) -> list[EngineInstance]:
        """All containers of the project; of those on a lost member little more than the names."""

        def ask(api: Any) -> Any:
            # A cluster asks every member that it takes for online, and waits for those that are lost.
            return api.instances.get(params={"recursion": 1}, timeout=(_CONNECT_S, _LIST_S)).json()[
                "metadata"
            ]

        return [
            EngineInstance(
                each["name"],
                each["status"],
                each["location"],
                each.get("config") or {},
                each.get("expanded_devices") or {},
            )
            for each in await self._ask(ask)
        ]

    async def members(self) -> list[str]:
        """The members of the cluster that are online; without a cluster there is one."""

        def ask(api: Any) -> Any:
            if not api.cluster.get().json()["metadata"]["enabled"]:
                return [{"server_name": THE_ONLY_ONE, "status": "Online"}]
            return api.cluster.members.get(params={"recursion": 1}).json()["metadata"]

        return sorted(each["server_name"] for each in await self._ask(ask) if each["status"] == "Online")

    async def create(self, definition: Mapping[str, object], *, member: str, wait_s: float) -> None:
        """Creates a container on that member."""
        params = {} if member == THE_ONLY_ONE else {"target": member}
        await self._work(lambda api: api.instances.post(json=definition, params=params).json(), wait_s=wait_s)

    async def change(self, name: str, action: str, *, wait_s: float) -> None:
        """Has a container start, stop (at once), freeze or unfreeze; one that runs or is stopped already is well."""
        state = {"action": action, "force": True, "timeout": int(wait_s)}
        await self._work(
            lambda api: api.instances[name].state.put(json=state).json(),
            wait_s=wait_s,
            done_already=_DONE_ALREADY.get(action, ()),
        )

    async def delete(self, name: str, *, wait_s: float = 30.0) -> None:
        """Deletes a container that is stopped."""

        def delete(api: Any) -> Any:
            # pylxd returns nothing from a delete, so its session is asked for the operation to wait for.
            address = api.instances[name]._api_endpoint
            return api.session.delete(address, params={"project": self._project}, timeout=_ANSWER_S).json()

        await self._work(delete, wait_s=wait_s)

    async def close(self) -> None:
        """Waits for no more answers."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for api in self._clients.values():
            api.session.close()

    async def _work(
        self, begin: Callable[[Any], Any], *, wait_s: float, done_already: Sequence[str] = ()
    ) -> None:
        """Has the engine do something that takes time, once a container is through with what it does.

        Raises EngineError where it fails or takes too long.
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
        """Why it was not done; empty when it was."""

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
        """Asks the first address that answers at all, and that one first from then on. Runs in a thread."""
        from pylxd.exceptions import ClientConnectionFailed, LXDAPIException
        from requests import RequestException

        problem: EngineError | None = None
        for address in list(self._addresses):
            try:
                answer = ask(self._api(address))
            except LXDAPIException as error:
                raise EngineError(str(error)) from error
            except (ClientConnectionFailed, RequestException, OSError) as error:
                unreachable = _unreachable(address, error)
                _log.warning("%s", unreachable)
                problem = problem or unreachable
                continue
            if address != self._addresses[0]:
                self._addresses = [address, *(each for each in self._addresses if each != address)]
            return answer
        assert problem is not None  # noqa: S101 - there is at least one address
        raise problem

    def _api(self, address: EngineAddress) -> Any:
        """The engine's interface below /1.0 at the address."""
        if address not in self._clients:
            self._clients[address] = _client(address, self._project).api
        return self._clients[address]


def _client(address: EngineAddress, project: str) -> Any:
    import pylxd
    from pylxd.client import get_session_for_url

    if address.url.startswith("unix:"):
        path = address.url.removeprefix("unix:")
        with socket.socket(socket.AF_UNIX) as probe:  # which says more plainly than pylxd what is wrong
            probe.connect(path)
        url = f"http+unix://{quote(path, safe='')}"
        session = get_session_for_url(url)
    else:
        url = address.url
        session = get_session_for_url(
            url, verify=str(address.engine_certificate), cert=(str(address.certificate), str(address.key))
        )
    session.trust_env = False  # variables meant for others would replace the certificate that is believed
    return pylxd.Client(endpoint=url, session=session, timeout=(_CONNECT_S, _ANSWER_S), project=project)


def _unreachable(address: EngineAddress, error: Exception) -> EngineError:
    where = address.url.removeprefix("unix:")
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
