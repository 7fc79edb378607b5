"""When an instance is of no use, who had a part in it, and how long its service is left alone."""

from __future__ import annotations

import pytest

from upwash.core.admission.admission import AdmissionController, AdmissionSettings, Available, StartPending
from upwash.core.admission.clients import Client
from upwash.core.admission.instances import InstanceState, StartInstance, StopInstance
from upwash.core.admission.server import Denied, ServerOffer
from upwash.core.admission.watchdog import InstanceFailures, Limit, Watch

D1, D2, D3 = Client("d1"), Client("d2"), Client("d3")
BOTH = frozenset({"d1", "d2"})
CALL_LIMIT_S, LEAST_LIMIT_S, DENIALS = 60.0, 20.0, 3
FIRST_PAUSE_S, LONGEST_PAUSE_S, FORGOTTEN_S = 10.0, 300.0, 300.0


# --- a call's limit -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("took_s", "limit_s"), [((), 60.0), ((0.1,), LEAST_LIMIT_S), ((1.0, 8.0, 2.0), 40.0), ((50.0,), 60.0)]
)
def test_a_call_may_take_five_times_the_longest_one_within_bounds(
    took_s: tuple[float, ...], limit_s: float
) -> None:
    limit = Limit()
    for each_s in took_s:
        limit.answered(each_s)
    assert limit.seconds(60.0) == limit_s


def test_after_a_replacement_a_call_may_take_as_long_as_the_operator_allows() -> None:
    limit = Limit()
    limit.answered(0.1)
    limit.cut(60.0)
    limit.answered(0.1)
    assert limit.seconds(60.0) == 60.0


# --- one instance -------------------------------------------------------------------------------------------


def test_a_call_that_goes_on_for_too_long_is_named_with_its_drone_and_no_other() -> None:
    watch = Watch(lanes=2)
    watch.heard(29.0)
    watch.began("d1", 0.0)
    watch.began("d2", 20.0)
    assert watch.verdict(30.0, served=BOTH, now_s=29.9) is None
    useless = watch.verdict(30.0, served=BOTH, now_s=30.0)
    assert useless is not None and useless.drones == {"d1"}


def test_an_answered_call_is_over_whichever_call_of_the_drone_it_was() -> None:
    watch = Watch(lanes=2)
    watch.heard(30.0)
    watch.began("d1", 0.0)
    watch.began("d1", 5.0)
    watch.ended("d1", took_s=25.1, outcome="value", now_s=30.0)
    useless = watch.verdict(30.0, served=BOTH, now_s=30.0)
    assert useless is not None, "the second one was answered, and the first goes on"


def test_no_more_calls_are_believed_to_be_computed_than_there_are_lanes() -> None:
    watch = Watch(lanes=1)
    for second in range(100):
        watch.began(f"d{second}", float(second))
    assert watch.callers == {"d99"}


def test_an_instance_without_a_sign_of_life_is_of_no_use() -> None:
    watch = Watch(now_s=10.0)
    watch.began("d1", 30.0)
    assert watch.verdict(30.0, served=BOTH, now_s=39.9) is None
    useless = watch.verdict(30.0, served=BOTH, now_s=40.0)
    assert useless is not None and useless.drones == {"d1"} and "sign of life" in useless.why


def test_a_limit_shorter_than_the_pause_between_two_looks_costs_no_instance_its_life() -> None:
    watch = Watch(now_s=0.0)
    assert watch.verdict(1.0, served=BOTH, now_s=LEAST_LIMIT_S - 0.1) is None


def raising(watch: Watch, *drones: str) -> Watch:
    for drone in drones:
        watch.began(drone, 0.0)
        watch.ended(drone, took_s=0.0, outcome="raised", now_s=0.0)
        watch.denied(drone)
    return watch


@pytest.mark.parametrize(
    ("drones", "served", "stopped"),
    [
        (["d1"] * DENIALS, {"d1"}, True),
        (["d1"] * (DENIALS - 1), {"d1"}, False),
        (["d1"] * 50, BOTH, False),
        (["d1", "d2", "d1"], {"d1", "d2", "d3"}, True),
    ],
)
def test_denials_of_one_drone_stop_no_instance_that_another_drone_may_use(
    drones: list[str], served: set[str], stopped: bool
) -> None:
    useless = raising(Watch(), *drones).verdict(30.0, served=served, now_s=0.0)
    assert (useless is not None) == stopped


def test_a_value_that_it_returns_to_anybody_is_proof_of_its_use() -> None:
    watch = raising(Watch(), *["d1"] * (DENIALS - 1))
    watch.began("d2", 0.0)
    watch.ended("d2", took_s=0.0, outcome="value", now_s=0.0)
    raising(watch, "d1")
    assert watch.verdict(30.0, served={"d1"}, now_s=0.0) is None


def test_a_denial_counts_only_where_the_instance_has_raised() -> None:
    watch = Watch()
    for _ in range(50):
        watch.denied("d1")
    assert watch.verdict(30.0, served={"d1"}, now_s=0.0) is None


# --- in a row -----------------------------------------------------------------------------------------------


def test_a_service_that_does_not_start_is_left_alone_for_pauses_that_double() -> None:
    failures, now_s, pauses_s = InstanceFailures(), 0.0, []
    for _ in range(8):
        failures.add("no model", frozenset(), had_started=False, now_s=now_s)
        pauses_s.append(failures.pause_s("d1", now_s=now_s))
        now_s += pauses_s[-1]
    assert pauses_s == [10.0, 20.0, 40.0, 80.0, 160.0, 300.0, 300.0, 300.0]


def test_the_first_failure_of_one_that_had_started_costs_no_pause_and_is_forgotten_at_last() -> None:
    failures = InstanceFailures()
    failures.add("killed", frozenset(), had_started=True, now_s=0.0)
    assert failures.pause_s("d1", now_s=0.0) == 0.0
    failures.add("killed", frozenset(), had_started=True, now_s=FORGOTTEN_S)
    assert failures.pause_s("d1", now_s=FORGOTTEN_S) == FIRST_PAUSE_S
    later_s = FORGOTTEN_S + FIRST_PAUSE_S + FORGOTTEN_S + 0.1
    failures.add("killed", frozenset(), had_started=True, now_s=later_s)
    assert failures.pause_s("d1", now_s=later_s) == 0.0


def test_a_drone_that_was_at_each_failure_has_the_pause_alone() -> None:
    failures = InstanceFailures()
    failures.add("busy", BOTH, had_started=True, now_s=0.0)
    failures.add("busy", frozenset({"d2", "d3"}), had_started=True, now_s=60.0)
    assert failures.pause_s("d2", now_s=60.0) == FIRST_PAUSE_S
    assert [failures.pause_s(drone, now_s=60.0) for drone in ("d1", "d3")] == [0.0, 0.0]


def test_failures_of_different_drones_are_the_services_and_count_from_there() -> None:
    failures, now_s = InstanceFailures(), 0.0
    for _ in range(6):
        failures.add("busy", frozenset({"d2"}), had_started=True, now_s=now_s)
        now_s += failures.pause_s("d2", now_s=now_s)
    failures.add("busy", frozenset({"d1"}), had_started=True, now_s=now_s)
    assert failures.pause_s("d1", now_s=now_s) == 0.0, "what d2 did costs d1 nothing"
    failures.add("busy", frozenset({"d2"}), had_started=True, now_s=now_s)
    assert failures.pause_s("d3", now_s=now_s) == FIRST_PAUSE_S


def test_no_pause_is_longer_than_its_bound_however_often_a_service_fails() -> None:
    failures = InstanceFailures()
    for _ in range(5_000):
        failures.add("no model", frozenset(), had_started=False, now_s=0.0)
    assert failures.pause_s("d1", now_s=0.0) == LONGEST_PAUSE_S


# --- a server -----------------------------------------------------------------------------------------------


def host(*drones: Client, slots: int = 2) -> AdmissionController:
    """A server with its detector running for these drones."""
    machine = AdmissionController(
        {"s1": ServerOffer(frozenset({"detector"}), slots)}, AdmissionSettings(lease_s=1e4)
    )
    for drone in drones:
        machine.start("s1", "detector", drone, now_s=0.0)
    machine.at("s1").ready("detector", 1, ":1", now_s=0.0)
    return machine


def hang(machine: AdmissionController, drone: Client, number: int, now_s: float) -> float:
    """A call of the drone keeps the instance of that number busy until it is gone, at the time returned."""
    machine.at("s1").called("detector", number, drone.key, now_s=now_s)
    over_s = now_s + CALL_LIMIT_S
    machine.at("s1").heard("detector", number, now_s=over_s)
    assert machine.at("s1").watch("detector", number, now_s=over_s - 0.1) == []
    stop = machine.at("s1").watch("detector", number, now_s=over_s)[0]
    assert isinstance(stop, StopInstance) and stop.number == number and "kept it busy for 60 s" in stop.why
    return over_s


def test_an_instance_of_no_use_is_stopped_and_started_anew() -> None:
    machine = host(D1)
    now_s = hang(machine, D1, 1, 0.0)
    assert machine.at("s1").watch("detector", 1, now_s=now_s + 5.0) == [], "it is being stopped"
    assert machine.at("s1").gone("detector", 1, now_s=now_s) == [StartInstance("s1", "detector", 2)]
    (status,) = machine.servers(now_s=now_s)[0].instances
    assert (status.replaced, status.failures, status.paused_s) == (1, 1, 0.0)


def test_a_drone_whose_calls_hang_again_and_again_is_shut_out_and_another_is_served() -> None:
    machine = host(D1, D2)
    now_s = hang(machine, D2, 1, 0.0)
    machine.at("s1").gone("detector", 1, now_s=now_s)
    machine.at("s1").ready("detector", 2, ":2", now_s=now_s)
    now_s = hang(machine, D2, 2, now_s)
    assert machine.leases("s1") == {"d1"}
    assert machine.at("s1").gone("detector", 2, now_s=now_s) == [StartInstance("s1", "detector", 3)]
    answer, _ = machine.availability("s1", ["detector"], D2, now_s=now_s)
    assert isinstance(answer, Denied) and answer.pause_s == FIRST_PAUSE_S
    assert isinstance(machine.availability("s1", ["detector"], D1, now_s=now_s)[0], Available)
    assert isinstance(machine.availability("s1", [], D2, now_s=now_s)[0], Available), "other services are"
    assert isinstance(machine.start("s1", "detector", D2, now_s=now_s + FIRST_PAUSE_S)[0], StartPending)


def test_a_service_that_does_not_start_is_offered_to_nobody_during_the_pause() -> None:
    machine = host(D1)
    machine.at("s1").gone("detector", 1, "killed by SIGKILL", now_s=0.0)
    machine.start("s1", "detector", D1, now_s=1.0)
    assert machine.at("s1").gone("detector", 2, "no such model", now_s=2.0) == []
    for drone in (D1, D2):
        answer, commands = machine.start("s1", "detector", drone, now_s=3.0)
        assert isinstance(answer, Denied) and answer.pause_s == 19.0 and commands == []
        assert "failed 2 times in a row: no such model" in answer.why
    answer, _ = machine.start("s1", "detector", D1, now_s=21.5)
    assert isinstance(answer, Denied) and answer.pause_s == 0.5


def test_a_sign_of_life_of_this_instance_and_of_no_other_keeps_it_running() -> None:
    machine = host(D1)
    machine.at("s1").heard("detector", 1, now_s=50.0)
    machine.at("s1").heard("detector", 7, now_s=90.0)
    assert machine.at("s1").watch("detector", 1, now_s=109.9) == []
    assert machine.at("s1").watch("detector", 7, now_s=110.0) == []
    (stop, *_) = machine.at("s1").watch("detector", 1, now_s=110.0)
    assert isinstance(stop, StopInstance) and "no sign of life for 60 s" in stop.why


@pytest.mark.parametrize(("outcome", "limit_s"), [("value", 50.0), ("raised", 60.0)])
def test_the_limit_of_calls_is_learnt_from_values(outcome: str, limit_s: float) -> None:
    machine = host(D1)
    machine.at("s1").answered("detector", 1, "d1", took_s=10.0, outcome=outcome, now_s=10.0)
    machine.at("s1").called("detector", 1, "d1", now_s=100.0)
    machine.at("s1").heard("detector", 1, now_s=100.0 + limit_s)
    assert machine.at("s1").watch("detector", 1, now_s=99.9 + limit_s) == []
    assert machine.at("s1").watch("detector", 1, now_s=100.0 + limit_s) != []


def test_an_instance_computes_one_call_at_a_time_unless_its_offer_says_more() -> None:
    for lanes, stopped in (({}, False), ({"detector": 2}, True)):
        machine = AdmissionController(
            {"s1": ServerOffer(frozenset({"detector"}), 2, lanes=lanes)}, AdmissionSettings(lease_s=1e4)
        )
        machine.start("s1", "detector", D1, now_s=0.0)
        machine.at("s1").ready("detector", 1, ":1", now_s=0.0)
        machine.at("s1").called("detector", 1, "d1", now_s=0.0)
        machine.at("s1").called("detector", 1, "d2", now_s=50.0)
        machine.at("s1").heard("detector", 1, now_s=60.0)
        assert bool(machine.at("s1").watch("detector", 1, now_s=60.0)) == stopped


def test_an_instance_that_is_stopped_for_another_reason_has_not_failed() -> None:
    machine = host(D1)
    machine.leave("s1", D1, now_s=0.0)
    assert machine.look(now_s=600.0) == [StopInstance("s1", "detector", 1)]
    assert machine.at("s1").gone("detector", 1, "stopped", now_s=601.0) == []
    (status,) = machine.servers(now_s=601.0)[0].instances
    assert (status.replaced, status.failures) == (0, 0)


def test_a_daemon_that_closes_starts_nothing_anew() -> None:
    machine = host(D1)
    now_s = hang(machine, D1, 1, 0.0)
    machine.close("shutting down")
    assert machine.at("s1").gone("detector", 1, now_s=now_s) == []
    assert machine.at("s1").state("detector") is InstanceState.ABSENT


def test_a_drone_without_a_lease_denies_nothing() -> None:
    machine = host(D1)
    for _ in range(DENIALS):
        machine.at("s1").answered("detector", 1, "d1", took_s=0.1, queued_s=0.0, outcome="raised", now_s=1.0)
        assert machine.deny("s1", ["detector", "unknown"], D3, now_s=1.0) == []
        assert machine.deny("s9", ["detector"], D1, now_s=1.0) == []
    assert machine.at("s1").state("detector") is InstanceState.RUNNING
    for _ in range(DENIALS):
        commands = machine.deny("s1", ["detector", "unknown"], D1, now_s=1.0)
    assert isinstance(commands[0], StopInstance)
