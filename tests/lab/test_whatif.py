"""`upwash whatif`: a flight under other policies and settings, from its log alone."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from tests.scenarios import fault, scenario, server

from upwash.cli.main import main
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.kept import KeptEvents
from upwash.eventlog.schema import Event
from upwash.lab.run import simulate
from upwash.lab.scenario import with_policy
from upwash.lab.whatif import ReplayedTime, Replays, WhatIf, best_of, predicted, tune, what_if

pytestmark = pytest.mark.virtual
FEW = Replays(draws=6, workers=1)
SERVERS = (server("s1", 20.0, 20.0), server("s2", 90.0, 20.0))
SMALL = {"columns": 4, "noise": {"call": 0.05, "leg": 0.02}}


def flown(by: str, *servers: dict[str, Any], seed: int = 1, **tables: Any) -> KeptEvents:
    config = scenario(*(servers or SERVERS), **{**SMALL, **tables})
    return simulate(replace(with_policy(config, by), seed=seed)).events


def time_s(by: str, *servers: dict[str, Any], **tables: Any) -> float:
    """The truth: the same world under the policy, with another seed."""
    config = scenario(*(servers or SERVERS), **{**SMALL, **tables})
    return simulate(replace(with_policy(config, by), seed=99)).result.mission_time_s


def of(found: WhatIf) -> dict[str, ReplayedTime]:
    return {one.policy: one for one in found.predictions}


WORLDS: dict[str, dict[str, Any]] = {
    "quiet": {},
    "a server fails": {"faults": [fault("s1", "off", from_s=60.0, to_s=200.0)]},
    "a hot computer": {"heat": {"ambient_c": 44.0}, "columns": 9},
    "a hot computer of 8 W": {"heat": {"ambient_c": 44.0, "load_w": 8.0}, "columns": 9},
    "answers that demand actions": {
        "event": {"every": 5},
        "mission": {"action_s": 8.0},
        "policy": {"stay_or_go": "learn"},
    },
    "a quick vehicle": {"vehicle": {"profile": "arducopter"}, "mission": {"ground_speed_m_s": 9.0}},
}


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_other_policies_lie_in_their_intervals_and_in_the_right_order(world: dict[str, Any]) -> None:
    found = of(what_if(flown("look-ahead", **world), ["local-only", "opportunistic"], replays=FEW))
    truth = {policy: time_s(policy, **world) for policy in found}
    assert {policy for policy, one in found.items() if one.low_s <= truth[policy] <= one.high_s} == set(truth)
    assert truth["look-ahead"] < truth["local-only"]
    assert found["look-ahead"].time_s < found["local-only"].time_s
    assert found["look-ahead"].high_s - found["look-ahead"].low_s < 0.75 * truth["look-ahead"]


def test_what_a_log_knows_little_about_widens_the_interval() -> None:
    apart = server("s2", 90.0, 20.0, range_m=30.0)
    dear = server("s1", 20.0, 20.0, range_m=45.0)
    both = of(what_if(flown("opportunistic", dear, apart, columns=6), ["look-ahead"], replays=FEW))[
        "look-ahead"
    ]
    never = what_if(
        (
            event
            for event in flown("opportunistic", dear, apart, columns=6)
            if getattr(event, "server", "") != "s2"
        ),
        ["look-ahead"],
        replays=FEW,
    )
    one = of(never)["look-ahead"]
    assert one.high_s - one.low_s > 1.5 * (both.high_s - both.low_s)
    assert any("never used in this flight: s2" in note for note in never.notes)


def test_a_log_without_calls_on_servers_says_nothing_about_policies_that_use_them() -> None:
    found = what_if(flown("local-only"), replays=FEW)
    assert list(of(found)) == ["local-only"]
    assert set(found.refused) == {"opportunistic", "location-aware", "look-ahead"}
    assert "knows nothing about calls there" in found.refused["look-ahead"]


def test_of_a_flight_that_was_taken_over_its_first_part_is_predicted() -> None:
    whole = flown("look-ahead")
    found = what_if(itertools.takewhile(lambda event: event.t < 90.0, whole), ["local-only"], replays=FEW)
    assert found.flown_s < 90.0
    assert any("ended early" in note and "without the way home" in note for note in found.notes)
    assert of(found)["local-only"].time_s > 1.2 * found.flown_s


def without_inputs(by: str) -> list[Event]:
    return [event for event in flown(by) if not isinstance(event, schema.Decided)]


def test_without_the_inputs_of_decisions_what_was_measured_is_believed() -> None:
    found = what_if(without_inputs("look-ahead"), ["local-only"], replays=FEW)
    one = of(found)["local-only"]
    assert one.low_s <= time_s("local-only") <= one.high_s
    assert any("no inputs" in note for note in found.notes)


def rows() -> Sequence[Event]:
    return list(flown("look-ahead", mission={"photos": {"every_m": 20.0}}))


def of_two_drones() -> Sequence[Event]:
    events = list(flown("look-ahead"))
    return [*events, schema.MissionStarted(t=1.0, drone="another", policy="look-ahead")]


def resumed() -> Sequence[Event]:
    return [*flown("look-ahead"), schema.MissionStarted(t=1.0, drone="drone", policy="look-ahead", done=[1])]


def before_the_first_waypoint() -> Sequence[Event]:
    return list(itertools.takewhile(lambda event: not isinstance(event, schema.Arrived), flown("look-ahead")))


def with_two_answers() -> Sequence[Event]:
    first = schema.FirstAnswer(t=20.0, waypoint=1, operation="detector.process_photo[light]", delay_s=3.0)
    return [*flown("look-ahead"), first]


def endless() -> Sequence[Event]:
    events = list(flown("look-ahead"))
    call = next(event for event in events if isinstance(event, schema.Call))
    return [*events, replace(call, place="local", onboard_s=1e9, delay_s=1e9)]


@pytest.mark.parametrize(
    ("events", "why"),
    [
        (rows, "rows without stopping"),
        (of_two_drones, "missions of several drones"),
        (resumed, "broken off and resumed"),
        (before_the_first_waypoint, "reached no waypoint"),
        (with_two_answers, "two answers"),
        (endless, "contradict one another"),
        (lambda: [schema.LocalReady(t=0.0, service="detector")], "no mission to replay"),
    ],
)
def test_what_cannot_be_replayed_is_refused_with_the_reason(
    events: Callable[[], Sequence[Event]], why: str
) -> None:
    with pytest.raises(UsageError, match=why):
        what_if(events(), replays=FEW)


def test_tuning_says_what_settings_save_and_what_was_measured() -> None:
    slow = server("s1", 20.0, 20.0, remote_call_s={"light": 1.0, "heavy": 7.6})
    slow["truth"] = {"remote_call_s": {"light": 1.0, "heavy": 5.0}}
    both = (slow, server("s2", 90.0, 20.0))
    logs = [flown("location-aware", *both, columns=4, rows=2, seed=seed) for seed in (1, 2)]
    found = tune(logs, replays=Replays(draws=4, workers=1))
    saved = {one.setting: one.saved for one in found.settings}
    assert {"estimates = as measured", "gain_wait = 0.1", "stay_or_go = go"} <= set(saved)
    assert saved["stay_or_go = stay"].value == 0.0  # as it was flown
    assert saved["stay_or_go = go"].value > saved["stay_or_go = go"].margin  # no answer demands anything
    assert found.settings[0].setting in {"stay_or_go = go", "stay_or_go = learn"}
    assert any(
        line.startswith('s2: remote_call_s.detector = { "heavy" = 0.7') and "check_s = 11" in line
        for line in found.estimates
    )
    with pytest.raises(UsageError, match="nothing to tune"):
        tune([flown("local-only")], replays=FEW)


def log_of(tmp_path: Path, events: KeptEvents) -> Path:
    file = tmp_path / "flight.jsonl"
    file.write_bytes(b"".join(events.lines()))
    return file


def test_a_setting_is_worth_what_it_saves_in_the_replays_that_did_not_choose_it() -> None:
    lucky = [30.0, 1.0, 31.0, 2.0, 29.0, 3.0]
    best = best_of({"lucky": lucky, "steady": [5.0, 5.1] * 3})
    assert best is not None
    assert best.setting == "lucky"
    assert best.saved.value == pytest.approx(2.0)
    assert best_of({"unsure": [30.0, 0.0, -30.0, 0.0, 1.0, 0.0]}) is None
    assert best_of({}) is None


def test_an_interval_is_of_one_flight_more_and_counts_the_models_doubt() -> None:
    logs, doubt = [5.0, 5.1, 5.2], 0.3
    found = predicted("look-ahead", logs, doubt)
    deviation = math.hypot(0.1 * math.sqrt(1 + 1 / 3), doubt)
    margin = 4.303 * deviation  # t of two degrees of freedom, 95 %
    assert math.log(found.high_s / found.time_s) == pytest.approx(margin, rel=1e-3)
    assert math.log(found.time_s / found.low_s) == pytest.approx(margin, rel=1e-3)


def test_the_command_prints_the_quickest_first_and_one_json_object(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log = log_of(tmp_path, flown("look-ahead"))
    assert main(["whatif", str(log), "--draws", "4", "--workers", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "flown in 2:25 under look-ahead; 12 calls, " in lines[0]
    assert any("look-ahead (flown)" in line for line in lines)
    assert any(line.endswith(" is quicker than local-only") for line in lines)
    assert (
        main(["whatif", str(log), "--policy", "local-only", "--json", "--draws", "4", "--workers", "1"]) == 0
    )
    (flight,) = json.loads(capsys.readouterr().out)["flights"].values()
    times = [one["time_s"] for one in flight["predictions"]]
    assert times == sorted(times)
    assert flight["predictions"][-1]["policy"] == "local-only"


def test_torn_lines_are_left_out_and_a_policy_of_ones_own_is_replayed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    log = log_of(tmp_path, flown("look-ahead"))
    lines = log.read_bytes().splitlines(keepends=True)
    lines[60] = lines[60][:30] + b"\n"
    log.write_bytes(b"".join(lines)[:-20])
    own = tmp_path / "mine.py"
    own.write_text("from upwash.policies import LookAhead\n\n\nclass Mine(LookAhead):\n    pass\n")
    assert main(["whatif", str(log), "--policy", f"{own}:Mine", "--draws", "4", "--workers", "1"]) == 0
    assert "Mine" in capsys.readouterr().out
    log.write_bytes(b"no log\n")
    assert main(["whatif", str(log)]) == 2
    assert "is not an event log" in capsys.readouterr().err
