"""A server's lane that computes calls of other drones too: its queue counts, and is no failure."""

from __future__ import annotations

import random

import pytest
from tests.core.test_selection import HEAVY, UNDER_S1, selection, with_s1_ready, written

from upwash.core.knowledge.servers import State
from upwash.core.operation import ON_DRONE
from upwash.core.policies.policy import Local, Remote
from upwash.core.selection.events import RemoteCallEnded, RemoteCallQueued, SelectionEvent
from upwash.core.selection.lanes import InLine
from upwash.core.selection.recovery import Probing
from upwash.core.selection.selection import Selection

LOCAL_S, NOW_S = 8.0, 20.0


def in_line(*, calls: int = 1, remote_s: float = 2.0, has_line: bool = True) -> Selection:
    """A drone with calls of 8 s in line, and a server that is ready."""
    machine = with_s1_ready(selection(s1_s=remote_s, probing=Probing()))
    machine.lanes.has_line = has_line
    for _ in range(calls):
        machine.lanes.enter(InLine(HEAVY, 0.0))
    return machine


def tell(machine: Selection, event: SelectionEvent, now_s: float = NOW_S) -> list[str]:
    return written(machine.handle(event, now_s=now_s, position=UNDER_S1))


def taken(machine: Selection, now_s: float = NOW_S) -> tuple[int, str] | None:
    """The number of the call that is decided now, and where; None while all wait."""
    machine.locate(UNDER_S1, now_s)
    following = machine.placement.next_in_line()
    return None if following is None else (machine.lanes.line.index(following[0]), following[1])


def answered(*, queued_s: float = 0.0, queue_s: float = 0.0) -> RemoteCallEnded:
    return RemoteCallEnded("s1", HEAVY, 2.0 + queued_s, queued_s=queued_s, queue_s=queue_s)


@pytest.mark.parametrize(
    ("queue_s", "after_s", "place"),
    [
        (0.0, 0.0, "either"),
        (5.0, 0.0, "either"),
        (7.0, 0.0, "drone"),
        (7.0, 2.0, "either"),
        (60.0, 50.0, "drone"),
    ],
)
def test_a_call_goes_to_the_server_if_it_is_sooner_there_behind_the_queue(
    queue_s: float, after_s: float, place: str
) -> None:
    machine = in_line()
    tell(machine, answered(queue_s=queue_s))
    assert taken(machine, NOW_S + after_s) == (0, place)


def test_the_server_takes_the_call_that_it_answers_before_the_drone_gets_to_it() -> None:
    machine = in_line(calls=4)
    tell(
        machine, answered(queue_s=16.0)
    )  # 18 s with the call; the drone has the second at 16 s, the third at 24 s
    assert taken(machine) == (2, "either")
    machine.lanes.hold("own", ON_DRONE, NOW_S + 5.0)
    assert taken(machine) == (1, "either")


def test_the_drone_counts_that_each_call_at_the_server_waits_again() -> None:
    machine = in_line()
    machine.lanes.hold("sent", "s1", NOW_S + 3.0)
    assert taken(machine) is None  # the server would have it at 3 s, and answer it at 5 s
    for _ in range(3):
        tell(machine, answered(queued_s=4.0))
    assert taken(machine) == (0, "drone")


@pytest.mark.parametrize("seed", range(200))
def test_a_call_is_taken_wherever_both_lanes_are_free(seed: int) -> None:
    chance = random.Random(seed)
    machine = in_line(calls=chance.randint(1, 3), remote_s=chance.uniform(0.1, 7.9))
    for _ in range(chance.randint(1, 3)):
        tell(
            machine,
            answered(queued_s=chance.choice([0.0, 3.0, 30.0]), queue_s=chance.choice([0.0, 3.0, 30.0])),
        )
    assert taken(machine, NOW_S + chance.choice([0.0, 1.0, 20.0])) is not None


def test_the_deadline_counts_the_queue_and_the_server_hears_how_long_a_call_may_wait() -> None:
    machine = in_line()
    usual, _ = machine.decide(HEAVY, now_s=NOW_S, position=UNDER_S1)
    tell(machine, answered(queue_s=5.0))
    behind, _ = machine.decide(HEAVY, now_s=NOW_S, position=UNDER_S1)
    assert isinstance(usual, Remote) and isinstance(behind, Remote)
    assert (usual.deadline_s, behind.deadline_s) == (8.0, 13.0)
    assert (usual.inputs.queue_s, behind.inputs.queue_s) == (None, 5.0)
    for deadline_s, may_queue_s in ((8.0, 5.5), (13.0, 8.0), (0.5, 1.75), (-9.0, 0.0)):
        assert machine.placement.may_queue_s("s1", HEAVY, deadline_s) == may_queue_s
    machine.locate(UNDER_S1, NOW_S + 5.0)
    assert machine.placement.may_queue_s("s1", HEAVY, 8.0) == 3.0


@pytest.mark.parametrize("has_line", [True, False])
def test_a_call_that_the_server_did_not_begin_is_no_failure(has_line: bool) -> None:
    machine = in_line(has_line=has_line)
    for _ in range(20):
        assert tell(machine, RemoteCallQueued("s1", "full", 3.0, 9.0)) == []
    assert machine.servers["s1"].state is State.READY
    decision, _ = machine.decide(HEAVY, now_s=NOW_S, position=UNDER_S1)
    assert isinstance(decision, Remote if has_line else Local)
    assert machine.lanes.queue_s("s1", NOW_S) == 9.0
    assert machine.lanes.usual_wait_s("s1") == (12.0 if has_line else 0.0)
    later, _ = machine.decide(HEAVY, now_s=NOW_S + 9.0, position=UNDER_S1)
    assert isinstance(later, Remote)


def test_a_server_that_begins_no_call_and_tells_no_queue_is_not_asked_at_once() -> None:
    machine = in_line()
    tell(machine, RemoteCallQueued("s1", "full", 0.0, 0.0))
    asked, _ = machine.overtake(HEAVY, began_s=NOW_S, now_s=NOW_S, position=UNDER_S1)
    assert asked is None


def test_without_a_line_the_usual_wait_is_part_of_a_call() -> None:
    machine = in_line(has_line=False)
    for _ in range(3):
        tell(machine, answered(queued_s=4.0, queue_s=50.0))
    assert machine.estimates.remote_s("s1", HEAVY) == 6.0
    assert machine.lanes.queue_s("s1", NOW_S) == 0.0
    assert machine.placement.may_queue_s("s1", HEAVY, 8.0) == 6.0  # 2 s of it are computed


def test_with_a_line_the_wait_is_no_part_of_a_call() -> None:
    machine = in_line()
    for _ in range(3):
        tell(machine, answered(queued_s=40.0))
    assert machine.estimates.remote_s("s1", HEAVY) == 2.0
    assert machine.estimates.mean_call_s("s1") == 2.0
