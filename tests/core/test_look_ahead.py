"""What look-ahead chooses, with what it is shown laid out by hand."""

from __future__ import annotations

from upwash.core.knowledge.servers import State
from upwash.core.planning.forecast import Forecast
from upwash.core.planning.schedule import CheckTimes, ComingCall, Offer
from upwash.core.policies.look_ahead import LookAhead
from upwash.core.policies.policy import (
    CallInputs,
    Choice,
    Coming,
    Decision,
    Local,
    LocationAware,
    Option,
    Remote,
    Situation,
)

LOCAL_S, REMOTE_S, GAP_S = 10.0, 1.0, 12.0
CHECKS = {"a": CheckTimes(12.0, 4.0), "b": CheckTimes(12.0, 4.0)}


def calls(*servers: str) -> list[ComingCall]:
    """Calls with these servers in range of them all the way from the call before, such as "a ab b"."""
    return [
        ComingCall(LOCAL_S, GAP_S, [Offer(server, REMOTE_S, GAP_S) for server in in_range])
        for in_range in servers
    ]


def choose(
    forecast: Forecast | None, *, in_range: str, current: str | None = None, under_way: Decision | None = None
) -> str | None:
    options = [Option(server, REMOTE_S, 0.0) for server in in_range]
    return (
        LookAhead()
        .choose(Situation(options, current, LOCAL_S, under_way=under_way, forecast=forecast))
        .server
    )


def test_the_server_of_the_next_call_is_chosen_once_it_is_in_range() -> None:
    forecast = Forecast(calls("b", "b", "b"), CHECKS, 0.0)
    assert choose(forecast, in_range="a", current="a") == "a"
    assert choose(forecast, in_range="ab", current="a") == "b"
    assert choose(forecast, in_range="") is None
    assert choose(forecast, in_range="a") is None
    assert choose(forecast, in_range="b") == "b"


def test_the_server_of_the_next_call_comes_before_that_of_the_call_after_it() -> None:
    assert choose(Forecast(calls("b", "a", "a"), CHECKS, 0.0), in_range="ab") == "b"


def test_a_server_is_not_left_for_one_that_is_just_as_good() -> None:
    assert choose(Forecast(calls("ab", "ab", "ab"), CHECKS, 0.0), in_range="ab", current="b") == "b"


def test_it_is_left_before_its_range_ends_if_the_next_one_would_not_be_ready_otherwise() -> None:
    slow = {"a": CHECKS["a"], "b": CheckTimes(2 * GAP_S, 4.0)}
    leaving = [
        ComingCall(LOCAL_S, GAP_S, [Offer("a", 8.0, GAP_S), Offer("b", REMOTE_S, GAP_S)]),
        *calls("b", "b"),
    ]
    assert choose(Forecast(leaving, slow, 0.0), in_range="ab", current="a") == "b"


def test_nothing_is_left_while_a_call_goes_on_there() -> None:
    forecast = Forecast(calls("b", "b", "b"), CHECKS, 0.0)
    assert choose(forecast, in_range="ab", current="a", under_way=Remote("a", 4.0, "server ready")) == "a"
    assert choose(forecast, in_range="ab", current="a", under_way=Local("not faster there")) == "b"


def test_a_check_goes_on_as_long_as_a_call_does() -> None:
    forecast = Forecast(calls("b", "b", "b"), CHECKS, 5.0)
    assert choose(forecast, in_range="ab", current="a", under_way=Local("too late to pay off")) == "a"
    assert choose(forecast, in_range="ab", current="a") == "b"


def test_a_server_out_of_range_is_not_kept() -> None:
    forecast = Forecast(calls("b", "b"), CHECKS, 0.0)
    assert choose(forecast, in_range="", current="a") is None


def test_the_server_that_comes_next_is_named_with_the_time_until_its_range() -> None:
    leaving = [*calls("a", ""), ComingCall(LOCAL_S, GAP_S, [Offer("b", REMOTE_S, 5.0)]), *calls("b")]
    situation = Situation([Option("a", REMOTE_S, 0.0)], "a", LOCAL_S, forecast=Forecast(leaving, CHECKS, 0.0))
    assert LookAhead().choose(situation).coming == Coming("b", 3 * GAP_S - 5.0 + REMOTE_S + LOCAL_S)
    staying = Situation(
        [Option("a", REMOTE_S, 0.0)], "a", LOCAL_S, forecast=Forecast(calls("a", "a"), CHECKS, 0.0)
    )
    assert LookAhead().choose(staying).coming is None


def test_where_nothing_is_foreseen_it_is_location_aware() -> None:
    situation = Situation([Option("a", 5.0, 0.0), Option("b", 1.0, 0.0)], "a", LOCAL_S)
    assert LookAhead().choose(situation) == LocationAware().choose(situation)
    assert LookAhead().choose(situation) == Choice("b", "gains enough over a")


def test_a_call_is_decided_as_by_location_aware() -> None:
    call = CallInputs("a", State.CHECK, LOCAL_S, REMOTE_S, check_expected_s=12.0, check_elapsed_s=9.0)
    assert LookAhead().decide(call) == LocationAware().decide(call)
