"""Which server for which call: small worlds whose best schedule is plain, and random ones tried out entirely."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from upwash.core.planning import schedule
from upwash.core.planning.schedule import CheckTimes, ComingCall, Offer, Schedule, quickest

LOCAL_S, REMOTE_S = 10.0, 1.0
SAME = {name: CheckTimes(12.0, 4.0) for name in ("a", "b")}


def call(gap_s: float, **head_starts_s: float) -> ComingCall:
    """A heavy call with servers in range of it for so long."""
    offers = [Offer(server, REMOTE_S, head_start_s) for server, head_start_s in head_starts_s.items()]
    return ComingCall(LOCAL_S, gap_s, offers)


def test_without_servers_every_call_runs_on_the_drone() -> None:
    schedule = quickest([call(5.0), call(5.0)], {})
    assert (schedule.servers, schedule.total_s) == ([None, None], 2 * LOCAL_S)


def test_a_server_is_left_before_its_range_so_that_the_next_is_ready_in_time() -> None:
    # Both ranges hold the second call. Switching before it costs a wait, switching after it costs nothing.
    calls = [call(12.0, a=12.0), call(12.0, a=12.0, b=6.0), call(12.0, b=12.0)]
    schedule = quickest(calls, SAME, server="a")
    assert (schedule.servers, schedule.total_s) == (["a", "a", "b"], 3 * REMOTE_S)


def test_a_server_whose_range_is_crossed_too_soon_is_skipped() -> None:
    calls = [call(5.0, a=5.0), call(5.0, a=5.0, b=5.0), call(5.0, a=5.0)]
    assert quickest(calls, SAME, server="a").servers == ["a", "a", "a"]


def test_a_faster_server_is_changed_to_where_the_calls_to_come_pay_for_the_check() -> None:
    def calls(count: int) -> list[ComingCall]:
        return [ComingCall(10.0, 5.0, [Offer("a", 3.0, 5.0), Offer("b", 1.0, 5.0)])] * count

    assert quickest(calls(2), SAME, server="a").servers == ["a", "a"]
    assert quickest(calls(9), SAME, server="a").servers == ["b"] * 9


def test_a_server_that_was_started_before_is_ready_sooner() -> None:
    calls = [call(20.0, a=20.0), call(5.0, b=5.0), call(5.0, a=5.0)]
    checks = {"a": CheckTimes(12.0, 4.0), "b": CheckTimes(12.0, 4.0, runs_for_s=60.0)}
    assert quickest(calls, checks).total_s == 3 * REMOTE_S
    forgotten = {**checks, "b": CheckTimes(12.0, 4.0, runs_for_s=10.0)}
    assert quickest(calls, forgotten).total_s > 3 * REMOTE_S


def test_a_peer_starts_its_services_while_the_server_before_is_ready() -> None:
    calls = [call(6.0, a=6.0), call(8.0, b=4.0), call(8.0, b=8.0)]
    alone = quickest(calls, SAME, server="a")
    prepared = quickest(calls, SAME, server="a", peers={"a": frozenset("b")})
    assert alone.total_s == REMOTE_S + (12.0 - 4.0) + REMOTE_S + REMOTE_S
    assert prepared.total_s == 3 * REMOTE_S, "b has had 11 s by the time that its range is entered"
    late = quickest(calls, SAME, server="a", ready_in_s=5.0, peers={"a": frozenset("b")})
    assert late.total_s == REMOTE_S + (12.0 - 6.0 - 4.0) + REMOTE_S + REMOTE_S, (
        "and 6 s, where a is ready later"
    )


def test_a_server_is_kept_that_has_peers_or_is_prepared() -> None:
    both = [call(30.0, a=30.0, b=30.0), call(4.0, c=4.0), call(4.0, c=4.0)]
    checks = {**SAME, "c": CheckTimes(12.0, 4.0)}
    assert quickest(both, checks, peers={"b": frozenset("c")}).servers == ["b", "c", "c"]
    assert quickest(both, checks, peers={"a": frozenset("c")}).servers == ["a", "c", "c"]
    after = [call(30.0, c=30.0), call(8.0, a=4.0, b=4.0), call(8.0, a=8.0, b=8.0)]
    for prepared in "ab":
        best = quickest(after, checks, peers={"c": frozenset(prepared)})
        assert (best.servers, best.total_s) == (["c", prepared, prepared], 3 * REMOTE_S)


def test_a_wait_has_to_gain_what_is_asked() -> None:
    calls = [call(8.0, a=8.0)]  # 4 s of the check are left
    assert quickest(calls, SAME).total_s == 4.0 + REMOTE_S
    assert quickest(calls, SAME, gain_wait=0.25).total_s == 4.0 + REMOTE_S
    assert quickest(calls, SAME, gain_wait=0.5).total_s == LOCAL_S


@pytest.mark.parametrize(
    ("ready_in_s", "total_s"), [(7.0, LOCAL_S + REMOTE_S), (7.1, LOCAL_S + 8.0 + REMOTE_S)]
)
def test_a_check_that_was_left_has_started_services_if_the_rest_is_that_of_a_start(
    ready_in_s: float, total_s: float
) -> None:
    # A check of 12 s joins and asks for 4 s; a second more is kept for a server that was slow to do so.
    calls = [call(5.0), call(8.0, a=4.0)]
    assert quickest(calls, SAME, server="a", ready_in_s=ready_in_s).total_s == total_s


@pytest.mark.parametrize(("head_start_s", "total_s"), [(3.0, 2.0 + 2.0 + 1.0), (2.9, 3 * 2.0)])
def test_services_that_a_check_started_during_a_call_run_at_the_next_visit(
    head_start_s: float, total_s: float
) -> None:
    # Of 20 s 15 are left after the first call, or more.
    calls = [
        ComingCall(2.0, 5.0, [Offer("a", REMOTE_S, head_start_s)]),
        ComingCall(2.0, 5.0, []),
        ComingCall(2.0, 8.0, [Offer("a", REMOTE_S, 4.0)]),
    ]
    assert quickest(calls, {"a": CheckTimes(20.0, 4.0)}).total_s == total_s


def test_a_second_call_at_once_finds_its_server_ready() -> None:
    assert quickest([call(4.0, a=4.0), call(0.0, a=0.0)], SAME, server="a").total_s == 2 * REMOTE_S
    assert quickest([call(8.0, a=8.0), call(0.0, a=0.0)], SAME).total_s == 4.0 + 2 * REMOTE_S


def test_a_check_that_is_just_over_is_no_wait() -> None:
    calls = [ComingCall(LOCAL_S, 4.0, [Offer("a", 9.0, 4.0)])]
    assert quickest(calls, {"a": CheckTimes(4.0, 4.0)}, gain_wait=0.25).total_s == 9.0


def test_a_range_that_was_left_on_the_way_needs_a_new_check() -> None:
    assert quickest([call(9.0, a=3.0)], SAME, server="a").total_s == 4.0 - 3.0 + REMOTE_S


def test_who_stays_does_not_switch_before_the_first_call() -> None:
    calls = [call(12.0, a=12.0, b=12.0), call(1.0, b=1.0)]
    assert quickest(calls, SAME, server="a").servers == ["b", "b"]
    assert quickest(calls, SAME, server="a", stays=True).servers == ["a", "b"]


times_s = st.sampled_from([0.5, 1.0, 3.0, 8.0, 12.0])


@st.composite
def coming_calls(draw: st.DrawFn) -> ComingCall:
    gap_s = draw(times_s)
    offers = [
        Offer(server, draw(times_s), draw(st.sampled_from([0.0, gap_s / 2, gap_s])))
        for server in draw(st.sets(st.sampled_from("abc")).map(sorted))
    ]
    return ComingCall(draw(st.sampled_from([3.0, 10.0])), gap_s, offers)


def tried_s(
    calls: Sequence[ComingCall],
    checks: Mapping[str, CheckTimes],
    servers: Sequence[str | None],
    waits: Sequence[bool],
) -> float:
    """What the calls take with these servers; where it waits, a call waits however long it takes."""
    total_s, selected, left_s = 0.0, None, 0.0
    for each, server, wait in zip(calls, servers, waits, strict=True):
        offer = next((offer for offer in each.offers if offer.server == server), None)
        if offer is None:
            total_s, selected = total_s + each.local_s, None
            continue
        if server == selected and offer.head_start_s == each.gap_s:
            left_s = max(0.0, left_s - each.gap_s)
        else:
            selected, left_s = server, max(0.0, checks[offer.server].running_s - offer.head_start_s)
        if left_s == 0 or wait:
            total_s, left_s = total_s + left_s + min(offer.call_s, each.local_s), 0.0
        else:
            total_s, left_s = total_s + each.local_s, max(0.0, left_s - each.local_s)
    return total_s


@settings(deadline=None)
@given(
    calls=st.lists(coming_calls(), min_size=1, max_size=4), check_s=st.lists(times_s, min_size=3, max_size=3)
)
def test_no_choice_of_servers_and_waits_is_quicker(calls: list[ComingCall], check_s: list[float]) -> None:
    checks = {name: CheckTimes(time_s, time_s) for name, time_s in zip("abc", check_s, strict=True)}
    best_s = min(
        tried_s(calls, checks, servers, waits)
        for servers in itertools.product([None, "a", "b", "c"], repeat=len(calls))
        for waits in itertools.product([False, True], repeat=len(calls))
    )
    assert quickest(calls, checks).total_s == pytest.approx(best_s)


@st.composite
def check_times(draw: st.DrawFn) -> CheckTimes:
    running_s = draw(times_s)
    return CheckTimes(running_s + draw(times_s), running_s, draw(st.sampled_from([0.0, 9.0])))


@st.composite
def searches(draw: st.DrawFn, checks: st.SearchStrategy[CheckTimes]) -> Callable[..., Schedule]:
    """A search of a random world in which services are started, some by peers, and waits have to gain something."""
    names = st.sets(st.sampled_from("abc")).map(frozenset)
    return partial(
        quickest,
        draw(st.lists(coming_calls(), min_size=1, max_size=8)),
        {name: draw(checks) for name in "abc"},
        server=draw(st.sampled_from([None, *"abc"])),
        ready_in_s=draw(st.sampled_from([0.0, 4.0])),
        gain_wait=draw(st.sampled_from([0.0, 0.25])),
        stays=draw(st.booleans()),
        peers={name: draw(names) - {name} for name in "abc"},
    )


@settings(deadline=None)
@given(search=searches(check_times()), little=st.sampled_from([0.0, 0.2, 1.0]))
def test_what_is_followed_first_changes_nothing_about_what_is_found(
    search: Callable[..., Schedule], little: float
) -> None:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(schedule, "_LITTLE", math.inf)
        everything = search()
        patched.setattr(schedule, "_LITTLE", little)
        assert search() == everything


@settings(deadline=None)
@given(search=searches(check_times()))
def test_a_bound_on_the_labels_changes_nothing_until_it_is_exceeded(search: Callable[..., Schedule]) -> None:
    assert search(most_labels=2 * 8 * 3) == search(), (
        "each of 8 calls adds no more than two to each of 3 servers"
    )


@settings(deadline=None)
@given(search=searches(times_s.map(lambda check_s: CheckTimes(check_s, check_s))))
def test_with_fewer_labels_nothing_better_is_found_than_the_best(search: Callable[..., Schedule]) -> None:
    # Where checks take longer as services are started, the search without a bound need not find the best either.
    bounded, unbounded = search(most_labels=1), search()
    assert len(bounded.servers) == len(unbounded.servers)
    assert bounded.total_s >= unbounded.total_s or bounded.total_s == pytest.approx(unbounded.total_s)
