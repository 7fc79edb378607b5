"""Real processes and real links under faults: a few seeds of what `python -m tests.system.faults` flies."""

from __future__ import annotations

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from tests.system.faults.__main__ import fly, told
from tests.system.faults.plan import draw

pytestmark = [
    pytest.mark.root,
    pytest.mark.system,
    pytest.mark.flight,
    pytest.mark.timeout(600),
    pytest.mark.xdist_group("emulate"),  # whose tests clean up after each other
    pytest.mark.skipif(os.geteuid() != 0, reason="makes network namespaces: needs root"),
    *(
        pytest.mark.skipif(not shutil.which(tool), reason=f"needs {package}")
        for tool, package in (("ip", "iproute2"), ("nft", "nftables"))
    ),
]

AT_ONCE = 2  # more are late where other tests fly beside them
SEEDS = (0, 4, 7, 8)  # every length of a black-out, garbage or nothing from a peer, and lost frames


def test_the_promises_hold_whatever_is_killed_frozen_cut_or_answers_garbage(tmp_path: Path) -> None:
    with ThreadPoolExecutor(AT_ONCE) as pool:
        verdicts = list(pool.map(lambda seed: fly(seed, tmp_path / str(seed)), SEEDS))
    for seed, verdict in zip(SEEDS, verdicts, strict=True):
        assert not verdict.broken, "\n".join(told(seed, verdict))
        assert {strike.said for strike in verdict.record.strikes} <= {str(fault) for fault in draw(seed)}
        assert verdict.remote_calls > 0
