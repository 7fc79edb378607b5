"""Events in, commands out: what the drone-side machine wants done, step by step."""

from __future__ import annotations

import pytest

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.knowledge.servers import Change, State
from upwash.core.operation import Operation
from upwash.core.policies.policy import (
    Deadline,
    Local,
    LocalOnly,
    LocationAware,
    Opportunistic,
    Policy,
    Remote,
    Wait,
    WaitRule,
)
from upwash.core.selection.commands import Check, Effect, Full, Leave, Probe, ServerPaused, Start
from upwash.core.selection.events import (
    CheckAnswered,
    DescentBegun,
    LeaseRenewed,
    LocalCallEnded,
    NetworkGone,
    NoMoreCalls,
    PeerPrepared,
    ProbePaused,
    RemoteCallEnded,
    RemoteCallFailed,
    RemoteCallRaised,
    RemoteFaultTested,
    ServerUnusable,
    ServicesStarted,
    SlotRefused,
    SlotTaken,
    Tick,
)
from upwash.core.selection.recovery import Probing
from upwash.core.selection.selection import Selection, SelectionSettings
from upwash.errors import TransitionError

HEAVY = Operation("detector", "process_photo", "heavy")
AREAS = {"s1": Circle(Position(80.0, 80.0), 100.0), "s2": Circle(Position(120.0, 120.0), 100.0)}
UNDER_S1 = Position(0.0, 80.0)
UNDER_S2 = Position(200.0, 120.0)
UNDER_BOTH = Position(100.0, 100.0)
NOWHERE = Position(0.0, 200.0)


def selection(
    policy: Policy | None = None,
    *,
    s1_s: float = 0.75,
    s2_s: float = 2.0,
    probing: Probing | None = None,
) -> Selection:
    """A heavy call takes 8 s on the drone; a check is believed to take 11.5 s, and 3.5 s with the service running."""
    beliefs = {name: Beliefs(11.5, 3.5, {HEAVY: delay_s}) for name, delay_s in (("s1", s1_s), ("s2", s2_s))}
    estimates = Estimates(local_s={HEAVY: 8.0}, servers=beliefs)
    settings = SelectionSettings(probing=probing)
    return Selection(AREAS, estimates=estimates, policy=policy or LocationAware(), settings=settings)


def written(commands: list[Effect]) -> list[str]:
    """The commands in words, without their reasons."""
    words = []
    for command in commands:
        match command:
            case Change(server, _, before, after):
                words.append(f"{server} {before} {after}")
            case Leave(server):
                words.append(f"leave {server}")
            case Check(server, check):
                words.append(f"check {server} {check}")
            case Start(server, check):
                words.append(f"start {server} {check}")
    return words


def with_s1_ready(machine: Selection, *, position: Position = UNDER_S1) -> Selection:
    """The machine with s1 selected at 0 s by check 1, and READY at 10 s."""
    machine.handle(Tick(), now_s=0.0, position=position)
    machine.handle(CheckAnswered(1, running=False), now_s=2.0, position=position)
    machine.handle(ServicesStarted(1), now_s=10.0, position=position)
    assert machine.servers["s1"].state is State.READY
    return machine


def with_s1_left_running(machine: Selection) -> Selection:
    """The machine after s1 was READY and its range was left at 20 s: s1 is AVL-R, nothing is selected."""
    with_s1_ready(machine).handle(Tick(), now_s=20.0, position=NOWHERE)
    assert machine.servers["s1"].state is State.AVL_R
    return machine


# ---- trials


def test_a_trial_that_fails_as_the_range_ends_is_over() -> None:
    settings = SelectionSettings(probing=Probing())
    beliefs = {name: Beliefs(11.5, 3.5, {HEAVY: 0.7}) for name in AREAS}
    estimates = Estimates(local_s={HEAVY: 8.0}, servers=beliefs, slow_apart=True)
    machine = with_s1_ready(Selection(AREAS, estimates=estimates, policy=LocationAware(), settings=settings))
    machine.handle(RemoteCallEnded("s1", HEAVY, 9.0), now_s=20.0, position=UNDER_S1)  # slower than the drone
    decision, _ = machine.decide(HEAVY, now_s=25.0, position=UNDER_S1)
    assert isinstance(decision, Remote) and decision.raced
    machine.handle(RemoteCallFailed("s1", 1, "gone"), now_s=26.0, position=NOWHERE)
    machine.handle(Tick(), now_s=60.0, position=UNDER_S1)
    machine.handle(CheckAnswered(2, running=True), now_s=62.0, position=UNDER_S1)
    assert machine.servers["s1"].state is State.READY
    again, _ = machine.decide(HEAVY, now_s=63.0, position=UNDER_S1)
    assert isinstance(again, Remote) and again.raced


# ---- turns


def test_a_server_without_a_slot_goes_on_being_asked_and_no_call_waits_for_it() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    assert machine.handle(SlotRefused(1, 3), now_s=2.0, position=UNDER_S1) == [Full("s1", 1, 3)]
    assert machine.handle(SlotRefused(1, 2), now_s=4.0, position=UNDER_S1) == [], "it is no news"
    assert not machine.is_awaited(1)
    decision, effects = machine.decide(HEAVY, now_s=5.0, position=UNDER_S1)
    assert (decision, effects) == (Local("s1 has no free slot"), [])
    machine.handle(CheckAnswered(1, running=True), now_s=6.0, position=UNDER_S1)
    assert isinstance(machine.decide(HEAVY, now_s=7.0, position=UNDER_S1)[0], Remote)


def test_the_time_for_which_a_slot_was_waited_for_teaches_nothing_about_checks() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    machine.handle(SlotRefused(1, 1), now_s=2.0, position=UNDER_S1)
    machine.handle(CheckAnswered(1, running=True), now_s=40.0, position=UNDER_S1)
    assert machine.estimates.check_s("s1", running=True) == 3.5


@pytest.mark.parametrize("policy", [LocationAware(), Opportunistic()])
def test_another_server_is_preferred_to_one_without_a_slot_and_of_two_such_the_drone_stays(
    policy: Policy,
) -> None:
    machine = selection(policy)
    machine.handle(Tick(), now_s=0.0, position=UNDER_BOTH)
    left = machine.handle(SlotRefused(1, 1), now_s=2.0, position=UNDER_BOTH)
    assert written(left) == ["s1 CHECK AVL", "leave s1", "s2 AVL CHECK", "check s2 2"]
    assert written(machine.handle(SlotRefused(2, 1), now_s=5.0, position=UNDER_BOTH)) == []
    assert machine.current is machine.servers["s2"]
    back = machine.handle(LocalCallEnded(HEAVY, 8.0), now_s=62.5, position=UNDER_BOTH)
    assert written(back)[:2] == ["s2 CHECK AVL", "leave s2"], "s1 may have a slot again after a minute"


def test_a_turn_that_is_over_has_the_server_asked_again_over_the_same_network() -> None:
    machine = with_s1_ready(selection())
    again = machine.handle(SlotTaken(1, "others wait"), now_s=50.0, position=UNDER_S1)
    assert written(again) == ["s1 READY CHECK-R", "check s1 2"]
    decision, _ = machine.decide(HEAVY, now_s=51.0, position=UNDER_S1)
    assert decision == Local("s1 has no free slot")
    assert machine.handle(SlotTaken(1, "others wait"), now_s=52.0, position=UNDER_S1) == [], (
        "of an earlier turn"
    )
    ready = machine.handle(CheckAnswered(2, running=True), now_s=80.0, position=UNDER_S1)
    assert written(ready) == ["s1 CHECK-R READY"]


def test_a_server_that_gives_turns_and_answers_no_call_has_failed() -> None:
    machine = with_s1_ready(selection())
    for check in (1, 2):
        machine.handle(SlotTaken(check, "no lease", in_call=True), now_s=20.0 * check, position=UNDER_S1)
        machine.handle(CheckAnswered(check + 1, running=True), now_s=20.0 * check + 2, position=UNDER_S1)
        assert machine.servers["s1"].state is State.READY
    machine.handle(SlotTaken(3, "no lease", in_call=True), now_s=60.0, position=UNDER_S1)
    assert machine.servers["s1"].state is State.BLACKLISTED


def test_answers_between_turns_keep_a_server_from_being_taken_for_failed() -> None:
    machine = with_s1_ready(selection())
    for check in range(1, 6):
        machine.handle(RemoteCallEnded("s1", HEAVY, 0.75), now_s=20.0 * check - 5, position=UNDER_S1)
        machine.handle(SlotTaken(check, "no lease", in_call=True), now_s=20.0 * check, position=UNDER_S1)
        machine.handle(CheckAnswered(check + 1, running=True), now_s=20.0 * check + 2, position=UNDER_S1)
    assert machine.servers["s1"].state is State.READY


@pytest.mark.parametrize(("s1_s", "stays"), [(5.0, True), (7.0, False)])
def test_where_others_wait_a_drone_that_gains_little_leaves_its_slot_to_them(
    s1_s: float, *, stays: bool
) -> None:
    machine = with_s1_ready(selection(s1_s=s1_s))
    effects = machine.handle(LeaseRenewed(1, 1), now_s=20.0, position=UNDER_S1)
    assert (machine.current is not None) == stays, "a local call takes 8 s, and 0.25 of that is to be gained"
    assert written(effects) == ([] if stays else ["s1 READY AVL-R", "leave s1"])
    if not stays:
        assert machine.handle(LocalCallEnded(HEAVY, 8.0), now_s=79.0, position=UNDER_S1) == []
        again = machine.handle(LocalCallEnded(HEAVY, 8.0), now_s=81.0, position=UNDER_S1)
        assert written(again) == ["s1 AVL-R CHECK-R", "check s1 2"], "nobody was seen waiting for a minute"


# ---- checks


def test_a_server_in_range_is_selected_and_checked() -> None:
    machine = selection()
    assert written(machine.handle(Tick(), now_s=5.0, position=UNDER_S1)) == ["s1 AVL CHECK", "check s1 1"]
    assert machine.current is machine.servers["s1"]
    assert machine.is_awaited(1)


def test_out_of_every_range_nothing_is_wanted() -> None:
    machine = selection()
    assert machine.handle(Tick(), now_s=0.0, position=NOWHERE) == []
    assert machine.current is None


def test_looking_again_does_not_check_again() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    assert machine.handle(Tick(), now_s=1.0, position=UNDER_S1) == []


def test_a_service_that_does_not_run_is_started_once() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    not_running = CheckAnswered(1, running=False)
    assert written(machine.handle(not_running, now_s=2.0, position=UNDER_S1)) == ["start s1 1"]
    assert machine.handle(not_running, now_s=3.0, position=UNDER_S1) == []


def test_started_services_make_the_server_ready_and_teach_how_long_a_check_takes() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=5.0, position=UNDER_S1)
    machine.handle(CheckAnswered(1, running=False), now_s=7.0, position=UNDER_S1)
    assert written(machine.handle(ServicesStarted(1), now_s=22.5, position=UNDER_S1)) == ["s1 CHECK READY"]
    assert machine.estimates.check_s("s1", running=False) == pytest.approx((11.5 + 11.5 + 17.5) / 3)
    assert machine.estimates.check_s("s1", running=True) == 3.5


def test_a_service_found_running_makes_the_server_ready_at_once() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=5.0, position=UNDER_S1)
    running = CheckAnswered(1, running=True)
    assert written(machine.handle(running, now_s=11.0, position=UNDER_S1)) == ["s1 CHECK READY"]
    assert machine.estimates.check_s("s1", running=True) == pytest.approx((3.5 + 3.5 + 6.0) / 3)
    assert machine.estimates.check_s("s1", running=False) == 11.5


def test_a_server_left_running_is_believed_to_run() -> None:
    machine = with_s1_left_running(selection())
    again = machine.handle(Tick(), now_s=30.0, position=UNDER_S1)
    assert written(again) == ["s1 AVL-R CHECK-R", "check s1 2"]
    ready = machine.handle(CheckAnswered(2, running=True), now_s=33.0, position=UNDER_S1)
    assert written(ready) == ["s1 CHECK-R READY"]
    assert machine.estimates.check_s("s1", running=True) == pytest.approx((3.5 + 3.5 + 3.0) / 3)


def test_a_belief_that_proves_wrong_falls_back_without_starting_the_clock_again() -> None:
    machine = with_s1_left_running(selection())
    machine.handle(Tick(), now_s=30.0, position=UNDER_S1)
    fallback = machine.handle(CheckAnswered(2, running=False), now_s=33.0, position=UNDER_S1)
    assert written(fallback) == ["s1 CHECK-R CHECK", "start s1 2"]
    decision, _ = machine.decide(HEAVY, now_s=33.0, position=UNDER_S1)
    assert isinstance(decision, Local)  # 3 s of the 11 s of a check with a start are over: 8 s more

    check_s = machine.estimates.check_s("s1", running=False)
    machine.handle(ServicesStarted(2), now_s=42.0, position=UNDER_S1)
    assert machine.estimates.check_s("s1", running=True) == 3.5  # it was no such check after all
    assert machine.estimates.check_s("s1", running=False) == pytest.approx(check_s + (12.0 - 11.5) / 3)


def test_after_a_failed_check_the_next_best_is_selected_in_the_same_step() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_BOTH)
    failed = ServerUnusable(1, "no slot")
    assert written(machine.handle(failed, now_s=3.0, position=UNDER_BOTH)) == [
        "s1 CHECK BLACKLISTED",
        "leave s1",
        "s2 AVL CHECK",
        "check s2 2",
    ]


@pytest.mark.parametrize("probing", [None, Probing()])
def test_a_server_that_names_a_pause_is_left_and_not_asked_until_the_pause_is_over(
    probing: Probing | None,
) -> None:
    machine = selection(probing=probing)
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    told = machine.handle(ServerUnusable(1, "no model", pause_s=80.0), now_s=3.0, position=UNDER_S1)
    assert told[0] == ServerPaused("s1", 1, 80.0, "no model")
    assert written(told[1:]) == ["s1 CHECK BLACKLISTED", "leave s1"]
    for now_s in (3.5, 14.0, 64.0, 82.9):
        assert machine.handle(Tick(), now_s=now_s, position=UNDER_S1) == []
    assert "check s1" in " ".join(written(machine.handle(Tick(), now_s=83.0, position=UNDER_S1)))


def test_a_probe_that_hears_of_a_pause_ends_and_the_server_is_left_out() -> None:
    machine = selection(probing=Probing())
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    probe = machine.handle(ServerUnusable(1, "no answer"), now_s=3.0, position=UNDER_S1)[-1]
    assert isinstance(probe, Probe)
    told = machine.handle(ProbePaused(probe.check, "no model", 40.0), now_s=5.0, position=UNDER_S1)
    assert told == [ServerPaused("s1", probe.check, 40.0, "no model"), Leave("s1", probe.check)]
    for now_s in (5.5, 13.0, 44.9):
        assert machine.handle(Tick(), now_s=now_s, position=UNDER_S1) == []
    assert "check s1" in " ".join(written(machine.handle(Tick(), now_s=45.0, position=UNDER_S1)))


def test_when_all_servers_are_blacklisted_the_drone_is_on_its_own() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_BOTH)
    machine.handle(ServerUnusable(1, "no slot"), now_s=3.0, position=UNDER_BOTH)
    last = machine.handle(ServerUnusable(2, "no answer"), now_s=8.0, position=UNDER_BOTH)
    assert written(last) == ["s2 CHECK BLACKLISTED", "leave s2"]
    assert machine.current is None


def test_the_reason_of_a_failure_is_kept() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    change = machine.handle(ServerUnusable(1, "no slot"), now_s=3.0, position=UNDER_S1)[0]
    assert isinstance(change, Change)
    assert (change.why, change.at_s) == ("no slot", 3.0)


def test_a_check_that_leaves_the_range_is_no_failure_of_the_server() -> None:
    for event in (Tick(), ServerUnusable(1, "no answer")):
        machine = selection()
        machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
        commands = machine.handle(event, now_s=3.0, position=NOWHERE)
        assert written(commands) == ["s1 CHECK AVL", "leave s1"]


def test_a_check_that_leaves_the_range_after_the_start_was_requested() -> None:
    for event in (Tick(), ServerUnusable(1, "no answer")):
        machine = selection()
        machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
        machine.handle(CheckAnswered(1, running=False), now_s=2.0, position=UNDER_S1)
        commands = machine.handle(event, now_s=3.0, position=NOWHERE)
        assert written(commands) == ["s1 CHECK AVL-R", "leave s1"]


def test_a_check_of_a_running_server_that_leaves_the_range() -> None:
    machine = with_s1_left_running(selection())
    machine.handle(Tick(), now_s=30.0, position=UNDER_S1)
    commands = machine.handle(ServerUnusable(2, "no answer"), now_s=31.0, position=NOWHERE)
    assert written(commands) == ["s1 CHECK-R AVL-R", "leave s1"]


def test_a_start_that_failed_is_a_failed_check() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    machine.handle(CheckAnswered(1, running=False), now_s=2.0, position=UNDER_S1)
    failed = machine.handle(ServerUnusable(1, "no image"), now_s=3.0, position=UNDER_S1)
    assert written(failed) == ["s1 CHECK BLACKLISTED", "leave s1"]


@pytest.mark.parametrize(
    "stale",
    [
        CheckAnswered(1, running=True),
        CheckAnswered(1, running=False),
        ServicesStarted(1),
        ServerUnusable(1, "late"),
    ],
)
def test_a_result_of_an_earlier_check_changes_nothing(
    stale: CheckAnswered | ServicesStarted | ServerUnusable,
) -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    machine.handle(Tick(), now_s=1.0, position=NOWHERE)
    assert machine.handle(stale, now_s=2.0, position=NOWHERE) == []
    machine.handle(Tick(), now_s=3.0, position=UNDER_S1)
    assert machine.handle(stale, now_s=4.0, position=UNDER_S1) == []
    assert machine.servers["s1"].state is State.CHECK
    assert machine.is_awaited(2)
    assert not machine.is_awaited(1)


def test_a_result_that_comes_again_changes_nothing() -> None:
    machine = with_s1_ready(selection())
    check_s = machine.estimates.check_s("s1", running=False)
    for again in (CheckAnswered(1, running=True), ServicesStarted(1), ServerUnusable(1, "late")):
        assert machine.handle(again, now_s=11.0, position=UNDER_S1) == []
    assert machine.estimates.check_s("s1", running=False) == check_s


def test_services_cannot_be_started_by_a_check_that_asked_for_no_start() -> None:
    machine = with_s1_left_running(selection())
    machine.handle(Tick(), now_s=30.0, position=UNDER_S1)
    with pytest.raises(TransitionError, match="started is impossible in CHECK-R"):
        machine.handle(ServicesStarted(2), now_s=31.0, position=UNDER_S1)


# ---- networks that are lost


def test_a_network_that_is_lost_in_range_blacklists_and_the_next_best_is_selected() -> None:
    machine = with_s1_ready(selection(), position=UNDER_BOTH)
    lost = machine.handle(NetworkGone(1, "no carrier"), now_s=20.0, position=UNDER_BOTH)
    assert written(lost) == ["s1 READY BLACKLISTED", "leave s1", "s2 AVL CHECK", "check s2 2"]
    assert isinstance(lost[0], Change) and lost[0].why == "no carrier"


def test_a_network_that_is_lost_out_of_range_is_no_failure_of_the_server() -> None:
    machine = with_s1_ready(selection())
    lost = machine.handle(NetworkGone(1, "no carrier"), now_s=20.0, position=NOWHERE)
    assert written(lost) == ["s1 READY AVL-R", "leave s1"]


def test_a_network_that_is_lost_during_a_check_ends_it() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    lost = machine.handle(NetworkGone(1, "no carrier"), now_s=4.0, position=UNDER_S1)
    assert written(lost) == ["s1 CHECK BLACKLISTED", "leave s1"]


def test_a_network_that_an_earlier_check_joined_can_be_lost_without_consequence() -> None:
    machine = with_s1_left_running(selection())
    machine.handle(Tick(), now_s=21.0, position=UNDER_S1)
    assert machine.handle(NetworkGone(1, "no carrier"), now_s=22.0, position=UNDER_S1) == []
    assert machine.is_awaited(2)
    assert (
        with_s1_left_running(selection()).handle(NetworkGone(1, "late"), now_s=22.0, position=NOWHERE) == []
    )


# ---- calls that end


def test_a_call_that_fails_in_range_blacklists_and_the_next_best_is_selected() -> None:
    machine = with_s1_ready(selection(), position=UNDER_BOTH)
    failed = machine.handle(RemoteCallFailed("s1", 1, "deadline"), now_s=20.0, position=UNDER_BOTH)
    assert written(failed) == ["s1 READY BLACKLISTED", "leave s1", "s2 AVL CHECK", "check s2 2"]


def test_a_call_that_fails_out_of_range_is_no_failure_of_the_server() -> None:
    machine = with_s1_ready(selection())
    failed = machine.handle(RemoteCallFailed("s1", 1, "deadline"), now_s=20.0, position=NOWHERE)
    assert written(failed) == ["s1 READY AVL-R", "leave s1"]


@pytest.mark.parametrize("failed", [RemoteCallFailed("s1", 0, "late"), RemoteCallFailed("s2", 1, "late")])
def test_a_failed_call_of_an_earlier_visit_changes_nothing(failed: RemoteCallFailed) -> None:
    machine = with_s1_ready(selection())
    assert machine.handle(failed, now_s=20.0, position=UNDER_S1) == []
    assert machine.servers["s1"].state is State.READY


def test_a_failed_call_of_the_last_visit_does_not_end_the_check_of_this_one() -> None:
    machine = with_s1_left_running(selection())
    machine.handle(Tick(), now_s=21.0, position=UNDER_S1)
    assert machine.handle(RemoteCallFailed("s1", 1, "deadline"), now_s=22.0, position=UNDER_S1) == []
    assert machine.is_awaited(2)


def raised_on_s1(machine: Selection, *, check: int = 1, confirmed: bool) -> list[Effect]:
    """What is to be done when s1 has said that a call raised, and the drone's own service has had it too."""
    doubted = machine.handle(RemoteCallRaised("s1", "raised"), now_s=19.0, position=UNDER_BOTH)
    assert doubted == []
    tested = RemoteFaultTested("s1", check, HEAVY, 1.75, "did not raise on the drone", confirmed)
    return machine.handle(tested, now_s=27.0, position=UNDER_BOTH)


def test_a_server_that_invents_an_exception_is_left_like_one_that_fails() -> None:
    machine = with_s1_ready(selection(), position=UNDER_BOTH)
    assert written(raised_on_s1(machine, confirmed=False)) == [
        "s1 READY BLACKLISTED",
        "leave s1",
        "s2 AVL CHECK",
        "check s2 2",
    ]


def test_an_exception_that_the_drone_confirms_is_an_answer_like_any_other() -> None:
    machine = with_s1_ready(selection(), position=UNDER_BOTH)
    counted = machine.estimates.mean_call_s()
    assert raised_on_s1(machine, confirmed=True) == []
    assert machine.servers["s1"].state is State.READY
    assert machine.estimates.remote_s("s1", HEAVY) == (0.75 + 0.75 + 1.75) / 3
    assert not machine.estimates.is_first_call("s1", HEAVY)
    assert machine.estimates.mean_call_s() == counted, "the call is counted when it ends on the drone"


def test_an_invented_exception_of_an_earlier_visit_changes_nothing() -> None:
    machine = with_s1_ready(selection(), position=UNDER_BOTH)
    assert raised_on_s1(machine, check=0, confirmed=False) == []
    assert machine.servers["s1"].state is State.READY


def test_a_server_whose_calls_became_slower_than_local_is_left_even_with_nothing_better() -> None:
    machine = with_s1_ready(selection())
    assert machine.handle(RemoteCallEnded("s1", HEAVY, 8.0), now_s=20.0, position=UNDER_S1) == []
    slow = machine.handle(RemoteCallEnded("s1", HEAVY, 20.0), now_s=40.0, position=UNDER_S1)
    assert written(slow) == ["s1 READY AVL-R", "leave s1"]


def test_a_server_left_for_its_slow_calls_is_tried_again() -> None:
    machine = with_s1_ready(selection())
    machine.handle(RemoteCallEnded("s1", HEAVY, 30.0), now_s=40.0, position=UNDER_S1)
    assert machine.current is None
    before = machine.handle(Tick(), now_s=339.9, position=UNDER_S1)
    assert written(before) == ["s1 AVL-R AVL"]
    again = machine.handle(Tick(), now_s=340.0, position=UNDER_S1)
    assert written(again) == ["s1 AVL CHECK", "check s1 2"]


def test_a_server_is_selected_once_the_drone_itself_became_slower() -> None:
    machine = selection(s1_s=8.5)
    assert machine.handle(Tick(), now_s=0.0, position=UNDER_S1) == []
    hot = machine.handle(LocalCallEnded(HEAVY, 14.0), now_s=14.0, position=UNDER_S1)
    assert written(hot) == ["s1 AVL CHECK", "check s1 1"]


# ---- switching


def test_the_old_server_is_left_before_the_new_one_is_joined() -> None:
    machine = with_s1_ready(selection(s1_s=2.0, s2_s=0.5))
    assert machine.handle(Tick(), now_s=20.0, position=UNDER_BOTH) == []  # 1.5 of 8 s: not enough
    slower = machine.handle(RemoteCallEnded("s1", HEAVY, 5.0), now_s=21.0, position=UNDER_BOTH)
    assert written(slower) == ["s1 READY AVL-R", "leave s1", "s2 AVL CHECK", "check s2 2"]


def test_from_range_to_range_in_one_step() -> None:
    machine = with_s1_ready(selection())
    crossed = machine.handle(Tick(), now_s=20.0, position=UNDER_S2)
    assert written(crossed) == ["s1 READY AVL-R", "leave s1", "s2 AVL CHECK", "check s2 2"]


def test_a_check_under_way_is_given_up_for_a_much_better_server() -> None:
    machine = selection(s1_s=4.0, s2_s=0.5)
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    better = machine.handle(Tick(), now_s=1.0, position=UNDER_BOTH)
    assert written(better) == ["s1 CHECK AVL", "leave s1", "s2 AVL CHECK", "check s2 2"]


def test_opportunistic_stays_where_it_came_first() -> None:
    machine = with_s1_ready(selection(Opportunistic(), s1_s=7.0, s2_s=0.5))
    assert machine.handle(Tick(), now_s=20.0, position=UNDER_BOTH) == []
    assert machine.handle(RemoteCallEnded("s1", HEAVY, 30.0), now_s=21.0, position=UNDER_BOTH) == []
    crossed = machine.handle(Tick(), now_s=30.0, position=UNDER_S2)
    assert written(crossed) == ["s1 READY AVL-R", "leave s1", "s2 AVL CHECK", "check s2 2"]


def test_opportunistic_counts_from_when_a_range_was_entered() -> None:
    machine = selection(Opportunistic())
    machine.handle(Tick(), now_s=0.0, position=UNDER_S2)
    machine.handle(Tick(), now_s=1.0, position=UNDER_BOTH)
    machine.handle(ServerUnusable(1, "no slot"), now_s=2.0, position=UNDER_BOTH)  # s2; s1 is being checked
    machine.handle(ServerUnusable(2, "no slot"), now_s=3.0, position=UNDER_BOTH)
    both_back = machine.handle(Tick(), now_s=63.0, position=UNDER_BOTH)
    assert written(both_back) == ["s1 BLACKLISTED AVL", "s2 BLACKLISTED AVL", "s2 AVL CHECK", "check s2 3"]


def test_local_only_contacts_nobody() -> None:
    machine = selection(LocalOnly())
    for now_s, position in enumerate([UNDER_S1, UNDER_BOTH, UNDER_S2]):
        assert machine.handle(Tick(), now_s=float(now_s), position=position) == []


def test_a_server_without_the_drones_services_is_no_candidate() -> None:
    estimates = Estimates(local_s={HEAVY: 8.0}, servers={"s1": Beliefs(11.5, 3.5, {})})
    machine = Selection({"s1": AREAS["s1"]}, estimates=estimates, policy=LocationAware())
    assert machine.handle(Tick(), now_s=0.0, position=UNDER_S1) == []


# ---- memory


def test_a_blacklisted_server_is_left_alone_for_its_time() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    machine.handle(ServerUnusable(1, "no slot"), now_s=3.0, position=UNDER_S1)
    assert machine.handle(Tick(), now_s=62.9, position=UNDER_S1) == []
    over = machine.handle(Tick(), now_s=63.0, position=UNDER_S1)
    assert written(over) == ["s1 BLACKLISTED AVL", "s1 AVL CHECK", "check s1 2"]


def test_a_server_not_selected_for_long_is_no_longer_believed_to_run() -> None:
    machine = with_s1_left_running(selection())
    assert machine.handle(Tick(), now_s=199.9, position=NOWHERE) == []
    assert written(machine.handle(Tick(), now_s=200.0, position=NOWHERE)) == ["s1 AVL-R AVL"]


def test_a_selected_server_is_never_idle() -> None:
    machine = with_s1_ready(selection())
    assert machine.handle(Tick(), now_s=5000.0, position=UNDER_S1) == []


# ---- where a call shall run


def test_without_a_server_a_call_runs_here() -> None:
    decision, commands = selection().decide(HEAVY, now_s=0.0, position=UNDER_S1)
    assert isinstance(decision, Local)
    assert commands == []


def test_a_ready_server_in_range_gets_the_call() -> None:
    decision, commands = with_s1_ready(selection()).decide(HEAVY, now_s=20.0, position=UNDER_S1)
    assert isinstance(decision, Remote)
    assert (decision.server, decision.deadline_s) == ("s1", 3.0)
    assert commands == []


def test_the_first_call_after_a_start_is_told_from_the_others() -> None:
    def deadline_s(now_s: float) -> float:
        decision, _ = machine.decide(HEAVY, now_s=now_s, position=UNDER_S1)
        assert isinstance(decision, Remote)
        return decision.deadline_s

    patient = WaitRule(deadline=Deadline(patient_first=True))
    machine = with_s1_ready(selection(LocationAware(wait=patient)))
    assert deadline_s(20.0) == 8.0
    machine.handle(RemoteCallEnded("s1", HEAVY, 0.75), now_s=20.75, position=UNDER_S1)
    assert deadline_s(30.0) == 3.0
    machine.handle(Tick(), now_s=40.0, position=NOWHERE)
    machine.handle(Tick(), now_s=50.0, position=UNDER_S1)
    machine.handle(CheckAnswered(2, running=True), now_s=52.0, position=UNDER_S1)
    assert deadline_s(53.0) == 3.0  # the same instance
    machine.handle(Tick(), now_s=60.0, position=NOWHERE)
    machine.handle(PeerPrepared("s1", "s2"), now_s=70.0, position=NOWHERE)
    machine.handle(Tick(), now_s=80.0, position=UNDER_S1)
    machine.handle(CheckAnswered(3, running=True), now_s=82.0, position=UNDER_S1)
    assert deadline_s(83.0) == 8.0
    machine.handle(RemoteCallEnded("s1", HEAVY, 0.75), now_s=84.0, position=UNDER_S1)
    machine.handle(Tick(), now_s=90.0, position=NOWHERE)
    machine.handle(Tick(), now_s=100.0, position=UNDER_S1)
    machine.handle(CheckAnswered(4, running=False), now_s=102.0, position=UNDER_S1)
    machine.handle(ServicesStarted(4), now_s=110.0, position=UNDER_S1)
    assert deadline_s(111.0) == 8.0


def test_a_ready_server_out_of_range_is_given_up_and_the_call_runs_here() -> None:
    machine = with_s1_ready(selection())
    decision, commands = machine.decide(HEAVY, now_s=20.0, position=NOWHERE)
    assert isinstance(decision, Local)
    assert written(commands) == ["s1 READY AVL-R", "leave s1"]
    assert machine.current is None


def test_an_operation_without_estimates_runs_here() -> None:
    unknown = Operation("counter", "count")
    for policy in (LocationAware(), Opportunistic()):
        decision, commands = with_s1_ready(selection(policy)).decide(unknown, now_s=20.0, position=UNDER_S1)
        assert isinstance(decision, Local)
        assert commands == []


@pytest.mark.parametrize(
    ("elapsed_s", "decision_class"),
    [
        (0.0, Local),  # X = 8 * 0.75 - 0.75 = 5.25 s; READY is expected in 11.5 s
        (6.25, Local),  # in 5.25 s
        (6.5, Wait),
        (11.5, Wait),
        (90.0, Wait),  # late
    ],
)
def test_a_call_during_a_check_waits_if_the_server_is_ready_soon(
    elapsed_s: float, decision_class: type
) -> None:
    machine = selection()
    machine.handle(Tick(), now_s=100.0, position=UNDER_S1)
    decision, commands = machine.decide(HEAVY, now_s=100.0 + elapsed_s, position=UNDER_S1)
    assert isinstance(decision, decision_class)
    assert commands == []
    if isinstance(decision, Wait):
        assert (decision.server, decision.at_most_s) == ("s1", 5.25)


def test_a_check_of_a_running_service_is_awaited_from_its_start() -> None:
    machine = with_s1_left_running(selection())
    machine.handle(Tick(), now_s=30.0, position=UNDER_S1)
    decision, _ = machine.decide(HEAVY, now_s=30.0, position=UNDER_S1)
    assert isinstance(decision, Wait)  # 3.5 s, not 11.5 s


def test_a_check_out_of_range_is_not_awaited() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    decision, commands = machine.decide(HEAVY, now_s=10.0, position=NOWHERE)
    assert isinstance(decision, Local)
    assert written(commands) == ["s1 CHECK AVL", "leave s1"]


def test_a_decision_has_the_inputs_that_it_was_made_from_though_it_leaves_the_server() -> None:
    machine = with_s1_ready(selection())
    local_s, remote_s = machine.estimates.local_s(HEAVY), machine.estimates.remote_s("s1", HEAVY)
    decision, commands = machine.decide(HEAVY, now_s=20.0, position=NOWHERE)
    assert written(commands) == ["s1 READY AVL-R", "leave s1"]
    known = decision.inputs
    assert (known.selected, known.state, known.check) == ("s1", State.READY, 1)
    assert (known.local_s, known.remote_s) == (local_s, remote_s)
    decision, _ = machine.decide(HEAVY, now_s=20.0, position=NOWHERE)
    assert (decision.inputs.selected, decision.inputs.local_s) == (None, local_s)


def test_a_check_says_how_long_its_parts_may_take() -> None:
    machine = selection()
    check = machine.handle(Tick(), now_s=0.0, position=UNDER_S1)[-1]
    assert isinstance(check, Check)
    assert check.join_limit_s == 3.0 * machine.estimates.check_s("s1", running=True)
    (start,) = machine.handle(CheckAnswered(1, running=False), now_s=2.0, position=UNDER_S1)
    assert isinstance(start, Start)
    assert start.limit_s == 3.0 * machine.estimates.check_s("s1", running=False)


def test_after_a_wait_the_server_that_became_ready_gets_the_call() -> None:
    machine = with_s1_ready(selection())
    decision, commands = machine.decide_after_wait(HEAVY, 1, now_s=10.0, position=UNDER_S1)
    assert isinstance(decision, Remote)
    assert (decision.server, decision.deadline_s) == ("s1", 3.0)
    assert commands == []


def test_after_a_wait_that_was_too_short_the_call_runs_here() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    decision, commands = machine.decide_after_wait(HEAVY, 1, now_s=15.25, position=UNDER_S1)
    assert isinstance(decision, Local)  # it does not wait twice
    assert commands == []
    assert machine.is_awaited(1)


def test_after_a_wait_for_a_check_that_failed_the_call_runs_here() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    machine.handle(ServerUnusable(1, "no slot"), now_s=3.0, position=UNDER_S1)
    decision, _ = machine.decide_after_wait(HEAVY, 1, now_s=3.0, position=UNDER_S1)
    assert isinstance(decision, Local)


def test_after_a_wait_for_one_check_the_outcome_of_another_does_not_count() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_BOTH)
    machine.handle(ServerUnusable(1, "no slot"), now_s=3.0, position=UNDER_BOTH)
    machine.handle(CheckAnswered(2, running=True), now_s=4.0, position=UNDER_BOTH)
    assert machine.servers["s2"].state is State.READY
    decision, _ = machine.decide_after_wait(HEAVY, 1, now_s=4.0, position=UNDER_BOTH)
    assert isinstance(decision, Local)


def test_after_a_wait_out_of_range_the_call_runs_here() -> None:
    machine = with_s1_ready(selection())
    decision, commands = machine.decide_after_wait(HEAVY, 1, now_s=10.0, position=NOWHERE)
    assert isinstance(decision, Local)
    assert written(commands) == ["s1 READY AVL-R", "leave s1"]


# ---- the end


def test_after_the_mission_nobody_is_selected_any_more() -> None:
    machine = with_s1_ready(selection())
    ended = machine.handle(NoMoreCalls(), now_s=20.0, position=UNDER_S1)
    assert written(ended) == ["s1 READY AVL-R", "leave s1"]
    assert machine.handle(Tick(), now_s=21.0, position=UNDER_BOTH) == []
    assert machine.current is None


# ---- hedged calls, where the server is later than the drone


def test_on_the_way_down_the_server_is_left_and_no_other_is_joined() -> None:
    machine = with_s1_ready(selection())
    left = machine.handle(DescentBegun(), now_s=11.0, position=UNDER_S1)
    assert written(left) == ["s1 READY AVL-R", "leave s1"]
    assert machine.handle(Tick(), now_s=12.0, position=UNDER_S2) == []


def test_a_call_under_way_keeps_its_server_on_the_way_down() -> None:
    machine = with_s1_ready(selection())
    machine.decide(HEAVY, now_s=11.0, position=UNDER_S1)
    assert machine.handle(DescentBegun(), now_s=11.5, position=UNDER_S1) == []
    answered = RemoteCallEnded("s1", HEAVY, 0.75)
    left = machine.handle(answered, now_s=11.75, position=UNDER_S1)
    assert written(left) == ["s1 READY AVL-R", "leave s1"]


def test_a_mission_that_calls_on_its_way_down_has_servers_again() -> None:
    machine = selection()
    machine.handle(DescentBegun(), now_s=0.0, position=UNDER_S1)
    machine.decide(HEAVY, now_s=1.0, position=UNDER_S1)
    assert "check s1 1" in written(machine.handle(Tick(), now_s=1.5, position=UNDER_S1))


def test_a_late_answer_teaches_how_slow_the_server_is_and_is_no_second_call() -> None:
    machine = with_s1_ready(selection())
    machine.handle(LocalCallEnded(HEAVY, 8.0), now_s=30.0, position=UNDER_S1)
    counted = machine.estimates.mean_call_s()
    late = RemoteCallEnded("s1", HEAVY, 9.75, late=True)
    machine.handle(late, now_s=31.0, position=UNDER_S1)
    assert machine.estimates.remote_s("s1", HEAVY) == (0.75 + 0.75 + 9.75) / 3
    assert machine.estimates.mean_call_s() == counted


def test_a_server_that_fails_late_is_left_alone_like_any_other() -> None:
    machine = with_s1_ready(selection())
    machine.handle(LocalCallEnded(HEAVY, 8.0), now_s=30.0, position=UNDER_S1)
    failed = RemoteCallFailed("s1", 1, "no answer", late=True)
    assert written(machine.handle(failed, now_s=31.0, position=UNDER_S1)) == [
        "s1 READY BLACKLISTED",
        "leave s1",
    ]


# ---- two radios


def with_two_radios(*, s2_s: float, s1_s: float = 4.0) -> Selection:
    """The machine with s1 READY, under both."""
    beliefs = {"s1": Beliefs(11.5, 3.5, {HEAVY: s1_s}), "s2": Beliefs(11.5, 3.5, {HEAVY: s2_s})}
    machine = Selection(
        AREAS,
        estimates=Estimates(local_s={HEAVY: 8.0}, servers=beliefs),
        policy=LocationAware(),
        settings=SelectionSettings(radios=2),
    )
    return with_s1_ready(machine)


def test_a_better_server_is_checked_while_the_one_before_is_still_used() -> None:
    machine = with_two_radios(s2_s=0.5)
    commands = machine.handle(Tick(), now_s=20.0, position=UNDER_BOTH)
    assert written(commands) == ["s2 AVL CHECK", "check s2 2"]
    decision, _ = machine.decide(HEAVY, now_s=21.0, position=UNDER_BOTH)
    assert isinstance(decision, Remote)
    assert decision.server == "s1"
    assert written(machine.handle(CheckAnswered(2, running=False), now_s=22.0, position=UNDER_BOTH)) == [
        "start s2 2"
    ]
    ready = machine.handle(ServicesStarted(2), now_s=30.0, position=UNDER_BOTH)
    assert written(ready) == ["s2 CHECK READY", "s1 READY AVL-R", "leave s1"]
    decision, _ = machine.decide(HEAVY, now_s=31.0, position=UNDER_BOTH)
    assert isinstance(decision, Remote)
    assert decision.server == "s2"


def test_the_server_in_preparation_takes_the_place_of_one_that_is_lost() -> None:
    machine = with_two_radios(s2_s=0.5)
    machine.handle(Tick(), now_s=20.0, position=UNDER_BOTH)
    failed = machine.handle(RemoteCallFailed("s1", 1, "no answer"), now_s=22.0, position=UNDER_BOTH)
    assert written(failed) == ["s1 READY BLACKLISTED", "leave s1"]
    assert machine.current is machine.servers["s2"]
    assert machine.is_awaited(2)
    machine = with_two_radios(s2_s=0.5)
    machine.handle(Tick(), now_s=20.0, position=UNDER_BOTH)
    assert written(machine.handle(Tick(), now_s=23.0, position=UNDER_S2)) == ["s1 READY AVL-R", "leave s1"]
    assert machine.current is machine.servers["s2"]


def test_a_failed_preparation_leaves_the_server_in_use_alone() -> None:
    machine = with_two_radios(s2_s=0.5)
    machine.handle(Tick(), now_s=20.0, position=UNDER_BOTH)
    failed = machine.handle(ServerUnusable(2, "no carrier"), now_s=22.0, position=UNDER_BOTH)
    assert written(failed) == ["s2 CHECK BLACKLISTED", "leave s2"]
    assert machine.current is machine.servers["s1"]


def test_a_server_that_is_no_longer_faster_than_the_drone_is_not_kept_until_the_next_is_ready() -> None:
    machine = with_two_radios(s2_s=0.5)
    machine.handle(Tick(), now_s=20.0, position=UNDER_BOTH)
    commands = [
        command
        for now_s in (24.0, 27.0, 30.0)
        for command in machine.handle(LocalCallEnded(HEAVY, 3.0), now_s=now_s, position=UNDER_BOTH)
    ]
    assert written(commands) == ["s1 READY AVL-R", "leave s1"]
    assert machine.is_awaited(2)
    decision, _ = machine.decide(HEAVY, now_s=30.5, position=UNDER_BOTH)
    assert isinstance(decision, Wait)
    assert decision.server == "s2"


def test_a_slot_that_others_wait_for_is_not_kept_until_the_next_server_is_ready() -> None:
    machine = with_two_radios(s1_s=7.0, s2_s=7.0)
    assert written(machine.handle(Tick(), now_s=20.0, position=UNDER_BOTH)) == []
    effects = machine.handle(LeaseRenewed(1, 1), now_s=21.0, position=UNDER_BOTH)
    assert written(effects) == ["s1 READY AVL-R", "leave s1", "s2 AVL CHECK", "check s2 2"]
    assert machine.current is machine.servers["s2"]


def test_what_was_prepared_is_given_up_too_for_a_third_server() -> None:
    remote_s = {"s1": 4.0, "s2": 0.5, "s3": 0.25}
    machine = Selection(
        AREAS | {"s3": Circle(UNDER_BOTH, 10.0)},
        estimates=Estimates(
            local_s={HEAVY: 8.0},
            servers={name: Beliefs(11.5, 3.5, {HEAVY: delay_s}) for name, delay_s in remote_s.items()},
        ),
        policy=LocationAware(),
        settings=SelectionSettings(radios=2),
    )
    beside_s3 = Position(100.0, 80.0)
    with_s1_ready(machine)
    assert written(machine.handle(Tick(), now_s=20.0, position=beside_s3)) == ["s2 AVL CHECK", "check s2 2"]
    for now_s in (21.0, 22.0):
        machine.handle(LocalCallEnded(HEAVY, 3.0), now_s=now_s, position=beside_s3)
    commands = machine.handle(LocalCallEnded(HEAVY, 3.0), now_s=23.0, position=UNDER_BOTH)
    assert written(commands) == [
        "s1 READY AVL-R",
        "leave s1",
        "s2 CHECK AVL",
        "leave s2",
        "s3 AVL CHECK",
        "check s3 3",
    ]
    assert machine.current is machine.servers["s3"]


def test_both_are_left_at_the_end() -> None:
    machine = with_two_radios(s2_s=0.5)
    machine.handle(Tick(), now_s=20.0, position=UNDER_BOTH)
    ended = machine.handle(NoMoreCalls(), now_s=22.0, position=UNDER_BOTH)
    assert written(ended) == ["s1 READY AVL-R", "leave s1", "s2 CHECK AVL", "leave s2"]
