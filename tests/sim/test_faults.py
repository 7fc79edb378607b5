"""What each fault looks like from the drone."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest
from tests.events import written
from tests.scenarios import fault, scenario, server

from upwash.config.world import FaultConfig
from upwash.errors import UsageError
from upwash.lab.run import Run, simulate
from upwash.sim.faults import Faults
from upwash.sim.loop import DeadlockError, run_virtually

NEAR = server("s1", 0.0, 0.0, range_m=1000.0)  # always in range


def fly(*faults: dict[str, Any], **tables: Any) -> Run:
    return simulate(scenario(NEAR, faults=faults, **{"columns": 3, "rows": 2} | tables))


def events(run: Run, name: str) -> list[dict[str, Any]]:
    return [event for event in written(run.events) if event["event"] == name]


def remote_delays_s(run: Run) -> list[float]:
    calls = [call for call in events(run, "call") if call["place"] == "s1"]
    assert calls
    return [call["delay_s"] - call["waited_s"] for call in calls]


def first(run: Run, name: str) -> dict[str, Any]:
    return events(run, name)[0]


@pytest.mark.parametrize(
    ("kind", "after_s", "why"),
    [
        ("off", 3.5, "does not answer"),
        ("stuck", 8.5, "no answer within 5.0 s"),
        ("garbage", 3.5, "a reply that cannot be decoded"),
        ("crash", 7.5, r"detector@s1 crashed while it started"),
    ],
)
def test_a_check_of_a_faulty_server_fails(kind: str, after_s: float, why: str) -> None:
    failed = first(fly(fault("s1", kind)), "check_failed")
    assert (failed["t"], failed["after"]) == (after_s, "BLACKLISTED")
    assert why in failed["why"]


def test_a_server_without_a_slot_has_not_failed_and_is_asked_until_it_has_one() -> None:
    run = fly(fault("s1", "full", to_s=20.0))
    (refused,) = events(run, "no_slot")
    assert (refused["t"], refused["server"], refused["waiting"]) == (3.5, "s1", 1)
    assert not events(run, "check_failed")
    assert first(run, "started")["t"] == pytest.approx(29.5, abs=2.0), (
        "asked every 2 s, and started once it had one"
    )
    waiting = [call for call in events(run, "call") if call["at_s"] < 20.0]
    assert {(call["place"], call["waited_s"], call["decision"]) for call in waiting} == {
        ("local", 0.0, "s1 has no free slot")
    }


def test_a_lying_server_is_found_out_by_its_first_call() -> None:
    run = fly(fault("s1", "wrong"))
    assert first(run, "found_running")["t"] == 3.5
    assert "s1:1 does not answer" in first(run, "remote_failed")["why"]
    assert first(run, "call_failed_in_range")["after"] == "BLACKLISTED"


@pytest.mark.parametrize(
    ("lie", "from_s", "why"),
    [
        ("elsewhere", 0.0, "the endpoint xds:///nobody, which is not its own"),
        ("oversized", 0.0, "a reply that cannot be decoded: Expected `str` of length"),
        ("oversized", 0.002, "a reply that cannot be decoded: Expected `array` of length <= 255"),
        ("lease", 0.0, "a reply that cannot be decoded: Expected a finite number"),
        ("lease", 0.005, "a reply that cannot be decoded: Expected `float` >= 2.0"),
        (
            "control",
            0.002,
            r"s1 is unavailable: \x1b[2J\x1b]0;nobody\x07\x9b31m\u202e\u2066\r\nupwash: all is well",
        ),
    ],
)
def test_a_lie_is_a_failed_check(lie: str, from_s: float, why: str) -> None:
    failed = first(fly(fault("s1", "lying", lie=lie, from_s=from_s)), "check_failed")
    assert failed["after"] == "BLACKLISTED"
    assert why in failed["why"]


@pytest.mark.parametrize("lie", ["types", "control"])
def test_a_lie_in_a_result_costs_the_call_and_the_server(lie: str) -> None:
    run = fly(fault("s1", "lying", lie=lie, from_s=22.0))
    failed = first(run, "call_failed_in_range")
    assert failed["after"] == "BLACKLISTED"
    assert failed["why"].isprintable()
    assert events(run, "call")[-1]["place"] == "local"


def test_what_nobody_asked_for_is_not_taken() -> None:
    run = fly(fault("s1", "lying", lie="unwanted"))
    assert run.result.totals.fallbacks == 0
    assert run.result.totals.remote["s1"] > 0


def test_a_slow_server_answers_later() -> None:
    run = fly(fault("s1", "slow", extra_s=2.0))
    assert first(run, "started")["t"] == 3.5 + 2.0 + 8.0 + 2.0
    assert all(delay_s == pytest.approx(0.7 + 2.0) for delay_s in remote_delays_s(run))


def test_what_was_ready_crashes_in_its_next_call_and_again_as_it_restarts() -> None:
    run = fly(fault("s1", "crash", from_s=22.0), policy={"blacklist_s": 5.0})
    failed = first(run, "remote_failed")
    assert failed["why"].endswith("detector@s1 crashed in a call")
    assert failed["t"] == pytest.approx(22.2 + 0.7 / 2)
    assert "crashed while it started" in first(run, "check_failed")["why"]


def test_instances_that_crash_as_the_lease_is_renewed_are_started_again() -> None:
    run = fly(fault("s1", "crash", from_s=21.4, to_s=21.6), policy={"blacklist_s": 5.0})
    assert "does not answer" in first(run, "remote_failed")["why"]
    assert len(events(run, "started")) == 2
    assert events(run, "call")[-1]["place"] == "s1"


def test_instances_have_ended_after_a_power_cut() -> None:
    run = fly(fault("s1", "power-cut", from_s=22.3, to_s=22.4), policy={"blacklist_s": 1.0})
    assert first(run, "remote_failed")["why"].endswith("s1 lost its power")
    assert len(events(run, "started")) == 2
    assert events(run, "call")[-1]["place"] == "s1"


def test_strangers_take_no_slot_that_the_drone_holds() -> None:
    run = fly(fault("s1", "full", from_s=11.6))
    assert run.result.totals.fallbacks == 0
    assert run.result.totals.remote == {"s1": 6}


def test_flapping_shows_as_off_every_other_five_seconds() -> None:
    async def look() -> list[str]:
        faults = Faults([FaultConfig(target="s1", kind="flapping", from_s=2.0, to_s=20.0)])
        kinds: list[str] = []
        for _ in range(24):
            on = faults.now("s1")
            kinds.append(on.kind if on else "-")
            await asyncio.sleep(1.0)
        return kinds

    off, well = ["off"] * 5, ["-"] * 5
    assert run_virtually(look()) == ["-"] * 2 + off + well + off + ["-"] * 7


@pytest.mark.parametrize(
    ("kind", "after_s", "why"),
    [("off", 3.5, "network s1 is out of range"), ("stuck", 8.5, "no answer within 5.0 s")],
)
def test_a_link_that_is_down(kind: str, after_s: float, why: str) -> None:
    failed = first(fly(fault("link:s1", kind)), "check_failed")
    assert failed["t"] == after_s
    assert why in failed["why"]


@pytest.mark.parametrize(
    ("kind", "lost_s", "why"),
    [
        ("off", 0.6, "s1: its network was lost: network s1 is off the air"),
        ("stuck", 4 * 0.7, "no answer within 2.8 s"),
    ],
)
def test_a_call_is_cut_at_once_by_a_network_that_is_lost_but_ends_with_its_deadline_where_nothing_gets_through(
    kind: str, lost_s: float, why: str
) -> None:
    policy = {"name": "location-aware"}
    ready = fly(policy=policy)
    call = events(ready, "call")[1]
    broken = fly(fault("link:s1", kind, from_s=call["t"] - 0.1), policy=policy)
    at = events(broken, "call")[1]
    assert (call["place"], at["place"], at["fell_back"]) == ("s1", "local", True)
    assert at["delay_s"] == pytest.approx(lost_s + 10.0)
    assert why in first(broken, "remote_failed")["why"]


def test_a_network_that_is_lost_between_calls_ends_the_use_of_its_server_then() -> None:
    run = fly(fault("link:s1", "off", from_s=27.0, to_s=29.0))
    lost = first(run, "network_lost")
    assert (lost["t"], lost["before"], lost["after"]) == (27.0, "READY", "BLACKLISTED")
    assert lost["why"] == "network s1 is off the air"
    assert events(run, "remote_failed") == []


def test_a_network_that_is_lost_while_its_server_is_asked_ends_the_check() -> None:
    lost = first(fly(fault("link:s1", "off", from_s=5.0)), "network_lost")
    assert (lost["t"], lost["before"], lost["after"]) == (5.0, "CHECK", "BLACKLISTED")


def test_what_befalls_a_target_is_known_when_it_does() -> None:
    async def when(*faults: FaultConfig, now_s: float = 3.0) -> float:
        await asyncio.sleep(now_s)
        await Faults(faults).befalls("link:s1", "off")
        return asyncio.get_running_loop().time()

    def link(kind: str, from_s: float, to_s: float) -> FaultConfig:
        return msgspec.convert(fault("link:s1", kind, from_s=from_s, to_s=to_s), FaultConfig)

    assert run_virtually(when(link("off", 0.0, 9.0))) == 3.0
    assert run_virtually(when(link("off", 4.0, 9.0))) == 4.0
    assert run_virtually(when(link("flapping", 0.1, 9.0))) == 3.0
    assert run_virtually(when(link("flapping", 0.1, 90.0), now_s=6.0)) == pytest.approx(10.1)
    assert run_virtually(when(link("slow", 2.0, 6.0), link("off", 4.0, 9.0))) == 6.0, "one fault at a time"
    with pytest.raises(DeadlockError):
        run_virtually(when(link("off", 1.0, 2.0), link("stuck", 5.0, 6.0)))


def test_a_slow_link_takes_half_of_its_time_each_way() -> None:
    run = fly(fault("link:s1", "slow", extra_s=1.0))
    assert all(delay_s == pytest.approx(0.7 + 1.0) for delay_s in remote_delays_s(run))


# --- the autopilot ------------------------------------------------------------------------------------------


def test_a_leg_that_is_never_reached_ends_the_mission_and_the_vehicle_lands() -> None:
    run = fly(fault("autopilot", "stuck", from_s=20.0))
    assert run.failure == "goto: the vehicle did not arrive within 69 s"
    assert not run.result.completed
    assert first(run, "safe_end")["t"] < first(run, "landed")["t"] <= first(run, "mission_ended")["t"]


def test_a_silent_autopilot_ends_the_mission_and_cannot_be_landed() -> None:
    run = fly(fault("autopilot", "off", from_s=20.0))
    assert run.failure == "goto: the vehicle's link is silent"
    assert "the vehicle's link is silent" in first(run, "safe_end_failed")["why"]


def test_an_autopilot_that_flaps_fails_the_verb_that_needs_it() -> None:
    assert fly(fault("autopilot", "flapping", from_s=1e5)).failure == ""
    assert fly(fault("autopilot", "flapping")).failure == "start: the vehicle's link is silent"


def test_slow_legs_take_so_much_more() -> None:
    well, slow = (
        fly(policy={"name": "local-only"}),
        fly(fault("autopilot", "slow", extra_s=3.0), policy={"name": "local-only"}),
    )
    assert slow.result.mission_time_s == pytest.approx(well.result.mission_time_s + 6 * 3.0)


@pytest.mark.parametrize(("target", "kind"), [("link:s1", "garbage"), ("autopilot", "crash")])
def test_a_fault_that_means_nothing_there_is_refused(target: str, kind: str) -> None:
    with pytest.raises(UsageError, match=rf"fault\[1\]\.kind: {target} cannot be {kind}: give one of off, "):
        Faults([FaultConfig(target="s1", kind="off"), FaultConfig(target=target, kind=kind)])  # type: ignore[arg-type]


# --- instances of no use ------------------------------------------------------------------------------------

PROBED = {"probe": {"first_s": 0.5, "longest_s": 1.0}, "hedge": False}


def test_an_instance_that_raises_is_replaced_once_three_calls_were_denied_and_serves_again() -> None:
    run = fly(fault("s1", "poisoned", from_s=22.0, to_s=23.0), columns=10, policy=PROBED)
    raised = [event["t"] for event in events(run, "remote_raised")]
    assert len(raised) == 3
    assert events(run, "call")[-1]["place"] == "s1"
    assert not events(run, "left_out"), "the first failure costs no pause"


def test_a_server_whose_service_does_not_start_is_left_out_for_the_pauses_that_it_names() -> None:
    run = fly(fault("s1", "unstartable"), columns=10, policy=PROBED)
    pauses = [(event["t"], event["pause_s"]) for event in events(run, "left_out")]
    assert [pause_s for _, pause_s in pauses] == [
        min(300.0, 10.0 * 2**number) for number in range(len(pauses))
    ]
    assert len(pauses) > 2
    joins_s = [event["t"] for event in events(run, "joined")]
    assert len(joins_s) == len(pauses)
    for (told_s, pause_s), joined_s in zip(pauses, joins_s[1:], strict=False):
        assert joined_s >= told_s + pause_s
