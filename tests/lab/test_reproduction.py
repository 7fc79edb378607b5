"""The thesis's experiments: every printed mission time is met, with one parameter set per set-up."""

from __future__ import annotations

import io
from pathlib import Path
from statistics import fmean

import msgspec
import pytest
from rich.console import Console

from upwash.config import NoiseConfig, read_drone_config
from upwash.lab.reproduction import (
    EXPERIMENTS,
    SETUPS,
    Cell,
    Comparison,
    Experiment,
    Quantity,
    draw_figures,
    fly,
    missions,
    print_comparison,
    reproduce,
    scenario,
)
from upwash.lab.run import simulate
from upwash.sim.heat import Heat

THESIS = Path(__file__).parents[2] / "scenarios" / "thesis.toml"
SEEDS = 3
HEAVY = Experiment("heavy", slow_s2=False)


@pytest.fixture(scope="module")
def reproduced() -> list[Comparison]:
    flown: list[None] = []
    comparisons = reproduce(seeds=SEEDS, workers=2, progress=lambda: flown.append(None))
    assert len(flown) == missions(SEEDS)
    return comparisons


def of(reproduced: list[Comparison], name: str) -> list[Comparison]:
    return [each for each in reproduced if each.quantity.name == name]


def test_every_printed_mission_time_is_met_within_3_percent(reproduced: list[Comparison]) -> None:
    times = of(reproduced, "mission_time_local_only") + of(reproduced, "mission_time_offloading")
    assert len(times) == 2 * (2 + 4)
    deviations = {(each.setup, each.experiment.name): each.deviation_percent for each in times}
    assert all(percent is not None and abs(percent) <= 3 for percent in deviations.values()), deviations


def test_the_naive_selection_is_slower_by_about_what_the_thesis_estimates(
    reproduced: list[Comparison],
) -> None:
    shares = of(reproduced, "naive_selection_extra_mission_time_share")
    assert [each.setup for each in shares] == list(SETUPS)
    assert all(6 <= each.mean.value <= 13 for each in shares)


def test_a_row_has_a_value_per_seed_and_the_printed_figure_where_there_is_one(
    reproduced: list[Comparison],
) -> None:
    ratios = of(reproduced, "total_service_delay_local_over_offloading")
    assert {len(each.values) for each in reproduced} == {SEEDS}
    assert [each.printed for each in ratios if each.setup == "hitl"] == [3.7, 7, None, 3.6]
    assert all(each.printed is None for each in ratios if each.setup == "simulation")


def test_the_comparison_is_printed_with_its_deviations(reproduced: list[Comparison]) -> None:
    output = io.StringIO()
    print_comparison(reproduced, Console(file=output, width=100))
    printed = output.getvalue()
    assert all(printed.count(experiment.name) == len(SETUPS) for experiment in EXPERIMENTS)
    first, mean = reproduced[0], reproduced[0].mean
    ours = f"{mean.value:.2f} min ± {mean.margin:.2f}"
    row = f"{ours}     {first.printed}      {first.deviation_percent:+.1f} %"
    assert row in printed


def test_a_single_seed_is_printed_without_a_margin() -> None:
    output = io.StringIO()
    once = Comparison("hitl", HEAVY, Quantity("mission_time_offloading", "mission time", "min"), [24.0], 25.0)
    print_comparison([once], Console(file=output, width=100))
    assert "24.00 min       25      -4.0 %" in output.getvalue()


def test_without_offloading_the_load_on_a_server_changes_nothing() -> None:
    equal, slow = (
        fly(Cell("hitl", Experiment("heavy", slow_s2=slow), "local-only"), seed=1) for slow in (False, True)
    )
    assert equal.log() == slow.log()


def test_the_thesis_scenario_is_the_hitl_set_up_without_noise() -> None:
    packaged = scenario(Cell("hitl", HEAVY, "location-aware"), seed=1)
    assert read_drone_config(THESIS) == msgspec.structs.replace(packaged, noise=NoiseConfig())


def test_heavy_calls_slow_down_with_heat_along_the_curve() -> None:
    heat, now_s, calls_s = Heat(ambient_c=44.0, load_w=4.0), 0.0, []
    for _ in range(60):
        now_s += 10.0  # a leg and a photo
        calls_s.append(heat.work(10.0, now_s=now_s))
        now_s += calls_s[-1]
    at = {call: calls_s[call - 1] for call in (1, 5, 10, 15, 20, 30, 60)}
    curve = {1: 10.0, 5: 10.0, 10: 11.1, 15: 12.6, 20: 13.2, 30: 13.4, 60: 13.4}
    assert at == pytest.approx(curve, abs=0.25)
    assert fmean(calls_s[30:]) == pytest.approx(13.4, abs=0.1)


def test_with_offloading_the_rare_local_calls_stay_cool() -> None:
    result = simulate(read_drone_config(THESIS)).result
    after_the_cold_start_s = [call.delay_s for call in result.calls[1:] if call.place == "local"]
    assert len(after_the_cold_start_s) >= 10
    assert all(10.0 <= delay_s <= 10.3 for delay_s in after_the_cold_start_s)


def test_the_figures_of_the_thesis_are_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    drawn = draw_figures(tmp_path / "figures")
    assert [file.name for file in drawn] == [f"figure_4.{number}.png" for number in range(4, 13)]
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in drawn)


def test_the_dots_of_a_figure_are_the_decisions_about_servers_that_were_not_ready() -> None:
    pytest.importorskip("matplotlib")
    from upwash.lab.figures import Wait, read_call_points

    run = simulate(read_drone_config(THESIS))
    points = list(read_call_points(run.events))
    assert [point.waypoint for point in points] == list(range(121))
    waited = [point for point in points if point.wait is Wait.WAITED]
    assert len(waited) == run.result.totals.waits
    declined = [point for point in points if point.wait is Wait.DECLINED]
    assert declined
    assert all(point.place == "local" for point in declined)
