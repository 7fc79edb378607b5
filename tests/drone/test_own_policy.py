"""Policies of the user's own: loaded by name, kept in bounds, and compared like any other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.programs import ROOT

import upwash
from upwash.cli.main import main
from upwash.drone import own_policy
from upwash.errors import ConfigError, UpwashError, UsageError
from upwash.eventlog import schema
from upwash.lab.explanation import replay
from upwash.lab.scenario import read_scenario

DEMONSTRATION = ROOT / "scenarios" / "demonstration.toml"
MINE = """
import time
from upwash.policies import Choice, Coming, Local, LocationAware, LookAhead, Remote, Wait

class Same(LookAhead): pass

class Remembers(LookAhead):
    def __init__(self, *, name_of_memory): self.memory = {name_of_memory: 0}
    def choose(self, s):
        self.memory["it"] += 1
        self.last = s.current
        return super().choose(s)

class Named:
    def choose(self, s): return next((option.server for option in s.options), None)

class Careful:
    def __init__(self, *, least_s=2.0): self.least_s = least_s
    def choose(self, s): return Named.choose(self, s)
    def decide(self, call):
        return Remote(call.server, self.least_s, "mine") if call.state == "READY" else Local("mine")

class Raises:
    def choose(self, s): raise KeyError("x")
class Loops:
    def choose(self, s):
        while True: pass
class Sleeps:
    def choose(self, s): time.sleep(9.0)
class Exits:
    def choose(self, s): raise SystemExit(3)
class Nowhere:
    def choose(self, s): return "s9"
class Rubbish:
    def choose(self, s): return 42
class Comes:
    def choose(self, s): return Choice(None, "", "s1")
class Decides(Named):
    def decide(self, call): return "remote"
class Elsewhere(Named):
    def decide(self, call): return Remote("s9", 1.0, "")
class Endless(Named):
    def decide(self, call): return Wait(call.server, float("inf"), "")
class TimesOut(Named):
    def decide(self, call): raise TimeoutError("mine")

class Needs:
    def __init__(self, x): pass
class Chooseless: pass
class Far(Named):
    horizon = -1
number = 3
"""


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(MINE)
    return file


def simulate(file: Path, policy: str, **overrides: Any) -> upwash.Simulation:
    return upwash.simulate(DEMONSTRATION, policy=f"{file}:{policy}", overrides=overrides)


def test_look_ahead_as_an_own_policy_flies_the_same_mission(mine: Path) -> None:
    own, built_in = simulate(mine, "Same"), upwash.simulate(DEMONSTRATION, policy="look-ahead")
    assert own.policy == "mine.py:Same"
    assert own.calls == built_in.calls and own.totals == built_in.totals
    assert own.mission_time_s == built_in.mission_time_s and not own.offloading_failed


def test_a_policy_without_decide_places_calls_as_location_aware_does(mine: Path) -> None:
    own = simulate(mine, "Named")
    assert own.completed and not own.offloading_failed
    assert {call.place for call in own.calls} == {"local", "s1", "s2"}


def test_settings_are_arguments_of_the_class(mine: Path) -> None:
    run = simulate(mine, "Careful", **{"policy.settings": {"least_s": 3.5}})
    sent = [event for event in run.events if isinstance(event, schema.Decided) and event.decision == "remote"]
    assert {event.deadline_s for event in sent} == {3.5}
    assert "mine" in {event.why for event in sent}
    with pytest.raises(
        UsageError, match=r"Careful cannot be made: TypeError.*it takes .*least_s.*has most_s"
    ):
        simulate(mine, "Careful", **{"policy.settings": {"most_s": 3.5}})
    with pytest.raises(ConfigError, match="settings are for a policy of your own, and look-ahead has none"):
        upwash.simulate(DEMONSTRATION, overrides={"policy.settings": {"least_s": 3.5}})


@pytest.mark.parametrize(
    ("policy", "why"),
    [
        ("Raises", "choose raised KeyError: 'x'"),
        ("Loops", "choose did not answer within 1 s"),
        ("Sleeps", "choose did not answer within 1 s"),
        ("Exits", "choose raised SystemExit: 3"),
        ("Nowhere", r"choose named 's9', which is not among the servers \[\]"),
        ("Rubbish", "choose returned 42, and a server's name, None or a Choice is expected"),
        ("Comes", r"choose returned Choice\(server=None, why='', coming='s1'\), and a server's name"),
        ("Decides", "decide returned 'remote': expected Local, or Remote or Wait at s1"),
        ("Elsewhere", "decide returned Remote"),
        ("Endless", "decide returned Wait"),
        ("TimesOut", "decide raised TimeoutError: mine"),
    ],
)
def test_a_defect_of_a_policy_ends_offloading_and_not_the_mission(
    mine: Path, policy: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patience:
        if "did not answer" in why:
            patience.setattr(own_policy, "ANSWERS_WITHIN_S", 1.0)
        run = simulate(mine, policy)
    assert run.completed and len(run.calls) == 12
    assert pytest.approx(run.totals.local, abs=1) == 12
    (failed,) = [event for event in run.events if isinstance(event, schema.OffloadingFailed)]
    assert failed.why == run.offloading_failed
    with pytest.raises(AssertionError, match=rf"policy mine\.py:{policy}: {why}"):
        raise AssertionError(failed.why)
    assert simulate(mine, "Named").totals.local < 12, "the next policy is asked again"


@pytest.mark.parametrize(
    ("policy", "problem"),
    [
        ("Needs", r"Needs cannot be made: TypeError.*it takes \(x\), and policy.settings has nothing"),
        ("Chooseless", r"Chooseless has no method choose"),
        ("Far", r"Far: its horizon is -1: give a number of calls up to 1000"),
        ("Missing", r"there is no Missing in"),
        ("number", r"expected a class, and this is 3"),
    ],
)
def test_a_class_that_is_no_policy_is_refused_before_take_off(mine: Path, policy: str, problem: str) -> None:
    with pytest.raises(UsageError, match=problem):
        simulate(mine, policy)


def test_its_file_counts_from_the_configuration_and_drones_may_have_their_own(mine: Path) -> None:
    scenario = mine.parent / "field.toml"
    text = DEMONSTRATION.read_text()
    scenario.write_text(f'{text}\n[policy]\nname = "mine.py:Named"\n')
    assert upwash.simulate(scenario).policy == "mine.py:Named"
    config = read_scenario(scenario)
    assert config.policy.probing is not None and config.policy.hedging is not None
    assert [*replay([], scenario).runs][-1] == "mine.py:Named"
    scenario.write_text(
        f'{text}\n[policy]\nname = "mine.py:Careful"\nsettings = {{ least_s = 3.0 }}\n'
        '[[drone]]\nname = "d1"\n[[drone]]\nname = "d2"\npolicy = "mine.py:Named"\n'
        '[[drone]]\nname = "d3"\npolicy = "local-only"\n'
    )
    flown = upwash.simulate_fleet(scenario)
    assert [drone.policy for drone in flown.drones.values()] == [
        "mine.py:Careful",
        "mine.py:Named",
        "local-only",
    ]


def test_a_defect_in_a_fleet_is_printed_with_its_drone(
    mine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = mine.parent / "field.toml"
    drones = '[[drone]]\nname = "d1"\n[[drone]]\nname = "d2"\npolicy = "mine.py:Raises"\n'
    scenario.write_text(f"{DEMONSTRATION.read_text()}\n{drones}")
    assert main(["simulate", str(scenario)]) == 0
    assert "d2: every call ran on the drone after a defect" in " ".join(capsys.readouterr().out.split())
    assert main(["simulate", str(scenario), "--json"]) == 0
    assert "choose raised KeyError" in capsys.readouterr().out
    assert main(["check", str(scenario), "--seeds", "1", "--workers", "1"]) != 0
    assert "mine.py:Raises: choose raised" in " ".join(capsys.readouterr().out.split())


def test_a_built_in_policy_can_be_extended_with_settings_and_a_memory(mine: Path) -> None:
    run = simulate(mine, "Remembers", **{"policy.settings": {"name_of_memory": "it"}})
    built_in = upwash.simulate(DEMONSTRATION, policy="look-ahead")
    assert run.calls == built_in.calls and not run.offloading_failed


def test_it_is_compared_in_several_processes_and_a_defect_stops_the_comparison(mine: Path) -> None:
    policies = ["local-only", f"{mine}:Same"]
    alone, own = upwash.compare([DEMONSTRATION], policies=policies, seeds=3, workers=2)
    assert own.policy == f"{mine}:Same"
    assert own.saved_s is not None and own.mean_s + own.saved_s == pytest.approx(alone.mean_s)
    with pytest.raises(UpwashError, match=r"seed 1: every call ran on the drone after a defect.*Nowhere"):
        upwash.compare([DEMONSTRATION], policies=[f"{mine}:Nowhere"], seeds=1, workers=1)
