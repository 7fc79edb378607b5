from __future__ import annotations

import contextlib
import csv
import itertools
import json
import math
import os
import re
import signal
import statistics
import subprocess
import sys
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from random import Random

import msgspec
import pytest
from tests.waiting import wait_for

from upwash.cli.main import main
from upwash.config.drone_file import drone_config, read_drone_config
from upwash.config.reading import read_document
from upwash.errors import ConfigError, UsageError
from upwash.lab import processes
from upwash.lab.campaigns.campaign import (
    Chunk,
    CombinationSummary,
    Cost,
    fly_chunk,
    in_processes,
    on_cluster,
    run_campaign,
)
from upwash.lab.campaigns.file import CampaignFile, CampaignRow
from upwash.lab.campaigns.sweep import ParameterSweep, read_setting, read_sweep
from upwash.lab.run import simulate
from upwash.lab.scenario import with_value
from upwash.support.confidence import mean_of, student_quantile

SCENARIO = """
[mission]
mode = "heavy"
waypoints_m = [[0, 0], [60, 0], [120, 0], [180, 0]]

[[service]]
name = "detector"
local_call_s = { light = 3.0, heavy = 10.0 }

[[server]]
name = "s1"
east_m = 0.0
north_m = 0.0
range_m = 100.0
remote_call_s = { light = 0.3, heavy = 0.7 }

[[server]]
name = "s1.far"
east_m = 180.0
north_m = 0.0
range_m = 100.0
remote_call_s = { light = 0.3, heavy = 0.7 }

[noise]
call = 0.1
leg = 0.1
"""

# Fails where the plan leads further than 100 m.
UNRELIABLE = """
def survey(drone):
    drone.autopilot.arm()
    drone.autopilot.takeoff(altitude_m=20)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
    if drone.plan[-1].position.east_m > 100:
        raise ValueError("too far\\nfrom home")
    drone.autopilot.return_home_and_land()
    drone.autopilot.disarm()
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    file = tmp_path / "line.toml"
    file.write_text(SCENARIO)
    return file


@contextlib.contextmanager
def here(chunks: Sequence[Chunk]) -> Generator[Iterator[list[CampaignRow]]]:
    """Flies in this process, the chunks in an order that no campaign may depend on."""
    yield (fly_chunk(chunk) for chunk in Random(len(chunks)).sample(chunks, len(chunks)))


def interrupted_after(count: int, chunks: Sequence[Chunk]) -> Iterator[list[CampaignRow]]:
    for chunk in chunks[:count]:
        yield fly_chunk(chunk)
    raise KeyboardInterrupt


def run_here(sweep: ParameterSweep, out: Path) -> list[CombinationSummary]:
    return run_campaign(CampaignFile.open(out, sweep), fly=here)


def cells(out: Path) -> list[dict[str, str]]:
    with out.open(newline="") as lines:
        return list(csv.DictReader(lines))


# --- which runs ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("policy.gain_wait=0.1,0.25", (0.1, 0.25)),
        ("policy.name=local-only,location-aware", ("local-only", "location-aware")),
        ('policy.name="local-only"', ("local-only",)),
        ("server.s1.remote_call_s={ light = 0.3, heavy = 1 }", ({"light": 0.3, "heavy": 1},)),
        ("mission.waypoints_m=[[0, 0]],[[0, 0], [20, 0]]", ([[0, 0]], [[0, 0], [20, 0]])),
        ("mission.grid.rows_alternate = true, false", (True, False)),
    ],
)
def test_values_are_written_as_in_toml_and_strings_need_no_quotes(
    text: str, values: tuple[object, ...]
) -> None:
    assert read_setting(text).values == values


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("policy.gain_wait", "is not KEY="),
        ("policy.gain_wait=", "is not KEY="),
        ("=3", "is not KEY="),
        ("seed=1,2", "seed cannot be set"),
        ("policy.gain_wait=0.1,0.10", "to 0.1 twice"),
    ],
)
def test_a_setting_that_cannot_be_understood_is_refused(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        read_setting(text)


def test_a_key_names_a_server_by_its_name_even_one_with_dots(scenario: Path) -> None:
    document = read_document(scenario)
    for key, expected in (
        ("server.s1.range_m", [80, 100.0]),
        ("server.s1.far.range_m", [100.0, 80]),
    ):
        changed = drone_config(with_value(document, scenario, key, 80), scenario)
        assert [server.range_m for server in changed.servers] == expected
    assert document == read_document(scenario), "the document itself stays as it is"


def test_a_key_names_a_table_without_name_by_its_number(scenario: Path) -> None:
    with scenario.open("a") as file:
        file.write('[[fault]]\ntarget = "s1"\nkind = "stuck"\n')
    changed = with_value(read_document(scenario), scenario, "fault.0.kind", "slow")
    assert [fault.kind for fault in drone_config(changed, scenario).faults] == ["slow"]


def test_turns_without_end_can_be_set_and_are_told_as_written(scenario: Path) -> None:
    sweep = read_sweep(scenario, ["server.s1.truth.turn_s=30,inf"], seeds=1)
    assert [combination.values for combination in sweep.combinations] == [("30",), ("inf",)]
    flown = [
        drone_config(combination.document, scenario).servers[0].truth.turn_s
        for combination in sweep.combinations
    ]
    assert flown == [30.0, math.inf]
    with pytest.raises(ConfigError, match="a finite number, found inf"):
        read_sweep(scenario, ["server.s1.truth.join_s=3,inf"], seeds=1)


def test_a_key_adds_the_tables_that_lead_to_it(scenario: Path) -> None:
    changed = with_value(read_document(scenario), scenario, "server.s1.truth.join_s", 7)
    changed = with_value(changed, scenario, "heat.load_w", 3)
    config = drone_config(changed, scenario)
    assert config.servers[0].truth.join_s == 7
    assert config.heat is not None
    assert config.heat.load_w == 3


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("policy.gian_wait=0.1", "policy.gian_wait"),
        ("policy.gain_wait=0.1,7", "policy.gain_wait"),
        ("policy.gain_wait=inf", "policy.gain_wait"),
        ("mission.mode.more=1", "mission.mode"),
        ("server.s9.range_m=80", "server"),
        ("server.s1=80", "server.s1"),
        ("server.s1.range_m=-1", "server[0].range_m"),
        ("service.0.request_bytes=3", "service"),
        ("polcy.gain_wait=0.1", "polcy"),
    ],
)
def test_what_no_scenario_may_say_is_refused_with_its_key(scenario: Path, setting: str, key: str) -> None:
    with pytest.raises(ConfigError) as refused:
        read_sweep(scenario, [setting], seeds=1)
    assert refused.value.key == key


def test_every_combination_is_checked_before_anything_runs(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.csv"
    arguments = [
        "campaign",
        str(scenario),
        "--seeds",
        "1",
        "--set",
        "server.s1.check_s=11,1",
        "--out",
        str(out),
    ]
    assert main(arguments) == 2
    assert "server[0].check_s" in capsys.readouterr().err
    assert not out.exists()


def test_a_sweep_is_the_product_of_its_settings_in_their_order(scenario: Path) -> None:
    sweep = read_sweep(scenario, ["policy.gain_wait=0.1,0.25", "mission.mode=light,heavy"], seeds=3)
    assert [combination.values for combination in sweep.combinations] == [
        ("0.1", "light"), ("0.1", "heavy"), ("0.25", "light"), ("0.25", "heavy"),
    ]  # fmt: skip


# --- what they come to --------------------------------------------------------------------------------------


def test_each_row_is_what_a_single_simulation_comes_to(scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    run_here(read_sweep(scenario, ["policy.name=local-only,location-aware"], seeds=7), out)
    rows = cells(out)
    assert len(rows) == 14
    config = read_drone_config(scenario)
    for row in rows:
        policy = msgspec.structs.replace(config.policy, name=row["policy.name"])
        run = simulate(msgspec.structs.replace(config, policy=policy, seed=int(row["seed"])))
        totals = run.result.totals
        assert float(row["mission_time_s"]) == run.result.mission_time_s
        assert float(row["service_delay_s"]) == totals.service_delay_s
        assert row["policy"] == row["policy.name"]
        assert (row["completed"], row["failure"]) == ("true", "")
        assert [int(row[name]) for name in ("calls", "local", "remote", "waits", "waits_failed", "switches")] == [
            totals.calls, totals.local, sum(totals.remote.values()),
            totals.waits, totals.waits_failed, totals.switches,
        ]  # fmt: skip
    assert len({row["mission_time_s"] for row in rows}) == 14, "every seed has its own noise"


def test_the_summary_is_of_the_completed_runs_of_each_combination(scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    for summary in run_here(read_sweep(scenario, ["policy.name=local-only,location-aware"], seeds=6), out):
        times_s = [
            float(row["mission_time_s"]) for row in cells(out) if (row["policy.name"],) == summary.values
        ]
        mean = summary.mission_time_s
        assert mean is not None
        assert mean.count == 6
        assert mean.value == pytest.approx(statistics.fmean(times_s))
        assert mean.margin == pytest.approx(2.570582 * statistics.stdev(times_s) / math.sqrt(6))
        assert summary.failures == {}


def test_a_failing_run_is_a_row_with_its_reason_and_ends_no_other(scenario: Path, tmp_path: Path) -> None:
    (tmp_path / "unreliable.py").write_text(UNRELIABLE)
    out = tmp_path / "out.csv"
    sweep = read_sweep(
        scenario,
        ["mission.program=unreliable.py:survey", "mission.waypoints_m=[[0, 0], [60, 0]],[[0, 0], [120, 0]]"],
        seeds=2,
    )
    near, far = run_here(sweep, out)
    assert near.mission_time_s is not None
    assert (near.mission_time_s.count, near.failures) == (2, {})
    assert far.mission_time_s is None
    assert far.failures == dict.fromkeys((1, 2), "the mission program raised ValueError: too far from home")
    assert [row["completed"] for row in cells(out)] == ["true", "true", "false", "false"]
    assert {summary.values: summary.failures for summary in run_here(sweep, out)} == {
        near.values: near.failures,
        far.values: far.failures,
    }, "and is still one when the file is read again"


def test_failures_are_told_with_their_seeds_and_in_the_exit_code(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "unreliable.py").write_text(UNRELIABLE)
    out = tmp_path / "out.csv"
    arguments = ["campaign", str(scenario), "--seeds", "2", "--workers", "1", "--out", str(out)]
    assert main([*arguments, "--set", "mission.program=unreliable.py:survey"]) == 1
    said = capsys.readouterr().out
    assert "seed 1: the mission program raised ValueError: too far from home" in said
    assert "seed 2: the mission program raised ValueError: too far from home" in said


@pytest.mark.parametrize("with_noise", [True, False])
def test_an_interval_is_told_of_missions_that_differ_and_why_they_do_not(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], *, with_noise: bool
) -> None:
    if not with_noise:
        text = scenario.read_text()
        scenario = tmp_path / "quiet.toml"
        scenario.write_text(re.sub(r"^\[noise\]\n(?:[^\[\n].*\n)*", "", text, flags=re.MULTILINE))
    arguments = [
        "campaign",
        str(scenario),
        "--seeds",
        "2",
        "--workers",
        "1",
        "--out",
        str(tmp_path / "out.csv"),
    ]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert ("± 95 % confidence" in said, " ± 0.00" in said) == (with_noise, False)
    assert ("without [noise] all seeds are alike: one mission says it all" in said) == (not with_noise)


def test_a_parquet_file_has_the_rows_of_the_csv_file_beside_it(scenario: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra 'parquet' is not installed")
    run_here(read_sweep(scenario, ["policy.gain_wait=0.1,0.25"], seeds=3), tmp_path / "out.parquet")
    table = parquet.read_table(tmp_path / "out.parquet").to_pylist()
    rows = cells(tmp_path / "out.csv")
    assert [
        (row["policy.gain_wait"], row["seed"], row["mission_time_s"], row["failure"]) for row in table
    ] == [
        (float(row["policy.gain_wait"]), int(row["seed"]), float(row["mission_time_s"]), "") for row in rows
    ]


# --- interrupted and continued ------------------------------------------------------------------------------


def test_an_interrupted_campaign_flies_the_rest_and_ends_the_same(scenario: Path, tmp_path: Path) -> None:
    sweep = read_sweep(scenario, ["policy.gain_wait=0.1,0.25"], seeds=12)
    whole, parts = tmp_path / "whole.csv", tmp_path / "parts.csv"
    run_here(sweep, whole)

    @contextlib.contextmanager
    def stop_early(chunks: Sequence[Chunk]) -> Generator[Iterator[list[CampaignRow]]]:
        yield interrupted_after(2, chunks)

    with pytest.raises(KeyboardInterrupt):
        run_campaign(CampaignFile.open(parts, sweep), fly=stop_early)
    kept = parts.read_text()
    assert kept.count("\n") == 1 + 10
    parts.write_text(kept[:-20])  # as a kill in mid-write leaves it

    told: list[int] = []
    run_campaign(CampaignFile.open(parts, sweep), fly=here, flown=told.append)
    assert told[0] == 9
    assert sum(told) == 24
    assert parts.read_bytes() == whole.read_bytes()


def test_what_the_rest_costs_is_measured_on_missions_of_all_of_it(scenario: Path, tmp_path: Path) -> None:
    sweep = read_sweep(scenario, ["policy.gain_wait=0.1,0.25,0.3,0.4"], seeds=10)
    out, costs, told = tmp_path / "out.csv", list[Cost](), list[int]()
    left: list[Chunk] = []

    @contextlib.contextmanager
    def note(chunks: Sequence[Chunk]) -> Generator[Iterator[list[CampaignRow]]]:
        left.extend(chunks)
        with here(chunks) as rows:
            yield rows

    run_campaign(CampaignFile.open(out, sweep), fly=note, flown=told.append, costs=costs.append)
    (cost,) = costs
    assert cost.missions == sum(len(chunk.seeds) for chunk in left) == 32, "eight were flown to measure"
    assert cost.mission_s > 0
    assert {
        seeds: len(list(group)) for seeds, group in itertools.groupby(sorted(_flown_of(left, sweep)))
    } == {8: 4}, "two of each combination"
    assert sum(told) == 40
    run_here(sweep, tmp_path / "at-once.csv")
    assert out.read_bytes() == (tmp_path / "at-once.csv").read_bytes()


def _flown_of(chunks: Sequence[Chunk], sweep: ParameterSweep) -> list[int]:
    """How many runs of each combination are in the chunks."""
    return [
        sum(len(chunk.seeds) for chunk in chunks if chunk.values == combination.values)
        for combination in sweep.combinations
    ]


def test_more_seeds_are_added_to_a_finished_campaign_but_none_are_dropped(
    scenario: Path, tmp_path: Path
) -> None:
    grown, at_once = tmp_path / "grown.csv", tmp_path / "at-once.csv"
    run_here(read_sweep(scenario, [], seeds=3), grown)
    run_here(read_sweep(scenario, [], seeds=8), grown)
    run_here(read_sweep(scenario, [], seeds=8), at_once)
    assert grown.read_bytes() == at_once.read_bytes()
    with pytest.raises(UsageError, match="seeds up to 8"):
        run_here(read_sweep(scenario, [], seeds=3), grown)


def test_a_file_of_another_campaign_is_refused_and_left_alone(scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    run_here(read_sweep(scenario, ["policy.gain_wait=0.1"], seeds=1), out)
    before = out.read_bytes()
    with pytest.raises(UsageError, match=r"another campaign.*policy\.gain_wait = \[0\.1\]"):
        run_here(read_sweep(scenario, ["policy.gain_wait=0.2"], seeds=1), out)
    scenario.write_text(SCENARIO.replace("range_m = 100.0", "range_m = 90.0"))
    with pytest.raises(UsageError, match="another state of its scenario"):
        run_here(read_sweep(scenario, ["policy.gain_wait=0.1"], seeds=1), out)
    assert out.read_bytes() == before


def test_a_file_of_no_campaign_is_refused_and_left_alone(scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "thesis.csv"
    out.write_text("years of work\n")
    with pytest.raises(UsageError, match="no campaign"):
        run_here(read_sweep(scenario, [], seeds=1), out)
    assert out.read_text() == "years of work\n"


def test_a_row_that_was_changed_by_hand_is_refused(scenario: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    sweep = read_sweep(scenario, [], seeds=1)
    run_here(sweep, out)
    out.write_text(out.read_text().replace(",true,", ",perhaps,"))
    with pytest.raises(UsageError, match="changed by hand"):
        run_here(sweep, out)


# --- where they fly -----------------------------------------------------------------------------------------


def test_any_number_of_processes_writes_the_same_file(scenario: Path, tmp_path: Path) -> None:
    sweep = read_sweep(scenario, ["policy.gain_wait=0.1,0.25"], seeds=7)
    written = []
    for name, fly in (("here", here), ("one", in_processes(1)), ("two", in_processes(2))):
        out = tmp_path / f"{name}.csv"
        run_campaign(CampaignFile.open(out, sweep), fly=fly)
        written.append(out.read_bytes())
    assert written[0] == written[1] == written[2]


def test_of_many_parts_a_few_are_handed_out_at_a_time() -> None:
    asked = 0

    class Parts(list[int]):
        def __iter__(self) -> Iterator[int]:
            nonlocal asked
            for part in range(len(self)):
                asked += 1
                yield part

    with processes.in_processes(_process_of, Parts(range(60)), workers=2) as results:
        next(results)
        assert asked < 30
        assert len(list(results)) == 59


@pytest.mark.parametrize(("worth_s", "here_alone"), [(3600.0, True), (1e-9, False)])
def test_what_takes_long_enough_is_also_flown_in_other_processes(
    monkeypatch: pytest.MonkeyPatch, worth_s: float, here_alone: bool
) -> None:
    monkeypatch.setattr(processes, "_WORTH_STARTING_S", worth_s)
    with processes.here_first(_process_of, range(6), workers=2) as results:
        found = list(results)
    assert sorted(part for part, _ in found) == list(range(6))
    assert ({process for _, process in found} == {os.getpid()}) is here_alone


def _process_of(part: int) -> tuple[int, int]:
    return part, os.getpid()


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_a_killed_campaign_leaves_no_process_behind_and_is_continued(
    scenario: Path, tmp_path: Path, how: signal.Signals
) -> None:
    out = tmp_path / "out.csv"
    arguments = ["campaign", str(scenario), "--seeds", "20000", "--workers", "2", "--out", str(out)]
    reading, writing = os.pipe()  # every process of the campaign holds `writing`: it is closed with the last
    with (
        os.fdopen(reading, "rb") as all_ended,
        subprocess.Popen(
            [sys.executable, "-m", "upwash", *arguments],
            stdout=writing, stderr=subprocess.DEVNULL, start_new_session=True,
        ) as campaign,
    ):  # fmt: skip
        os.close(writing)
        wait_for(lambda: out.exists() and out.read_bytes().count(b"\n") > 1, within_s=120.0, process=campaign)
        if how is signal.SIGINT:
            os.killpg(campaign.pid, how)  # as a terminal does
        else:
            campaign.kill()
        all_ended.read()
    assert campaign.returncode == (130 if how is signal.SIGINT else -signal.SIGKILL)
    flown = out.read_bytes().count(b"\n") - 1
    continued = CampaignFile.open(out, read_sweep(scenario, [], seeds=20000))
    assert len(continued.rows) == flown > 0


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler with two workers, each a process of its own."""
    pytest.importorskip("distributed", reason="the extra 'campaign' is not installed")
    folder = tmp_path_factory.mktemp("cluster")
    file = folder / "scheduler.json"
    common = ["--scheduler-file", str(file)]
    with contextlib.ExitStack() as stack:
        for program in (
            ["dask_scheduler", *common, "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-jupyter"],
            *[
                ["dask_worker", *common, "--no-nanny", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1",
                 "--death-timeout", "60", "--local-directory", str(folder)]
            ] * 2,
        ):  # fmt: skip
            process = subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.{program[0]}", *program[1:]],
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            stack.callback(process.wait)
            stack.callback(process.kill)
            wait_for(lambda: _address(file), within_s=120.0, process=process)
        yield _address(file)


def _address(file: Path) -> str:
    """Where the scheduler that writes the file is; empty before it has written all of it."""
    try:
        address: str = msgspec.json.decode(file.read_bytes())["address"]
    except (FileNotFoundError, msgspec.DecodeError):
        return ""
    return address


def test_a_dask_cluster_writes_the_same_file_as_one_process(
    cluster: str, scenario: Path, tmp_path: Path
) -> None:
    from distributed import Client

    sweep = read_sweep(scenario, ["policy.gain_wait=0.1,0.25"], seeds=20)
    run_here(sweep, tmp_path / "here.csv")
    with Client(cluster, set_as_default=False) as client:  # type: ignore[no-untyped-call]
        client.wait_for_workers(2, timeout=120)
        run_campaign(CampaignFile.open(tmp_path / "cluster.csv", sweep), fly=on_cluster(cluster))
        served = client.run(lambda dask_worker: dask_worker.state.executed_count)
    assert (tmp_path / "cluster.csv").read_bytes() == (tmp_path / "here.csv").read_bytes()
    assert len(served) == 2
    assert all(count > 0 for count in served.values()), "both workers had a share"


def test_a_cluster_that_does_not_answer_is_said_so(scenario: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra 'campaign' is not installed")
    sweep = read_sweep(scenario, [], seeds=1)
    with pytest.raises(UsageError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:1"):
        run_campaign(
            CampaignFile.open(tmp_path / "out.csv", sweep), fly=on_cluster("tcp://127.0.0.1:1", answer_s=0.5)
        )


# --- confidence ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("freedom", "quantile"),
    [(1, 12.7062), (2, 4.30265), (3, 3.18245), (4, 2.77645), (5, 2.57058), (29, 2.04523), (999, 1.96234)],
)
def test_quantiles_are_those_of_the_printed_tables(freedom: int, quantile: float) -> None:
    assert student_quantile(freedom) == pytest.approx(quantile, abs=6e-6)


def test_an_interval_holds_the_true_mean_in_95_of_100_cases() -> None:
    chance = Random(1)
    held = 0
    for _ in range(4000):
        mean = mean_of([chance.gauss(10, 2) for _ in range(4)])
        held += abs(mean.value - 10) <= mean.margin
    assert held / 4000 == pytest.approx(0.95, abs=0.01)


def test_a_single_observation_leaves_everything_possible() -> None:
    assert mean_of([3.0]).margin == math.inf


def test_what_a_drone_that_goes_came_to_has_columns_of_its_own(tmp_path: Path) -> None:
    file, out = tmp_path / "survey.toml", tmp_path / "out.csv"
    file.write_text(
        """
        [mission]
        waypoints_m = [[0, 0], [20, 0], [40, 0]]
        mode = "heavy"
        [[service]]
        name = "detector"
        local_call_s = { light = 3.0, heavy = 10.0 }
        [event]
        every = 2
        """
    )
    run_here(read_sweep(file, ["policy.stay_or_go=stay,go"], seeds=1), out)
    told = [(row["went_on"], row["turns_back"], float(row["hidden_s"])) for row in cells(out)]
    assert told == [("0", "0", 0.0), ("2", "1", 20.0)]
    out.unlink()
    note = json.loads(out.with_suffix(".campaign.json").read_text())
    assert (note["scenario"], note["configuration"]["event"]) == (file.name, {"every": 2})
    assert note["upwash"]
    out.with_suffix(".campaign.json").unlink()
    run_here(read_sweep(file, ["policy.stay_or_go=stay"], seeds=1), out)
    assert "turns_back" not in cells(out)[0]
