"""Events in, commands out: what the drone-side machine wants done, step by step."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.knowledge.servers import State
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
from upwash.core.selection.commands import Check, Effect, Leave, Probe, Start
from upwash.core.selection.events import (
    CheckAnswered,
    DescentBegun,
    LeaseRenewed,
    LocalCallEnded,
    NetworkGone,
    NoMoreCalls,
    PeerPrepared,
    RemoteCallEnded,
    RemoteCallFailed,
    RemoteCallRaised,
    RemoteFaultTested,
    SelectionEvent,
    ServerUnusable,
    ServicesStarted,
    SlotRefused,
    SlotTaken,
    Tick,
)
from upwash.core.selection.radios import check_limit_s
from upwash.core.selection.recovery import Probing
from upwash.core.selection.selection import Selection
from upwash.core.selection.settings import SelectionSettings
from upwash.errors import TransitionError
from upwash.eventlog.schema import LeftOut, NoSlot, ServerStep

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
            case ServerStep(server=server, before=before, after=after):
                words.append(f"{server} {before} {after}")
            case Check(server, check) | Start(server, check) | Probe(server, check):
                words.append(f"{type(command).__name__.lower()} {server} {check}")
            case Leave(server):
                words.append(f"leave {server}")
            case NoSlot(server=server, waiting=waiting):
                words.append(f"{server} full, {waiting} waiting")
            case LeftOut(server=server, pause_s=pause_s, why=why):
                words.append(f"{server} paused {pause_s:g} s: {why}")
            case _:
                raise AssertionError(command)
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


# ---- stories: what happens when and where, and what is to be done in words

Step = tuple[float, Position, SelectionEvent, str]
LEFT, NEXT, FAILED = "s1 READY AVL-R, leave s1", "s2 AVL CHECK, check s2 2", "s1 READY BLACKLISTED, leave s1"
CHECKED: Step = (0.0, UNDER_S1, Tick(), "s1 AVL CHECK, check s1 1")
AT_BOTH: Step = (0.0, UNDER_BOTH, Tick(), "s1 AVL CHECK, check s1 1")
CHECKED_AGAIN: Step = (21.0, UNDER_S1, Tick(), "s1 AVL-R CHECK-R, check s1 2")
STARTING: Step = (2.0, UNDER_S1, CheckAnswered(1, running=False), "start s1 1")
PREPARED: Step = (20.0, UNDER_BOTH, Tick(), NEXT)
UNUSABLE, ONCE_MORE = "s1 CHECK BLACKLISTED, leave s1", "s1 BLACKLISTED AVL, s1 AVL CHECK, check s1 2"
LOST = RemoteCallFailed("s1", 1, "deadline")
NO_MODEL = ServerUnusable(1, "no model", pause_s=80.0)
PAUSED: list[Step] = [
    CHECKED,
    (3.0, UNDER_S1, NO_MODEL, f"s1 paused 80 s: no model, {UNUSABLE}"),
    *((now_s, UNDER_S1, Tick(), "") for now_s in (3.5, 14.0, 64.0, 82.9)),
    (83.0, UNDER_S1, Tick(), ONCE_MORE),
]


def new(policy: Policy | None = None, **how: Any) -> Callable[[], Selection]:
    return lambda: selection(policy, **how)


def ready(
    policy: Policy | None = None, *, position: Position = UNDER_S1, **how: Any
) -> Callable[[], Selection]:
    return lambda: with_s1_ready(selection(policy, **how), position=position)


def left() -> Selection:
    return with_s1_left_running(selection())


def turns(*steps: Step) -> list[Step]:
    """Three turns lost in calls, with these steps before each."""
    return [
        step
        for check in (1, 2, 3)
        for step in (
            *((20.0 * check - 5, *step[1:]) for step in steps),
            (
                20.0 * check,
                UNDER_S1,
                SlotTaken(check, "", in_call=True),
                f"s1 READY CHECK-R, check s1 {check + 1}",
            ),
            (20.0 * check + 2, UNDER_S1, CheckAnswered(check + 1, running=True), "s1 CHECK-R READY"),
        )
    ]


def test_no_more_than_four_servers_are_selected_within_a_second() -> None:
    names = [f"s{number}" for number in range(1, 7)]
    machine = Selection(
        dict.fromkeys(names, AREAS["s1"]),
        estimates=Estimates(
            local_s={HEAVY: 8.0}, servers=dict.fromkeys(names, Beliefs(11.5, 3.5, {HEAVY: 0.75}))
        ),
        policy=LocationAware(),
    )
    machine.handle(Tick(), now_s=10.0, position=UNDER_S1)
    for check in (1, 2, 3, 4):
        machine.handle(ServerUnusable(check, "refused"), now_s=10.1, position=UNDER_S1)
    assert machine.current is None and machine.next_look_s(now_s=10.1) == 11.0
    assert machine.handle(Tick(), now_s=10.9, position=UNDER_S1) == []
    assert written(machine.handle(Tick(), now_s=11.0, position=UNDER_S1)) == ["s5 AVL CHECK", "check s5 5"]


@pytest.mark.parametrize("policy", [LocationAware(), Opportunistic()])
def test_another_server_is_preferred_to_one_without_a_slot_and_of_two_such_the_drone_stays(
    policy: Policy,
) -> None:
    tell(
        selection(policy),
        AT_BOTH,
        (2.0, UNDER_BOTH, SlotRefused(1, 1), f"s1 full, 1 waiting, s1 CHECK AVL, leave s1, {NEXT}"),
        (5.0, UNDER_BOTH, SlotRefused(2, 1), "s2 full, 1 waiting"),
        # s1 may have a slot again after a minute.
        (61.9, UNDER_BOTH, Tick(), ""),
        (62.0, UNDER_BOTH, Tick(), "s2 CHECK AVL, leave s2, s1 AVL CHECK, check s1 3"),
    )


def tell(machine: Selection, *steps: Step) -> None:
    for now_s, position, event, commands in steps:
        assert ", ".join(written(machine.handle(event, now_s=now_s, position=position))) == commands


STORIES: dict[str, tuple[Callable[[], Selection], list[Step]]] = {
    # --- checks
    "looking again does not check again": (new(), [CHECKED, (1.0, UNDER_S1, Tick(), "")]),
    "out of every range nothing is wanted": (new(), [(0.0, NOWHERE, Tick(), "")]),
    "a service that does not run is started once": (
        new(),
        [CHECKED, STARTING, (3.0, UNDER_S1, CheckAnswered(1, running=False), "")],
    ),
    "after a failed check the next best is selected, and after that nobody": (
        new(),
        [
            AT_BOTH,
            (3.0, UNDER_BOTH, ServerUnusable(1, "no slot"), f"{UNUSABLE}, {NEXT}"),
            (8.0, UNDER_BOTH, ServerUnusable(2, "no answer"), "s2 CHECK BLACKLISTED, leave s2"),
        ],
    ),
    "a check that leaves the range is no failure": (
        new(),
        [CHECKED, (3.0, NOWHERE, Tick(), "s1 CHECK AVL, leave s1")],
    ),
    "nor is one that fails out of range": (
        new(),
        [CHECKED, (3.0, NOWHERE, ServerUnusable(1, "no answer"), "s1 CHECK AVL, leave s1")],
    ),
    "a check that leaves the range after the start was requested": (
        new(),
        [CHECKED, STARTING, (3.0, NOWHERE, Tick(), "s1 CHECK AVL-R, leave s1")],
    ),
    "a check that fails out of range after the start was requested": (
        new(),
        [CHECKED, STARTING, (3.0, NOWHERE, ServerUnusable(1, "no answer"), "s1 CHECK AVL-R, leave s1")],
    ),
    "a check of a running server that leaves the range": (
        left,
        [CHECKED_AGAIN, (31.0, NOWHERE, ServerUnusable(2, "no answer"), "s1 CHECK-R AVL-R, leave s1")],
    ),
    "a server that is found stopped and left at once is remembered as stopped": (
        left,
        [
            CHECKED_AGAIN,
            (22.0, NOWHERE, CheckAnswered(2, running=False), "s1 CHECK-R CHECK, s1 CHECK AVL, leave s1"),
        ],
    ),
    "a start that failed is a failed check": (
        new(),
        [CHECKED, STARTING, (3.0, UNDER_S1, ServerUnusable(1, "no image"), UNUSABLE)],
    ),
    "a server that names a pause is left alone until it is over": (new(), PAUSED),
    "nor is it probed meanwhile": (new(probing=Probing()), PAUSED),
    "a probe that hears of a pause ends": (
        new(probing=Probing()),
        [
            CHECKED,
            (3.0, UNDER_S1, ServerUnusable(1, "no answer"), "s1 CHECK BLACKLISTED, probe s1 2"),
            (
                5.0,
                UNDER_S1,
                ServerUnusable(2, "no model", pause_s=40.0),
                "s1 paused 40 s: no model, leave s1",
            ),
            *((now_s, UNDER_S1, Tick(), "") for now_s in (5.5, 13.0, 44.9)),
            (45.0, UNDER_S1, Tick(), "s1 BLACKLISTED AVL, s1 AVL CHECK, check s1 3"),
        ],
    ),
    # --- turns
    "a turn that is over has the server asked again over the same network": (
        ready(),
        [
            (50.0, UNDER_S1, SlotTaken(1, "others wait"), "s1 READY CHECK-R, check s1 2"),
            (52.0, UNDER_S1, SlotTaken(1, "others wait"), ""),  # of an earlier turn
            (80.0, UNDER_S1, CheckAnswered(2, running=True), "s1 CHECK-R READY"),
        ],
    ),
    "a server that gives turns and answers no call has failed": (
        ready(),
        [*turns()[:4], (60.0, UNDER_S1, SlotTaken(3, "no lease", in_call=True), FAILED)],
    ),
    "answers between turns keep a server from being taken for failed": (
        ready(),
        turns((0.0, UNDER_S1, RemoteCallEnded("s1", HEAVY, 0.75), "")),
    ),
    # --- networks that are lost, and calls that fail
    "a network lost in range blacklists": (
        ready(position=UNDER_BOTH),
        [(20.0, UNDER_BOTH, NetworkGone(1, "no carrier"), f"{FAILED}, {NEXT}")],
    ),
    "one lost out of range is no failure": (ready(), [(20.0, NOWHERE, NetworkGone(1, "no carrier"), LEFT)]),
    "one lost during a check ends it": (
        new(),
        [CHECKED, (4.0, UNDER_S1, NetworkGone(1, "no carrier"), UNUSABLE)],
    ),
    "one of an earlier check is lost without consequence": (
        left,
        [CHECKED_AGAIN, (22.0, UNDER_S1, NetworkGone(1, "no carrier"), "")],
    ),
    "nor has it any where nothing is selected": (left, [(22.0, NOWHERE, NetworkGone(1, "late"), "")]),
    "a call that fails in range blacklists": (
        ready(position=UNDER_BOTH),
        [(20.0, UNDER_BOTH, LOST, f"{FAILED}, {NEXT}")],
    ),
    "one that fails out of range is no failure": (ready(), [(20.0, NOWHERE, LOST, LEFT)]),
    "one of an earlier visit changes nothing": (
        ready(),
        [
            (20.0, UNDER_S1, RemoteCallFailed("s1", 0, "late"), ""),
            (20.0, UNDER_S1, RemoteCallFailed("s2", 1, "late"), ""),
        ],
    ),
    "one of the last visit does not end the check of this one": (
        left,
        [CHECKED_AGAIN, (22.0, UNDER_S1, LOST, "")],
    ),
    "one that fails late is left alone like any other": (
        ready(),
        [
            (30.0, UNDER_S1, LocalCallEnded(HEAVY, 8.0), ""),
            (31.0, UNDER_S1, RemoteCallFailed("s1", 1, "no answer", late=True), FAILED),
        ],
    ),
    # --- calls that are slow
    "a server slower than the drone is left even with nothing better": (
        ready(),
        [
            (20.0, UNDER_S1, RemoteCallEnded("s1", HEAVY, 8.0), ""),
            (40.0, UNDER_S1, RemoteCallEnded("s1", HEAVY, 20.0), LEFT),
        ],
    ),
    "a server left for its slow calls is tried again": (
        ready(),
        [
            (40.0, UNDER_S1, RemoteCallEnded("s1", HEAVY, 30.0), LEFT),
            (339.9, UNDER_S1, Tick(), "s1 AVL-R AVL"),
            (340.0, UNDER_S1, Tick(), "s1 AVL CHECK, check s1 2"),
        ],
    ),
    "a server is selected once the drone itself became slower": (
        new(s1_s=8.5),
        [
            (0.0, UNDER_S1, Tick(), ""),
            (14.0, UNDER_S1, LocalCallEnded(HEAVY, 14.0), "s1 AVL CHECK, check s1 1"),
        ],
    ),
    # --- switching
    "the old server is left before the new one is joined": (
        ready(s1_s=2.0, s2_s=0.5),
        [
            (20.0, UNDER_BOTH, Tick(), ""),  # 1.5 of 8 s: not enough
            (21.0, UNDER_BOTH, RemoteCallEnded("s1", HEAVY, 5.0), f"{LEFT}, {NEXT}"),
        ],
    ),
    "from range to range in one step": (ready(), [(20.0, UNDER_S2, Tick(), f"{LEFT}, {NEXT}")]),
    "a check is given up for a much better server": (
        new(s1_s=4.0, s2_s=0.5),
        [CHECKED, (1.0, UNDER_BOTH, Tick(), f"s1 CHECK AVL, leave s1, {NEXT}")],
    ),
    "opportunistic stays where it came first": (
        ready(Opportunistic(), s1_s=7.0, s2_s=0.5),
        [
            (20.0, UNDER_BOTH, Tick(), ""),
            (21.0, UNDER_BOTH, RemoteCallEnded("s1", HEAVY, 30.0), ""),
            (30.0, UNDER_S2, Tick(), f"{LEFT}, {NEXT}"),
        ],
    ),
    "opportunistic counts from when a range was entered": (
        new(Opportunistic()),
        [
            (0.0, UNDER_S2, Tick(), "s2 AVL CHECK, check s2 1"),
            (1.0, UNDER_BOTH, Tick(), ""),
            (
                *(2.0, UNDER_BOTH, ServerUnusable(1, "no slot")),
                "s2 CHECK BLACKLISTED, leave s2, s1 AVL CHECK, check s1 2",
            ),
            (3.0, UNDER_BOTH, ServerUnusable(2, "no slot"), UNUSABLE),
            (63.0, UNDER_BOTH, Tick(), "s1 BLACKLISTED AVL, s2 BLACKLISTED AVL, s2 AVL CHECK, check s2 3"),
        ],
    ),
    "local-only contacts nobody": (
        new(LocalOnly()),
        [(0.0, UNDER_S1, Tick(), ""), (1.0, UNDER_BOTH, Tick(), ""), (2.0, UNDER_S2, Tick(), "")],
    ),
    # --- memory, and the end
    "a blacklisted server is left alone for its time": (
        new(),
        [
            CHECKED,
            (3.0, UNDER_S1, ServerUnusable(1, "no slot"), UNUSABLE),
            (62.9, UNDER_S1, Tick(), ""),
            (63.0, UNDER_S1, Tick(), ONCE_MORE),
        ],
    ),
    "a server not selected for long is no longer believed to run": (
        left,
        [(199.9, NOWHERE, Tick(), ""), (200.0, NOWHERE, Tick(), "s1 AVL-R AVL")],
    ),
    "a selected server is never idle": (ready(), [(5000.0, UNDER_S1, Tick(), "")]),
    "after the mission nobody is selected any more": (
        ready(),
        [(20.0, UNDER_S1, NoMoreCalls(), LEFT), (21.0, UNDER_BOTH, Tick(), "")],
    ),
    "on the way down the server is left and no other is joined": (
        ready(),
        [(11.0, UNDER_S1, DescentBegun(), LEFT), (12.0, UNDER_S2, Tick(), "")],
    ),
    # --- two radios
    "the server in preparation takes the place of one that failed": (
        lambda: with_two_radios(s2_s=0.5),
        [
            PREPARED,
            (22.0, UNDER_BOTH, LOST, FAILED),
            (23.0, UNDER_BOTH, CheckAnswered(2, running=True), "s2 CHECK READY"),
        ],
    ),
    "and of one out of range": (
        lambda: with_two_radios(s2_s=0.5),
        [
            PREPARED,
            (23.0, UNDER_S2, Tick(), LEFT),
            (24.0, UNDER_S2, CheckAnswered(2, running=True), "s2 CHECK READY"),
        ],
    ),
    "a failed preparation leaves the server in use alone": (
        lambda: with_two_radios(s2_s=0.5),
        [PREPARED, (22.0, UNDER_BOTH, ServerUnusable(2, "no carrier"), "s2 CHECK BLACKLISTED, leave s2")],
    ),
    "a slot that others wait for is not kept until the next server is ready": (
        lambda: with_two_radios(s1_s=7.0, s2_s=7.0),
        [(20.0, UNDER_BOTH, Tick(), ""), (21.0, UNDER_BOTH, LeaseRenewed(1, 1), f"{LEFT}, {NEXT}")],
    ),
    "both are left at the end": (
        lambda: with_two_radios(s2_s=0.5),
        [PREPARED, (22.0, UNDER_BOTH, NoMoreCalls(), f"{LEFT}, s2 CHECK AVL, leave s2")],
    ),
}


@pytest.mark.parametrize(("machine", "steps"), STORIES.values(), ids=STORIES)
def test_a_story(machine: Callable[[], Selection], steps: list[Step]) -> None:
    tell(machine(), *steps)


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


def test_a_failed_server_is_joined_within_the_time_of_a_check_whose_services_run() -> None:
    machine = with_s1_ready(selection(probing=Probing()))
    effects = machine.handle(RemoteCallFailed("s1", 1, "silent"), now_s=20.0, position=UNDER_S1)
    (probe,) = (effect for effect in effects if isinstance(effect, Probe))
    assert (probe.server, probe.join_limit_s) == ("s1", check_limit_s(3.5))
    assert check_limit_s(3.5) < check_limit_s(11.5)


# ---- turns


def test_a_server_without_a_slot_goes_on_being_asked_and_no_call_waits_for_it() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    refused = machine.handle(SlotRefused(1, 3), now_s=2.0, position=UNDER_S1)
    assert refused == [NoSlot(server="s1", check=1, waiting=3)]
    assert machine.handle(SlotRefused(1, 2), now_s=4.0, position=UNDER_S1) == [], "it is no news"
    assert not machine.is_awaited(1)
    decision, effects = machine.decide(HEAVY, now_s=5.0, position=UNDER_S1)
    assert (decision, effects) == (Local("s1 has no free slot"), [])
    machine.handle(CheckAnswered(1, running=True), now_s=6.0, position=UNDER_S1)
    assert isinstance(machine.decide(HEAVY, now_s=7.0, position=UNDER_S1)[0], Remote)


def test_the_time_for_which_a_server_was_asked_again_teaches_nothing_about_checks() -> None:
    machine = with_s1_ready(selection())
    machine.handle(SlotTaken(1, "others wait"), now_s=50.0, position=UNDER_S1)
    machine.handle(CheckAnswered(2, running=True), now_s=60.0, position=UNDER_S1)
    assert machine.estimates.check_s("s1", running=True) == 3.5


def test_the_time_for_which_a_slot_was_waited_for_teaches_nothing_about_checks() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    machine.handle(SlotRefused(1, 1), now_s=2.0, position=UNDER_S1)
    machine.handle(CheckAnswered(1, running=True), now_s=40.0, position=UNDER_S1)
    assert machine.estimates.check_s("s1", running=True) == 3.5


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
        again = machine.handle(Tick(), now_s=80.0, position=UNDER_S1)
        assert written(again) == ["s1 AVL-R CHECK-R", "check s1 2"], "nobody was seen waiting for a minute"


# ---- checks


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


def test_the_reason_of_a_failure_is_kept() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    change = machine.handle(ServerUnusable(1, "no slot"), now_s=3.0, position=UNDER_S1)[0]
    assert isinstance(change, ServerStep)
    assert (change.why, machine.servers["s1"].since_s) == ("no slot", 3.0)


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


# ---- calls that end


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


# ---- switching


def test_a_server_without_the_drones_services_is_no_candidate() -> None:
    estimates = Estimates(local_s={HEAVY: 8.0}, servers={"s1": Beliefs(11.5, 3.5, {})})
    machine = Selection({"s1": AREAS["s1"]}, estimates=estimates, policy=LocationAware())
    assert machine.handle(Tick(), now_s=0.0, position=UNDER_S1) == []


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


def test_the_next_look_is_when_a_server_may_have_a_slot_again_or_is_idle() -> None:
    machine = selection()
    machine.handle(Tick(), now_s=0.0, position=UNDER_S1)
    machine.handle(SlotRefused(1, 1), now_s=2.0, position=UNDER_S1)
    assert machine.next_look_s(now_s=5.0) == 62.0
    assert with_s1_left_running(selection()).next_look_s(now_s=30.0) == 200.0
    assert with_s1_ready(selection()).next_look_s(now_s=30.0) == math.inf


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


# ---- hedged calls, where the server is later than the drone


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


def test_a_call_that_the_drone_computes_too_counts_once() -> None:
    light = Operation("detector", "process_photo", "light")
    machine = Selection(
        AREAS,
        estimates=Estimates(
            local_s={HEAVY: 8.0, light: 2.0}, servers=dict.fromkeys(AREAS, Beliefs(11.5, 3.5, {HEAVY: 1.0}))
        ),
        policy=LocationAware(),
    )
    with_s1_ready(machine)
    for event in (
        LocalCallEnded(light, 2.0),
        RemoteFaultTested("s1", 1, HEAVY, 1.0, "it raised", confirmed=True),
        RemoteCallEnded("s1", HEAVY, 9.0, late=True),
        LocalCallEnded(light, 2.0),
    ):
        machine.handle(event, now_s=20.0, position=UNDER_S1)
        assert machine.estimates.mean_call_s() == (8.0 + 2.0) / 2, "three calls are needed for weights"
    machine.handle(LocalCallEnded(HEAVY, 8.0), now_s=30.0, position=UNDER_S1)
    assert machine.estimates.mean_call_s() == pytest.approx((8.0 + 2 * 2.0) / 3)


# ---- two radios


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
