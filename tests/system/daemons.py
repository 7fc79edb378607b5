"""Edge daemons as processes, and drones that visit them, for tests."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import grpc
import msgspec
import tomli_w
from tests.children import children, is_alive
from tests.waiting import wait_for

from upwash.real.link.link import GrpcDialer, GrpcLink
from upwash.real.trust.authority import keys_in
from upwash.real.trust.credentials import Credentials, read_credentials
from upwash.rpc.protocol import (
    AVAILABILITY,
    LEAVE,
    START,
    AvailabilityReply,
    AvailabilityRequest,
    LeaveReply,
    LeaveRequest,
    StartReply,
    StartRequest,
    decode_reply,
    resolve,
    service_path,
)
from upwash.rpc.service import load_service, spec_of

T = TypeVar("T")
MAX_MESSAGE_BYTES = 1_000_000

ROOT = Path(__file__).parents[2]
SERVICES = [
    {"name": cls.lower(), "program": f"services_for_tests:{cls}"}
    for cls in ("Workbench", "Unstartable", "SlowToStart")
]
SERVERS = [{"name": "s1", "slots": 1}, {"name": "s2", "slots": 1}]


def shown(keys: Path, holder: str) -> Credentials:
    """What the holder of a certificate in the folder shows."""
    files = keys_in(keys, holder)
    return read_credentials(files.authority, files.certificate, files.key)


def channel(address: str, shows: Credentials, server: str = "s1") -> grpc.Channel:
    """A connection of its own to the server at the address."""
    secret = grpc.ssl_channel_credentials(shows.authority, shows.key or None, shows.certificate or None)
    options = [
        ("grpc.ssl_target_name_override", server),
        ("grpc.use_local_subchannel_pool", 1),
        ("grpc.enable_http_proxy", 0),
    ]
    return grpc.secure_channel(address, secret, options)


def config(keys: Path | None, /, **tables: Any) -> str:
    """A daemon that is s1 and s2; without a folder of keys it lets anyone of this machine in.

    A table changes or adds to what there is; a key of None is left out.
    """
    document: dict[str, Any] = {
        "listen": "127.0.0.1:0",
        "runtime": {"sandbox": "off", "sandbox_as_root": True},
        "service": SERVICES,
        "server": SERVERS,
    }
    if keys is None:
        document["allow_without_certificates"] = True
    else:
        document["keys"] = {"authority": f"{keys}/authority.pem"}
        document["keys"] |= {"certificate": f"{keys}/s1.pem", "key": f"{keys}/s1.key"}
    for name, table in tables.items():
        if isinstance(table, dict):
            changed = {**document.get(name, {}), **table}
            document[name] = {key: value for key, value in changed.items() if value is not None}
        else:
            document[name] = table
    return tomli_w.dumps(document)


def started(folder: Path, text: str, *options: str, path: str = os.environ["PATH"]) -> subprocess.Popen[str]:
    (folder / "server.toml").write_text(text)
    environment = {
        **os.environ,
        "PATH": path,
        # Where services_for_tests lies, and this checkout's own upwash.
        "PYTHONPATH": os.pathsep.join(str(ROOT / each) for each in ("tests", "src")),
        "PROCESS_ID_FILE": str(folder / "process_id"),
    }
    command = [sys.executable, "-m", "upwash", "serve", "--config", str(folder / "server.toml"), *options]
    with (folder / "stderr").open("w") as stderr:
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, env=environment, text=True)


class Daemon:
    """A daemon's process that is ready at its address."""

    def __init__(self, process: subprocess.Popen[str], names: str, folder: Path) -> None:
        assert process.stdout is not None
        self.process = process
        self._folder = folder
        said, _, self.address = process.stdout.readline().strip().partition(" ready at ")
        assert said == names, self.said()

    @property
    def port(self) -> int:
        return int(self.address.rpartition(":")[2])

    def instances(self) -> list[int]:
        return children(self.process.pid)

    def said(self) -> str:
        """Its log."""
        return (self._folder / "stderr").read_text()

    def has_said(self, pattern: str, *, since: int = 0) -> None:
        """Returns when that is in its log, after the first so many characters."""
        wait_for(lambda: re.search(pattern, self.said()[since:]), seen=self.said)

    def successors(self) -> list[int]:
        """The processes that have taken its place."""
        return [int(each) for each in re.findall(r"process (\d+) has taken this daemon's place", self.said())]

    def reload(self, text: str, awaited: str) -> None:
        """Has it read another configuration, or the same; returns when it has said that of it."""
        (self._folder / "server.toml").write_text(text)
        known = len(self.said())
        self.process.send_signal(signal.SIGHUP)
        self.has_said(awaited, since=known)

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        self.process.send_signal(number)
        return self.process.wait(timeout=10.0)


@contextmanager
def daemon(
    folder: Path, text: str, *options: str, names: str = "s1, s2", **settings: str
) -> Iterator[Daemon]:
    """A daemon until the end of the block, by which it, its successors and all instances must have ended."""
    with started(folder, text, *options, **settings) as process, ExitStack() as stack:
        try:
            running = Daemon(process, names, folder)
            stack.callback(lambda: _signal(running.successors(), signal.SIGKILL))
            yield running
            successors = running.successors()
            instances = [each for parent in (process.pid, *successors) for each in children(parent)]
            _signal(successors, signal.SIGTERM)
            wait_for(lambda: not any(map(is_alive, successors)), seen=running.said)
            if process.poll() is None:
                assert running.end() == 0
            assert not re.search("^Traceback", running.said(), re.MULTILINE)
            wait_for(lambda: not any(map(is_alive, instances)))
        finally:
            process.kill()


def _signal(process_ids: Iterable[int], number: signal.Signals) -> None:
    """Sends it to those that have not ended."""
    for each in process_ids:
        with suppress(ProcessLookupError):
            os.kill(each, number)


def memory_bytes(process_id: int, what: str = "VmRSS") -> int:
    """What of its memory is resident, or was at most (VmHWM)."""
    status = Path(f"/proc/{process_id}/status").read_text()
    return next(int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith(f"{what}:"))


class Guest:
    """A drone's links to one server of a daemon, and to the instances that it was told of."""

    def __init__(self, dialer: GrpcDialer, server: str, address: str, program: str) -> None:
        self._dialer = dialer
        self._server = server
        self._address = address
        self._service = spec_of(load_service(program))
        self.daemon = dialer.dial(address, server=server)
        self.instances: dict[str, GrpcLink] = {}

    async def availability(self, *services: str) -> AvailabilityReply:
        return await self._tell(
            AVAILABILITY, AvailabilityRequest(self._server, list(services)), AvailabilityReply
        )

    async def start(self, service: str = "workbench") -> StartReply:
        return await self._tell(START, StartRequest(self._server, service), StartReply)

    async def leave(self) -> LeaveReply:
        return await self._tell(LEAVE, LeaveRequest(self._server), LeaveReply)

    async def call(self, endpoint: str, name: str, *arguments: object) -> Any:
        """A call of the service that listens at the endpoint."""
        if endpoint not in self.instances:
            address = resolve(endpoint, self._address)
            self.instances[endpoint] = self._dialer.dial(address, server=self._server)
        method = self._service.methods[name]
        _, request = method.encode(arguments, {})
        path = service_path(self._service.name, name)
        reply = await self.instances[endpoint].request(path, request, timeout_s=10.0)
        return method.result(method.decode(reply))

    async def close(self) -> None:
        for link in (self.daemon, *self.instances.values()):
            await link.close()

    async def _tell(self, path: str, message: msgspec.Struct, reply: type[T]) -> T:
        answer = await self.daemon.request(path, msgspec.msgpack.encode(message), timeout_s=10.0)
        return decode_reply(answer, reply, sender=self._server)


@asynccontextmanager
async def guests(
    at: Daemon, services: Path | str, *who: tuple[str, Credentials | None, str]
) -> AsyncIterator[list[Guest]]:
    """Drones, each by its name, what it shows, and its server; they call the workbench or another program."""
    program = services if isinstance(services, str) else f"{services}:Workbench"
    async with AsyncExitStack() as stack:
        each = []
        for name, shown, server in who:
            dialer = GrpcDialer(name, shown, max_message_bytes=MAX_MESSAGE_BYTES)
            guest = Guest(dialer, server, at.address, program)
            stack.push_async_callback(guest.close)
            each.append(guest)
        yield each


async def eventually(ask: Callable[[], Awaitable[T]], true: Callable[[T], object]) -> None:
    """Asks again and again, until what is true of the answer should be; fails if that takes very long."""
    async with asyncio.timeout(60.0):  # a busy machine starts an instance in many seconds
        while True:
            if true(await ask()):
                return
            await asyncio.sleep(0.05)
