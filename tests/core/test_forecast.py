"""What a policy is shown of the calls to come: which servers, for how long, and after which checks."""

from __future__ import annotations

import pytest

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.coverage import Coverage
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.knowledge.servers import Server, State, Trigger
from upwash.core.operation import Operation
from upwash.core.planning.forecast import Forecast, make_forecast, rest_of_check_s
from upwash.core.planning.mission_model import ExpectedCall
from upwash.core.planning.schedule import CheckTimes, ComingCall, Offer

LOOK, COUNT = Operation("detector", "look"), Operation("counter", "count")
HERE, THERE = Position(0.0, 0.0), Position(500.0, 0.0)
LOCAL_S, REMOTE_S, CHECK_S, RUNNING_S, FULL_S = 10.0, 1.0, 12.0, 4.0, 15.0


def estimates(remote_s: dict[str, float], coverage: Coverage | None = None) -> Estimates:
    """Looks and counts take 10 s on the drone; servers host looks alone."""
    servers = {name: Beliefs(CHECK_S, RUNNING_S, {LOOK: delay_s}) for name, delay_s in remote_s.items()}
    return Estimates(local_s={LOOK: LOCAL_S, COUNT: LOCAL_S}, servers=servers, coverage=coverage)


def server(name: str = "a", *events: Trigger, peers: str = "") -> Server:
    """A server at which these events came at 100 s."""
    found = Server(name, Circle(HERE, 50.0), peers=frozenset(peers))
    for event in events:
        found.apply(event, now_s=100.0)
    return found


def call(
    gap_s: float, operation: Operation = LOOK, *, at: Position | None = None, **in_range_s: float
) -> ExpectedCall:
    return ExpectedCall(operation, gap_s, in_range_s, at)


def forecast(
    calls: list[ExpectedCall],
    *servers: Server,
    believed: Estimates | None = None,
    selected: tuple[Server, ...] = (),
    banned_s: dict[str, float] | None = None,
    now_s: float = 100.0,
) -> Forecast:
    known = {each.name: each for each in servers}
    believed = believed or estimates(dict.fromkeys(known, REMOTE_S))
    return make_forecast(calls, known, believed, selected, now_s=now_s, banned_s=banned_s or {}, idle_s=60.0)


def test_each_call_is_shown_with_the_faster_servers_in_its_range() -> None:
    believed = estimates({"a": REMOTE_S, "even": LOCAL_S, "slow": 11.0})
    servers = [server(name) for name in ("a", "even", "slow")]
    shown = forecast(
        [call(5.0, a=5.0, even=5.0, slow=5.0), call(3.0, a=2.0), call(2.0)], *servers, believed=believed
    )
    # Half of the calls are counts, of which the servers know nothing.
    assert shown.calls == [
        ComingCall(LOCAL_S, 5.0, [Offer("a", REMOTE_S, 5.0)]),
        ComingCall(LOCAL_S, 3.0, [Offer("a", REMOTE_S, 2.0)]),
        ComingCall(LOCAL_S, 2.0, []),
    ]
    assert shown.checks == {"a": CheckTimes(CHECK_S, RUNNING_S)}
    assert shown.ready_in_s == 0.0


def test_what_a_server_does_not_host_takes_as_long_there_as_on_the_drone() -> None:
    (shown,) = forecast([call(5.0, COUNT, a=5.0)], server()).calls
    assert shown.offers == [Offer("a", LOCAL_S, 5.0)]


@pytest.mark.parametrize(
    ("banned_s", "head_starts_s"),
    [(5.0, [None, 3.0]), (4.0, [1.0, 3.0]), (0.0, [5.0, 3.0]), (8.0, [None, None]), (7.5, [None, 0.5])],
)
def test_a_server_that_is_left_alone_counts_from_when_it_may_be_used(
    banned_s: float, head_starts_s: list[float | None]
) -> None:
    shown = forecast([call(5.0, a=5.0), call(3.0, a=3.0)], server(), banned_s={"a": banned_s}).calls
    assert [each.offers[0].head_start_s if each.offers else None for each in shown] == head_starts_s


def test_the_services_of_a_server_that_was_left_run_until_it_is_idle_for_long() -> None:
    left = server("a", Trigger.SELECTED, Trigger.STARTED, Trigger.DESELECTED)
    calls = [call(5.0, a=5.0)]
    assert forecast(calls, left, now_s=110.0).checks["a"].runs_for_s == 50.0
    assert forecast(calls, server(), now_s=110.0).checks["a"].runs_for_s == 0.0


def test_of_a_check_under_way_its_rest_is_left() -> None:
    believed = estimates({"a": REMOTE_S})
    checked = server("a", Trigger.SELECTED)
    again = server("a", Trigger.SELECTED, Trigger.STARTED, Trigger.TURN_OVER)
    for each, left_s in ((checked, CHECK_S), (again, RUNNING_S)):
        assert rest_of_check_s(each, believed, 103.0) == left_s - 3.0
        assert rest_of_check_s(each, believed, 150.0) == 0.0
        each.full_s = 100.0
        assert rest_of_check_s(each, believed, 103.0) == FULL_S
    again.apply(Trigger.FOUND_RUNNING, now_s=104.0)
    assert again.state is State.READY
    assert rest_of_check_s(again, believed, 105.0) == 0.0


def test_the_check_of_a_second_radio_goes_on_in_any_case() -> None:
    first, second = server("a", Trigger.SELECTED), server("b", Trigger.SELECTED)
    calls = [call(5.0, a=5.0, b=5.0)]
    shown = forecast(calls, first, second, selected=(first, second), now_s=103.0)
    assert shown.ready_in_s == CHECK_S - 3.0
    assert shown.checks == {
        "a": CheckTimes(CHECK_S, RUNNING_S),
        "b": CheckTimes(CHECK_S - 3.0, CHECK_S - 3.0),
    }
    away = forecast([call(5.0, a=5.0)], first, second, selected=(first, second), now_s=103.0)
    assert set(away.checks) == {"a"}


def test_a_server_without_a_range_is_as_fast_as_it_was_at_the_place_of_the_call() -> None:
    coverage = Coverage({"a": ()})
    for place, delay_s in ((HERE, 3.0), (THERE, 20.0)):
        coverage.asked("a", place, answered=True).note(LOOK, delay_s)
    believed = estimates({"a": LOCAL_S}, coverage)
    calls = [call(5.0, at=HERE, a=5.0), call(5.0, at=THERE, a=5.0), call(5.0, at=Position(250.0, 0.0), a=5.0)]
    shown = forecast(calls, server(), believed=believed)
    assert [each.offers[0].call_s for each in shown.calls] == [3.0, 20.0, LOCAL_S]
    assert forecast(calls[1:], server(), believed=believed).checks == {}, "it gains nowhere"


def test_the_peers_of_the_servers_that_gain_are_shown() -> None:
    servers = [server("a", peers="b"), server("b"), server("slow", peers="a")]
    believed = estimates({"a": REMOTE_S, "b": REMOTE_S, "slow": 11.0})
    shown = forecast([call(5.0, a=5.0, b=5.0, slow=5.0)], *servers, believed=believed)
    assert shown.peers == {"a": frozenset("b")}
