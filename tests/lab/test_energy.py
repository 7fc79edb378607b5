"""Missions on a battery: what they draw, and how they end when that is too much."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.scenarios import scenario, server

import upwash
from upwash.cli.main import main
from upwash.config.drone import DroneConfig
from upwash.config.world import EnergyConfig
from upwash.errors import ConfigError
from upwash.eventlog import schema
from upwash.eventlog.results import EnergyTotals
from upwash.lab.bounds import bound_of
from upwash.lab.run import Run, simulate
from upwash.support.heat import Surroundings

ROOT = Path(__file__).parents[2]
THESIS, BATTERY = ROOT / "scenarios" / "thesis.toml", ROOT / "scenarios" / "thesis-battery.toml"
NEAR = server("s1", 0.0, 0.0, range_m=1000.0, bandwidth_bit_s=54e6)
POLICIES = ("local-only", "opportunistic", "location-aware", "look-ahead")


def on(*servers: dict[str, Any], policy: str = "look-ahead", **energy: float) -> DroneConfig:
    return scenario(*servers, policy={"name": policy}, energy=energy)


def drawn(run: Run) -> EnergyTotals:
    assert run.result.energy is not None
    return run.result.energy


def parts_wh(energy: EnergyTotals) -> float:
    return energy.flight_wh + energy.hover_wh + energy.computing_wh + energy.radio_wh


@pytest.mark.parametrize("policy", POLICIES)
def test_the_parts_are_the_whole(policy: str) -> None:
    energy = drawn(simulate(on(NEAR, policy=policy)))
    assert energy.total_wh == pytest.approx(parts_wh(energy), abs=1e-6)
    assert min(energy.flight_wh, energy.hover_wh, energy.computing_wh, energy.radio_wh) > 0


@pytest.mark.parametrize("policy", POLICIES)
def test_the_flight_is_the_same_without_a_meter(policy: str) -> None:
    unmetered = simulate(scenario(NEAR, policy={"name": policy}))
    metered = simulate(on(NEAR, policy=policy, battery_wh=1000.0))
    assert unmetered.result.energy is None
    *before, used, completed = metered.events
    limits = next(event for event in before if isinstance(event, schema.LimitsRead))
    assert limits.low_percent, "its battery has a stage"
    before[before.index(limits)] = msgspec.structs.replace(limits, low_percent=None, critical_percent=None)
    assert [*before, completed] == unmetered.events
    assert isinstance(used, schema.EnergyUsed)
    assert metered.result.mission_time_s == unmetered.result.mission_time_s


def test_a_faster_mission_draws_less_and_what_it_saves_is_hover() -> None:
    near, alone = drawn(simulate(on(NEAR, policy="location-aware"))), drawn(simulate(on(policy="local-only")))
    assert near.flight_wh == pytest.approx(alone.flight_wh, abs=1e-4)
    assert near.hover_wh < 0.5 * alone.hover_wh
    assert near.computing_wh < alone.computing_wh
    saved_wh = alone.total_wh - near.total_wh
    assert (alone.hover_wh - near.hover_wh) / saved_wh > 0.9


def test_computing_is_the_idle_power_and_the_load_of_the_calls() -> None:
    run = simulate(on(policy="local-only", computer_idle_w=3.0, computer_load_w=7.0))
    calls_s = sum(call.delay_s for call in run.result.calls)
    expected_wh = (3.0 * run.result.mission_time_s + 7.0 * calls_s) / 3600
    assert drawn(run).computing_wh == pytest.approx(expected_wh, rel=1e-3)


def test_a_computer_that_is_slowed_down_draws_less_for_longer() -> None:
    hot, cool = (
        simulate(
            scenario(
                columns=11, rows=6, policy={"name": "local-only"}, heat={"ambient_c": ambient_c}, energy={}
            )
        )
        for ambient_c in (44.0, 0.0)
    )
    assert hot.result.mission_time_s > 1.05 * cool.result.mission_time_s

    def load_wh(run: Run) -> float:
        return drawn(run).computing_wh - 2.7 * run.result.mission_time_s / 3600

    assert load_wh(cool) == pytest.approx(4.0 * 10.0 * 66 / 3600, rel=1e-3)
    assert 0.8 * load_wh(cool) < load_wh(hot) < load_wh(cool)


@pytest.mark.parametrize(
    "truth", [{}, {"radio": "disc54", "processing_s": {"light": 0.2, "heavy": 0.6}}], ids=["fixed", "disc54"]
)
def test_transfers_draw_radio_power_however_the_radio_is_modelled(truth: dict[str, Any]) -> None:
    run = simulate(on({**NEAR, "range_m": 100.0, "truth": truth}, policy="location-aware", radio_idle_w=0.0))
    remote = sum(run.result.totals.remote.values())
    assert remote > 0
    least_s = 8 * 425_500 / 54e6
    assert remote * least_s * 0.5 / 3600 <= drawn(run).radio_wh * (1 + 1e-3) < 0.01


def test_two_radios_draw_twice_as_much_idle() -> None:
    one, two = (
        drawn(simulate(scenario(policy={"name": "local-only"}, network={"radios": radios}, energy={})))
        for radios in (1, 2)
    )
    assert two.radio_wh == pytest.approx(2 * one.radio_wh, abs=1e-5)


def test_the_reserve_ends_a_mission_as_on_any_battery() -> None:
    config = scenario(mission={"reserve_percent": 40.0}, energy={"battery_wh": 15.0})
    run = simulate(config)
    assert run.failure == "40 % is left in the battery, less than the reserve of 40 %"
    assert not run.result.completed and run.result.undone
    stopping = next(event for event in run.events if isinstance(event, schema.Stopping))
    assert stopping.why == run.failure
    assert any(isinstance(event, schema.Landed) for event in run.events)
    assert bound_of(run, config) is None


def test_a_reserve_of_seconds_counts_with_the_vehicles_own_stage() -> None:
    run = simulate(
        scenario(mission={"reserve_s": 1.0}, energy={"battery_wh": 15.0, "failsafe_percent": 50.0})
    )
    assert "the vehicle's own low-battery stage is at 50 %" in run.failure
    assert not any(isinstance(event, schema.VehicleSaid) for event in run.events)


@pytest.mark.parametrize(
    ("energy", "said"),
    [
        ({"failsafe_percent": 10.0}, "Battery Failsafe: 10 % is left"),
        ({"failsafe_percent": 0.0}, "Battery empty: the motors stop"),
    ],
)
def test_without_a_reserve_the_vehicle_comes_down_by_itself(energy: dict[str, float], said: str) -> None:
    run = simulate(on(policy="local-only", battery_wh=8.0, **energy))
    assert "a fail-safe has the vehicle" in run.failure and said in run.failure
    names = [event.kind for event in run.events]
    assert names[-3:] == ["stood", "energy_used", "mission_ended"]
    assert drawn(run).battery_wh == 8.0
    assert drawn(run).total_wh < 8.0 + 0.15


def test_a_battery_that_is_nearly_empty_on_the_ground_does_nothing() -> None:
    config = on(policy="local-only", battery_wh=1000.0)
    needed_wh = drawn(simulate(config)).total_wh
    run = simulate(on(policy="local-only", battery_wh=needed_wh + 1e-3, failsafe_percent=0.0))
    assert run.result.completed


# --- what is compared by it ---------------------------------------------------------------------------------


@pytest.mark.parametrize("policy", POLICIES)
def test_the_thesis_is_flown_on_one_battery_only_with_servers(policy: str) -> None:
    flight = upwash.simulate(BATTERY, policy=policy)
    assert flight.completed == (policy != "local-only")
    if flight.completed:
        assert flight.calls == upwash.simulate(THESIS, policy=policy).calls
    else:
        assert flight.failure == "10 % is left in the battery, less than the reserve of 10 %"
        assert len(flight.undone) > 40


def test_the_page_has_what_is_drawn() -> None:
    page = (ROOT / "docs" / "scenarios.md").read_text()
    found = re.findall(r"^\| ([\w -]+) \|" + r" ([\d.]+) \|" * 6 + "$", page, flags=re.MULTILINE)
    rows = {name: written for name, *written in found}
    for policy in POLICIES:
        written = rows["local-only" if policy == "local-only" else "every other policy"]
        flight = upwash.simulate(BATTERY, policy=policy, overrides={"energy.battery_wh": 200.0})
        energy = flight.energy
        assert energy is not None
        numbers = (
            *(energy.total_wh, energy.flight_wh, energy.hover_wh, energy.computing_wh, energy.radio_wh),
            flight.mission_time_s / 60,
        )
        assert [float(each) for each in written] == [
            pytest.approx(number, abs=0.051 if number is numbers[-1] else 0.0051) for number in numbers
        ]


def test_the_reference_says_what_a_call_adds_without_that_key() -> None:
    page = (ROOT / "docs" / "configuration-reference.md").read_text()
    assert EnergyConfig(battery_wh=77.0).computer_load_w is None
    assert (
        f"The power that a call adds, in watts; default: {Surroundings().load_w:g}, or `heat.load_w`." in page
    )


def test_an_explanation_has_the_bound_of_those_that_completed_it(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log = tmp_path / "ended.jsonl"
    assert main(["simulate", str(BATTERY), "--policy", "local-only", "--log", str(log)]) == 1
    assert main(["explain", str(log), "--scenario", str(BATTERY)]) == 0
    told = capsys.readouterr().out
    assert "local-only: 24:38, not completed" in told and "theoretical minimum: 24:29" in told


def test_json_has_the_parts_and_why_it_ended(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(BATTERY), "--json"]) == 0
    flown = json.loads(capsys.readouterr().out)
    assert list(flown)[-3:] == ["energy", "upwash", "configuration"] and list(flown["energy"]) == [
        "total_wh", "flight_wh", "hover_wh", "computing_wh", "radio_wh", "battery_wh",
    ]  # fmt: skip
    assert main(["simulate", str(BATTERY), "--json", "--policy", "local-only"]) == 1
    ended = json.loads(capsys.readouterr().out)
    assert (ended["completed"], ended["bound"]) == (False, None)
    assert ended["failure"].startswith("10 % is left")


def test_people_are_told_what_was_drawn(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    log = tmp_path / "flown.jsonl"
    assert main(["simulate", str(BATTERY), "--log", str(log)]) == 0
    assert "68.7 Wh of 77 Wh drawn: flight 49.0, hover 18.1" in capsys.readouterr().out
    assert main(["report", str(log), "--out", str(tmp_path / "page.html")]) == 0
    assert "68.7 Wh, of which 18.1 Wh in hover" in (tmp_path / "page.html").read_text()
    result = upwash.read_result(upwash.read_log(log))
    assert result.energy == upwash.simulate(BATTERY).energy
    assert result.mission_time_s == upwash.simulate(THESIS).mission_time_s


def test_a_comparison_has_means_of_what_was_completed(capsys: pytest.CaptureFixture[str]) -> None:
    alone, near = upwash.compare([BATTERY], policies=["local-only", "look-ahead"], seeds=2, workers=1)
    assert (alone.missions, alone.completed, near.completed) == (2, 0, 2)
    assert alone.mean_s != alone.mean_s and alone.energy_wh != alone.energy_wh  # NaN
    assert near.energy_wh == pytest.approx(68.2, abs=0.5)
    assert near.energy_half_width_wh is not None and near.energy_half_width_wh > 0
    assert near.bound_s < near.mean_s
    (without,) = upwash.compare([THESIS], policies=["look-ahead"], seeds=1)
    assert without.energy_wh is without.energy_half_width_wh is None
    assert main(["compare", str(BATTERY), "--seeds", "1", "--workers", "1"]) == 0
    minutes, _, times, empty, heading, _, energies = capsys.readouterr().out.splitlines()
    assert minutes.startswith("| mission time |") and heading.startswith("| Wh |") and not empty
    assert times.startswith("| thesis-battery | 24:28 |") and "| 0 of 1 completed |" in times
    assert energies.startswith("| thesis-battery | - | 6")


def test_a_campaign_keeps_the_parts_of_each_mission(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    policies = "policy.name=local-only,look-ahead"
    for scenario_file, metered in ((BATTERY, True), (THESIS, False)):
        out = tmp_path / f"{scenario_file.stem}.csv"
        for seeds in ("1", "2"):  # and goes on with the file
            command = ["campaign", str(scenario_file), "--seeds", seeds, "--workers", "1", "--out", str(out)]
            assert main([*command, "--set", policies]) == int(metered)
        rows = list(csv.DictReader(out.read_text().splitlines()))
        assert ("drawn" in capsys.readouterr().out) == metered == ("energy_wh" in rows[0])
        if metered:
            assert [row["completed"] for row in rows] == ["false", "false", "true", "true"]
            for row in rows:
                parts = ("flight_wh", "hover_wh", "computing_wh", "radio_wh")
                assert float(row["energy_wh"]) == pytest.approx(sum(float(row[part]) for part in parts))


def test_a_check_says_that_the_battery_is_not_enough(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(BATTERY), "--workers", "1", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["usable_wh"] == pytest.approx(69.3)
    (warning,) = found["warnings"]
    assert warning["kind"] == "battery"
    assert "the battery gives 69.3 Wh down to 10 %" in warning["text"]
    assert "local-only (134.7 Wh)" in warning["text"] and "as configured" not in warning["text"]
    assert main(["check", str(BATTERY), "--workers", "1"]) == 1
    shown = capsys.readouterr().out
    assert "battery left" in shown and "-65.4 Wh" in shown and "0.6 Wh" in shown


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ({"capacity_wh": 77.0}, "energy.capacity_wh"),
        ({"battery_wh": 0.0}, "energy.battery_wh"),
        ({"failsafe_percent": 100.0}, "energy.failsafe_percent: expected a number from 0 to below 100"),
        ({"computer_load_w": 4.0}, "energy.computer_load_w: heat.load_w = 4 says already what a call adds"),
    ],
)
def test_what_cannot_be_drawn_is_refused(table: dict[str, float], told: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(told)):
        scenario(heat={}, energy=table)
