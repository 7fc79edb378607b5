"""The drone's own services in real processes: whatever becomes of them, the next call is answered."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.children import expect_no_child

from upwash.drone.onboard import OnboardServices
from upwash.errors import InstanceError, OutcomeUnknown
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.ports import InstanceSpec, Program
from upwash.real.instances.runtime import OwnProcesses
from upwash.rpc.service import load_service, spec_of
from upwash.sim.link import ModelDialer, Switchboard

MAX_MESSAGE_BYTES = 1_000_000


class Diary:
    """A journal that keeps its events, and can be waited for."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self._recorded = asyncio.Event()

    def record(self, event: Event) -> None:
        self.events.append(event)
        self._recorded.set()

    def count(self, event: str) -> int:
        return [each.kind for each in self.events].count(event)

    async def until(self, event: str, count: int) -> None:
        """Returns when as many of these events have been recorded."""
        async with asyncio.timeout(10.0):
            while self.count(event) < count:
                self._recorded.clear()
                await self._recorded.wait()


class Onboard:
    """A drone's services with a workbench among them."""

    def __init__(self, services: OnboardServices, diary: Diary, program: str) -> None:
        self.services = services
        self.diary = diary
        self._methods = spec_of(load_service(program)).methods

    async def call(self, name: str, *arguments: object, timeout_s: float = 10.0, once: bool = False) -> Any:
        method = self._methods[name]
        _, request = method.encode(arguments, {})
        return method.result(
            method.decode(
                await self.services.call("workbench", name, request, timeout_s=timeout_s, once=once)
            )
        )


@asynccontextmanager
async def onboard(services: Path, folder: Path, cls: str = "Workbench") -> AsyncIterator[Onboard]:
    own = OwnProcesses("heron", max_message_bytes=MAX_MESSAGE_BYTES)
    diary = Diary()
    program = f"{services}:{cls}"
    running = OnboardServices(
        [InstanceSpec("heron", cls.lower(), Program(program))],
        start_timeout_s=60.0,
        runtime=own,
        dialer=own,
        journal=diary,
    )
    try:
        yield Onboard(running, diary, program)
    finally:
        await running.close()
        expect_no_child()


def with_started(services: Path, folder: Path, use: Callable[[Onboard], Coroutine[Any, Any, None]]) -> None:
    async def run() -> None:
        async with onboard(services, folder) as drone:
            await drone.services.start()
            await use(drone)

    asyncio.run(run())


def test_a_call_is_answered_and_nothing_is_restarted(services: Path, tmp_path: Path) -> None:
    async def use(drone: Onboard) -> None:
        first = await drone.call("process_id")
        assert await drone.call("echo", b"photo") == b"photo"
        assert await drone.call("process_id") == first
        assert drone.diary.events == [schema.LocalReady(service="workbench")]

    with_started(services, tmp_path, use)


def test_a_service_that_crashes_in_a_call_is_restarted_and_the_call_repeated(
    services: Path, tmp_path: Path
) -> None:
    async def use(drone: Onboard) -> None:
        assert await drone.call("crash_once", str(tmp_path / "crashed")) == "survived"
        assert drone.diary.count("local_failed") == 1
        assert schema.LocalEnded(service="workbench", how="ended with code 3") in drone.diary.events

    with_started(services, tmp_path, use)


@pytest.mark.parametrize(("name", "timeout_s"), [("crash_once", 10.0), ("hang_once", 1.0)])
def test_what_must_run_once_is_not_repeated(
    services: Path, tmp_path: Path, name: str, timeout_s: float
) -> None:
    async def use(drone: Onboard) -> None:
        with pytest.raises(OutcomeUnknown, match=f"{name}, which may have run and must not run twice"):
            await drone.call(name, str(tmp_path / "failed"), timeout_s=timeout_s, once=True)
        assert await drone.call("echo", b"photo") == b"photo"

    with_started(services, tmp_path, use)


def test_a_call_that_crashes_the_service_twice_is_given_up_and_the_next_answered(
    services: Path, tmp_path: Path
) -> None:
    async def use(drone: Onboard) -> None:
        with pytest.raises(InstanceError, match="workbench failed on the drone, twice"):
            await drone.call("crash")
        assert await drone.call("echo", b"photo") == b"photo"
        assert drone.diary.count("local_ready") == 3

    with_started(services, tmp_path, use)


def test_a_call_that_hangs_is_ended_at_its_timeout_and_repeated(services: Path, tmp_path: Path) -> None:
    async def use(drone: Onboard) -> None:
        began_s = time.monotonic()
        assert await drone.call("hang_once", str(tmp_path / "hung"), timeout_s=1.0) == "survived"
        assert time.monotonic() - began_s < 8.0
        assert drone.diary.count("local_ready") == 2

    with_started(services, tmp_path, use)


def test_a_service_that_crashes_between_calls_is_running_again_before_the_next(
    services: Path, tmp_path: Path
) -> None:
    async def use(drone: Onboard) -> None:
        first = await drone.call("process_id")
        os.kill(first, signal.SIGKILL)
        await drone.diary.until("local_ready", 2)
        assert await drone.call("process_id") != first
        assert drone.diary.count("local_failed") == 0

    with_started(services, tmp_path, use)


def test_a_call_just_after_a_crash_is_answered(services: Path, tmp_path: Path) -> None:
    async def use(drone: Onboard) -> None:
        os.kill(await drone.call("process_id"), signal.SIGKILL)
        assert await drone.call("echo", b"photo") == b"photo"

    with_started(services, tmp_path, use)


def test_a_service_that_crashes_and_leaves_a_child_behind_is_restarted(
    services: Path, tmp_path: Path
) -> None:
    async def use(drone: Onboard) -> None:
        await drone.call("spawn")
        os.kill(await drone.call("process_id"), signal.SIGKILL)
        await drone.diary.until("local_ready", 2)

    with_started(services, tmp_path, use)


@pytest.mark.timeout(30)
@pytest.mark.parametrize("photo", [b"photo", bytes(430_000)], ids=["small", "more than its socket holds"])
def test_a_frozen_service_is_ended_and_the_call_repeated(
    services: Path, tmp_path: Path, photo: bytes
) -> None:
    async def use(drone: Onboard) -> None:
        assert await drone.call("echo", photo) == photo
        os.kill(await drone.call("process_id"), signal.SIGSTOP)
        assert await drone.call("echo", photo, timeout_s=1.0) == photo

    with_started(services, tmp_path, use)


def test_a_service_error_is_the_callers_and_restarts_nothing(services: Path, tmp_path: Path) -> None:
    async def use(drone: Onboard) -> None:
        with pytest.raises(Exception, match=r"91\.5 °C"):
            await drone.call("fail")
        assert drone.diary.count("local_ready") == 1

    with_started(services, tmp_path, use)


def test_a_call_that_is_too_large_does_not_end_a_healthy_service(services: Path, tmp_path: Path) -> None:
    async def use(drone: Onboard) -> None:
        process_id = await drone.call("process_id")
        with pytest.raises(InstanceError, match=r"the request has .* more than max_message_bytes"):
            await drone.call("echo", bytes(MAX_MESSAGE_BYTES + 1))
        assert await drone.call("process_id") == process_id

    with_started(services, tmp_path, use)


def test_a_cancelled_call_leaves_the_service_usable(services: Path, tmp_path: Path) -> None:
    async def use(drone: Onboard) -> None:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(drone.call("pause", 0.5), 0.1)
        assert await drone.call("echo", b"photo") == b"photo"

    with_started(services, tmp_path, use)


async def test_a_service_that_cannot_start_is_said_at_the_start(services: Path, tmp_path: Path) -> None:
    async with onboard(services, tmp_path, "Unstartable") as drone:
        with pytest.raises(InstanceError, match=r"model\.onnx is missing"):
            await drone.services.start()


def test_services_end_while_they_are_being_restarted(services: Path, tmp_path: Path) -> None:
    async def use(drone: Onboard) -> None:
        os.kill(await drone.call("process_id"), signal.SIGKILL)
        await drone.diary.until("local_ended", 1)

    with_started(services, tmp_path, use)


async def test_services_that_were_never_started_can_be_closed(services: Path, tmp_path: Path) -> None:
    async with onboard(services, tmp_path):
        """Nothing."""


def test_a_crash_without_a_usable_temporary_folder_is_survived(
    services: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "removed"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "removed"))

    async def use(drone: Onboard) -> None:
        os.kill(await drone.call("process_id"), signal.SIGKILL)
        await drone.diary.until("local_ready", 2)
        assert await drone.call("echo", b"photo") == b"photo"

    with_started(services, tmp_path, use)


@pytest.mark.system
@pytest.mark.parametrize("folder", ["empty", "full"])
def test_a_crash_with_the_shared_temporary_folder_empty_or_full_is_survived(
    services: Path, folder: str
) -> None:
    """In a mount namespace of its own, where `/tmp` has room for one page."""
    if Path(sys.executable).is_relative_to("/tmp"):
        pytest.skip("this checkout lies in /tmp, over which the test mounts another folder")
    program = [sys.executable, "-c", CRASHES, str(services), folder]
    script = 'mount -t tmpfs -o size=4096 none /tmp && exec "$@"'
    flown = subprocess.run(
        ["unshare", "--mount", "--map-root-user", "sh", "-c", script, "sh", *program],
        env={**os.environ, "TMPDIR": "/tmp", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        check=False,
    )
    if flown.stderr.startswith(("unshare: ", "mount: ")):
        pytest.skip(flown.stderr)
    assert flown.stdout == "photo\n", flown.stderr


CRASHES = """
import asyncio, os, signal, sys
from pathlib import Path
from tests.drone.test_onboard import onboard

async def run():
    async with onboard(Path(sys.argv[1]), Path("/nowhere")) as drone:
        await drone.services.start()
        assert not list(Path("/tmp").iterdir()), "something of it lies there"
        if sys.argv[2] == "full":
            Path("/tmp/full").write_bytes(bytes(4096))
        os.kill(await drone.call("process_id"), signal.SIGKILL)
        await drone.diary.until("local_ready", 2)
        print((await drone.call("echo", b"photo")).decode())

asyncio.run(run())
"""


def test_a_defect_in_watching_a_service_fails_its_calls_at_once_and_is_logged() -> None:
    class Defective:
        endpoint = "unix:nowhere"

        async def admit(self, drones: frozenset[str], finishing: frozenset[str] = frozenset()) -> None: ...

        async def drain(self, why: str) -> None: ...
        async def health(self) -> None: ...

        async def exited(self) -> str:
            raise LookupError("a defect")

        async def stop(self) -> None: ...

        async def start(self, *_: object, **__: object) -> Defective:
            return self

    async def main() -> None:
        diary = Diary()
        services = OnboardServices(
            [InstanceSpec("heron", "workbench", Program("nowhere:Workbench"))],
            runtime=Defective(),
            dialer=ModelDialer("heron", Switchboard({})),
            journal=diary,
            start_timeout_s=60.0,
        )
        await services.start()
        await diary.until("local_failed", 1)
        with pytest.raises(
            InstanceError, match="not watched any more, after a defect: LookupError: a defect"
        ):
            await services.call("workbench", "light", b"", timeout_s=1.0)
        await services.close()

    asyncio.run(main())
