"""How many slots a server measures to be right."""

from __future__ import annotations

import pytest

from upwash.core.admission.admission import AdmissionController, AdmissionSettings
from upwash.core.admission.clients import Client
from upwash.core.admission.server import ServerOffer
from upwash.core.admission.slots import MeasuredSlots


def calls(
    slots: MeasuredSlots,
    drone: str,
    *,
    every_s: float,
    took_s: float,
    queued_s: float = 0.0,
    count: int = 6,
    service: str = "detector",
) -> None:
    for number in range(count):
        slots.answered(service, drone, took_s=took_s, queued_s=queued_s, now_s=number * (every_s + queued_s))


def test_as_many_drones_fit_as_keep_the_instance_busy() -> None:
    slots = MeasuredSlots({"detector": 1})
    calls(slots, "d1", every_s=9.0, took_s=0.6)
    assert slots.count == 15
    assert slots.why == "a drone keeps detector busy for 7 % of its time"


def test_what_a_call_waited_for_others_makes_no_room() -> None:
    alone, crowded = MeasuredSlots({"detector": 1}), MeasuredSlots({"detector": 1})
    calls(alone, "d1", every_s=9.0, took_s=0.6)
    calls(crowded, "d1", every_s=9.0, took_s=0.6, queued_s=5.0)
    assert crowded.count == alone.count


@pytest.mark.parametrize("lanes", [1, 3])
def test_until_it_is_measured_a_drone_is_taken_to_keep_a_lane_busy_for_a_quarter_of_its_time(
    lanes: int,
) -> None:
    slots = MeasuredSlots({"detector": lanes})
    calls(slots, "d1", every_s=9.0, took_s=0.6, count=2)  # one span from one call to the next
    assert slots.count == 4 * lanes
    assert slots.why == "detector is not measured yet, and taken to be busy for 25 % of a drone's time"


def test_with_more_lanes_more_drones_fit() -> None:
    slots = MeasuredSlots({"detector": 4})
    calls(slots, "d1", every_s=1.0, took_s=0.5)
    assert slots.count == 8


def test_a_drone_that_calls_all_the_time_leaves_room_for_none_but_a_crowd_outvotes_it() -> None:
    slots = MeasuredSlots({"detector": 1})
    calls(slots, "hammer", every_s=0.6, took_s=0.6)
    assert slots.count == 1
    for number in range(3):
        calls(slots, f"d{number}", every_s=9.0, took_s=0.6)
    assert slots.count == 3, "of 1.2 s of four drones' time"


def test_the_service_that_is_the_narrowest_counts() -> None:
    slots = MeasuredSlots({"detector": 1, "counter": 1})
    calls(slots, "d1", every_s=9.0, took_s=0.6)
    assert slots.count == 15, "nobody calls the other one"
    calls(slots, "d1", every_s=9.0, took_s=0.6, service="counter")
    calls(slots, "d2", every_s=9.0, took_s=3.0, service="counter")
    assert (slots.count, slots.why) == (5, "a drone keeps counter busy for 20 % of its time")
    slots.offer({"detector": 1})
    assert slots.count == 15
    slots.offer({})
    assert (slots.count, slots.why) == (1, "no service is offered")


def test_the_first_calls_of_a_drone_count_alike_and_of_later_ones_the_latest_for_a_fifth() -> None:
    slots = MeasuredSlots({"detector": 1})
    for now_s, took_s in ((0.0, 0.6), (10.0, 1.0), (20.0, 3.0)):
        slots.answered("detector", "d1", took_s=took_s, queued_s=0.0, now_s=now_s)
    assert slots.why == "a drone keeps detector busy for 20 % of its time"
    for number in range(3, 10):
        slots.answered("detector", "d1", took_s=2.0, queued_s=0.0, now_s=10.0 * number)
    slots.answered("detector", "d1", took_s=7.0, queued_s=0.0, now_s=100.0)
    assert slots.why == "a drone keeps detector busy for 30 % of its time"


def test_a_call_that_takes_no_time_between_two_others_leaves_no_room() -> None:
    slots = MeasuredSlots({"detector": 1})
    for _ in range(3):
        slots.answered("detector", "d1", took_s=0.0, queued_s=0.0, now_s=5.0)
    assert (slots.count, slots.why) == (1, "a drone keeps detector busy for 100 % of its time")


def test_of_many_drones_the_64_that_called_last_count() -> None:
    slots = MeasuredSlots({"detector": 1})
    calls(slots, "hammer", every_s=0.6, took_s=0.6)
    calls(slots, "d0", every_s=10.0, took_s=1.0)
    for number in range(1, 63):
        calls(slots, f"d{number}", every_s=10.0, took_s=1.0)
    assert slots.count == 8, "the hammer and 63 others"
    slots.answered("detector", "d0", took_s=1.0, queued_s=0.0, now_s=60.0)
    calls(slots, "d63", every_s=10.0, took_s=1.0)
    assert slots.count == 10
    calls(slots, "hammer", every_s=0.6, took_s=0.6)
    slots.came("d0")
    assert slots.count == 8, "d1 called before d0"


@pytest.mark.parametrize(("lanes", "count"), [(1, 64), (100, 100)])
def test_there_are_no_more_slots_than_drones_can_be_measured_or_lanes(lanes: int, count: int) -> None:
    slots = MeasuredSlots({"detector": lanes})
    calls(slots, "d1", every_s=100.0, took_s=0.1)
    assert slots.count == count
    assert "0.1 % of its time, and no more drones are measured at once" in slots.why


def test_time_without_a_slot_is_not_counted_as_a_drones_pace() -> None:
    slots = MeasuredSlots({"detector": 1})
    calls(slots, "d1", every_s=9.0, took_s=0.6)
    slots.came("d1")
    slots.answered("detector", "d1", took_s=0.6, queued_s=0.0, now_s=10_000.0)
    assert slots.count == 15


def test_a_server_measures_the_calls_of_drones_with_a_slot_from_when_they_got_it() -> None:
    offer = ServerOffer(frozenset({"detector"}), "auto")
    machine = AdmissionController({"s1": offer}, AdmissionSettings(lease_s=30.0))

    def slots_after(*calls_s: float, drone: str = "d1", took_s: float = 1.0) -> int:
        for now_s in calls_s:
            machine.at("s1").answered("detector", 0, drone, took_s=took_s, queued_s=0.0, now_s=now_s)
            machine.availability("s1", [], Client("d1"), now_s=now_s)
        return machine.servers(now_s=0.0)[0].slots

    machine.availability("s1", [], Client("d1"), now_s=0.0)
    assert slots_after(10.0, 20.0, 30.0) == 10
    assert slots_after(30.0, 31.0, 32.0, 33.0, drone="stranger") == 10
    machine.look(now_s=100.0)
    machine.availability("s1", [], Client("d1"), now_s=10_000.0)
    assert slots_after(10_001.0, 10_011.0) == 10, "the time without a slot is left out"
