"""A pytest plugin: plants defects in functions, each in a fork of the process that has collected the tests.

The environment's MUTATION_JOBS names a file of jobs, one JSON object a line; each gets a line in the file beside it.
"""

from __future__ import annotations

import gc
import json
import os
import select
import signal
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import CodeType, FunctionType

import msgspec
import pytest
from hypothesis import Phase, settings
from tests.mutation.mutants import Mutant

MOST_S = 20.0  # of computing, for the tests of one defect; later tests are left out
HANGS_S = 400.0  # pytest ends a test that hangs, unless the interpreter itself hangs


class Job(msgspec.Struct):
    """A defect, None where it is in the sources already, and the tests that judge it, in order."""

    mutant: Mutant | None
    tests: list[str]


class Outcome(msgspec.Struct):
    """The test that found the defect, "" for none, or None where the defect could not be planted; and the seconds."""

    found_by: str | None
    took_s: float


def pytest_configure(config: pytest.Config) -> None:
    """Begin; the drawn tests draw the same each time, and make no failure small."""
    settings.register_profile(
        "planted", settings(), derandomize=True, phases=[Phase.explicit, Phase.generate]
    )
    settings.load_profile("planted")
    config.pluginmanager.register(Planting())


class Planting:
    """Runs jobs in place of the collected tests."""

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Judge each defect."""
        if session.testsfailed:
            raise session.Interrupted("the tests cannot be collected")
        items = {item.nodeid: item for item in session.items}
        file = Path(os.environ["MUTATION_JOBS"])
        gc.freeze()
        with file.with_suffix(".outcomes").open("wb", buffering=0) as outcomes:
            for line in file.read_bytes().splitlines():
                job = msgspec.json.decode(line, type=Job, dec_hook=lambda kind, text: kind(text))
                chosen = [items[test] for test in job.tests if test in items]
                outcomes.write(msgspec.json.encode(_in_fork(job.mutant, chosen, session)) + b"\n")
        return True


def _in_fork(mutant: Mutant | None, tests: Sequence[pytest.Item], session: pytest.Session) -> Outcome:
    began_s = time.monotonic()
    reads, writes = os.pipe()
    child = os.fork()
    if child == 0:
        os.setsid()
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        found_by = _first_failure(tests, session) if mutant is None or plant(mutant) else None
        os.write(writes, json.dumps(found_by).encode())
        os._exit(0)
    os.close(writes)
    ended, _, _ = select.select([reads], [], [], HANGS_S)
    found_by = os.read(reads, 2**16).decode() if ended else '"a hang"'
    os.close(reads)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return Outcome(json.loads(found_by or '"a crash"'), time.monotonic() - began_s)


def _first_failure(tests: Sequence[pytest.Item], session: pytest.Session) -> str:
    began_s = time.process_time()
    for test, following in zip(tests, [*tests[1:], None], strict=True):
        if time.process_time() - began_s > MOST_S:
            break
        ends_s = time.monotonic() + test.config.getoption("timeout")
        try:
            test.config.hook.pytest_runtest_protocol(item=test, nextitem=following)
        except BaseException:  # noqa: BLE001 - the defect can end pytest too
            return test.nodeid
        if (
            session.testsfailed or time.monotonic() > ends_s
        ):  # a task can swallow the failure of a test that hangs
            return test.nodeid
    return ""


def plant(mutant: Mutant) -> bool:
    """Gives the function, which is imported, the code with the defect; returns whether that was possible."""
    outer = mutant.function.partition(".<locals>")[0]
    if not outer:
        return False
    codes = [
        code
        for code in _codes(compile(mutant.applied(), str(mutant.file), "exec"))
        if code.co_qualname == outer and code.co_firstlineno <= mutant.line
    ]
    latest = max(codes, key=lambda code: code.co_firstlineno)
    gc.unfreeze()
    functions = [
        found
        for found in gc.get_objects()
        if isinstance(found, FunctionType)
        and found.__code__.co_qualname == outer
        and found.__code__.co_firstlineno == latest.co_firstlineno
        and Path(found.__code__.co_filename) == mutant.file
    ]
    try:
        for function in functions:
            function.__code__ = latest
    except ValueError:  # other variables of outer functions
        return False
    return bool(functions)


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)
