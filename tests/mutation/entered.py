"""A pytest plugin: notes which functions each test enters.

The environment's MUTATION_ENTERED names the file that it writes.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Generator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

SOURCES = "src/upwash/"


class Notes:
    """The functions that each test enters; what tests share counts for each of them."""

    def __init__(self) -> None:
        self._functions: dict[str, list[str]] = {}
        self._of_fixture: dict[object, set[CodeType]] = {}
        self._now: set[CodeType] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        """Trace one test."""
        for shared in vars(getattr(item, "module", None) or object).values():
            if hasattr(shared, "cache_clear"):
                shared.cache_clear()
        self._now = set()
        threading.settrace(self._enter)
        sys.settrace(self._enter)
        done = yield
        sys.settrace(None)
        fixtures = getattr(item, "_fixtureinfo", None)
        for definitions in fixtures.name2fixturedefs.values() if fixtures is not None else ():
            for definition in definitions:
                self._now |= self._of_fixture.get(definition, set())
        found = {(code.co_filename.partition(SOURCES), code.co_qualname) for code in self._now.copy()}
        self._functions[item.nodeid] = sorted(f"{SOURCES}{file[2]}:{name}" for file, name in found if file[2])
        return done

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[None, Any, Any]:
        """Keep what a fixture of several tests enters."""
        outer, self._now = self._now, set()
        try:
            return (yield)
        finally:
            if fixturedef.scope != "function":
                self._of_fixture[fixturedef] = self._now
            self._now = outer | self._now

    def pytest_sessionfinish(self) -> None:
        """Write the notes."""
        Path(os.environ["MUTATION_ENTERED"]).write_text(json.dumps({"functions": self._functions}))

    def _enter(self, frame: FrameType, *_: object) -> None:
        self._now.add(frame.f_code)


def pytest_configure(config: pytest.Config) -> None:
    """Begin."""
    config.pluginmanager.register(Notes())
