"""Who used a server, and how much: slot time, calls and computing, by drone and by team."""

from __future__ import annotations

import pytest

from upwash.core.admission.admission import AdmissionController, AdmissionSettings
from upwash.core.admission.clients import Client, DroneUsage, Role, ServerStatus, TeamUsage
from upwash.core.admission.server import ServerOffer
from upwash.core.admission.usage import LeaseEnded, Usage, team_of

NORTH_1, NORTH_2, HERON = Client("north-1", "01"), Client("north-2", "02"), Client("heron", "03")


def host(*drones: Client, slots: int = 3) -> AdmissionController:
    machine = AdmissionController(
        {"s1": ServerOffer(frozenset({"detector"}), slots=slots)},
        AdmissionSettings(lease_s=30.0),
        peers=["s2"],
    )
    for drone in drones:
        machine.availability("s1", [], drone, now_s=0.0)
    return machine


def call(
    machine: AdmissionController, drone: Client, took_s: float, *, now_s: float, outcome: str = "value"
) -> None:
    machine.at("s1").answered("detector", 9, drone.key, took_s=took_s, outcome=outcome, now_s=now_s)


def status(machine: AdmissionController, now_s: float) -> ServerStatus:
    (server,) = machine.servers(now_s=now_s)
    return server


@pytest.mark.parametrize(
    ("drone", "team"), [("north-1", "north"), ("north-1-b", "north"), ("heron", "heron"), ("-1", "-1")]
)
def test_a_team_is_the_part_of_a_name_before_its_first_hyphen(drone: str, team: str) -> None:
    assert team_of(drone) == team


def test_what_drones_used_is_told_and_summed_by_team() -> None:
    machine = host(NORTH_1, NORTH_2, HERON)
    call(machine, NORTH_1, 2.0, now_s=5.0)
    call(machine, NORTH_1, 1.0, now_s=9.0, outcome="raised")
    call(machine, NORTH_2, 4.0, now_s=10.0, outcome="dropped")
    machine.leave("s1", NORTH_2, now_s=12.0)
    seen = status(machine, 20.0)
    assert seen.drones == [
        DroneUsage("heron", "heron", 20.0, 20.0, 0, 0.0, None),
        DroneUsage("north-1", "north", 20.0, 20.0, 2, 3.0, 11.0),
        DroneUsage("north-2", "north", None, 12.0, 0, 4.0, 10.0),
    ]
    assert seen.teams == [
        TeamUsage("heron", 1, 20.0, 0, 0.0, None),
        TeamUsage("north", 1, 32.0, 2, 7.0, 10.0),
    ]


def test_at_its_end_a_lease_is_told_with_what_was_used_in_it_alone() -> None:
    machine = host(HERON)
    call(machine, HERON, 2.0, now_s=5.0)
    (first, _) = machine.leave("s1", HERON, now_s=10.0)
    assert first == LeaseEnded("s1", "heron", 10.0, calls=1, computed_s=2.0)
    machine.availability("s1", [], HERON, now_s=100.0)
    call(machine, HERON, 0.5, now_s=101.0)
    (second, _) = machine.look(now_s=130.0)
    assert second == LeaseEnded("s1", "heron", 30.0, calls=1, computed_s=0.5)
    assert status(machine, 140.0).drones == [DroneUsage("heron", "heron", None, 40.0, 2, 2.5, 39.0)]


def test_a_slot_that_was_held_in_vain_names_the_peer() -> None:
    machine = host()
    machine.hold("s1", [], HERON, peer=Client("s2", "0f", Role.SERVER), for_s=20.0, now_s=0.0)
    assert machine.look(now_s=20.0)[0] == LeaseEnded("s1", "heron", 20.0, 0, 0.0, held_by="s2")


def test_a_call_that_ends_after_the_lease_counts_and_a_strangers_does_not() -> None:
    machine = host(HERON)
    machine.leave("s1", HERON, now_s=10.0)
    call(machine, HERON, 3.0, now_s=12.0)
    call(machine, Client("stork", "0e"), 3.0, now_s=12.0)
    assert [(drone.drone, drone.calls) for drone in status(machine, 12.0).drones] == [("heron", 1)]


def test_the_end_of_a_daemon_ends_every_lease() -> None:
    machine = host(HERON, NORTH_1)
    ended = [lease for lease in machine.end_leases(now_s=4.0) if isinstance(lease, LeaseEnded)]
    assert [(each.drone, each.slot_s) for each in ended] == [("heron", 4.0), ("north-1", 4.0)]


def test_of_many_drones_the_longest_unseen_are_forgotten_and_none_with_a_slot() -> None:
    usage = Usage("s1")
    usage.took(HERON, now_s=0.0)
    for number in range(1000):
        drone = Client(f"south-{number}", f"{number:x}")
        usage.took(drone, now_s=1.0)
        usage.called(drone.key, took_s=1.0, is_answered=True, now_s=1.0)
        usage.gave_back(drone.name, held_by="", now_s=2.0)
    known = [each.drone for each in usage.drones(now_s=3.0)]
    assert len(known) == 200
    assert "heron" in known and "south-999" in known and "south-0" not in known
    teams = {team.team: team for team in usage.teams(now_s=3.0)}
    assert teams["south"] == TeamUsage("south", 0, 1000.0, 1000, 1000.0, 2.0)


def test_of_many_teams_the_longest_unseen_are_forgotten() -> None:
    usage = Usage("s1")
    for number in range(300):
        usage.took(Client(f"t{number}-1"), now_s=0.0)
        usage.gave_back(f"t{number}-1", held_by="", now_s=1.0)
    assert [len(usage.teams(now_s=1.0)), len(usage.drones(now_s=1.0))] == [100, 200]
    for seen in ("t200-1", "new-1"):
        usage.took(Client(seen), now_s=2.0)
        usage.gave_back(seen, held_by="", now_s=3.0)
    teams = {team.team for team in usage.teams(now_s=3.0)}
    assert {"t200", "new"} <= teams and "t201" not in teams and len(teams) == 100
    for seen in ("t101-1", "new-2"):
        usage.took(Client(seen), now_s=4.0)
        usage.gave_back(seen, held_by="", now_s=5.0)
    drones = {drone.drone for drone in usage.drones(now_s=5.0)}
    assert "t101-1" in drones and "t102-1" not in drones


def test_of_drones_that_give_their_slots_back_at_once_the_bound_holds_too() -> None:
    usage = Usage("s1")
    for number in range(250):
        usage.took(Client(f"d{number}"), now_s=0.0)
    before = usage.drones(now_s=1.0)
    assert len(before) == 250
    for number in range(250):
        usage.gave_back(f"d{number}", held_by="", now_s=1.0)
    assert len(usage.drones(now_s=1.0)) == 200
    usage.took(Client("new"), now_s=1.0)
    assert len(usage.drones(now_s=1.0)) == 200
    after = Usage("s1")
    after.take_up(before, [], now_s=1.0)
    assert len(after.drones(now_s=1.0)) == 200


def test_a_drone_with_another_certificate_is_still_one_drone() -> None:
    machine = host(HERON)
    again = Client("heron", "0b")
    machine.availability("s1", [], again, now_s=1.0)
    call(machine, again, 1.0, now_s=2.0)
    call(machine, HERON, 1.0, now_s=2.0)
    assert [(drone.drone, drone.calls) for drone in status(machine, 2.0).drones] == [("heron", 2)]


def test_a_daemon_goes_on_from_what_the_one_before_it_counted() -> None:
    before = host(HERON, NORTH_1)
    call(before, HERON, 2.0, now_s=5.0)
    call(before, NORTH_1, 1.0, now_s=5.0)
    before.leave("s1", NORTH_1, now_s=10.0)
    told = status(before, 20.0)
    after = AdmissionController({"s1": ServerOffer(frozenset({"detector"}), slots=3)})
    after.take_up("s1", [HERON], [], now_s=1000.0)
    after.take_up_usage("s1", told.drones, told.teams, now_s=1000.0)
    after.take_up_usage("s7", told.drones, told.teams, now_s=1000.0)
    seen = status(after, 1000.0)
    assert (seen.drones, seen.teams) == (told.drones, told.teams)
    call(after, HERON, 0.5, now_s=1003.0)
    (ended, _) = after.leave("s1", HERON, now_s=1004.0)
    assert ended == LeaseEnded("s1", "heron", 24.0, calls=1, computed_s=0.5)
    assert status(after, 1004.0).drones[0] == DroneUsage("heron", "heron", None, 24.0, 2, 2.5, 1.0)
