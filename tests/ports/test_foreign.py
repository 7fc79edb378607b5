"""Services whose calls a program in another language computes, over its standard input and output."""

from __future__ import annotations

import asyncio
import contextlib
import runpy
import shutil
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.children import expect_no_child

from upwash.config.daemon import read_daemon_config
from upwash.errors import InstanceError, LinkError, ServiceError, UsageError
from upwash.missions.bundled import load_services
from upwash.ports import InstanceSpec, Program
from upwash.real.instances.foreign import ForeignProgram
from upwash.real.instances.local_instance import LocalInstance
from upwash.real.instances.runtime import ProcessRuntime
from upwash.real.instances.sandbox import find_sandbox
from upwash.real.link.link import GrpcDialer
from upwash.rpc.protocol import service_path
from upwash.rpc.service import load_service, spec_of

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "other-languages"
MAX_MESSAGE_BYTES = 100_000
DECLARED = """
from upwash import service

@service(concurrency=2)
class Foreign:
    def __init__(self, *, factor: int = 1) -> None: ...
    def times(self, number: int) -> int: ...
    def meet(self, number: int) -> int: ...
    def misbehave(self, how: str) -> int: ...
"""
# Nothing of upwash: this might be any language.
PROGRAM = """
import os, signal, sys
import msgspec

def read():
    head = sys.stdin.buffer.read(4)
    return msgspec.msgpack.decode(sys.stdin.buffer.read(int.from_bytes(head))) if head else None

def write(message):
    body = msgspec.msgpack.encode(message)
    sys.stdout.buffer.write(len(body).to_bytes(4) + body)
    sys.stdout.buffer.flush()

factor = read()["settings"].get("factor", 1)
if factor == 0:
    write({"id": 0, "fault": {"type": "builtins:ValueError", "message": "factor is 0: give another"}})
    sys.exit(1)
if factor < 0:
    print("no idea", file=sys.stderr)
    sys.exit(4)
write({"id": 0, "value": None})
held = None
while call := read():
    match call["method"], call["arguments"]:
        case "times", {"number": number}:
            write({"id": call["id"], "value": number * factor})
        case "meet", _ if held is None:  # answered last
            held = call
        case "meet", {"number": number}:
            write({"id": call["id"], "value": number})
            write({"id": held["id"], "value": held["arguments"]["number"]})
        case _, {"how": "raise"}:
            write({"id": call["id"], "fault": {"type": "builtins:KeyError", "message": "'lost'", "args": ["lost"]}})
        case _, {"how": "raise its own"}:
            write({"id": call["id"], "fault": {"type": "Panic", "message": "index out of bounds"}})
        case _, {"how": "another type"}:
            write({"id": call["id"], "value": "seven"})
        case _, {"how": "crash"}:
            print("out of film", file=sys.stderr)
            sys.exit(3)
        case _, {"how": "die"}:
            os.kill(os.getpid(), signal.SIGKILL)
        case _, {"how": "die of a real-time signal"}:
            os.kill(os.getpid(), 36)
        case _, {"how": "print"}:
            print("hello", flush=True)
        case _, {"how": "flood"}:
            sys.stdout.buffer.write(b"\\x7f" * 2**20)
            sys.stdout.buffer.flush()
        case _, {"how": "answer another"}:
            write({"id": 77, "value": 1})
        case _, {"how": "answer nothing"}:
            write({"id": call["id"]})
"""
Call = Callable[..., Awaitable[Any]]


def started(
    folder: Path, *, sandboxed: bool = False, **settings: object
) -> AbstractAsyncContextManager[tuple[Call, LocalInstance]]:
    (folder / "declared.py").write_text(DECLARED)
    (folder / "program.py").write_text(PROGRAM)
    command = (sys.executable, str(folder / "program.py"))
    return run_service(
        Program(f"{folder}/declared.py:Foreign", settings, command), folder, sandboxed=sandboxed
    )


@asynccontextmanager
async def run_service(
    program: Program, folder: Path, *, sandboxed: bool = False
) -> AsyncIterator[tuple[Call, LocalInstance]]:
    try:
        sandbox = find_sandbox(readable=()) if sandboxed else None
    except UsageError as why:
        pytest.skip(str(why))
    spec = spec_of(load_service(program.path))
    runtime = ProcessRuntime(
        lambda _: f"unix:{folder}/s.sock", max_message_bytes=MAX_MESSAGE_BYTES, sandbox=sandbox
    )
    instance = await runtime.start(
        InstanceSpec("s1", spec.name, program, methods=frozenset(spec.methods)), called=lambda _: None
    )
    link = GrpcDialer("heron", None, max_message_bytes=MAX_MESSAGE_BYTES).dial(instance.endpoint, server="s1")

    async def call(name: str, *arguments: object) -> Any:
        method = spec.methods[name]
        _, request = method.encode(arguments, {})
        reply = await link.request(service_path(spec.name, name), request, timeout_s=10.0)
        return method.result(method.decode(reply))

    try:
        await instance.admit(frozenset({"heron"}))
        yield call, instance
    finally:
        await link.close()
        await instance.stop()


async def test_calls_are_computed_by_the_program_with_its_settings(tmp_path: Path) -> None:
    async with started(tmp_path, factor=3) as (call, _):
        assert [await call("times", number) for number in (1, -2, 2**40)] == [3, -6, 3 * 2**40]


@pytest.mark.sandbox
async def test_in_a_sandbox_too(tmp_path: Path) -> None:
    async with started(tmp_path, sandboxed=True, factor=3) as (call, _):
        assert await call("times", 14) == 42


async def test_as_many_calls_are_under_way_as_declared_and_answers_come_in_any_order(tmp_path: Path) -> None:
    async with started(tmp_path) as (call, _):
        assert list(await asyncio.gather(call("meet", 1), call("meet", 2))) == [1, 2]


async def test_a_fault_is_an_exception_of_its_class_or_the_services_own(tmp_path: Path) -> None:
    async with started(tmp_path) as (call, _):
        with pytest.raises(KeyError, match="lost"):
            await call("misbehave", "raise")
        with pytest.raises(ServiceError, match="Panic: index out of bounds"):
            await call("misbehave", "raise its own")
        with pytest.raises(
            LinkError, match=r"foreign\.misbehave\(\): what it returned is not what its type hint says"
        ):
            await call("misbehave", "another type")
        assert await call("times", 2) == 2


@pytest.mark.parametrize(
    ("how", "end"),
    [
        ("crash", "ended with code 3: out of film"),
        ("die", "the program was killed by SIGKILL"),
        ("die of a real-time signal", "the program was killed by signal 36"),
        ("print", "the program sent no valid answer: a frame of 1751477356 bytes, at most 104096 are read"),
        ("flood", "the program sent no valid answer: a frame of 2139062143 bytes, at most 104096 are read"),
        ("answer another", "the program answered a call that was not made: 77"),
        (
            "answer nothing",
            "the program sent no valid answer: an answer must have either a value or a fault",
        ),
    ],
)
async def test_a_program_that_ends_or_says_what_is_no_answer_ends_the_instance_with_the_reason(
    tmp_path: Path, how: str, end: str
) -> None:
    async with started(tmp_path) as (call, instance):
        with pytest.raises(LinkError):
            await call("misbehave", how)
        async with asyncio.timeout(10.0):
            assert end in await instance.exited()


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (0, r"python\S*: factor is 0: give another"),
        (-1, r"python\S* did not answer to its settings: .*code 4"),
    ],
)
async def test_a_program_that_does_not_take_its_settings_says_why(
    tmp_path: Path, factor: int, said: str
) -> None:
    with pytest.raises(InstanceError, match=said):
        async with started(tmp_path, factor=factor):
            pytest.fail("it started")


REFUSES = """
import sys, time
import msgspec
body = msgspec.msgpack.encode({"id": 0, "fault": {"type": "builtins:ValueError", "message": "not today"}})
sys.stdout.buffer.write(len(body).to_bytes(4) + body)
sys.stdout.buffer.flush()
time.sleep(1000.0)
"""


def open_files() -> set[str]:
    """What this process has open, each by its own name; what earlier tests left may be closed at any moment."""
    found = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # the listing itself
            found.add(str(descriptor.readlink()))
    return found


@pytest.mark.parametrize(
    "program", [REFUSES, "import sys; sys.stdout.write('no answer at all'); sys.exit(3)"]
)
def test_a_program_that_does_not_start_leaves_no_process_and_no_pipe(program: str) -> None:
    expect_no_child()
    before = open_files()
    with pytest.raises(UsageError):
        ForeignProgram((sys.executable, "-c", program), {}, max_message_bytes=MAX_MESSAGE_BYTES)
    expect_no_child()
    assert not open_files() - before


async def test_a_program_that_is_not_there_is_named(tmp_path: Path) -> None:
    (tmp_path / "declared.py").write_text(DECLARED)
    nowhere = Program(f"{tmp_path}/declared.py:Foreign", {}, ("nowhere",))
    with pytest.raises(InstanceError, match="nowhere cannot be run: No such file"):
        async with run_service(nowhere, tmp_path):
            pytest.fail("it started")


# --- the example in C++ -------------------------------------------------------------------------------------


def test_the_test_vectors_are_those_of_the_code() -> None:
    page = runpy.run_path(str(ROOT / "site" / "wire.py"))["page"]()
    assert (ROOT / "docs" / "services.md").read_text() == page, "run make docs, or python site/wire.py alone"


@pytest.mark.sandbox
def test_the_program_in_cpp_answers_as_the_test_vectors_say(detail: Path) -> None:
    vectors = runpy.run_path(str(ROOT / "site" / "wire.py"))["vectors"]()
    asked = b"".join(sent for who, sent in vectors if who == "instance")
    said = subprocess.run((str(detail),), input=asked, capture_output=True, check=True, timeout=10).stdout
    for who, sent in vectors:
        if who == "program":
            length = 4 + int.from_bytes(said[:4])
            answer, said = msgspec.msgpack.decode(said[4:length]), said[length:]
            expected = msgspec.msgpack.decode(sent[4:])
            if "fault" in expected:
                expected["fault"].pop("args")  # which need not be said
            assert answer == expected
    assert said == b""


@pytest.mark.sandbox
async def test_the_example_in_cpp_answers_as_its_class_does(detail: Path, tmp_path: Path) -> None:
    for name in ("detail.py", "server.toml"):
        shutil.copy(EXAMPLE / name, tmp_path)
    shutil.copy(detail, tmp_path / "detail")
    program = load_services(read_daemon_config(tmp_path / "server.toml").images)["detail"].program
    twin = load_service(program.path)()
    async with run_service(program, tmp_path) as (call, _):
        for photo in (bytes(range(256)) * 3, bytes(50_000), b"photo"):
            found, expected = await call("measure", photo), twin.measure(photo)
            assert found.bits_per_byte == pytest.approx(expected.bits_per_byte)
            assert found.is_blank == expected.is_blank
        with pytest.raises(ValueError, match="the photo is empty"):
            await call("measure", b"")
