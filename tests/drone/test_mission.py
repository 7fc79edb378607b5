"""A blocking mission in its thread beside the event loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from upwash.drone.mission import MissionThread
from upwash.errors import MissionStopped

Program = Callable[[MissionThread], None]


def fly(program: Program, beside: Callable[[MissionThread], Coroutine[Any, Any, None]] | None = None) -> None:
    """Runs the program in a mission's thread, and a coroutine beside it on the loop."""

    async def run() -> None:
        thread = MissionThread()
        async with asyncio.timeout(5.0), asyncio.TaskGroup() as tasks:
            if beside is not None:
                tasks.create_task(beside(thread))
            await thread.run(lambda: program(thread))

    try:
        asyncio.run(run())
    except ExceptionGroup as group:
        raise group.exceptions[0] from group.exceptions[0].__cause__


async def loop_thread() -> str:
    return threading.current_thread().name


def test_a_verb_runs_on_the_loop_and_its_result_comes_back_to_the_missions_thread() -> None:
    seen: list[str] = []

    def program(thread: MissionThread) -> None:
        seen.extend([thread.call(loop_thread()), threading.current_thread().name])

    fly(program)
    assert seen == [threading.current_thread().name, "mission"]


def test_a_verbs_exception_is_raised_in_the_mission_which_may_go_on() -> None:
    seen: list[object] = []

    async def fail() -> None:
        raise KeyError("lost")

    def program(thread: MissionThread) -> None:
        with pytest.raises(KeyError, match="lost"):
            thread.call(fail())
        seen.append(thread.call(asyncio.sleep(0, "went on")))

    fly(program)
    assert seen == ["went on"]


@pytest.mark.parametrize("error", [ValueError("not a photo"), StopIteration("no more")], ids=repr)
def test_what_the_mission_raises_is_raised_by_its_run(error: Exception) -> None:
    def program(_: MissionThread) -> None:
        raise error

    with pytest.raises((type(error), RuntimeError)) as caught:  # a coroutine cannot raise StopIteration
        fly(program)
    assert error in (caught.value, caught.value.__cause__)


@pytest.mark.parametrize("error", [SystemExit("no photo"), KeyboardInterrupt("no photo")], ids=repr)
def test_a_mission_that_wants_to_exit_ends_itself_and_not_the_program(error: BaseException) -> None:
    def program(_: MissionThread) -> None:
        raise error

    with pytest.raises(MissionStopped, match="no photo"):
        fly(program)


def test_stopping_ends_the_verb_under_way_and_every_one_after_it() -> None:
    seen: list[str] = []
    started = asyncio.Event()

    async def hover() -> None:
        started.set()
        try:
            await asyncio.Event().wait()
        finally:
            seen.append("the verb ended")

    async def stop(thread: MissionThread) -> None:
        await started.wait()
        thread.stop("the battery is low")
        thread.stop("Ctrl-C")

    def program(thread: MissionThread) -> None:
        for verb in (hover, loop_thread, loop_thread):
            with pytest.raises(MissionStopped, match="the battery is low"):
                thread.call(verb())
            seen.append(verb.__name__)

    fly(program, stop)
    assert sorted(seen) == ["hover", "loop_thread", "loop_thread", "the verb ended"]


def test_stopping_between_two_verbs_ends_the_next() -> None:
    def program(thread: MissionThread) -> None:
        thread.call(asyncio.sleep(0))
        stopped.wait(5.0)
        thread.call(loop_thread())

    stopped = threading.Event()

    async def stop(thread: MissionThread) -> None:
        thread.stop("Ctrl-C")
        stopped.set()

    with pytest.raises(MissionStopped, match="Ctrl-C"):
        fly(program, stop)


def test_stopping_just_as_a_verb_begins_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    async def stop_before_the_next_callback(thread: MissionThread) -> None:
        loop = asyncio.get_running_loop()
        schedule = loop.call_soon_threadsafe

        def stop_first(*callback: Any) -> Any:
            schedule(thread.stop, "Ctrl-C")
            return schedule(*callback)

        monkeypatch.setattr(loop, "call_soon_threadsafe", stop_first)
        begun.set()

    begun = threading.Event()

    def program(thread: MissionThread) -> None:
        assert begun.wait(5.0)
        thread.call(asyncio.sleep(60.0))

    with pytest.raises(MissionStopped, match="Ctrl-C"):
        fly(program, stop_before_the_next_callback)


def test_a_mission_that_returns_although_it_was_stopped_has_ended() -> None:
    async def stop(thread: MissionThread) -> None:
        thread.stop("Ctrl-C")

    def program(thread: MissionThread) -> None:
        try:
            thread.call(asyncio.sleep(60.0))
        except MissionStopped:
            return

    fly(program, stop)


def test_a_stopped_mission_that_is_busy_with_itself_is_left_behind() -> None:
    released, ended = threading.Event(), threading.Event()
    late: list[object] = []

    def program(thread: MissionThread) -> None:
        released.wait(5.0)
        try:
            thread.call(asyncio.sleep(0))
        except MissionStopped as stopped:
            late.append(stopped)
        ended.set()

    async def main() -> None:
        thread = MissionThread(grace_s=0.05)
        asyncio.get_running_loop().call_soon(thread.stop, "Ctrl-C")
        with pytest.raises(MissionStopped, match="Ctrl-C"):
            await thread.run(lambda: program(thread))
        assert not late
        released.set()
        assert await asyncio.to_thread(ended.wait, 5.0)
        assert late, "and no verb of it has effect any more"

    asyncio.run(main())


def test_a_mission_whose_run_is_cancelled_flies_no_further() -> None:
    outcome: list[object] = []
    cancelled, ended = threading.Event(), threading.Event()

    def program(thread: MissionThread) -> None:
        assert cancelled.wait(5.0)
        try:
            outcome.append(thread.call(loop_thread()))
        except MissionStopped as stopped:
            outcome.append(stopped)
        ended.set()

    async def cancel() -> None:
        thread = MissionThread()
        run = asyncio.create_task(thread.run(lambda: program(thread)))
        await asyncio.sleep(0)
        run.cancel()
        with pytest.raises(asyncio.CancelledError):
            await run
        cancelled.set()
        assert await asyncio.to_thread(ended.wait, 5.0)

    asyncio.run(cancel())
    assert isinstance(outcome[0], MissionStopped)
