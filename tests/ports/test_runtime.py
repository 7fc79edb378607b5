"""Instances as processes of their own: started, admitted to, called, killed."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.children import expect_no_child, gone, is_alive
from tests.doors import certified_processes, reached
from tests.waiting import wait_for

from upwash.errors import InstanceError, Refused, Unreachable
from upwash.ports import InstanceSpec, Program
from upwash.real.instances.local_instance import LocalInstance
from upwash.real.instances.runtime import ProcessRuntime
from upwash.real.link.link import GrpcDialer, GrpcLink
from upwash.real.trust.credentials import Credentials, fingerprint
from upwash.rpc.protocol import service_path
from upwash.rpc.service import load_service, spec_of
from upwash.support.heat import Surroundings

MAX_MESSAGE_BYTES = 1_000_000
HERON = frozenset({"heron"})


def runtime(folder: Path) -> ProcessRuntime:
    """Starts instances that listen at unix sockets in the folder, which need no certificates."""
    return ProcessRuntime(lambda spec: f"unix:{folder}/{spec.name}.sock", max_message_bytes=MAX_MESSAGE_BYTES)


def spec(
    services: Path,
    cls: str = "Workbench",
    pace_s: dict[str, float] | None = None,
    settings: dict[str, object] | None = None,
    heats: Surroundings | None = None,
) -> InstanceSpec:
    program = Program(f"{services}:{cls}", settings or {})
    return InstanceSpec("s1", cls.lower(), program, pace_s or {}, heats=heats)


class Bench:
    """A workbench that runs in a process, and a drone's link to it."""

    def __init__(self, instance: LocalInstance, link: GrpcLink, program: str) -> None:
        self.instance = instance
        self.link = link
        self.called: list[str] = []  # by whom
        self.busy = asyncio.Event()  # set from the first call on
        self._methods = spec_of(load_service(program)).methods

    async def call(self, name: str, *arguments: object, timeout_s: float = 10.0) -> Any:
        method = self._methods[name]
        _, request = method.encode(arguments, {})
        reply = await self.link.request(service_path("workbench", name), request, timeout_s=timeout_s)
        return method.result(method.decode(reply))


@asynccontextmanager
async def running(
    services: Path,
    folder: Path,
    *,
    admitted: frozenset[str] = HERON,
    pace_s: dict[str, float] | None = None,
    heats: Surroundings | None = None,
) -> AsyncIterator[Bench]:
    """A workbench until the end of the block; nothing of it may be left then."""
    what = spec(services, pace_s=pace_s, heats=heats)
    calls: list[str] = []
    busy = asyncio.Event()

    def called(drone: str) -> None:
        calls.append(drone)
        busy.set()

    instance = await runtime(folder).start(what, called=called)
    link = GrpcDialer("heron", None, max_message_bytes=MAX_MESSAGE_BYTES).dial(instance.endpoint, server="s1")
    try:
        await instance.admit(admitted)
        bench = Bench(instance, link, what.program.path)
        bench.called, bench.busy = calls, busy
        yield bench
    finally:
        await link.close()
        await instance.stop()
    expect_no_child()


# --- starting -----------------------------------------------------------------------------------------------


async def test_what_a_service_prints_is_logged_while_it_runs(
    services: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "upwash.instance")
    said = asyncio.Event()

    def note(record: logging.LogRecord) -> bool:
        if "a word" in record.getMessage():
            said.set()
        return True

    caplog.handler.addFilter(note)
    async with running(services, tmp_path) as bench:
        await bench.call("mutter", "a word without a flush")
        await asyncio.wait_for(said.wait(), 10.0)
    assert "workbench@s1: a word without a flush" in caplog.messages


async def test_an_instance_answers_from_a_process_in_a_session_of_its_own(
    services: Path, tmp_path: Path
) -> None:
    async with running(services, tmp_path) as bench:
        assert await bench.call("echo", b"photo") == b"photo"
        process_id = await bench.call("process_id")
        assert process_id != os.getpid()
        assert os.getsid(process_id) == os.getpgid(process_id) == process_id


async def test_an_instance_with_certificates_is_told_by_its_port(
    services: Path, credentials: Callable[[str], Credentials]
) -> None:
    async with certified_processes(credentials("s1"), max_message_bytes=MAX_MESSAGE_BYTES) as certified:
        instance = await certified.start(spec(services), called=lambda _: None)
        dialer = GrpcDialer("stork", credentials("heron"), max_message_bytes=MAX_MESSAGE_BYTES)
        link = dialer.dial(reached(instance.endpoint), server="s1")
        try:
            assert int(instance.endpoint.removeprefix(":")) > 0
            await instance.admit(frozenset({fingerprint(credentials("heron").certificate)}))
            bench = Bench(instance, link, spec(services).program.path)
            assert await bench.call("echo", b"photo") == b"photo"
        finally:
            await link.close()
            await instance.stop()


@pytest.mark.parametrize(
    ("cls", "settings", "made"),
    [
        ("Tuned", {"gain": 2.5, "table": "/etc/table"}, "2.5 light /etc/table"),
        ("Tuner", {"note": "a", "tuned": {"gain": 2.5, "mode": "heavy"}}, "a: 2.5 heavy None"),
    ],
)
async def test_an_instance_is_made_with_its_settings_and_those_of_what_it_uses(
    services: Path, tmp_path: Path, cls: str, settings: dict[str, object], made: str
) -> None:
    what = spec(services, cls, settings=settings)
    instance = await runtime(tmp_path).start(what, called=lambda _: None)
    link = GrpcDialer("heron", None, max_message_bytes=MAX_MESSAGE_BYTES).dial(instance.endpoint, server="s1")
    method = spec_of(load_service(what.program.path)).methods["made"]
    try:
        await instance.admit(HERON)
        reply = await link.request(
            service_path(cls.lower(), "made"), method.encode((), {})[1], timeout_s=10.0
        )
        assert method.result(method.decode(reply)) == made
    finally:
        await link.close()
        await instance.stop()


@pytest.mark.parametrize(
    ("cls", "said"),
    [
        ("Tuned", "tuned@s1 did not start: Tuned cannot be made with its settings: .*gain"),
        ("Unstartable", "unstartable@s1 did not start: .*model.onnx is missing"),
        ("Missing", "missing@s1 did not start: .*there is no Missing"),
        ("Overheated", "overheated@s1 did not start: .*put @service above"),
    ],
)
async def test_a_service_that_cannot_start_says_why_and_leaves_nothing(
    services: Path, tmp_path: Path, cls: str, said: str
) -> None:
    def left() -> tuple[int, list[Path]]:
        return len(os.listdir("/proc/self/fd")), list(tmp_path.glob("*.sock*"))  # noqa: PTH208

    with pytest.raises(InstanceError, match=said):
        await runtime(tmp_path).start(spec(services, cls), called=lambda _: None)
    before = left()  # the loop has opened what it needs
    with pytest.raises(InstanceError, match=said):
        await runtime(tmp_path).start(spec(services, cls), called=lambda _: None)
    expect_no_child()
    assert left() == before == (before[0], [])


async def test_a_reason_of_any_length_is_an_instance_error(tmp_path: Path) -> None:
    program = tmp_path / "wordy.py"
    program.write_text("raise ValueError('x' * 200_000)")
    with pytest.raises(InstanceError, match="did not start"):
        await runtime(tmp_path).start(
            InstanceSpec("s1", "wordy", Program(f"{program}:Wordy")), called=lambda _: None
        )


async def test_a_start_that_is_cancelled_leaves_nothing(
    services: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = tmp_path / "process_id"
    monkeypatch.setenv("PROCESS_ID_FILE", str(told))
    starting = asyncio.create_task(
        runtime(tmp_path).start(spec(services, "SlowToStart"), called=lambda _: None)
    )
    process_id = await asyncio.to_thread(read_when_written, told)
    starting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await starting
    assert not is_alive(process_id)


@pytest.mark.parametrize("turns", range(1, 6))
async def test_a_start_that_is_cancelled_early_leaves_nothing(
    services: Path, tmp_path: Path, turns: int
) -> None:
    with nothing_left_open():
        starting = asyncio.create_task(runtime(tmp_path).start(spec(services), called=lambda _: None))
        for _ in range(turns):
            await asyncio.sleep(0)
        starting.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await starting
        expect_no_child()


def test_a_process_that_cannot_be_made_is_an_instance_error(
    services: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "no-such-python"))

    async def use() -> str:
        try:
            await runtime(tmp_path).start(spec(services), called=lambda _: None)
        except Exception as error:  # noqa: BLE001 - its frames would keep open what should be closed
            return f"{type(error).__name__}: {error}"
        return "started"

    with nothing_left_open():
        said = asyncio.run(use())
    assert said.startswith("InstanceError: workbench@s1 did not start")


@contextlib.contextmanager
def nothing_left_open() -> Iterator[None]:
    """Fails if a socket or file is left for the garbage collector to close."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        yield
        gc.collect()
    assert not [str(each.message) for each in warned]


def read_when_written(file: Path) -> int:
    wait_for(lambda: file.exists() and file.read_text().endswith("\n"), within_s=10.0)
    return int(file.read_text())


# --- admitting and calling ----------------------------------------------------------------------------------


async def test_only_admitted_drones_are_answered_from_the_moment_that_admit_returns(
    services: Path, tmp_path: Path
) -> None:
    async with running(services, tmp_path, admitted=frozenset()) as bench:
        for _ in range(50):
            for admitted in (frozenset({"stork"}), frozenset({"stork", "heron"}), frozenset[str]()):
                await bench.instance.admit(admitted)
                if "heron" in admitted:
                    assert await bench.call("echo", b"photo") == b"photo"
                else:
                    with pytest.raises(Refused, match="drone heron has no lease here"):
                        await bench.call("echo", b"photo")


async def test_admissions_at_the_same_time_end_in_the_order_in_which_they_began(
    services: Path, tmp_path: Path
) -> None:
    async with running(services, tmp_path) as bench:
        admitted = [frozenset({"stork"}), HERON] * 20
        await asyncio.gather(*(bench.instance.admit(each) for each in admitted))
        assert await bench.call("echo", b"photo") == b"photo"


async def test_a_drone_whose_calls_are_let_in_is_reported_at_least_every_other_second(
    services: Path, tmp_path: Path
) -> None:
    async with running(services, tmp_path, admitted=frozenset()) as bench:
        with pytest.raises(Refused):
            await bench.call("echo", b"photo")
        await bench.instance.admit(HERON)  # what the instance reported before it has been heard by now
        assert bench.called == []
        await bench.call("pause", 1.1)
        await bench.call("echo", b"photo")
        await bench.instance.admit(HERON)
        assert bench.called == ["heron", "heron"]


async def test_a_call_that_nobody_waits_for_any_more_is_not_run(services: Path, tmp_path: Path) -> None:
    async with running(services, tmp_path) as bench:
        first = asyncio.create_task(bench.call("pause", 0.5))
        await asyncio.sleep(0.1)
        second = asyncio.create_task(bench.call("crash"))
        await asyncio.sleep(0.1)
        second.cancel()
        await first
        assert await bench.call("echo", b"still here") == b"still here"


async def test_a_call_of_a_method_that_is_not_there_is_refused(services: Path, tmp_path: Path) -> None:
    async with running(services, tmp_path) as bench:
        for path in (service_path("workbench", "__init__"), service_path("another", "echo")):
            with pytest.raises(Refused, match="no method"):
                await bench.link.request(path, b"", timeout_s=5.0)


async def test_the_services_own_exception_arrives_as_its_class(services: Path, tmp_path: Path) -> None:
    async with running(services, tmp_path) as bench:
        with pytest.raises(Exception, match=r"91\.5 °C") as caught:
            await bench.call("fail")
        assert type(caught.value).__name__ == "Overheated"


async def test_a_service_that_wants_to_exit_answers_and_goes_on(services: Path, tmp_path: Path) -> None:
    async with running(services, tmp_path) as bench:
        with pytest.raises(Exception, match="the service wants to end"):
            await bench.call("leave", timeout_s=2.0)
        assert await bench.call("echo", b"photo") == b"photo"


async def test_a_paced_start_takes_its_time(services: Path, tmp_path: Path) -> None:
    began_s = time.monotonic()
    slow = InstanceSpec("s1", "workbench", Program(f"{services}:Workbench"), start_pace_s=1.5)
    instance = await runtime(tmp_path).start(slow, called=lambda _: None)
    took_s = time.monotonic() - began_s
    await instance.stop()
    assert took_s >= 1.5
    expect_no_child()


async def test_a_paced_call_takes_its_time_and_no_longer(services: Path, tmp_path: Path) -> None:
    async with running(services, tmp_path, pace_s={"heavy": 0.3}) as bench:
        for mode, at_least_s, at_most_s in (("heavy", 0.3, 1.0), ("light", 0.0, 0.25)):
            began_s = time.monotonic()
            assert await bench.call("work", mode) == mode
            assert at_least_s <= time.monotonic() - began_s < at_most_s


async def test_a_paced_call_takes_longer_in_air_that_is_too_hot(services: Path, tmp_path: Path) -> None:
    async with running(
        services, tmp_path, pace_s={"heavy": 0.3}, heats=Surroundings(ambient_c=85.0, load_w=4.0)
    ) as bench:
        began_s = time.monotonic()
        assert await bench.call("work", "heavy") == "heavy"
        assert time.monotonic() - began_s >= 0.45  # at two thirds of the frequency


@pytest.mark.parametrize("length", [10, 1_000_000])
async def test_a_service_may_print_without_ending_the_line(
    services: Path, tmp_path: Path, length: int
) -> None:
    async with running(services, tmp_path) as bench:
        await bench.call("print_without_end", length, timeout_s=3.0)
        assert await bench.call("echo", b"photo", timeout_s=3.0) == b"photo"


# --- ending -------------------------------------------------------------------------------------------------


async def test_a_killed_instance_says_so_with_its_last_words(services: Path, tmp_path: Path) -> None:
    async with running(services, tmp_path) as bench:
        await bench.call("say", "the camera is wet")
        os.kill(await bench.call("process_id"), signal.SIGKILL)
        how = await asyncio.wait_for(bench.instance.exited(), 5.0)
        assert how == "killed by SIGKILL: the camera is wet"
        with pytest.raises(Unreachable):
            await bench.call("echo", b"photo")


async def test_a_crash_in_a_call_ends_the_call_and_is_told_by_its_code(
    services: Path, tmp_path: Path
) -> None:
    async with running(services, tmp_path) as bench:
        with pytest.raises(Unreachable):
            await bench.call("crash")
        assert await asyncio.wait_for(bench.instance.exited(), 5.0) == "ended with code 3"


async def test_an_instance_that_is_gone_admits_nobody_and_says_so_at_once(
    services: Path, tmp_path: Path
) -> None:
    async with running(services, tmp_path) as bench:
        os.kill(await bench.call("process_id"), signal.SIGKILL)
        for _ in range(2):
            with pytest.raises(InstanceError, match="gone"):
                await asyncio.wait_for(bench.instance.admit(HERON), 2.0)
        await bench.instance.exited()
        with pytest.raises(InstanceError, match="gone"):
            await asyncio.wait_for(bench.instance.admit(HERON), 2.0)


@pytest.mark.parametrize("crash", [True, False])
async def test_what_a_service_started_ends_with_it(services: Path, tmp_path: Path, crash: bool) -> None:
    async with running(services, tmp_path) as bench:
        child = await bench.call("spawn")
        assert is_alive(child)
        if crash:
            os.kill(await bench.call("process_id"), signal.SIGKILL)
            await asyncio.wait_for(bench.instance.exited(), 5.0)
        else:
            await bench.instance.stop()
        assert await asyncio.to_thread(gone, child)


async def test_stopping_ends_the_call_under_way_and_can_be_repeated(services: Path, tmp_path: Path) -> None:
    async with running(services, tmp_path) as bench:
        calling = asyncio.create_task(bench.call("pause", 60.0))
        await bench.busy.wait()
        began_s = time.monotonic()
        await asyncio.gather(bench.instance.stop(), bench.instance.stop())
        await bench.instance.stop()
        assert time.monotonic() - began_s < 5.0
        expect_no_child()
        with pytest.raises(Unreachable):
            await calling
        assert "SIGTERM" in await bench.instance.exited()


PARENT = """
import asyncio, sys
from pathlib import Path
from upwash.ports import InstanceSpec, Program
from upwash.real.instances.runtime import ProcessRuntime

async def run(folder, program):
    runtime = ProcessRuntime(lambda _: f"unix:{folder}/socket", max_message_bytes=1_000_000)
    instance = await runtime.start(InstanceSpec("s1", "workbench", Program(program)), called=print)
    await instance.admit(frozenset({"heron"}))
    print(instance.endpoint, flush=True)
    await asyncio.sleep(60)

asyncio.run(run(*sys.argv[1:]))
"""


@pytest.mark.parametrize("hears", [True, False])
def test_an_instance_and_its_children_end_when_whoever_started_them_is_killed(
    services: Path, tmp_path: Path, *, hears: bool
) -> None:
    async def family(endpoint: str, program: str) -> list[int]:
        link = GrpcDialer("heron", None, max_message_bytes=MAX_MESSAGE_BYTES).dial(endpoint, server="s1")
        try:
            bench = Bench(None, link, program)  # type: ignore[arg-type]  # it is another process's
            return [await bench.call("process_id"), await bench.call("spawn")]
        finally:
            await link.close()

    program = f"{services}:Workbench"
    command = [sys.executable, "-c", PARENT, str(tmp_path), program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        endpoint = parent.stdout.readline().strip()
        if not hears:
            parent.send_signal(signal.SIGSTOP)  # and leaves reports of calls unread, so that the line breaks
        process_ids = asyncio.run(family(endpoint, program))
        parent.kill()
    try:
        assert gone(*process_ids)
    finally:
        if is_alive(process_ids[0]):
            os.killpg(process_ids[0], signal.SIGKILL)


def test_an_instance_that_is_still_starting_ends_when_whoever_started_it_is_killed(
    services: Path, tmp_path: Path
) -> None:
    told = tmp_path / "process_id"
    command = [sys.executable, "-c", PARENT, str(tmp_path), f"{services}:SlowToStart"]
    with subprocess.Popen(command, env={**os.environ, "PROCESS_ID_FILE": str(told)}) as parent:
        process_id = read_when_written(told)
        parent.kill()
    try:
        assert gone(process_id)
    finally:
        if is_alive(process_id):
            os.killpg(process_id, signal.SIGKILL)
