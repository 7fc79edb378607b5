"""What a service in a sandbox cannot do: whatever it tries, its neighbours and the machine are as before."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from tests.children import expect_no_child

from upwash.errors import InstanceError, Unreachable, UsageError
from upwash.ports import InstanceSpec, Program
from upwash.protocol import service_path
from upwash.real.link import GrpcDialer
from upwash.real.runtime import ProcessInstance, ProcessRuntime
from upwash.real.sandbox import Limits, Sandbox, code_of, files_in, find_sandbox
from upwash.service import load_service, spec_of

PROGRAM = f"{Path(__file__).parents[1] / 'mischief.py'}:Mischief"
SPEC = InstanceSpec("s1", "mischief", Program(PROGRAM))
LIMITS = Limits(memory_bytes=2**28, processes=48, disk_bytes=2**22)
MAX_MESSAGE_BYTES = 2**20

Call = Callable[..., Awaitable[Any]]


@pytest.fixture(scope="module")
def sandbox() -> Sandbox:
    try:
        return find_sandbox(LIMITS, readable=())
    except UsageError as error:
        pytest.skip(str(error))


def in_sandbox(
    sandbox: Sandbox, folder: Path, do: Callable[[Call, ProcessInstance], Awaitable[None]]
) -> None:
    """Does something with an instance of the mischief, beside a neighbour that must answer before and after."""

    async def run() -> None:
        numbers = iter(range(100))
        runtime = ProcessRuntime(
            lambda _: f"unix:{folder}/{next(numbers)}.sock",
            credentials=None,
            max_message_bytes=MAX_MESSAGE_BYTES,
            sandbox=sandbox,
        )
        dialer = GrpcDialer("heron", None, max_message_bytes=MAX_MESSAGE_BYTES)
        methods = spec_of(load_service(PROGRAM)).methods
        instances = [await runtime.start(SPEC, called=lambda _: None) for _ in range(2)]
        links = [dialer.dial(instance.endpoint, server="s1") for instance in instances]

        async def call(name: str, *arguments: object, at: int = 0) -> Any:
            method = methods[name]
            _, request = method.encode(arguments, {})
            reply = await links[at].request(service_path("mischief", name), request, timeout_s=30.0)
            return method.result(method.decode(reply))

        try:
            for instance in instances:
                await instance.admit(frozenset({"heron"}))
            seen = await call("processes", at=1)
            await do(call, instances[0])
            assert set(await call("processes", at=1)) >= set(seen), "the neighbour is not as before"
        finally:
            for link, instance in zip(links, instances, strict=True):
                await link.close()
                await instance.stop()
        expect_no_child()

    asyncio.run(run())


def test_it_gets_no_more_memory_than_its_limit_and_goes_on(sandbox: Sandbox, tmp_path: Path) -> None:
    async def eat(call: Call, _: ProcessInstance) -> None:
        assert await call("eat_memory", 2**30) < LIMITS.memory_bytes
        assert await call("eat_memory", 2**25) == 2**25

    in_sandbox(sandbox, tmp_path, eat)


@pytest.mark.skipif(os.geteuid() == 0, reason="Linux does not limit the processes of root")
def test_it_gets_no_more_processes_than_its_limit(sandbox: Sandbox, tmp_path: Path) -> None:
    async def fork(call: Call, _: ProcessInstance) -> None:
        with contextlib.suppress(Unreachable):  # gRPC in it could start no thread any more, and ended it
            assert await call("fork", 500) < LIMITS.processes
        assert await call("fork", 10, at=1) == 10, "its neighbour has processes of its own"

    in_sandbox(sandbox, tmp_path, fork)


def test_processes_that_it_left_behind_end_with_it(sandbox: Sandbox, tmp_path: Path) -> None:
    async def fork(call: Call, instance: ProcessInstance) -> None:
        assert await call("fork", 10) == 10
        assert len(await call("processes")) >= 12
        await instance.stop()
        assert sleeping_here(str(tmp_path)) == []

    in_sandbox(sandbox, tmp_path, fork)


def sleeping_here(folder: str) -> list[str]:
    """The processes of this machine whose command names the folder: those of instances that began in it."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            command = (entry / "cmdline").read_bytes().decode(errors="replace")
        except OSError:
            continue
        if "upwash.real.instance" in command and folder in command:
            found.append(entry.name)
    return found


def test_it_can_write_nowhere_but_into_its_own_tmp_and_no_more_than_its_limit(
    sandbox: Sandbox, tmp_path: Path
) -> None:
    async def fill(call: Call, _: ProcessInstance) -> None:
        assert 0 < await call("fill", "/tmp", 2**26) <= LIMITS.disk_bytes
        assert await call("fill", "/dev/shm", 2**26) <= LIMITS.disk_bytes
        for folder in ("/", "/dev", "/usr", "/etc", str(Path(PROGRAM).parent), str(tmp_path), sys.prefix):
            assert await call("fill", folder, 2**26) == 0, folder

    before = sorted(tmp_path.iterdir())
    in_sandbox(sandbox, tmp_path, fill)
    assert [each for each in tmp_path.iterdir() if each.suffix != ".sock"] == before


def test_it_reads_its_own_code_and_what_it_is_given_and_no_other_file_of_the_user(
    sandbox: Sandbox, tmp_path: Path, keys: Path
) -> None:
    model = tmp_path / "model.bin"
    model.write_text("weights")
    given = Sandbox(sandbox.bubblewrap, sandbox.limits, readable=(model,))

    async def read(call: Call, _: ProcessInstance) -> None:
        assert "class Mischief" in await call("read", PROGRAM.rpartition(":")[0])
        assert await call("read", str(model)) == "weights"
        for secret in (keys / "s1.key", keys / "authority.key", Path.home() / ".profile", Path(__file__)):
            assert await call("read", str(secret)) == "FileNotFoundError", secret

    in_sandbox(given, tmp_path, read)


def test_it_reaches_nobody(sandbox: Sandbox, tmp_path: Path) -> None:
    async def connect(call: Call, _: ProcessInstance) -> None:
        with (
            socket.create_server(("127.0.0.1", 0)) as server,
            socket.socket(socket.AF_UNIX) as abstract,
        ):
            abstract.bind(f"\0{tmp_path}")
            abstract.listen()
            assert await call("connect", f"127.0.0.1:{server.getsockname()[1]}") == "ConnectionRefusedError"
            assert await call("connect", "192.0.2.1:80") == "OSError"
            assert await call("connect", f"\0{tmp_path}") == "ConnectionRefusedError"
            assert await call("connect", f"{tmp_path}/1.sock") == "FileNotFoundError"

    in_sandbox(sandbox, tmp_path, connect)


def test_it_sees_no_process_and_no_variable_of_the_daemon(
    sandbox: Sandbox, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET_TOKEN", "1234")

    async def look(call: Call, _: ProcessInstance) -> None:
        assert len(await call("processes")) <= 3
        assert "SECRET_TOKEN" not in await call("environment")

    in_sandbox(sandbox, tmp_path, look)


def test_a_crash_in_it_is_explained_as_outside(sandbox: Sandbox, services: Path, tmp_path: Path) -> None:
    async def run() -> None:
        runtime = ProcessRuntime(
            lambda _: f"unix:{tmp_path}/s.sock",
            credentials=None,
            max_message_bytes=MAX_MESSAGE_BYTES,
            sandbox=sandbox,
        )
        with pytest.raises(InstanceError, match=r"did not start: .*model.onnx is missing"):
            spec = InstanceSpec("s1", "unstartable", Program(f"{services}:Unstartable"))
            await runtime.start(spec, called=lambda _: None)
        expect_no_child()

    asyncio.run(run())


def test_without_bubblewrap_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="apt install bubblewrap"):
        find_sandbox(LIMITS, readable=())


def test_a_bubblewrap_that_is_not_permitted_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refusing = tmp_path / "bwrap"
    refusing.write_text("#!/bin/sh\necho 'bwrap: No permissions to create new namespace' >&2\nexit 1\n")
    refusing.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(UsageError, match=r"No permissions to create new namespace.*user.max_user_namespaces"):
        find_sandbox(LIMITS, readable=())


@pytest.mark.parametrize(
    ("program", "code"),
    [
        ("/srv/my_services.py:Counter", ["/srv/my_services.py"]),
        ("upwash.services.hotspots:HotSpotDetector", [str(Path(spec_of.__code__.co_filename).parent)]),
        ("no_such_package:Counter", []),
    ],
)
def test_the_code_of_a_program_is_found_without_running_it(program: str, code: list[str]) -> None:
    assert [str(place) for place in code_of(program)] == code


def test_files_are_found_wherever_they_stand_in_settings(tmp_path: Path) -> None:
    model = tmp_path / "model.bin"
    model.touch()
    settings = {
        "model": str(model),
        "spare": [{"at": str(tmp_path)}],
        "gain": 2.0,
        "missing": "/no/such/file",
    }
    assert files_in(settings) == [model, tmp_path]
