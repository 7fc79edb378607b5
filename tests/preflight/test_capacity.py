from __future__ import annotations

import itertools
from pathlib import Path

import msgspec
import pytest

from upwash.cli.main import main
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import read_drone_config
from upwash.errors import UsageError
from upwash.preflight.capacity import SLOWER, capacity_of

SCENARIO = """
[mission]
mode = "heavy"
waypoints_m = [[0, 0], [10, 0], [20, 0], [30, 0], [40, 0], [50, 0]]
[[service]]
name = "detector"
local_call_s = { heavy = 10.0 }
[[server]]
name = "s1"
east_m = 25.0
north_m = 0.0
range_m = 100.0
check_s = 1.0
check_running_s = 0.5
remote_call_s = 2.0
[server.truth]
slots = 64
"""


@pytest.fixture
def config(tmp_path: Path) -> DroneConfig:
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    return read_drone_config(tmp_path / "scenario.toml")


def test_a_server_that_computes_a_call_at_a_time_carries_as_many_as_its_time_allows(
    config: DroneConfig,
) -> None:
    found = capacity_of(config, "scenario")
    assert [load.drones for load in found.loads][:3] == [1, 2, 3]
    busiest = max(load.calls_per_min["s1"] for load in found.loads)
    assert 15 < busiest <= 30  # of 2 s each, take-off and landing included
    assert found.loads[-1].saved < found.loads[0].saved / 2
    for less, more in itertools.pairwise(found.loads):
        assert more.mean_s >= 0.98 * less.mean_s
    carried = next(load for load in found.loads if load.drones == found.carried)
    assert carried.mean_s <= SLOWER * found.loads[0].mean_s
    assert 1 < found.carried < found.loads[-1].drones


def test_where_every_call_runs_on_the_drone_nobody_is_carried(config: DroneConfig) -> None:
    local_only = msgspec.structs.replace(
        config, policy=msgspec.structs.replace(config.policy, name="local-only")
    )
    with pytest.raises(UsageError, match="every call runs on the drone: name servers, and another policy"):
        capacity_of(local_only, "scenario")


def test_the_command_prints_what_was_found(
    config: DroneConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["check", str(tmp_path / "scenario.toml"), "--capacity"])
    said = " ".join(capsys.readouterr().out.split())
    found = capacity_of(config, "scenario")
    assert f"the servers carry {found.carried} drones" in said
    main(["check", str(tmp_path / "scenario.toml"), "--capacity", "--json"])
    printed = msgspec.json.decode(capsys.readouterr().out)
    assert printed["carried"] == found.carried
    assert printed["loads"] == list(msgspec.to_builtins(found.loads))
