"""The comparison with other clients, made short: its trials run, and every cell of its table is measured."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from pathlib import Path

import msgspec
import pytest
from bench.peers.order import SCENARIOS, Comparison
from bench.results import Result
from tests.programs import printed

PEERS = ("`requests`, time-out 2 s", "upwash, defaults")
CALLS = 5

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.root,
    pytest.mark.system,
    pytest.mark.xdist_group("emulate"),  # whose tests clean up after each other
    pytest.mark.skipif(os.geteuid() != 0, reason="makes network namespaces: needs root"),
    pytest.mark.skipif(not importlib.util.find_spec("requests"), reason="needs requests"),
    *(
        pytest.mark.skipif(not shutil.which(tool), reason=f"needs {package}")
        for tool, package in (("ip", "iproute2"), ("nft", "nftables"))
    ),
]


def test_every_trial_is_made_and_no_failure_of_a_server_reaches_the_mission(tmp_path: Path) -> None:
    out = tmp_path / "peers.json"
    command = ["bench.peers", "--python", sys.executable, "--peers", "http", "upwash", "--calls", str(CALLS)]
    table = printed(*command, "--fault-s", "3", "--local", "1", "--at-once", "10", "--out", out)
    result = msgspec.json.decode(out.read_bytes(), type=Result)
    comparison = msgspec.convert(result.figures, Comparison)
    assert {"requests", "upwash"} <= comparison.versions.keys()
    figures = {(trial.peer, trial.scenario): trial.figures for trial in comparison.trials}
    assert figures.keys() == {(peer, scenario) for peer in PEERS for scenario in SCENARIOS}
    for (peer, scenario), each in figures.items():
        assert each is not None
        assert each.raised == [], (peer, scenario)
        assert each.by_server + each.by_drone == CALLS
        assert each.by_drone <= each.drone_computed
        if scenario == "none":
            assert (each.by_server, each.server_computed, each.back_s) == (CALLS, CALLS, None)
        elif scenario in ("black-out", "killed"):
            assert each.by_drone > 0
    rows = [line for line in table.splitlines() if line.startswith(tuple(f"| {peer}" for peer in PEERS))]
    assert len(rows) == 2 * len(PEERS)  # in a table of what the mission saw, and in one of what was computed
    assert all(row.count("|") == len(SCENARIOS) + 2 for row in rows)
