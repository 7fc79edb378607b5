"""Servers that failed: how they are probed, and the calls there that the drone computes too."""

from __future__ import annotations

import math

import pytest
from tests.core.test_selection import (
    AREAS,
    CHECKED,
    HEAVY,
    LOST,
    NOWHERE,
    UNDER_BOTH,
    UNDER_S1,
    Step,
    ready,
    tell,
    with_s1_ready,
)

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.policies.policy import Local, LocationAware, Opportunistic, Policy, Remote
from upwash.core.selection.commands import Probe
from upwash.core.selection.events import (
    CheckAnswered,
    LocalCallEnded,
    NetworkGone,
    NoMoreCalls,
    ProbeAnswered,
    ProbeUnanswered,
    RemoteCallCut,
    RemoteCallEnded,
    RemoteCallFailed,
    SelectionEvent,
    Tick,
)
from upwash.core.selection.recovery import Probing
from upwash.core.selection.selection import Selection
from upwash.core.selection.settings import SelectionSettings

PROBED: Step = (20.0, UNDER_S1, LOST, "s1 READY BLACKLISTED, probe s1 2")


def machine(
    policy: Policy | None = None,
    *,
    radios: int = 1,
    probing: Probing | None = Probing(),  # noqa: B008 - a value
    **remote_s: float,
) -> Selection:
    """A heavy call takes 8 s on the drone; s1 is READY."""
    remote_s = {"s1": 0.75, "s2": 2.0} | remote_s
    beliefs = {name: Beliefs(11.5, 3.5, {HEAVY: delay_s}) for name, delay_s in remote_s.items()}
    estimates = Estimates(local_s={HEAVY: 8.0}, servers=beliefs, slow_apart=True)
    settings = SelectionSettings(probing=probing, radios=radios)
    areas = AREAS | {name: Circle(UNDER_BOTH, 10.0) for name in remote_s.keys() - AREAS.keys()}
    selection = Selection(areas, estimates=estimates, policy=policy or LocationAware(), settings=settings)
    return with_s1_ready(selection)


# --- probes


def test_a_failed_server_is_probed_while_it_is_in_range_and_the_mission_goes_on() -> None:
    tell(
        machine(),
        PROBED,
        (21.0, UNDER_S1, Tick(), ""),
        (21.5, UNDER_S1, ProbeUnanswered(2), ""),
        (22.0, NOWHERE, Tick(), "leave s1"),
        (23.0, UNDER_S1, Tick(), "probe s1 3"),
        (24.0, UNDER_S1, ProbeAnswered(2, running=True), ""),  # to an earlier probe
        (25.0, UNDER_S1, NoMoreCalls(), "leave s1"),
        (26.0, UNDER_S1, Tick(), ""),
    )


@pytest.mark.parametrize(
    ("failures", "alone_s"),
    [
        ((RemoteCallFailed("s1", 1, ""), RemoteCallFailed("s1", 3, "")), 1.0),
        ((NetworkGone(1, ""), NetworkGone(3, "")), 0.0),
    ],
)
def test_a_second_call_that_failed_delays_the_probe_and_a_network_that_was_lost_does_not(
    failures: tuple[SelectionEvent, SelectionEvent], alone_s: float
) -> None:
    selection, delays_s = machine(), []
    for number, (check, failure) in enumerate(zip((1, 3), failures, strict=True)):
        effects = selection.handle(failure, now_s=20.0 + 10.0 * number, position=UNDER_S1)
        delays_s += [each.alone_s for each in effects if isinstance(each, Probe)]
        for event in (ProbeAnswered(check + 1, running=True), CheckAnswered(check + 2, running=True)):
            selection.handle(event, now_s=25.0 + 10.0 * number, position=UNDER_S1)
    assert delays_s == [0.0, alone_s]


def test_without_probing_a_failed_server_is_not_probed() -> None:
    tell(
        ready()(),
        (20.0, UNDER_S1, LOST, "s1 READY BLACKLISTED, leave s1"),
        (21.0, NOWHERE, Tick(), ""),
        (22.0, UNDER_S1, Tick(), ""),
    )


@pytest.mark.parametrize(
    ("running", "steps"),
    [
        (True, "s1 BLACKLISTED AVL-R, s1 AVL-R CHECK-R, check s1 3"),
        (False, "s1 BLACKLISTED AVL, s1 AVL CHECK, check s1 3"),
    ],
)
def test_a_sign_of_life_has_a_server_checked_whose_network_stays_joined(running: bool, steps: str) -> None:
    selection = machine()
    before_s = selection.estimates.check_s("s1", running=True)
    tell(selection, PROBED, (25.0, UNDER_S1, ProbeAnswered(2, running), steps))
    state = "CHECK-R" if running else "CHECK"
    tell(selection, (27.0, UNDER_S1, CheckAnswered(3, running=True), f"s1 {state} READY"))
    assert selection.estimates.check_s("s1", running=True) == before_s, (
        "a check without a join teaches nothing"
    )
    tell(selection, (28.0, UNDER_S1, RemoteCallFailed("s1", 3, "silent"), "s1 READY BLACKLISTED, probe s1 4"))


def test_another_server_takes_the_only_radio_from_a_probe_and_a_free_one_first() -> None:
    both = "s1 READY BLACKLISTED, probe s1 2"
    tell(machine(), (20.0, UNDER_BOTH, LOST, f"{both}, leave s1, s2 AVL CHECK, check s2 3"))
    tell(machine(radios=2), (20.0, UNDER_BOTH, LOST, f"{both}, s2 AVL CHECK, check s2 3"))


def test_a_better_server_is_prepared_in_place_of_the_one_in_preparation() -> None:
    beside_s3 = Position(100.0, 80.0)
    tell(
        machine(radios=2, probing=None, s1=4.0, s2=1.0, s3=0.25),
        (20.0, beside_s3, Tick(), "s2 AVL CHECK, check s2 2"),
        (21.0, UNDER_BOTH, Tick(), "s2 CHECK AVL, leave s2, s3 AVL CHECK, check s3 3"),
        (22.0, UNDER_BOTH, CheckAnswered(3, running=True), "s3 CHECK READY, s1 READY AVL-R, leave s1"),
    )


# --- calls on trial


def slow(*, usual_s: float = 0.75, policy: Policy | None = None) -> Selection:
    """The machine whose s1 was slower than the drone at 20 s, for the first time."""
    selection = machine(policy, s1=usual_s)
    selection.handle(RemoteCallEnded("s1", HEAVY, 9.0), now_s=20.0, position=UNDER_S1)
    return selection


def test_a_slow_server_gets_one_trial_at_a_time_that_the_drone_computes_too() -> None:
    selection = slow()
    decision, _ = selection.decide(HEAVY, now_s=20.0, position=UNDER_S1)
    assert decision == Remote("s1", 10.0, "on trial", raced=True)
    again, _ = selection.decide(HEAVY, now_s=21.0, position=UNDER_S1)
    assert again == Local("s1 failed or was slow: it is tried again soon")
    selection.handle(RemoteCallEnded("s1", HEAVY, 0.75), now_s=22.0, position=UNDER_S1)
    answered, _ = selection.decide(HEAVY, now_s=23.0, position=UNDER_S1)
    assert isinstance(answered, Remote) and not answered.raced, "it was faster than the drone"


def test_a_trial_may_take_as_long_as_the_drone_and_ten_seconds_at_least() -> None:
    selection = slow()
    for now_s in (21.0, 22.0, 23.0):
        selection.handle(LocalCallEnded(HEAVY, 14.0), now_s=now_s, position=UNDER_S1)
    decision, _ = selection.decide(HEAVY, now_s=25.0, position=UNDER_S1)
    assert decision == Remote("s1", 14.0, "on trial", raced=True)


def test_a_server_that_was_slow_for_long_is_tried_again_after_a_pause() -> None:
    selection = slow()
    selection.handle(RemoteCallEnded("s1", HEAVY, 9.0), now_s=50.0, position=UNDER_S1)
    early, _ = selection.decide(HEAVY, now_s=50.9, position=UNDER_S1)
    assert early == Local("s1 failed or was slow: it is tried again soon")
    due, _ = selection.decide(HEAVY, now_s=51.0, position=UNDER_S1)
    assert isinstance(due, Remote) and due.raced


def test_no_call_waits_for_a_server_that_failed() -> None:
    selection = machine()
    tell(
        selection,
        PROBED,
        (25.0, UNDER_S1, ProbeAnswered(2, True), "s1 BLACKLISTED AVL-R, s1 AVL-R CHECK-R, check s1 3"),
    )
    decision, _ = selection.decide(HEAVY, now_s=28.0, position=UNDER_S1)
    assert decision == Local("s1 failed or was slow: it is not waited for")


@pytest.mark.parametrize("usual_s", [8.0, 9.0])
def test_a_server_in_doubt_that_is_usually_no_faster_is_not_tried(usual_s: float) -> None:
    decision, _ = slow(usual_s=usual_s, policy=Opportunistic()).decide(HEAVY, now_s=25.0, position=UNDER_S1)
    assert decision == Local("s1 failed or was slow, and is not faster")


def test_a_call_that_was_cut_short_makes_a_server_look_slower() -> None:
    selection = ready()()
    selection.handle(RemoteCallCut("s1", HEAVY, 6.0), now_s=20.0, position=UNDER_S1)
    assert selection.estimates.remote_s("s1", HEAVY) == (0.75 + 0.75 + 6.0) / 3


# --- calls of the drone that a server overtakes


def overtaking(selection: Selection, *, began_s: float, now_s: float = 20.0) -> tuple[Remote | None, float]:
    return selection.overtake(HEAVY, began_s=began_s, now_s=now_s, position=UNDER_S1)


def test_a_ready_server_that_is_expected_to_answer_first_computes_a_call_of_the_drone_too() -> None:
    selection = machine()
    raced, again_s = overtaking(selection, began_s=19.0)
    assert (raced, again_s) == (Remote("s1", 3.0, "s1 is ready, and sooner", raced=True), math.inf)
    assert overtaking(selection, began_s=20.0 - 7.25) == (None, math.inf), "the drone is as soon"
    assert overtaking(selection, began_s=20.0 - 7.2)[0] is not None


def test_a_server_with_a_call_of_the_drone_is_not_free_for_another() -> None:
    """It overtakes nothing, is no second server and gets no trial; what is sent there in spite of it takes longer."""
    selection, doubted = machine(), slow()
    for each in (selection, doubted):
        each.lanes.hold("a loser", "s1", 22.0)
    assert overtaking(selection, began_s=19.0) == (None, math.inf)
    second = selection.placement.second
    assert second(HEAVY, "s2", begins=True) is None
    assert second(HEAVY, "s2", begins=False) is selection.current, "it may be free by then"
    behind, _ = selection.decide(HEAVY, now_s=20.0, position=UNDER_S1)
    assert isinstance(behind, Remote)
    assert (behind.inputs.remote_s, behind.deadline_s) == (2.75, 8.0), (
        "0.75 s after 2 s; 4 times that, at most 8 s"
    )
    overdue, _ = selection.decide(HEAVY, now_s=30.0, position=UNDER_S1)
    assert overdue.inputs.remote_s == 0.75
    trial, _ = doubted.decide(HEAVY, now_s=20.0, position=UNDER_S1)
    assert trial == Local("s1 failed or was slow, and still has an earlier call")
    for each in (selection, doubted):
        each.lanes.release("a loser")
    assert overtaking(selection, began_s=19.0)[0] is not None
    assert isinstance(doubted.decide(HEAVY, now_s=20.0, position=UNDER_S1)[0], Remote)


def test_a_server_that_is_out_of_range_or_checked_overtakes_nothing() -> None:
    away = machine().overtake(HEAVY, began_s=19.0, now_s=20.0, position=NOWHERE)
    assert away == (None, math.inf)
    without_probing = ready()()
    assert overtaking(without_probing, began_s=19.0) == (None, math.inf)
    settings = SelectionSettings(probing=Probing())
    estimates = Estimates(local_s={HEAVY: 8.0}, servers={"s1": Beliefs(11.5, 3.5, {HEAVY: 0.75})})
    checked = Selection({"s1": AREAS["s1"]}, estimates=estimates, policy=LocationAware(), settings=settings)
    assert overtaking(checked, began_s=0.0, now_s=0.0) == (None, math.inf), "none is selected"
    tell(checked, CHECKED)
    assert overtaking(checked, began_s=0.0, now_s=1.0) == (None, math.inf)


def test_a_server_in_doubt_overtakes_a_call_once_its_next_trial_is_due() -> None:
    selection = slow()
    selection.handle(RemoteCallEnded("s1", HEAVY, 9.0), now_s=50.0, position=UNDER_S1)
    assert overtaking(selection, began_s=50.0, now_s=50.5) == (None, 51.0)
    raced, _ = overtaking(selection, began_s=50.0, now_s=51.0)
    assert raced is not None and raced.deadline_s == 10.0
    assert overtaking(selection, began_s=50.0, now_s=51.5) == (None, math.inf), "a trial is under way"
