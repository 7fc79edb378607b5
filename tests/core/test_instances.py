"""Requests in, answers and commands out: what the server-side machine grants, starts and stops."""

from __future__ import annotations

import pytest

from upwash.core.admission.admission import (
    AdmissionController,
    AdmissionSettings,
    Available,
    ServiceRunning,
    StartPending,
)
from upwash.core.admission.clients import (
    AccountStatus,
    Client,
    DroneUsage,
    InstanceStatus,
    LeaseStatus,
    Role,
    ServerStatus,
    TeamUsage,
)
from upwash.core.admission.instances import InstanceState, StartInstance, StopInstance
from upwash.core.admission.leases import Admit
from upwash.core.admission.server import Denied, ServerOffer
from upwash.core.admission.usage import LeaseEnded

ABSENT, STARTING, RUNNING, STOPPING = InstanceState


def host(*, slots: int = 1) -> AdmissionController:
    """s1 can run a detector and a counter, s2 a detector; a lease lasts 30 s, an instance 600 s without a call."""
    offers = {
        "s1": ServerOffer(frozenset({"detector", "counter"}), slots),
        "s2": ServerOffer(frozenset({"detector"}), slots),
    }
    return AdmissionController(offers, AdmissionSettings(lease_s=30.0, idle_stop_s=600.0))


def with_detector_running(*, slots: int = 1) -> AdmissionController:
    """The host with instance 1, a detector on s1 that drone d1 had started, ready at 8 s."""
    machine = host(slots=slots)
    machine.start("s1", "detector", Client("d1"), now_s=0.0)
    machine.at("s1").ready("detector", 1, "10.0.0.1:9000", now_s=8.0)
    assert machine.at("s1").state("detector") is RUNNING
    return machine


def admit(*drones: str, server: str = "s1") -> Admit:
    return Admit(server, frozenset(drones))


def ended(slot_s: float, drone: str = "d1") -> LeaseEnded:
    return LeaseEnded("s1", drone, slot_s, calls=0, computed_s=0.0)


# ---- slots and leases


def test_a_free_slot_is_held_for_the_drone_that_asked() -> None:
    machine = host()
    answer, commands = machine.availability("s1", ["detector"], Client("d1"), now_s=0.0)
    assert answer == Available({})  # nothing runs yet
    assert commands == [admit("d1")]
    assert machine.leases("s1") == {"d1"}


@pytest.mark.parametrize(
    ("server", "services", "why"),
    [
        ("s3", ["detector"], "no server s3 here; this daemon is s1, s2"),
        ("s2", ["detector", "counter"], "s2 has no image of counter"),
    ],
)
def test_a_denial_says_why_and_changes_nothing(server: str, services: list[str], why: str) -> None:
    machine = with_detector_running()
    answer, commands = machine.availability(server, services, Client("d2"), now_s=9.0)
    assert answer == Denied(why)
    assert commands == []
    assert machine.leases("s1") == {"d1"}
    assert machine.leases("s2") == set()
    assert machine.refused_times == {"s1": 0, "s2": int(server == "s2"), "": int(server == "s3")}


@pytest.mark.parametrize(("server", "service"), [("s3", "detector"), ("s2", "counter"), ("s1", "counter")])
def test_a_start_is_denied_for_the_same_reasons(server: str, service: str) -> None:
    machine = with_detector_running()
    answer, commands = machine.start(server, service, Client("d2"), now_s=9.0)
    assert isinstance(answer, Denied)
    assert commands == []
    assert machine.at("s1").state("counter") is ABSENT


def test_a_drone_that_holds_a_slot_needs_no_other() -> None:
    machine = host()
    machine.availability("s1", ["detector"], Client("d1"), now_s=0.0)
    answer, commands = machine.availability("s1", ["counter"], Client("d1"), now_s=1.0)
    assert isinstance(answer, Available)
    assert commands == []  # admitted already


def test_as_many_drones_as_slots() -> None:
    machine = host(slots=2)
    machine.availability("s1", ["detector"], Client("d1"), now_s=0.0)
    _, commands = machine.availability("s1", ["detector"], Client("d2"), now_s=0.0)
    assert commands == [admit("d1", "d2")]
    assert isinstance(machine.availability("s1", ["detector"], Client("d3"), now_s=0.0)[0], Denied)


def test_each_server_of_a_daemon_has_its_own_slots_and_instances() -> None:
    machine = with_detector_running()
    answer, commands = machine.start("s2", "detector", Client("d2"), now_s=9.0)
    assert isinstance(answer, StartPending)
    assert commands == [admit("d2", server="s2"), StartInstance("s2", "detector", 2)]
    assert machine.at("s1").state("detector") is RUNNING


def test_the_lease_of_a_drone_that_is_heard_of_no_more_ends_by_itself() -> None:
    machine = host()
    machine.availability("s1", ["detector"], Client("d1"), now_s=0.0)
    assert machine.look(now_s=29.9) == []
    assert machine.look(now_s=30.0) == [ended(30.0), admit()]
    assert machine.leases("s1") == set()


def test_a_lease_that_is_over_makes_room_without_anyone_looking() -> None:
    machine = host()
    machine.availability("s1", ["detector"], Client("d1"), now_s=0.0)
    answer, commands = machine.availability("s1", ["detector"], Client("d2"), now_s=30.0)
    assert isinstance(answer, Available)
    assert commands == [ended(30.0), admit(), admit("d2")]


def test_a_denied_request_still_ends_the_leases_that_are_over() -> None:
    machine = host()
    machine.availability("s1", ["detector"], Client("d1"), now_s=0.0)
    answer, commands = machine.availability("s3", ["detector"], Client("d2"), now_s=30.0)
    assert isinstance(answer, Denied)
    assert commands == [ended(30.0), admit()]


def test_every_request_renews_the_lease_and_what_the_daemon_sees_and_nothing_that_an_instance_says() -> None:
    machine = host()
    machine.availability("s1", ["detector"], Client("d1"), now_s=0.0)
    machine.availability("s1", ["detector"], Client("d1"), now_s=20.0)
    assert machine.look(now_s=49.9) == []
    machine.start("s1", "detector", Client("d1"), now_s=49.9)
    assert machine.look(now_s=79.8) == []
    machine.at("s1").ready("detector", 1, "10.0.0.1:9000", now_s=79.8)
    machine.at("s1").seen("d1", now_s=79.8)
    assert machine.look(now_s=109.7) == []
    machine.at("s1").called("detector", 1, "d1", now_s=109.7)
    assert machine.look(now_s=109.8) == [ended(109.8), admit()]


def test_a_call_gives_no_lease_to_a_drone_without_one() -> None:
    machine = with_detector_running(slots=2)
    machine.at("s1").called("detector", 1, "d2", now_s=9.0)
    machine.at("s1").seen("d2", now_s=9.0)
    assert machine.leases("s1") == {"d1"}


def test_drones_are_seen_by_their_certificates_and_no_others_lease_is_renewed() -> None:
    machine = host(slots=2)
    machine.availability("s1", ["detector"], Client("d1", "f1"), now_s=0.0)
    machine.at("s1").seen("d1", now_s=20.0)
    assert machine.look(now_s=30.0) == [ended(30.0), admit()]
    machine.availability("s1", ["detector"], Client("d1", "f1"), now_s=30.0)
    machine.at("s1").seen("f1", now_s=50.0)
    assert machine.look(now_s=79.9) == []


def test_calls_of_drones_without_a_lease_keep_no_instance_from_being_stopped() -> None:
    machine = with_detector_running()
    machine.leave("s1", Client("d1"), now_s=0.0)
    machine.at("s1").called("detector", 1, "d1", now_s=500.0)
    assert machine.look(now_s=608.0) == [StopInstance("s1", "detector", 1)]


def test_a_drone_that_leaves_frees_its_slot_at_once() -> None:
    machine = with_detector_running()
    assert machine.leave("s1", Client("d1"), now_s=0.0) == [ended(0.0), admit()]
    answer, _ = machine.availability("s1", ["detector"], Client("d2"), now_s=9.0)
    assert isinstance(answer, Available)


@pytest.mark.parametrize(("server", "drone"), [("s1", "d2"), ("s2", "d1"), ("s3", "d1")])
def test_leaving_where_one_never_was_changes_nothing(server: str, drone: str) -> None:
    machine = with_detector_running()
    assert machine.leave(server, Client(drone), now_s=0.0) == []
    assert machine.leases("s1") == {"d1"}


# ---- instances


def test_a_start_makes_an_instance_and_holds_a_slot() -> None:
    machine = host()
    answer, commands = machine.start("s1", "detector", Client("d1"), now_s=0.0)
    assert answer == StartPending(1, stopping=False)
    assert commands == [admit("d1"), StartInstance("s1", "detector", 1)]
    assert machine.at("s1").state("detector") is STARTING


def test_two_starts_of_one_service_make_one_instance() -> None:
    machine = host(slots=2)
    machine.start("s1", "detector", Client("d1"), now_s=0.0)
    answer, commands = machine.start("s1", "detector", Client("d2"), now_s=1.0)
    assert answer == StartPending(1, stopping=False)
    assert commands == [admit("d1", "d2")]


def test_an_instance_that_starts_is_not_offered_before_it_is_ready() -> None:
    machine = host()
    machine.start("s1", "detector", Client("d1"), now_s=0.0)
    assert machine.availability("s1", ["detector"], Client("d1"), now_s=1.0)[0] == Available({})
    assert machine.at("s1").ready("detector", 1, "10.0.0.1:9000", now_s=8.0) == [admit("d1")]
    endpoints = {"detector": "10.0.0.1:9000"}
    assert machine.availability("s1", ["detector", "counter"], Client("d1"), now_s=9.0)[0] == Available(
        endpoints
    )
    assert machine.availability("s1", ["counter"], Client("d1"), now_s=9.0)[0] == Available({})
    assert machine.start("s1", "detector", Client("d1"), now_s=9.0) == (ServiceRunning("10.0.0.1:9000"), [])


def test_an_instance_that_becomes_ready_after_the_drone_left_admits_nobody() -> None:
    machine = host()
    machine.start("s1", "detector", Client("d1"), now_s=0.0)
    machine.leave("s1", Client("d1"), now_s=0.0)
    assert machine.at("s1").ready("detector", 1, "10.0.0.1:9000", now_s=8.0) == [admit()]


def test_an_instance_that_crashed_is_absent_and_started_again_on_request() -> None:
    machine = with_detector_running()
    machine.at("s1").gone("detector", 1)
    assert machine.availability("s1", ["detector"], Client("d1"), now_s=9.0)[0] == Available({})
    answer, commands = machine.start("s1", "detector", Client("d1"), now_s=9.0)
    assert answer == StartPending(2, stopping=False)
    assert commands == [StartInstance("s1", "detector", 2)]


def test_an_end_that_is_reported_twice_starts_nothing() -> None:
    machine = with_detector_running()
    for now_s in (9.0, 10.0):
        assert machine.at("s1").gone("detector", 1, "killed", now_s=now_s) == []
    assert machine.at("s1").state("detector") is ABSENT


def test_a_service_that_is_withdrawn_is_shown_until_its_instance_has_ended() -> None:
    machine = with_detector_running()
    machine.at("s1").change(ServerOffer(frozenset({"counter"}), 1), outdated=frozenset())
    assert [(each.service, each.state) for each in machine.servers(now_s=9.0)[0].instances] == [
        ("counter", "absent"),
        ("detector", "stopping"),
    ]
    machine.at("s1").gone("detector", 1, now_s=10.0)
    assert [each.service for each in machine.servers(now_s=10.0)[0].instances] == ["counter"]


def test_an_instance_that_did_not_start_can_be_started_again() -> None:
    machine = host()
    machine.start("s1", "detector", Client("d1"), now_s=0.0)
    machine.at("s1").gone("detector", 1)
    assert machine.start("s1", "detector", Client("d1"), now_s=1.0)[1] == [StartInstance("s1", "detector", 2)]


def test_what_is_told_of_an_earlier_instance_changes_nothing() -> None:
    machine = with_detector_running()
    machine.at("s1").gone("detector", 1)
    assert machine.at("s1").ready("detector", 1, "10.0.0.1:9000", now_s=9.0) == []
    assert machine.at("s1").state("detector") is ABSENT
    machine.start("s1", "detector", Client("d1"), now_s=10.0)
    assert machine.at("s1").ready("detector", 1, "10.0.0.1:9000", now_s=11.0) == []
    machine.at("s1").gone("detector", 1)
    assert machine.at("s1").state("detector") is STARTING
    machine.at("s1").ready("detector", 2, "10.0.0.1:9001", now_s=12.0)
    machine.at("s1").gone("detector", 1)
    assert machine.start("s1", "detector", Client("d1"), now_s=13.0)[0] == ServiceRunning("10.0.0.1:9001")


def test_an_instance_that_nobody_uses_is_stopped_once() -> None:
    machine = with_detector_running()
    machine.availability("s1", ["detector"], Client("d1"), now_s=30.0)
    machine.at("s1").called("detector", 1, "d1", now_s=50.0)
    machine.leave("s1", Client("d1"), now_s=0.0)
    assert machine.look(now_s=649.9) == []
    assert machine.look(now_s=650.0) == [StopInstance("s1", "detector", 1)]
    assert machine.look(now_s=800.0) == []
    assert machine.at("s1").state("detector") is STOPPING


def test_an_instance_that_was_never_called_is_idle_from_when_it_was_ready() -> None:
    machine = with_detector_running()
    machine.leave("s1", Client("d1"), now_s=0.0)
    assert machine.look(now_s=607.9) == []
    assert machine.look(now_s=608.0) == [StopInstance("s1", "detector", 1)]


def test_an_instance_that_starts_for_long_is_not_idle() -> None:
    machine = host()
    machine.start("s1", "detector", Client("d1"), now_s=0.0)
    assert machine.look(now_s=1000.0) == [ended(1000.0), admit()]
    assert machine.at("s1").state("detector") is STARTING


def test_nothing_is_stopped_under_a_drone_with_a_lease() -> None:
    machine = with_detector_running()
    machine.availability("s1", ["detector"], Client("d1"), now_s=20.0)
    for now_s in range(40, 1000, 20):
        answer, commands = machine.availability("s1", ["detector"], Client("d1"), now_s=float(now_s))
        assert isinstance(answer, Available)
        assert commands == []
    assert machine.look(now_s=1100.0) == [ended(1100.0), admit(), StopInstance("s1", "detector", 1)]


def test_the_lease_of_one_server_does_not_keep_the_instances_of_another() -> None:
    machine = with_detector_running()
    machine.leave("s1", Client("d1"), now_s=0.0)
    machine.availability("s2", ["detector"], Client("d1"), now_s=607.0)
    assert machine.look(now_s=608.0) == [StopInstance("s1", "detector", 1)]


def test_an_instance_that_stops_is_started_again_only_once_it_is_gone() -> None:
    machine = with_detector_running()
    machine.leave("s1", Client("d1"), now_s=0.0)
    machine.look(now_s=608.0)
    assert machine.availability("s1", ["detector"], Client("d1"), now_s=609.0)[0] == Available({})
    answer, commands = machine.start("s1", "detector", Client("d1"), now_s=609.0)
    assert answer == StartPending(1, stopping=True)
    assert commands == []
    machine.at("s1").gone("detector", 1)
    assert machine.start("s1", "detector", Client("d1"), now_s=610.0)[1] == [
        StartInstance("s1", "detector", 2)
    ]


# ---- certificates


OURS = Client("d1", "0a")
THEIRS = Client("d1", "0b")  # of the same name, after a theft


def test_instances_know_a_drone_by_its_certificate_where_it_has_one() -> None:
    machine = host()
    assert machine.availability("s1", [], OURS, now_s=0.0)[1] == [admit("0a")]
    assert machine.availability("s1", [], THEIRS, now_s=1.0)[1] == [admit("0b")]
    assert machine.leave("s1", OURS, now_s=0.0) == [], "the lease is held with another certificate now"
    assert machine.leave("s1", THEIRS, now_s=0.0) == [ended(0.0, THEIRS.name), admit()]


def test_a_certificate_that_is_revoked_loses_its_lease_and_gets_no_other() -> None:
    machine = host()
    machine.availability("s1", [], OURS, now_s=0.0)
    assert machine.revoke(frozenset({"0a"}), now_s=0.0) == [ended(0.0, OURS.name), admit()]
    assert machine.leases("s1") == set()
    answer, commands = machine.start("s1", "detector", OURS, now_s=1.0)
    assert (answer, commands) == (Denied("the certificate of d1 is revoked"), [])
    assert isinstance(machine.availability("s1", [], THEIRS, now_s=1.0)[0], Available)
    assert machine.revoke(frozenset(), now_s=0.0) == []
    assert isinstance(machine.availability("s1", [], OURS, now_s=2.0)[0], Available)


def test_drones_without_certificates_are_not_touched_by_revocation() -> None:
    machine = host()
    machine.availability("s1", [], Client("d1"), now_s=0.0)
    assert machine.revoke(frozenset({"0a"}), now_s=0.0) == []
    assert machine.leases("s1") == {"d1"}


# ---- another configuration


def test_a_service_that_is_withdrawn_is_stopped_and_one_of_another_version_started_beside() -> None:
    machine = with_detector_running()
    same = ServerOffer(frozenset({"detector"}), 1)
    offers = {"s1": ServerOffer(frozenset({"mapper"}), 1), "s2": same}
    why = "s1 has no image of detector any more"
    assert machine.offer(offers, outdated=frozenset()) == [StopInstance("s1", "detector", 1, why)]
    answer, _ = machine.availability("s1", ["detector"], Client("d1"), now_s=9.0)
    assert answer == Denied("s1 has no image of detector")
    _, commands = machine.start("s1", "mapper", Client("d1"), now_s=9.0)
    assert commands == [StartInstance("s1", "mapper", 2)]
    machine.at("s1").ready("mapper", 2, ":9001", now_s=10.0)
    outdated = frozenset({("s1", "mapper")})
    assert machine.offer(offers, outdated=outdated) == [StartInstance("s1", "mapper", 3)]


def test_where_the_running_instance_ends_first_the_one_of_the_other_version_has_its_place() -> None:
    machine = with_detector_running()
    same = ServerOffer(frozenset({"detector"}), 1)
    machine.offer({"s1": same, "s2": same}, outdated=frozenset({("s1", "detector")}))
    machine.at("s1").gone("detector", 1, "killed", now_s=9.0)
    assert machine.start("s1", "detector", Client("d1"), now_s=9.5)[0] == StartPending(2, stopping=False)
    machine.at("s1").ready("detector", 2, ":9001", now_s=10.0)
    assert machine.start("s1", "detector", Client("d1"), now_s=11.0)[0] == ServiceRunning(":9001")


def test_a_daemon_is_idle_without_slots_that_are_held_and_instances_that_run() -> None:
    machine = host()
    assert machine.is_idle
    machine.start("s1", "detector", Client("d1"), now_s=0.0)
    assert not machine.is_idle
    machine.at("s1").ready("detector", 1, ":9000", now_s=8.0)
    machine.leave("s1", Client("d1"), now_s=9.0)
    assert not machine.is_idle, "an instance runs"
    assert machine.look(now_s=608.0) == [StopInstance("s1", "detector", 1)]
    assert machine.is_idle


def test_the_next_end_is_looked_for_within_a_lease_and_within_the_time_of_an_idle_instance() -> None:
    offers = {"s1": ServerOffer(frozenset({"detector"}), 1)}
    for lease_s, idle_stop_s in ((30.0, 600.0), (600.0, 30.0)):
        machine = AdmissionController(offers, AdmissionSettings(lease_s=lease_s, idle_stop_s=idle_stop_s))
        assert machine.next_end_s(now_s=100.0) == 130.0
    machine.start("s1", "detector", Client("d1"), now_s=100.0)
    machine.at("s1").ready("detector", 1, ":9000", now_s=108.0)
    assert machine.next_end_s(now_s=120.0) == 138.0


def test_a_former_instance_that_ended_by_itself_is_not_stopped() -> None:
    machine = with_detector_running()
    same = ServerOffer(frozenset({"detector"}), 1)
    machine.offer({"s1": same, "s2": same}, outdated=frozenset({("s1", "detector")}))
    machine.at("s1").ready("detector", 2, ":9001", now_s=10.0)
    assert machine.next_end_s(now_s=10.0) == 30.0
    machine.at("s1").gone("detector", 1, "killed", now_s=11.0)
    assert machine.look(now_s=50.0) == [ended(50.0), admit()]


def test_measured_slots_have_a_lane_for_each_service_unless_the_offer_says_more() -> None:
    for lanes, slots in (({}, 4), ({"detector": 3}, 12)):
        offer = ServerOffer(frozenset({"detector"}), "auto", lanes=lanes)
        assert AdmissionController({"s1": offer}).servers(now_s=0.0)[0].slots == slots


def test_a_former_instance_serves_on_where_another_version_comes_after_its_successor_has_ended() -> None:
    machine = with_detector_running()
    same = ServerOffer(frozenset({"detector"}), 1)
    offers, outdated = {"s1": same, "s2": same}, frozenset({("s1", "detector")})
    assert machine.offer(offers, outdated=outdated) == [StartInstance("s1", "detector", 2)]
    machine.at("s1").ready("detector", 2, ":9001", now_s=1.0)
    machine.at("s1").gone("detector", 2, "killed", now_s=2.0)
    assert machine.offer(offers, outdated=outdated) == []
    assert machine.start("s1", "detector", Client("d1"), now_s=3.0)[1] == [StartInstance("s1", "detector", 3)]
    stop = StopInstance("s1", "detector", 3, "s1 has another version of detector now")
    assert machine.offer(offers, outdated=outdated) == [stop], (
        "and not the first, whose address drones may have"
    )


def test_fewer_slots_end_no_lease_but_give_none_either() -> None:
    machine = host(slots=2)
    for drone in ("d1", "d2"):
        machine.availability("s1", [], Client(drone), now_s=0.0)
    only = ServerOffer(frozenset({"detector"}), 1)
    assert machine.offer({"s1": only, "s2": only}, outdated=frozenset()) == []
    assert isinstance(machine.availability("s1", [], Client("d1"), now_s=1.0)[0], Available)
    machine.leave("s1", Client("d2"), now_s=1.0)
    answer, _ = machine.availability("s1", [], Client("d2"), now_s=2.0)
    assert answer == Denied("s1 has no free slot: 1 of 1 in use", waiting=1, ask_again_s=2.0)


# ---- closing


def test_a_daemon_that_closes_stops_what_runs_or_starts_and_serves_nobody_for_the_first_reason() -> None:
    machine = with_detector_running()
    machine.start("s2", "detector", Client("d2"), now_s=9.0)
    assert machine.close("shutting down") == [
        StopInstance("s1", "detector", 1, "shutting down"),
        StopInstance("s2", "detector", 2, "shutting down"),
    ]
    assert machine.close("gone") == []
    for drone in ("d1", "d3"):
        answer, _ = machine.availability("s1", ["detector"], Client(drone), now_s=9.0)
        assert answer == Denied("shutting down")
    assert machine.at("s2").ready("detector", 2, ":9001", now_s=9.5) == []
    assert machine.at("s2").state("detector") is STOPPING


# ---- what operators see

ALICE = Client("alice", "0c", role=Role.OPERATOR)


def test_an_operator_sees_the_servers_and_the_last_refusals_the_latest_first() -> None:
    machine = with_detector_running()
    for now_s in (10.0, 11.0):
        machine.availability("s1", [], Client("d2"), now_s=now_s)
    machine.refused("s1", "d1", "no such model", now_s=12.0)
    shown = machine.show(ALICE, now_s=14.0)
    assert not isinstance(shown, Denied)
    servers, refusals = shown
    assert servers[0] == ServerStatus(
        "s1",
        1,
        [LeaseStatus("d1", "", 16.0)],
        [
            InstanceStatus("counter", "absent", "", 0.0),
            InstanceStatus("detector", "running", "10.0.0.1:9000", 6.0),
        ],
        slots_why="configured",
        turn_s=30.0,
        accounts=[AccountStatus("d1", 14.0, 14.0, None), AccountStatus("d2", 10.0, None, 4.0)],
        drones=[DroneUsage("d1", "d1", 14.0, 14.0, 0, 0.0, None)],
        teams=[TeamUsage("d1", 1, 14.0, 0, 0.0, None)],
    )
    assert [(refusal.client, refusal.why, refusal.times, refusal.ago_s) for refusal in refusals] == [
        ("d1", "no such model", 1, 2.0),
        ("d2", "s1 has no free slot: 1 of 1 in use", 1, 4.0),
    ]


def test_drones_with_certificates_see_nothing_and_operators_hold_no_lease() -> None:
    machine = host()
    assert isinstance(machine.show(OURS, now_s=0.0), Denied)
    assert not isinstance(machine.show(Client("d1"), now_s=0.0), Denied), "on one machine there are none"
    machine.revoke(frozenset({"0c"}), now_s=0.0)
    assert machine.show(ALICE, now_s=0.0) == Denied("the certificate of alice is revoked")
    machine.revoke(frozenset(), now_s=0.0)
    answer, _ = machine.availability("s1", [], ALICE, now_s=0.0)
    assert answer == Denied("alice is an operator, and s1 serves drones")


def test_only_the_last_different_refusals_are_kept() -> None:
    machine = host(slots=0)
    for number in range(100):
        machine.availability("s1", [], Client(f"d{number}"), now_s=float(number))
    shown = machine.show(ALICE, now_s=100.0)
    assert not isinstance(shown, Denied)
    assert [each.client for each in shown[1]] == [f"d{number}" for number in reversed(range(80, 100))]
