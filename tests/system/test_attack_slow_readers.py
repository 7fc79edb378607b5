"""Nobody who is slow holds a thread, or up who is not."""

from __future__ import annotations

import asyncio

import pytest
from tests.system.attacks.slow_readers import attack

pytestmark = pytest.mark.system


def test_the_slow_hold_no_thread_and_nobody_up() -> None:
    before, meanwhile, _ = asyncio.run(attack())  # in which an honest fetch was answered
    assert meanwhile <= before
