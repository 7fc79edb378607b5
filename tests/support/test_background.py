"""Each way to run work in the background, and what its failure leads to."""

from __future__ import annotations

import ast
import asyncio
import threading
from pathlib import Path
from typing import NoReturn

import pytest

import upwash
from upwash.support.background import begin, beside, end, first, kept_up, never, start, thread


async def fail(*, after_turns: int = 0) -> NoReturn:
    for _ in range(after_turns):
        await asyncio.sleep(0)
    raise LookupError("a defect")


def test_work_that_fails_beside_a_block_ends_the_block_with_its_failure() -> None:
    async def block() -> None:
        async with beside(fail(), name="work"):
            await never()

    with pytest.raises(LookupError, match="a defect"):
        asyncio.run(block())


def test_a_block_that_fails_raises_its_own_failure_and_logs_that_of_the_work(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def fail_at_the_end() -> None:
        try:
            await never()
        finally:
            await fail()

    async def block() -> None:
        async with beside(fail_at_the_end(), name="work"):
            await asyncio.sleep(0)
            try:
                raise KeyError("cause")
            except KeyError as cause:
                raise ValueError("the block") from cause

    with pytest.raises(ValueError, match="the block") as raised:
        asyncio.run(block())
    assert isinstance(raised.value.__cause__, KeyError)
    assert "work failed: LookupError: a defect" in caplog.text


def test_work_beside_a_block_ends_with_it() -> None:
    ended = []

    async def work() -> None:
        try:
            await never()
        finally:
            ended.append(True)

    async def block() -> str:
        async with beside(work(), name="work"):
            await asyncio.sleep(0)
            return "the block's own"

    assert asyncio.run(block()) == "the block's own"
    assert ended


async def test_cancelling_a_block_cancels_its_owner() -> None:
    async def block() -> None:
        async with beside(never(), name="work"):
            await never()

    task = begin(block())
    await asyncio.sleep(0)
    await end(task)
    assert task.cancelled()


async def test_the_failure_of_started_work_is_logged_with_its_trace_and_has_its_consequence(
    caplog: pytest.LogCaptureFixture,
) -> None:
    failures: list[Exception] = []

    task = start(fail(), name="the work", failed=failures.append)
    await asyncio.wait([task])
    await end(task)
    assert [str(failure) for failure in failures] == ["a defect"]
    (record,) = caplog.records
    assert record.levelname == "ERROR" and record.getMessage() == "the work failed: LookupError: a defect"
    assert record.exc_info and record.exc_info[1] is failures[0]


async def test_started_work_that_is_ended_has_not_failed(caplog: pytest.LogCaptureFixture) -> None:
    task = start(never(), name="the work", failed=lambda _: pytest.fail("it was ended"))
    await asyncio.sleep(0)
    await end(task, None)
    assert task.cancelled()
    assert not caplog.records


def test_who_awaits_begun_work_gets_its_failure() -> None:
    async def main() -> None:
        await begin(fail(after_turns=1))

    with pytest.raises(LookupError):
        asyncio.run(main())


def test_begun_work_that_fails_unawaited_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    async def main() -> None:
        begin(fail())
        await asyncio.sleep(0)
        await asyncio.sleep(0)

    asyncio.run(main())
    assert "a defect" in caplog.text


def test_a_thread_that_fails_is_logged_and_has_its_consequence(caplog: pytest.LogCaptureFixture) -> None:
    failures: list[tuple[str, str]] = []

    def work() -> None:
        raise LookupError("a defect")

    runs = thread(
        work,
        name="reader",
        failed=lambda error: failures.append((str(error), threading.current_thread().name)),
    )
    runs.start()
    runs.join()
    assert failures == [("a defect", "reader")]
    assert "reader failed: LookupError: a defect" in caplog.text


@pytest.mark.virtual
async def test_work_that_is_kept_up_runs_again_after_a_failure_which_is_told_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    runs: list[int] = []
    failures: list[Exception] = []

    async def work() -> None:
        runs.append(len(runs))
        if len(runs) == 4:
            await never()
        raise LookupError("a defect")

    kept = start(
        kept_up(work, name="heartbeats", pause_s=1.0, failed=failures.append),
        name="heartbeats",
        failed=failures.append,
    )
    await asyncio.sleep(10.0)
    await end(kept)
    assert runs == [0, 1, 2, 3]
    assert len(failures) == 1 and len(caplog.records) == 1


def loops_own_tasks(source: str) -> list[int]:
    """The lines of a module that make a task outside of an `asyncio.TaskGroup`, which the linter does not see."""
    return [
        node.lineno
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Attribute)
        and node.attr in ("create_task", "ensure_future")
        and not ast.unparse(node.value).endswith(("tasks", "group"))
    ]


def test_nothing_else_makes_tasks_of_a_loop() -> None:
    package = Path(upwash.__file__).parent
    made = {
        str(file.relative_to(package)): loops_own_tasks(file.read_text()) for file in package.rglob("*.py")
    }
    assert [file for file, lines in made.items() if lines] == ["support/background.py"]
    assert loops_own_tasks("asyncio.get_running_loop().create_task(work())\nself._loop.create_task(a)") == [
        1,
        2,
    ]


async def test_the_first_to_end_decides_and_the_others_have_ended() -> None:
    ended = []

    async def slow() -> str:
        try:
            await never()
        finally:
            ended.append("slow")

    async def quick() -> str:
        return "quick"

    assert await first(slow(), quick()) == "quick"
    assert ended == ["slow"]


def test_a_wait_that_fails_first_fails_the_race() -> None:
    async def main() -> None:
        await first(never(), fail(after_turns=1))

    with pytest.raises(LookupError):
        asyncio.run(main())


async def test_a_race_that_is_cancelled_cancels_its_waits() -> None:
    ended = []

    async def wait() -> None:
        try:
            await never()
        finally:
            ended.append(True)

    race = begin(first(wait(), wait()))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    await end(race)
    assert race.cancelled() and ended == [True, True]
