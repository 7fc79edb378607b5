"""An unhandled failure ends a run on virtual time."""

from __future__ import annotations

import asyncio
from typing import NoReturn

import pytest

from upwash.errors import Unreachable
from upwash.sim.loop import end_run, run_virtually
from upwash.support.background import begin, never, start


async def fail(error: Exception) -> NoReturn:
    raise error


def test_a_callback_that_raises_ends_the_run() -> None:
    async def main() -> None:
        asyncio.get_running_loop().call_later(1.0, [].pop)
        await asyncio.sleep(2.0)
        pytest.fail("it goes on")

    with pytest.raises(IndexError):
        run_virtually(main())


def test_a_task_that_fails_unawaited_ends_the_run() -> None:
    async def main() -> None:
        begin(fail(LookupError("a defect")))
        await asyncio.sleep(1.0)
        pytest.fail("it goes on")

    with pytest.raises(LookupError, match="a defect"):
        run_virtually(main())


def test_work_may_end_the_run_with_its_failure() -> None:
    async def main() -> None:
        daemon = start(fail(LookupError("a defect")), name="daemon", failed=end_run)
        await never()
        del daemon

    with pytest.raises(LookupError, match="a defect"):
        run_virtually(main())


def test_a_failure_that_work_may_end_with_ends_no_run() -> None:
    async def main() -> str:
        begin(fail(Unreachable("nobody waits for this answer")))
        await asyncio.sleep(1.0)
        return "done"

    assert run_virtually(main()) == "done"
