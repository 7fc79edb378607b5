"""Whose the vehicle is: each row of the table, and the laws under any sequence of claims, commands and reports."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from upwash.core.geo import Position
from upwash.core.vehicle.control import TRANSITIONS, ControlChange, Heartbeat, Latch, Owner
from upwash.errors import AutopilotOverruled

OWN, OTHERS = "GUIDED", ("LOITER", "STABILIZE", "RTL", "LAND")
MODES = st.sampled_from((OWN, *OTHERS))
STANDS, FLIES = Heartbeat(OWN, armed=False), Heartbeat(OWN, armed=True)


def claimed(*, flying: bool = False) -> Latch:
    latch = Latch(0.0)
    latch.report(FLIES if flying else STANDS, 1.0)
    latch.claim(2.0, own_mode=OWN, resumes=flying)
    return latch


def test_every_owner_has_a_row_for_every_change_that_can_come() -> None:
    told: set[tuple[Owner, ControlChange]] = {
        (Owner.NOBODY, change) for change in ControlChange if change is not ControlChange.DISARMED
    }
    told |= {
        (Owner.PROGRAM, change)
        for change in ControlChange
        if change
        not in (
            ControlChange.REMOTE_MOVED,
            ControlChange.FOUND_FAILING_SAFE,
            ControlChange.FOUND_COMING_DOWN,
        )
    }
    told |= {(Owner.GROUND_STATION, ControlChange.REMOTE_MOVED)}
    told -= {
        (Owner.NOBODY, change)
        for change in (ControlChange.TARGET_CHANGED, ControlChange.RESTARTED, ControlChange.REMOTE_MOVED)
    }
    for lost in (
        Owner.PILOT,
        Owner.GROUND_STATION,
        Owner.FAILSAFE,
        Owner.EARLIER_RUN,
        Owner.UNKNOWN,
    ):
        changes = (
            ControlChange.MODE_CHANGED,
            ControlChange.MODE_SWITCHED,
            ControlChange.MODE_COMMANDED,
            ControlChange.MODE_FAILED_SAFE,
            ControlChange.ARMED,
            ControlChange.ARMED_BY_REMOTE,
            ControlChange.RESTARTED,
        )
        told |= {(lost, change) for change in changes}
    assert set(TRANSITIONS) == told


def test_only_a_claim_makes_it_the_programs() -> None:
    assert {change for (_, change), owner in TRANSITIONS.items() if owner is Owner.PROGRAM} == {
        ControlChange.CLAIMED
    }
    assert {owner for owner, change in TRANSITIONS if change is ControlChange.CLAIMED} == {
        Owner.NOBODY,
        Owner.PROGRAM,
    }


@pytest.mark.parametrize(
    ("report", "resumes", "owner"),
    [
        (STANDS, False, Owner.PROGRAM),
        (STANDS, True, Owner.PROGRAM),
        (Heartbeat("STABILIZE", armed=False), False, Owner.PROGRAM),
        (FLIES, True, Owner.PROGRAM),
        (FLIES, False, Owner.UNKNOWN),
        (Heartbeat("LOITER", armed=True), True, Owner.UNKNOWN),
        (Heartbeat("RTL", armed=True, failsafe="battery"), True, Owner.FAILSAFE),
    ],
)
def test_what_can_be_claimed(report: Heartbeat, resumes: bool, owner: Owner) -> None:
    latch = Latch(0.0)
    latch.report(report, 1.0)
    latch.claim(2.0, own_mode=OWN, resumes=resumes)
    assert latch.control.owner is owner


def test_before_the_first_report_nothing_can_be_claimed_and_nothing_sent() -> None:
    latch = Latch(0.0)
    latch.claim(1.0, own_mode=OWN, resumes=False)
    with pytest.raises(AutopilotOverruled, match="arm: the program has not taken the vehicle"):
        latch.require("arm")


def test_switches_of_a_vehicle_that_stands_disarmed_are_nobodys_takeover() -> None:
    latch = claimed()
    latch.report(Heartbeat("LOITER", armed=False), 3.0)
    assert latch.control.is_ours


@pytest.mark.parametrize(
    ("report", "owner", "why"),
    [
        (
            Heartbeat("LOITER", armed=True),
            Owner.UNKNOWN,
            "mode LOITER .no report tells who chose it., GUIDED",
        ),
        (
            Heartbeat("LOITER", armed=True, remote_moved=True),
            Owner.PILOT,
            "mode LOITER .the remote control moved., GUIDED was commanded",
        ),
        (
            Heartbeat("LAND", armed=True, failsafe="battery"),
            Owner.FAILSAFE,
            "mode LAND .battery., GUIDED was",
        ),
        (Heartbeat(OWN, armed=False, on_ground=True), Owner.UNKNOWN, "disarmed on the ground"),
        (Heartbeat(OWN, armed=False, on_ground=False), Owner.UNKNOWN, "its motors stopped in the air"),
        (Heartbeat(OWN, armed=False), Owner.UNKNOWN, "does not say whether it stands"),
        (
            Heartbeat("STABILIZE", armed=False, on_ground=False),
            Owner.UNKNOWN,
            "its motors stopped in the air",
        ),
        (Heartbeat("LAND", armed=False, failsafe="crash"), Owner.FAILSAFE, "mode LAND .crash."),
    ],
)
def test_the_first_difference_closes_the_latch(report: Heartbeat, owner: Owner, why: str) -> None:
    latch = claimed(flying=True)
    latch.report(report, 7.5)
    assert (latch.control.owner, latch.control.since_s) == (owner, 7.5)
    with pytest.raises(AutopilotOverruled, match=f"goto: .*{why}.*; nothing was sent"):
        latch.require("goto")


def test_a_mode_is_the_ground_stations_where_the_remote_control_is_known_not_to_have_moved() -> None:
    latch, owners = claimed(flying=True), []
    for mode, moved, now_s in [
        ("LOITER", False, 3.0),
        ("LOITER", True, 4.0),  # its report came later than the mode's
        ("POSHOLD", False, 9.0),
        ("POSHOLD", True, 10.1),  # sticks that move later say nothing of the mode
    ]:
        latch.report(Heartbeat(mode, armed=True, remote_moved=moved), now_s)
        owners.append(latch.control.owner)
    assert owners == [Owner.GROUND_STATION, Owner.PILOT, Owner.GROUND_STATION, Owner.GROUND_STATION]


def test_sticks_that_move_as_the_target_changes_in_the_programs_mode_say_nothing() -> None:
    latch = sent(THERE, claimed(flying=True))
    latch.report_target(ELSEWHERE, 4.0)
    latch.report(Heartbeat(OWN, armed=True, remote_moved=True), 4.5)
    assert latch.control.owner is Owner.GROUND_STATION


def test_a_lost_vehicle_that_stands_disarmed_may_change_its_mode() -> None:
    latch = claimed(flying=True)
    for report in (
        Heartbeat("RTL", armed=True, failsafe="battery"),
        Heartbeat("RTL", armed=False, failsafe="battery"),
        Heartbeat("STABILIZE", armed=False),
    ):
        latch.report(report, 5.0)
        assert latch.control.owner is Owner.FAILSAFE
    latch.report(Heartbeat("STABILIZE", armed=True), 6.0)
    assert latch.control.owner is Owner.UNKNOWN


def test_once_a_mode_was_commanded_another_one_closes_the_latch_on_the_ground_too() -> None:
    latch = claimed()
    latch.expect_modes(("TAKEOFF", "LOITER"))
    latch.report(Heartbeat("RTL", armed=False), 3.0)
    assert latch.control.owner is Owner.UNKNOWN
    assert "mode RTL (no report tells who chose it), LOITER was commanded" in latch.control.why


def test_a_pilot_who_arms_while_the_program_waits_has_the_vehicle() -> None:
    latch = claimed()
    latch.report(Heartbeat("STABILIZE", armed=True, remote_moved=True), 3.0)
    assert latch.control.owner is Owner.PILOT


@pytest.mark.parametrize("remote_moved", [False, None])
def test_who_arms_is_not_known_where_the_remote_control_did_not_move(remote_moved: bool | None) -> None:
    latch = claimed()
    latch.report(Heartbeat("STABILIZE", armed=True, remote_moved=remote_moved), 3.0)
    assert latch.control.owner is Owner.UNKNOWN


@pytest.mark.parametrize(
    ("mode", "ordered_mode", "resumes", "owner", "wanted"),
    [
        ("RTL", "RTL", True, Owner.EARLIER_RUN, "wait for the landing and resume, or switch it to GUIDED"),
        ("LAND", "LAND", True, Owner.EARLIER_RUN, "wait for the landing and resume, or switch it to GUIDED"),
        ("LOITER", "RTL", True, Owner.UNKNOWN, "switch it to GUIDED"),
        ("RTL", "", True, Owner.UNKNOWN, "switch it to GUIDED"),
        ("RTL", "RTL", False, Owner.UNKNOWN, "disarm it first"),
    ],
)
def test_a_vehicle_that_comes_down_as_an_earlier_run_commanded_is_nobody_elses(
    mode: str, ordered_mode: str, resumes: bool, owner: Owner, wanted: str
) -> None:
    latch = Latch(0.0)
    latch.report(Heartbeat(mode, armed=True), 1.0)
    latch.claim(2.0, own_mode=OWN, resumes=resumes, ordered_mode=ordered_mode)
    assert latch.control.owner is owner
    with pytest.raises(AutopilotOverruled, match=f"{wanted}.*; nothing was sent"):
        latch.require("start")


def test_a_pilot_who_takes_what_an_earlier_run_left_is_named() -> None:
    latch = Latch(0.0)
    latch.report(Heartbeat("RTL", armed=True), 1.0)
    latch.claim(2.0, own_mode=OWN, resumes=True, ordered_mode="RTL")
    latch.report(Heartbeat("LOITER", armed=True, remote_moved=True), 3.0)
    assert latch.control.owner is Owner.PILOT


def test_a_command_on_its_way_may_not_have_been_obeyed_yet_and_leads_through_its_modes_in_order() -> None:
    latch = claimed(flying=True)
    latch.expect_modes(("TAKEOFF", "LOITER"))
    for mode in OWN, "TAKEOFF", "TAKEOFF", "LOITER":
        latch.report(Heartbeat(mode, armed=True), 3.0)
        assert latch.control.is_ours
    latch.report(Heartbeat("TAKEOFF", armed=True), 4.0)
    assert latch.control.owner is Owner.UNKNOWN


def test_arming_and_disarming_by_command_are_no_difference_and_a_refused_one_is_forgotten() -> None:
    latch = claimed()
    latch.expect_armed(True)
    latch.report(FLIES, 3.0)
    latch.expect_armed(False)
    latch.report(STANDS, 4.0)
    assert latch.control.is_ours
    latch.expect_armed(True)
    latch.withdraw()
    latch.report(FLIES, 5.0)
    assert latch.control.owner is Owner.UNKNOWN


def test_a_fail_safe_that_is_told_after_its_mode_is_still_known_as_one_and_a_pilot_may_end_it() -> None:
    latch = claimed(flying=True)
    owners = []
    for report in (
        Heartbeat("RTL", True),
        Heartbeat("RTL", True, failsafe="its system status is critical"),
        Heartbeat("RTL", True, failsafe="its battery is low"),
        Heartbeat("LOITER", True, remote_moved=True),
    ):
        latch.report(report, 3.0)
        owners.append((latch.control.owner, latch.control.why))
    assert owners == [
        (Owner.UNKNOWN, "the vehicle is in mode RTL (no report tells who chose it), GUIDED was commanded"),
        (Owner.FAILSAFE, "the vehicle is in mode RTL (its system status is critical)"),
        (Owner.FAILSAFE, "the vehicle is in mode RTL (its battery is low)"),
        (Owner.PILOT, "the vehicle is in mode LOITER (the remote control moved)"),
    ]


HERE, THERE, ELSEWHERE = Position(0.0, 0.0, 20.0), Position(40.0, 0.0, 20.0), Position(-52.0, 0.0, 20.0)


def sent(place: Position | None, latch: Latch, *, obeyed: bool = True) -> Latch:
    latch.expect_target(place)
    latch.settle_target(obeyed=obeyed)
    return latch


def test_a_target_that_the_program_did_not_command_closes_the_latch() -> None:
    latch = sent(THERE, claimed(flying=True))
    for rounded in Position(40.3, -0.4, 20.2), Position(41.0, 0.0, 20.0):
        latch.report_target(rounded, 3.0)
        assert latch.control.is_ours
    latch.report_target(ELSEWHERE, 4.0)
    assert latch.control.owner is Owner.GROUND_STATION
    assert "-52 m east, 0 m north, 92 m from where the program sent it" in latch.control.why


@pytest.mark.parametrize("reported", [ELSEWHERE, Position(40.0, 0.0, 12.0), None])
def test_another_place_another_altitude_and_a_velocity_are_each_somebody_elses_target(
    reported: Position | None,
) -> None:
    latch = sent(THERE, claimed(flying=True))
    latch.report_target(reported, 4.0)
    assert latch.control.owner is Owner.GROUND_STATION


def test_while_a_target_is_on_its_way_the_one_before_is_no_difference() -> None:
    latch = sent(HERE, claimed(flying=True))
    latch.expect_target(THERE)
    for reported in HERE, THERE, HERE:
        latch.report_target(reported, 3.0)
        assert latch.control.is_ours
    latch.settle_target(obeyed=True)
    latch.report_target(HERE, 4.0)
    assert latch.control.owner is Owner.GROUND_STATION


def test_a_target_whose_answer_nobody_waited_for_may_be_reported_until_the_next_is_obeyed() -> None:
    """A leg that a brake cuts short, on a link whose answers come late."""
    latch = sent(HERE, claimed(flying=True))
    latch.expect_target(THERE)  # the wait for its answer is cancelled
    latch.expect_target(HERE)
    latch.report_target(THERE, 3.0)
    assert latch.control.is_ours
    latch.settle_target(obeyed=True)
    latch.report_target(THERE, 4.0)
    assert latch.control.owner is Owner.GROUND_STATION


def test_a_target_that_is_refused_does_not_undo_one_before_it_that_may_have_been_obeyed() -> None:
    latch = sent(HERE, claimed(flying=True))
    latch.expect_target(THERE)  # the wait for its answer is cancelled
    latch.expect_target(ELSEWHERE)
    latch.settle_target(obeyed=False)
    latch.report_target(THERE, 3.0)
    assert latch.control.is_ours
    latch.report_target(ELSEWHERE, 4.0)
    assert latch.control.owner is Owner.GROUND_STATION


def test_a_refused_target_leaves_the_one_before() -> None:
    latch = sent(THERE, sent(HERE, claimed(flying=True)), obeyed=False)
    latch.report_target(HERE, 3.0)
    assert latch.control.is_ours
    latch.report_target(THERE, 3.0)
    assert not latch.control.is_ours


def test_after_a_take_off_any_target_is_another_ones_until_the_first_of_the_program() -> None:
    latch = sent(None, claimed(flying=True))
    latch.report_target(HERE, 3.0)
    assert latch.control.owner is Owner.GROUND_STATION
    assert latch.control.why == "it was sent to 0 m east, 0 m north, which the program did not command"


def test_before_the_first_command_was_obeyed_the_target_of_another_program_is_no_difference() -> None:
    latch = claimed(flying=True)
    latch.expect_target(THERE)
    latch.report_target(ELSEWHERE, 3.0)
    latch.settle_target(obeyed=False)
    latch.report_target(HERE, 4.0)
    assert latch.control.is_ours
    latch.report_target(ELSEWHERE, 5.0)
    assert latch.control.owner is Owner.GROUND_STATION


def test_targets_of_a_vehicle_that_stands_disarmed_say_nothing() -> None:
    latch = sent(THERE, claimed())
    latch.report_target(ELSEWHERE, 3.0)
    assert latch.control.is_ours


def test_what_another_program_left_a_resumed_vehicle_with_is_no_difference() -> None:
    latch = claimed(flying=True)
    latch.report_target(None, 3.0)
    latch.report_target(ELSEWHERE, 3.0)
    assert latch.control.is_ours
    latch.report_target(HERE, 4.0)
    assert latch.control.owner is Owner.GROUND_STATION


def test_targets_of_a_mode_that_was_commanded_say_nothing() -> None:
    latch = sent(THERE, claimed(flying=True))
    latch.expect_modes(("RTL",))
    latch.report_target(ELSEWHERE, 3.0)
    assert latch.control.is_ours


def test_a_restart_in_flight_closes_the_latch_and_names_no_person() -> None:
    latch = claimed(flying=True)
    latch.report(Heartbeat("STABILIZE", armed=False), 3.0)
    latch.report_restart("the autopilot restarted", 3.5)
    assert (latch.control.owner, latch.control.why) == (Owner.UNKNOWN, "the autopilot restarted")


def test_a_mode_beside_motors_that_stopped_is_nobodys_act() -> None:
    """The first heartbeat of an autopilot that restarted in the air."""
    latch = claimed()
    latch.expect_armed(True)
    latch.report(FLIES, 3.0)
    latch.expect_modes([OWN])
    latch.report(Heartbeat("STABILIZE", armed=False, on_ground=False), 4.0)
    assert latch.control.owner is Owner.UNKNOWN
    latch.report_restart("its clock went back", 5.0)
    assert latch.control.owner is Owner.UNKNOWN


def test_a_restart_on_the_ground_before_the_flight_is_no_loss() -> None:
    for latch in Latch(0.0), claimed():
        before = latch.control
        latch.report_restart("the autopilot restarted", 3.0)
        assert latch.control == before


REPORTS = st.builds(Heartbeat, MODES, st.booleans(), st.sampled_from(("", "battery")))
PLACES = st.sampled_from((None, HERE, THERE, ELSEWHERE))
STEPS = st.lists(
    st.one_of(
        REPORTS.map(lambda report: lambda latch, now_s: latch.report(report, now_s)),
        st.lists(MODES, min_size=1, max_size=2).map(
            lambda modes: lambda latch, _: latch.control.is_ours and latch.expect_modes(modes)
        ),
        st.booleans().map(lambda armed: lambda latch, _: latch.control.is_ours and latch.expect_armed(armed)),
        st.just(lambda latch, _: latch.withdraw()),
        PLACES.map(lambda place: lambda latch, _: latch.expect_target(place)),
        st.booleans().map(lambda obeyed: lambda latch, _: latch.settle_target(obeyed=obeyed)),
        PLACES.map(lambda place: lambda latch, now_s: latch.report_target(place, now_s)),
        st.just(lambda latch, now_s: latch.report_restart("it restarted", now_s)),
        st.booleans().map(
            lambda resumes: lambda latch, now_s: latch.claim(now_s, own_mode=OWN, resumes=resumes)
        ),
    ),
    max_size=40,
)


@given(STEPS)
def test_once_lost_it_is_never_the_programs_again(steps: list[Callable[[Latch, float], object]]) -> None:
    latch = Latch(0.0)
    was_ours = lost = False
    for now_s, step in enumerate(steps):
        step(latch, float(now_s))
        lost |= was_ours and not latch.control.is_ours
        was_ours |= latch.control.is_ours
        assert not (lost and latch.control.is_ours)
        assert latch.control.since_s <= now_s


@given(REPORTS)
def test_while_nothing_was_commanded_the_only_state_that_keeps_it_is_the_one_that_was_claimed(
    report: Heartbeat,
) -> None:
    latch = claimed(flying=True)
    latch.report(report, 3.0)
    assert latch.control.is_ours == (report.mode == OWN and report.armed)
