from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.knowledge.servers import State
from upwash.core.operation import Operation
from upwash.core.policies.names import make_policy
from upwash.core.policies.policy import (
    CallInputs,
    Deadline,
    Inputs,
    Lightened,
    Local,
    LocalOnly,
    LocationAware,
    Opportunistic,
    Option,
    Policy,
    Remote,
    Situation,
    Wait,
    WaitRule,
)
from upwash.eventlog import schema

JUST_BELOW_8 = math.nextafter(8.0, 0.0)


def situation(current: str | None = None, *, local_s: float = 8.0, **call_s: float) -> Situation:
    """Servers in range in the order of the table, each entered one second before the one listed ahead of it."""
    options = [Option(name, delay_s, 100.0 - place) for place, (name, delay_s) in enumerate(call_s.items())]
    return Situation(options, current, local_s)


@pytest.mark.parametrize(
    ("seen", "server"),
    [
        (situation(), None),
        (situation(s1=8.0), None),  # eq. 3.2 is strict
        (situation(s1=JUST_BELOW_8), "s1"),
        (situation(s1=9.0, s2=1.0), "s2"),
        (situation(s1=3.0, s2=1.0, s3=2.0), "s2"),  # eq. 3.3
        (situation(s1=3.0, s2=1.0, s3=1.0), "s2"),  # a tie: the order of the table
        (situation("s3", s1=3.0, s2=1.0, s3=1.0), "s3"),  # a tie: the current one
        (situation("s1", s1=3.0, s2=1.0), "s1"),  # eq. 3.4: gains exactly 25 %
        (situation("s1", s1=3.0, s2=0.999), "s2"),
        (situation("s1", s1=3.0, s2=1.01, s3=0.5), "s3"),
        (situation("s1", s1=8.0, s2=7.9), "s2"),  # the current one lost: the best, however little it gains
        (situation("s1", s1=8.0), None),  # de-selected with nothing better
        (situation("s1", s2=7.9), "s2"),  # the current one is out of range
        (situation("s1"), None),
    ],
)
def test_location_aware_selects_by_equations_3_2_to_3_4(seen: Situation, server: str | None) -> None:
    assert LocationAware(gain_switch=0.25).choose(seen).server == server


@pytest.mark.parametrize(
    ("seen", "server"),
    [
        (situation(), None),
        (situation(s1=1.0, s2=9.0, s3=2.0), "s3"),  # its range was entered first
        (situation(s1=1.0, s2=9.0), "s2"),  # slower than the drone: never compared
        (situation("s1", s1=9.0, s2=1.0), "s1"),  # stays while in range
        (situation("s1", s2=9.0), "s2"),
        (Situation([Option("s1", 5.0, 7.0), Option("s2", 1.0, 7.0)], None, 8.0), "s1"),  # entered at once
    ],
)
def test_opportunistic_takes_the_first_that_came(seen: Situation, server: str | None) -> None:
    assert Opportunistic().choose(seen).server == server


@given(st.lists(st.floats(0.1, 20.0), min_size=2, max_size=4), st.data())
def test_opportunistic_never_compares(delays_s: list[float], data: st.DataObject) -> None:
    first = [Option(f"s{place}", delay_s, float(place % 2)) for place, delay_s in enumerate(delays_s)]
    second = [replace(option, mean_call_s=data.draw(st.floats(0.1, 20.0))) for option in first]
    current = data.draw(st.sampled_from([None, "s0", "s1", "gone"]))
    policy = Opportunistic()
    assert policy.choose(Situation(first, current, 8.0)) == policy.choose(Situation(second, current, 8.0))


def test_local_only_never_leaves_the_drone() -> None:
    assert LocalOnly().choose(situation("s1", s1=0.1)).server is None
    assert isinstance(LocalOnly().decide(READY), Local)


READY = CallInputs("s1", State.READY, local_s=8.0, remote_s=1.0, check_expected_s=5.0, check_elapsed_s=0.0)
OFFLOADING = [Opportunistic(wait=WaitRule(0.25)), LocationAware(wait=WaitRule(0.25))]


@pytest.mark.parametrize(
    ("local_s", "remote_s", "deadline_s"),
    [
        (10.0, 0.75, 3.0),  # four times what is expected
        (10.0, 0.1, 1.0),  # never less than the minimum
        (10.0, 5.0, 10.0),  # nor more than a local call
        (0.5, 0.4, 1.0),  # but the minimum all the same
    ],
)
@pytest.mark.parametrize("policy", OFFLOADING)
def test_a_ready_server_is_called_with_a_deadline(
    policy: Policy, local_s: float, remote_s: float, deadline_s: float
) -> None:
    decision = policy.decide(replace(READY, local_s=local_s, remote_s=remote_s))
    assert isinstance(decision, Remote)
    assert (decision.server, decision.deadline_s) == ("s1", deadline_s)


def test_the_deadline_can_be_set() -> None:
    assert Deadline(least_s=0.5, factor=2.0).seconds(local_s=9.0, remote_s=0.1) == 0.5
    assert Deadline(least_s=0.5, factor=2.0).seconds(local_s=9.0, remote_s=1.0) == 2.0


@pytest.mark.parametrize(
    ("is_first", "local_s", "deadline_s"),
    [(True, 10.0, 10.0), (True, 0.5, 1.0), (False, 10.0, 3.0)],
)
def test_a_patient_drone_gives_a_first_call_the_time_of_a_local_one(
    is_first: bool, local_s: float, deadline_s: float
) -> None:
    policy = make_policy("location-aware", gain_switch=0.25, gain_wait=0.25, patient_first_call=True)
    call = replace(READY, local_s=local_s, remote_s=min(0.75, local_s / 2), is_first=is_first)
    decision = policy.decide(call)
    assert isinstance(decision, Remote)
    assert decision.deadline_s == deadline_s


@pytest.mark.parametrize("policy", OFFLOADING)
def test_unless_it_is_told_to_be_patient_the_first_call_is_as_any(policy: Policy) -> None:
    assert policy.decide(replace(READY, is_first=True)) == policy.decide(READY)


@pytest.mark.parametrize("state", [State.CHECK, State.CHECK_R])
@pytest.mark.parametrize(
    ("remote_s", "elapsed_s", "at_most_s"),
    [
        (1.0, 0.0, None),  # READY in 5 s gains exactly 25 %: eq. 3.5 is strict
        (1.0, 1e-9, 5.0),  # for at most X = 8 * 0.75 - 1, not merely the 5 s less a little
        (1.0, 4.0, 5.0),
        (1.0, 5.0, 5.0),  # due now
        (1.0, 500.0, 5.0),  # late
        (0.5, 0.0, 5.5),
        (2.0, 0.5, None),
        (2.0, 1.5, 4.0),
        (5.5, 5.0, 0.5),
        (5.5, 4.2, None),
        (6.0, 0.0, None),  # X = 0
        (6.0, 5.0, None),
        (6.0, 500.0, None),
        (7.0, 500.0, None),  # X < 0
        (8.0, 500.0, None),
        (9.0, 500.0, None),
    ],
)
@pytest.mark.parametrize("policy", OFFLOADING)
def test_waiting_by_equation_3_5(
    policy: Policy, state: State, remote_s: float, elapsed_s: float, at_most_s: float | None
) -> None:
    decision = policy.decide(replace(READY, state=state, remote_s=remote_s, check_elapsed_s=elapsed_s))
    if at_most_s is None:
        assert isinstance(decision, Local)
    else:
        assert isinstance(decision, Wait)
        assert (decision.server, decision.at_most_s) == ("s1", at_most_s)


@pytest.mark.parametrize("state", [State.AVL, State.AVL_R, State.BLACKLISTED])
@pytest.mark.parametrize("policy", OFFLOADING)
def test_nothing_is_expected_of_a_server_that_is_not_selected(policy: Policy, state: State) -> None:
    assert isinstance(policy.decide(replace(READY, state=state)), Local)


def test_an_operation_that_is_no_faster_there_stays_here_if_servers_are_compared() -> None:
    slow = replace(READY, remote_s=8.0)
    assert isinstance(LocationAware().decide(slow), Local)
    assert isinstance(LocationAware().decide(replace(slow, remote_s=JUST_BELOW_8)), Remote)
    assert isinstance(Opportunistic().decide(slow), Remote)


@pytest.mark.parametrize("name", ["local-only", "opportunistic", "location-aware", "look-ahead"])
def test_a_policy_is_made_by_its_name(name: str) -> None:
    assert make_policy(name, gain_switch=0.25, gain_wait=0.25).name == name


def test_the_gains_reach_the_policy() -> None:
    policy = make_policy("location-aware", gain_switch=0.5, gain_wait=0.125)
    assert policy.choose(situation("s1", s1=4.0, s2=0.5)).server == "s1"
    naive = make_policy("opportunistic", gain_switch=0.5, gain_wait=0.125)
    for each in (policy, naive):
        wait = each.decide(replace(READY, state=State.CHECK))
        assert isinstance(wait, Wait)
        assert wait.at_most_s == 6.0


def test_an_unknown_policy_is_refused() -> None:
    with pytest.raises(KeyError, match="clairvoyant"):
        make_policy("clairvoyant", gain_switch=0.25, gain_wait=0.25)


OPERATION = Operation("detector", "process_photo", "heavy")
quarters_s = st.integers(1, 48).map(lambda quarters: quarters / 4)  # coarse, so that ties are common


def thesis_selects(
    call: float, call_s: dict[str, float], in_range: set[str], cur: str | None, gain_switch: float
) -> str | None:
    """Equations 3.2 to 3.4 as printed, with the ties and the de-selection of the specification."""

    def candidate(s: str) -> bool:
        return s in in_range and call_s[s] < call

    def best(s: str) -> bool:
        return candidate(s) and not any(candidate(other) and call_s[other] < call_s[s] for other in call_s)

    if cur is not None and not candidate(cur):
        cur = None
    if cur is not None and best(cur):
        return cur
    chosen = next((s for s in call_s if best(s)), None)
    if cur is None or chosen is None:
        return chosen
    return chosen if (call_s[cur] - call_s[chosen]) / call > gain_switch else cur


@given(
    local_s=quarters_s,
    believed_s=st.dictionaries(st.sampled_from(["s1", "s2", "s3", "s4"]), quarters_s, min_size=1),
    observed=st.lists(st.tuples(st.sampled_from(["here", "s1", "s2", "s3", "s4"]), quarters_s), max_size=8),
    gain_switch=st.sampled_from([0.0, 0.125, 0.25, 0.5]),
    data=st.data(),
)
def test_with_one_operation_location_aware_is_the_thesis_to_the_letter(
    local_s: float,
    believed_s: dict[str, float],
    observed: list[tuple[str, float]],
    gain_switch: float,
    data: st.DataObject,
) -> None:
    beliefs = {name: Beliefs(11.5, 3.5, {OPERATION: delay_s}) for name, delay_s in believed_s.items()}
    estimates = Estimates(local_s={OPERATION: local_s}, servers=beliefs)
    windows = {"here": [local_s] * 3} | {name: [delay_s] * 3 for name, delay_s in believed_s.items()}
    for place, delay_s in observed:
        if place == "here":
            estimates.observe_local(OPERATION, delay_s)
        elif place in believed_s:
            estimates.observe_remote(place, OPERATION, delay_s, now_s=0.0)
        windows.setdefault(place, []).append(delay_s)
    mean_s = {place: sum(values[-3:]) / 3 for place, values in windows.items()}
    in_range = data.draw(st.sets(st.sampled_from(sorted(believed_s))))
    current = data.draw(st.sampled_from([None, *believed_s]))

    options = [Option(name, estimates.mean_call_s(name), 0.0) for name in believed_s if name in in_range]
    seen = Situation(options, current, estimates.mean_call_s())
    expected = thesis_selects(
        mean_s["here"], {name: mean_s[name] for name in believed_s}, in_range, current, gain_switch
    )
    assert LocationAware(gain_switch=gain_switch).choose(seen).server == expected


def test_the_inputs_of_a_decision_are_fields_of_its_log_event() -> None:
    assert Inputs().facts.keys() <= set(schema.Decided.__struct_fields__)
    operation = Operation("detector", "process_photo")
    lightened = Lightened(operation, operation, 1.0, 1.0)
    assert lightened.facts.keys() <= set(schema.Call.__struct_fields__)
