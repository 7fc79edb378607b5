"""When word is sent ahead: early enough for a start, to peers alone, and once for as long as a slot is held."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import pytest

from upwash.core.geo import Circle, Position, Waypoint
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.knowledge.servers import Server, ServerTable, State, Trigger
from upwash.core.operation import Operation
from upwash.core.planning.legs import Leg, Pace
from upwash.core.planning.mission_model import MissionBeliefs, StopCall
from upwash.core.planning.stay_or_go import Outlook
from upwash.core.policies.look_ahead import LookAhead
from upwash.core.policies.policy import Coming, Local, LocationAware, Policy, Remote, Wait
from upwash.core.selection.commands import Effect, Prepare
from upwash.core.selection.events import (
    CheckAnswered,
    LegBegun,
    LegEnded,
    LocalCallEnded,
    MissionBegun,
    RemoteCallFailed,
    SelectionEvent,
    ServerUnusable,
    SlotRefused,
    TargetUnknown,
    Tick,
)
from upwash.core.selection.moment import Moment
from upwash.core.selection.radios import Radios
from upwash.core.selection.recovery import Recovery
from upwash.core.selection.selection import Selection
from upwash.core.selection.server_planning import PrewarmNotifier
from upwash.core.selection.settings import SelectionSettings
from upwash.core.vehicle.way_home import EnergyFacts, WayHome
from upwash.eventlog.schema import Foreseen, Selected

START_S = 8.0


def server(*peers: str, ready: bool = True) -> Server:
    found = Server("a", Circle(Position(0.0, 0.0), 50.0), peers=frozenset(peers))
    found.check = 1
    for event in (Trigger.SELECTED, Trigger.STARTED) if ready else (Trigger.SELECTED,):
        found.apply(event, now_s=0.0)
    return found


def announcing() -> PrewarmNotifier:
    """A drone in range of nothing, which knows three servers."""
    table = ServerTable({name: Circle(Position(0.0, 0.0), 50.0) for name in "abc"}, idle_s=180.0)
    estimates = Estimates(local_s={}, servers=dict.fromkeys("abc", Beliefs(START_S, 0.0, {})))
    moment = Moment(LocationAware(), SelectionSettings(), table, estimates, Recovery(None))
    return PrewarmNotifier(moment, Radios(moment))


def announce(
    notifier: PrewarmNotifier, current: Server | None, coming: Coming | None, now_s: float = 0.0
) -> Sequence[Effect]:
    moment = notifier._moment
    notifier._radios.selected = [] if current is None else [current]
    moment.now_s, moment.effects = now_s, []
    notifier.announce(coming)
    return moment.effects


def test_the_coming_server_is_prepared_by_the_one_that_is_ready() -> None:
    notifier = announcing()
    assert announce(notifier, server("b"), Coming("b", 12.0)) == [Prepare("a", 1, "b", 12.0, 15.0)]
    assert notifier.has_announced("b", at_s=26.9)
    assert not notifier.has_announced("b", at_s=27.0)


def test_nothing_is_sent_to_strangers_or_by_a_server_that_is_not_ready() -> None:
    notifier = announcing()
    assert announce(notifier, server("c"), Coming("b", 12.0)) == []
    assert announce(notifier, server("b", ready=False), Coming("b", 12.0)) == []
    assert announce(notifier, server("b"), None) == []
    assert announce(notifier, None, Coming("b", 12.0)) == []
    assert notifier.due_s == math.inf


def test_it_waits_until_a_start_and_a_margin_are_left() -> None:
    notifier = announcing()
    assert announce(notifier, server("b"), Coming("b", 60.0)) == []
    assert notifier.due_s == 42.0
    assert announce(notifier, server("b"), Coming("b", 18.0), 42.0) == [Prepare("a", 1, "b", 18.0, 15.0)]
    assert notifier.due_s == math.inf


def test_word_is_sent_again_when_the_slot_is_held_no_longer() -> None:
    notifier = announcing()
    announce(notifier, server("b"), Coming("b", 5.0))
    assert announce(notifier, server("b"), Coming("b", 5.0), 19.9) == []
    assert notifier.due_s == 20.0
    assert announce(notifier, server("b"), Coming("b", 5.0), 20.0) != []


# --- a mission --------------------------------------------------------------------------------------------

LOOK, COUNT = Operation("detector", "look"), Operation("counter", "count")
PLAN = [Waypoint(number, Position(20.0 * number, 0.0, 20.0)) for number in range(4)]
LOCAL_S, REMOTE_S, CHECK_S, RUNNING_S, LEG_S, PHOTO_S = 10.0, 1.0, 6.0, 2.0, 9.0, 1.0
AT_ONCE = 1e9
LANDS_AT_ONCE = EnergyFacts(
    home=PLAN[0].position, way_home=WayHome(0.0, AT_ONCE, AT_ONCE, AT_ONCE, 0.0, AT_ONCE, 0.0, AT_ONCE)
)


def flight(policy: Policy | None = None, *, east_m: float = 0.0, radius_m: float = 30.0) -> Selection:
    """A mission of four looks along a line, each 20 m after the one before; s1 has a range around a place there."""
    return Selection(
        {"s1": Circle(Position(east_m, 0.0), radius_m)},
        estimates=Estimates(
            local_s={LOOK: LOCAL_S}, servers={"s1": Beliefs(CHECK_S, RUNNING_S, {LOOK: REMOTE_S})}
        ),
        policy=policy or LocationAware(),
        mission=MissionBeliefs(PLAN, 4.0, Pace(1.0), [StopCall(LOOK, PHOTO_S)]),
    )


def at_first(machine: Selection, *, until_s: float) -> Selection:
    """The machine after its arrival at the first waypoint at 0 s, with s1 READY."""
    for event in (LegBegun(PLAN[0].position, None), LegEnded(), CheckAnswered(1, running=True)):
        machine.handle(event, now_s=0.0, position=PLAN[0].position)
    machine.handle(Tick(), now_s=until_s, position=PLAN[0].position)
    return machine


NEXT = Leg(20.0, 4.0, 1.0)


def outlook_of(machine: Selection, now_s: float) -> Outlook | None:
    """What flying on from the first waypoint would save and cost."""
    machine.locate(PLAN[0].position, now_s)
    return machine.planning.outlook()


def test_flying_on_costs_a_remote_call_only_if_its_server_is_lost_on_the_way() -> None:
    for radius_m, go_s in ((30.0, 0.5), (0.01, 0.02**0.5 + LOCAL_S)):
        machine = at_first(flight(radius_m=radius_m), until_s=PHOTO_S)
        assert isinstance(machine.decide(LOOK, now_s=1.0, position=PLAN[0].position)[0], Remote)
        outlook = outlook_of(machine, 1.5)
        assert outlook is not None
        assert (outlook.leg, outlook.photo_s, outlook.stay_s) == (NEXT, PHOTO_S, 0.5)
        assert outlook.go_s == pytest.approx(go_s)


def test_the_pace_of_the_vehicle_that_was_found_counts_for_the_next_leg() -> None:
    machine = Selection(
        {},
        estimates=Estimates(local_s={LOOK: LOCAL_S}, servers={}),
        policy=LocationAware(),
        mission=MissionBeliefs(PLAN, 4.0, Pace(1.0), [StopCall(LOOK, PHOTO_S)], assumed=True),
    )
    found = MissionBegun(LANDS_AT_ONCE, Pace(4.0))
    for event in (found, LegBegun(PLAN[0].position, None), LegEnded()):
        machine.handle(event, now_s=0.0, position=PLAN[0].position)
    machine.decide(LOOK, now_s=1.0, position=PLAN[0].position)
    outlook = outlook_of(machine, 1.0)
    assert outlook is not None and outlook.leg == Leg(20.0, 4.0, 4.0)


def test_flying_on_costs_a_call_on_the_drone_nothing_and_without_an_open_call_there_is_nothing_to_weigh() -> (
    None
):
    machine = flight(east_m=900.0)
    for event in (LegBegun(PLAN[0].position, None), LegEnded()):
        machine.handle(event, now_s=0.0, position=PLAN[0].position)
    assert outlook_of(machine, 0.5) is None
    assert isinstance(machine.decide(LOOK, now_s=1.0, position=PLAN[0].position)[0], Local)
    assert outlook_of(machine, 4.0) == Outlook(NEXT, PHOTO_S, 7.0, 7.0)
    assert outlook_of(machine, 14.0) == Outlook(NEXT, PHOTO_S, 0.0, 0.0)
    machine.handle(TargetUnknown(), now_s=14.5, position=PLAN[0].position)
    assert outlook_of(machine, 14.5) is None, "it leaves its plan"
    called = at_first(flight(), until_s=PHOTO_S)
    called.decide(LOOK, now_s=1.0, position=PLAN[0].position)
    called.handle(LocalCallEnded(LOOK, 14.0), now_s=15.0, position=PLAN[0].position)
    assert outlook_of(called, 15.0) is None


def test_a_call_without_an_estimate_is_expected_to_be_over_at_once() -> None:
    machine = at_first(flight(), until_s=PHOTO_S)
    machine.decide(COUNT, now_s=1.0, position=PLAN[0].position)
    assert outlook_of(machine, 1.0) == Outlook(NEXT, PHOTO_S, 0.0, 0.0)


def test_a_call_that_waits_is_open_for_as_long_as_it_may_wait_and_then_for_its_own_time() -> None:
    machine = flight()
    for event in (LegBegun(PLAN[0].position, None), LegEnded()):
        machine.handle(event, now_s=0.0, position=PLAN[0].position)
    decision, _ = machine.decide(LOOK, now_s=5.0, position=PLAN[0].position)
    assert isinstance(decision, Wait) and decision.at_most_s == 6.5
    outlook = outlook_of(machine, 6.0)
    assert outlook is not None and outlook.stay_s == 5.5
    after, _ = machine.decide_after_wait(LOOK, 1, now_s=11.5, position=PLAN[0].position)
    assert isinstance(after, Local)
    outlook = outlook_of(machine, 12.0)
    assert outlook is not None and outlook.stay_s == outlook.go_s == LOCAL_S - 0.5


def test_a_policy_that_looks_ahead_sees_the_calls_to_come_and_every_leg() -> None:
    whys = []
    for policy in (LookAhead(), LocationAware()):
        machine = flight(policy, radius_m=100.0)
        step, _ = machine.handle(LegBegun(PLAN[0].position, None), now_s=0.0, position=PLAN[0].position)
        assert isinstance(step, Selected)
        whys.append(step.why)
        unknown = machine.handle(TargetUnknown(), now_s=1.0, position=PLAN[0].position)
        assert unknown == [], "without a forecast it stays"
    assert whys == ["serves the next 4 calls in 9.0 s", "fastest in range"]


def test_looking_ahead_a_server_is_left_as_a_leg_begins_that_leads_away_from_it() -> None:
    areas = {"near": Circle(Position(-10.0, 0.0), 11.0), "wide": Circle(Position(0.0, 0.0), 100.0)}
    beliefs = {
        name: Beliefs(CHECK_S, RUNNING_S, {LOOK: delay_s}) for name, delay_s in (("near", 0.5), ("wide", 1.0))
    }
    used = []
    for policy in (LookAhead(), LocationAware()):
        machine = Selection(
            areas,
            estimates=Estimates(local_s={LOOK: LOCAL_S}, servers=beliefs),
            policy=policy,
            mission=MissionBeliefs(PLAN, 4.0, Pace(1.0), [StopCall(LOOK, PHOTO_S)]),
        )
        for event in (Tick(), LegBegun(PLAN[1].position, None)):
            machine.handle(event, now_s=0.0, position=PLAN[0].position)
            used.append(machine.current.name if machine.current else "")
    assert used == ["near", "wide", "near", "near"]


def foreseen(machine: Selection, now_s: float) -> list[float]:
    """The seconds from each waypoint to the next, as they are expected at the start of a mission."""
    (times,) = machine.handle(MissionBegun(LANDS_AT_ONCE), now_s=now_s, position=Position(0.0, 0.0))
    assert isinstance(times, Foreseen)
    reached_s = [*times.reached_s, times.as_asked_s]
    return [after - before for before, after in itertools.pairwise(reached_s)]


AWAY_S, NEAR_S = PHOTO_S + LOCAL_S + LEG_S, PHOTO_S + REMOTE_S + LEG_S
LAST_S = PHOTO_S + REMOTE_S


@pytest.mark.parametrize(
    ("events", "expected_s"),
    [
        ([], [NEAR_S + CHECK_S - 2.0, NEAR_S, NEAR_S, LAST_S]),  # the first call waits for the check
        ([CheckAnswered(1, running=True)], [NEAR_S, NEAR_S, NEAR_S, LAST_S]),
        # It is left alone for another 59 s, and can be asked again then.
        ([ServerUnusable(1, "no answer")], [AWAY_S, AWAY_S, AWAY_S, LAST_S]),
        ([CheckAnswered(1, running=True), RemoteCallFailed("s1", 1, "")], [AWAY_S, AWAY_S, AWAY_S, LAST_S]),
        # Half of a turn is waited for.
        ([SlotRefused(1, 1)], [AWAY_S, NEAR_S, NEAR_S, LAST_S]),
    ],
)
def test_a_mission_is_foreseen_with_what_is_known_of_a_server(
    events: list[SelectionEvent], expected_s: list[float]
) -> None:
    machine = flight(radius_m=100.0)
    machine.handle(Tick(), now_s=0.0, position=Position(0.0, 0.0))
    for event in events:
        machine.handle(event, now_s=0.0, position=Position(0.0, 0.0))
    assert foreseen(machine, 1.0) == pytest.approx(expected_s, abs=0.01)


@pytest.mark.parametrize(("was_ready", "check_s"), [(False, CHECK_S), (True, RUNNING_S)])
def test_a_mission_is_foreseen_with_services_where_they_were_left_running(
    was_ready: bool, check_s: float
) -> None:
    machine = flight(radius_m=100.0)
    if was_ready:
        for position in (Position(0.0, 0.0), Position(500.0, 0.0)):
            machine.handle(Tick(), now_s=0.0, position=position)
            machine.handle(CheckAnswered(1, running=True), now_s=RUNNING_S, position=position)
        assert machine.servers["s1"].state is State.AVL_R
    expected_s = [NEAR_S + check_s - PHOTO_S, NEAR_S, NEAR_S, LAST_S]
    assert foreseen(machine, 5.0) == pytest.approx(expected_s, abs=0.01)
