"""Worlds full of faults: every promise holds in each of them."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import get_args

import msgspec
import pytest
from tests.sim.planted import deadline_ignored

from upwash.cli.arguments import seeds
from upwash.cli.main import main
from upwash.config.drone_file import drone_config
from upwash.config.world import Lie
from upwash.lab.faults import campaign as chaos
from upwash.lab.faults.display import Summary, judge_all
from upwash.lab.faults.worlds import SEEDS_PER_SCENARIO, World, configs
from upwash.lab.scenario import as_toml

WORLDS, CHUNK = 1_000, 100  # of the same seeds every time, and as many of seeds of the day


def assert_kept(seeds: range) -> None:
    assert sum(verdict.calls for verdict in judged(seeds)) > 2 * len(seeds)


def judged(seeds: range) -> list[chaos.WorldVerdict]:
    """The verdicts of the seeds, which broke no promise."""
    verdicts = judge_all(seeds)
    for verdict in verdicts:
        assert verdict.broken == [], f"see it again: upwash chaos --seed {verdict.seed} --log chaos.jsonl"
    return verdicts


@pytest.mark.parametrize(
    "first",
    [
        1,
        pytest.param(1 + CHUNK, marks=pytest.mark.long),
        *(
            pytest.param(first, marks=pytest.mark.nightly)
            for first in range(1 + 2 * CHUNK, WORLDS + 1, CHUNK)
        ),
    ],
)
def test_promises_hold_in_known_worlds(first: int) -> None:
    assert_kept(range(first, first + CHUNK))


def test_an_answer_that_waited_for_its_act_is_not_of_the_last_call() -> None:
    """It was raised on the drone before a server answered the next call."""
    judged(range(739950586, 739950587))


def test_a_way_back_leads_to_the_waypoint_behind_where_another_ahead_has_its_place() -> None:
    """The drone stays at the last waypoint, which lies at the place of the first."""
    judged(range(739950417, 739950418))


@pytest.mark.nightly  # as its verdict is another each day
@pytest.mark.parametrize("chunk", range(WORLDS // CHUNK))
def test_promises_hold_in_worlds_of_the_day(chunk: int) -> None:
    first = datetime.now(UTC).toordinal() * WORLDS + chunk * CHUNK + 1
    sys.stdout.write(f"seeds {first}..{first + CHUNK - 1}\n")
    assert_kept(range(first, first + CHUNK))


def test_a_seed_gives_the_same_world_and_log_in_any_process(tmp_path: Path) -> None:
    seed = next(seed for seed in itertools.count(1) if len(World(seed).faulty(seed, [])) > 1)
    logs = [tmp_path / name / "log.jsonl" for name in ("0", "4711")]
    for log in logs:
        subprocess.run(
            [sys.executable, "-m", "upwash", "chaos", "--seed", str(seed), "--log", str(log)],
            env={**os.environ, "PYTHONHASHSEED": log.parent.name},
            stdout=subprocess.DEVNULL,
            timeout=60,
            check=True,
        )
    first, second = ({each.name: each.read_bytes() for each in log.parent.iterdir()} for log in logs)
    assert first == second
    assert {"log.jsonl", "log.toml", "log-d2.jsonl", "log-d2.toml", "log-seen.jsonl"} <= set(first)


def test_the_scenario_that_is_written_is_the_one_that_was_flown() -> None:
    for seed in range(1, 200, SEEDS_PER_SCENARIO):
        documents = World(seed).faulty(seed, [])
        written = [drone_config(tomllib.loads(as_toml(document)), Path("log.toml")) for document in documents]
        assert written == configs(documents)


def test_worlds_have_faults_of_every_kind_everywhere() -> None:
    drawn = {
        (fault["target"].partition(":")[0].rstrip("0123456789"), fault["kind"])
        for seed in range(1, 1000, SEEDS_PER_SCENARIO)
        for fault in World(seed).faulty(seed, [])[0]["fault"]
    }
    moving = {"off", "stuck", "slow", "flapping"}
    of_instances = {"crash", "power-cut", "hung", "poisoned", "unstartable"}
    on_servers = moving | of_instances | {"garbage", "wrong", "lying", "full"}
    incidents = {
        "pilot",
        "fail-safe",
        "diverted",
        "home",
        "jump",
        "restart",
        "impostor",
        "battery",
        "hovers",
        "rally",
    }
    assert drawn == {("s", kind) for kind in on_servers} | {
        (target, kind) for target in ("link", "autopilot") for kind in moving
    } | {("autopilot", kind) for kind in incidents}


def test_servers_tell_every_lie_somewhere() -> None:
    told = {
        fault["lie"]
        for seed in range(1, 400, SEEDS_PER_SCENARIO)
        for fault in World(seed).faulty(seed, [])[0]["fault"]
        if fault["kind"] == "lying"
    }
    assert told == set(get_args(Lie))


def test_networks_are_left_slowly_and_slow_the_drone_down_somewhere() -> None:
    drawn = [config for seed in range(1, 400, SEEDS_PER_SCENARIO) for config in configs(World(seed).calm())]
    leaving = {server.truth.leave_s for config in drawn for server in config.servers}
    slower = {
        share
        for config in drawn
        for service in config.services
        for share in service.local_joining_slowdown.values()
    }
    assert leaving == {0.0, 0.5, 3.0}
    assert slower == {0.0, 0.2, 1.0}


def test_a_broken_promise_is_named_with_its_first_bad_event(capsys: pytest.CaptureFixture[str]) -> None:
    chaos._fly_calm.cache_clear()
    with deadline_ignored():
        assert main(["chaos", "--seed", "1"]) == 1
    chaos._fly_calm.cache_clear()
    printed = capsys.readouterr().out
    assert "promise 2 (bounded calls) broken by seed 1: took " in printed
    assert 'first bad event: {"event":' in printed


def test_worlds_are_flown_on_several_cores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left = tmp_path / "results" / "chaos.json"
    assert main(["chaos", "--seeds", "1..42", "--workers", "2", "--out", str(left)]) == 0
    printed = capsys.readouterr().out
    assert "42 worlds with " in printed and "no promise broken" in printed
    summary = msgspec.json.decode(left.read_bytes(), type=Summary)
    assert (summary.worlds, summary.replayed, summary.broken) == (42, 2, [])
    assert f"with {summary.flights:,} flights and {summary.calls:,} calls" in printed


def test_seeds_are_a_number_as_in_other_commands_or_a_range() -> None:
    assert seeds("3") == range(1, 4)
    assert seeds("3..5") == range(3, 6)


@pytest.mark.parametrize(
    "options",
    [
        ["--seeds", "seven"],
        ["--seeds", "0"],
        ["--seeds", "7.."],
        ["--seeds", "9..3"],
        ["--seeds", "0..3"],
        ["--seed", "0"],
        [],
        ["--seed", "1", "--seeds", "1..2"],
    ],
)
def test_seeds_that_are_none_are_refused(options: list[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["chaos", *options])


@pytest.mark.parametrize(
    "options",
    [["--seed", "1", "--minutes", "3"], ["--seed", "1", "--out", "x"], ["--seeds", "1..2", "--log", "x"]],
)
def test_options_that_do_not_go_together_are_refused(options: list[str]) -> None:
    assert main(["chaos", *options]) == 2
