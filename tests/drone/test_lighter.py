"""Whole flights that are to be over in time, on virtual time: what ran, what was asked for, and what the log says."""

from __future__ import annotations

import functools
from typing import Any, Literal

import pytest
from tests.events import written
from tests.scenarios import fault, scenario, server

from upwash.config.places import waypoints
from upwash.core.selection.selection import Selection
from upwash.drone.preparation import make_selection
from upwash.errors import UsageError
from upwash.eventlog.narration import Narrator, Tone
from upwash.eventlog.results import CallResult
from upwash.eventlog.schema import Foreseen
from upwash.lab.run import Run, simulate
from upwash.rpc.service import service, spec_of


class Plain:
    """Whose calls are all alike."""

    def process_photo(self, photo: bytes) -> None: ...


class Strict:
    """Whose modes are others than the configuration has delays of."""

    def process_photo(self, photo: bytes, mode: Literal["heavy", "tiny"]) -> None: ...


LIGHTER = {"lighter": {"heavy": "light"}}
NEAR = server("s1", 50.0, 0.0, range_m=45.0)
THESIS = {"policy": {"name": "location-aware"}}


def fly(finish_by_s: float | None, *faults: dict[str, Any], **tables: Any) -> Run:
    """A survey of 18 photos; the server has a part of them in range."""
    mission = {} if finish_by_s is None else {"finish_by_s": finish_by_s, **LIGHTER}
    run = simulate(scenario(NEAR, faults=faults, mission=mission, **{**THESIS, **tables}))
    assert run.failure == "" and run.result.completed
    return run


@functools.cache
def unhurried() -> Run:
    return fly(None)


def events(run: Run, name: str) -> list[dict[str, Any]]:
    return [event for event in written(run.events) if event["event"] == name]


def lighter(run: Run) -> list[CallResult]:
    return [call for call in run.result.calls if call.asked]


def test_a_mission_that_has_time_is_the_same_as_without_the_keys() -> None:
    run = fly(unhurried().result.mission_time_s + 30.0)
    assert run.result.calls == unhurried().result.calls
    (foreseen,) = events(run, "foreseen")
    assert foreseen["as_asked_s"] == pytest.approx(unhurried().result.mission_time_s, rel=0.02)
    assert foreseen["reached_s"] == [round(each_s, 1) for each_s in foreseen["reached_s"]]
    (unhurried_one,) = events(unhurried(), "foreseen")
    assert unhurried_one["as_asked_s"] == foreseen["as_asked_s"]
    assert "finish_by_s" not in unhurried_one and "lightest_s" not in unhurried_one


@pytest.mark.parametrize("policy", ["local-only", "opportunistic", "location-aware", "look-ahead"])
def test_a_mission_is_over_in_time_with_calls_on_the_drone_lighter_first(policy: str) -> None:
    asked_s = fly(None, policy={"name": policy}).result.mission_time_s
    run = fly(asked_s - 20.0, policy={"name": policy})
    assert asked_s - 30.0 < run.result.mission_time_s <= asked_s - 20.0 + 1.0
    assert 3 <= len(lighter(run)) <= 4, "each saves 7 s"
    for call in lighter(run):
        assert (call.place, call.key, call.asked) == ("local", "light", "detector.process_photo[heavy]")


@pytest.mark.parametrize("reserve", [{"reserve_percent": 20.0}, {"reserve_s": 60.0}])
def test_without_a_time_the_battery_says_by_when_and_the_reserve_ends_nothing(
    reserve: dict[str, float],
) -> None:
    asked_s = unhurried().result.mission_time_s
    kept = 1 - reserve["reserve_percent"] / 100 if "reserve_percent" in reserve else 1 - 60.0 / asked_s
    battery = {"endurance_s": (asked_s - 20.0) / kept}
    heavy = simulate(scenario(NEAR, mission=reserve, vehicle=battery, policy=THESIS["policy"]))
    assert not heavy.result.completed, "too much is asked for"
    run = simulate(scenario(NEAR, mission={**reserve, **LIGHTER}, vehicle=battery, policy=THESIS["policy"]))
    assert run.failure == "" and run.result.completed
    assert 0 < len(lighter(run)) < 12


def test_the_log_has_what_ran_and_why_it_was_lighter() -> None:
    run = fly(unhurried().result.mission_time_s - 20.0)
    calls = events(run, "call")
    hurried = [call for call in calls if "asked" in call]
    assert len(hurried) == run.result.totals.lighter > 0
    for call in hurried:
        assert call["operation"] == "detector.process_photo[light]"
        assert call["forecast_s"] > call["finish_by_s"] == unhurried().result.mission_time_s - 20.0
    assert all("forecast_s" not in call for call in calls if "asked" not in call)
    decided = [event["operation"] for event in events(run, "decided")]
    assert decided.count("detector.process_photo[light]") == len(hurried)


def test_where_light_does_not_fit_either_that_is_said_before_take_off_and_light_is_flown() -> None:
    run = fly(60.0)
    assert {call.key for call in run.result.calls} == {"light"}
    names = [event["event"] for event in written(run.events)]
    assert names.index("foreseen") < names.index("took_off")
    (foreseen,) = events(run, "foreseen")
    assert foreseen["lightest_s"] > foreseen["finish_by_s"] == 60.0


def test_a_remote_call_that_fails_falls_back_to_the_lighter_mode_where_it_is_late() -> None:
    dead = fault("link:s1", "stuck", from_s=150.0)
    calm, late = fly(5000.0, dead), fly(unhurried().result.mission_time_s - 5.0, dead)
    (as_asked,) = (call for call in events(calm, "call") if call["fell_back"])
    (fell_back,) = (call for call in events(late, "call") if call["fell_back"])
    assert as_asked["operation"] == fell_back["asked"] == "detector.process_photo[heavy]"
    assert fell_back["operation"] == "detector.process_photo[light]"
    assert as_asked["delay_s"] - fell_back["delay_s"] == pytest.approx(7.0)
    (sent,) = (
        event for event in events(late, "decided") if event["decision"] == "remote" and event["t"] > 150.0
    )
    assert sent["operation"] == "detector.process_photo[heavy]", "to the server it went as it was asked for"


@pytest.mark.parametrize("defective", ["decide", "fall_back"])
def test_a_defect_ends_offloading_and_the_missions_own_mode_is_used(
    monkeypatch: pytest.MonkeyPatch, defective: str
) -> None:
    def fail(*_: object, **__: object) -> Any:
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(Selection, defective, fail)
    run = fly(60.0 if defective == "decide" else 5000.0, fault("link:s1", "stuck", from_s=150.0))
    assert events(run, "offloading_failed")
    assert {call.key for call in run.result.calls} == {"heavy"}
    assert len(run.result.calls) == 18


@pytest.mark.parametrize(
    ("declared", "said"),
    [
        (service(name="detector")(Plain), "no service has a method with that profile key"),
        (service(name="detector", profile_by="mode")(Strict), "Invalid enum value 'light'"),
    ],
)
def test_a_service_that_has_no_such_mode_is_refused_before_anything_flies(declared: type, said: str) -> None:
    config = scenario(mission={"finish_by_s": 60.0, **LIGHTER})
    with pytest.raises(UsageError, match=r"mission\.lighter\.heavy") as refused:
        make_selection(config, {"detector": spec_of(declared)}, waypoints(config.mission))
    assert said in str(refused.value)


def test_what_a_server_says_was_raised_is_tested_by_the_same_call() -> None:
    """However late it is: the drone's own service cannot say whether another call raises."""
    lying = fault("s1", "lying", lie="faults", from_s=150.0)
    run = fly(unhurried().result.mission_time_s - 5.0, lying)
    tested = next(call for call in events(run, "call") if call.get("remote_fault"))
    assert (tested["operation"], tested["remote_fault"]) == ("detector.process_photo[heavy]", "denied")
    assert "asked" not in tested
    after = next(call for call in events(run, "call") if call["at_s"] > tested["at_s"] and "asked" in call)
    assert after["place"] == "local", "and what it took is saved later"


@pytest.mark.parametrize(
    ("finish_by_s", "tone", "named"),
    [(60.0, Tone.ALARM, "finish_by_s = 60"), (5000.0, Tone.ASIDE, "1:23:20")],
)
def test_a_person_is_alarmed_only_where_the_mission_cannot_be_over_in_time(
    finish_by_s: float, tone: Tone, named: str
) -> None:
    (foreseen,) = (event for event in fly(finish_by_s).events if isinstance(event, Foreseen))
    said = Narrator().tell(foreseen)
    assert said is not None and said.tone is tone
    assert said.text.endswith(named)
