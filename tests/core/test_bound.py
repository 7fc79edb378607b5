"""The bounds of a mission: what nobody can beat."""

from __future__ import annotations

from upwash.core.planning.bound import bound
from upwash.core.planning.schedule import ComingCall, Offer


def test_without_joins_each_call_runs_where_it_is_fastest() -> None:
    calls = [
        ComingCall(10.0, 5.0, [Offer("a", 2.0, 0.0), Offer("b", 1.0, 0.0)]),
        ComingCall(10.0, 5.0, [Offer("a", 12.0, 5.0)]),
        ComingCall(10.0, 5.0, []),
    ]
    assert bound(calls, {"a": 3.0, "b": 3.0}).free_s == 1.0 + 10.0 + 10.0


def test_joins_are_paid_for_where_no_flight_hides_them() -> None:
    calls = [
        ComingCall(10.0, 5.0, [Offer("a", 1.0, 5.0)]),
        ComingCall(10.0, 2.0, [Offer("b", 1.0, 2.0)]),
    ]
    assert bound(calls, {"a": 3.0, "b": 3.0}).with_joins_s == 1.0 + (3.0 - 2.0) + 1.0
