"""Flights with two radios: the next server is checked while the one before is still used."""

from __future__ import annotations

from typing import Any

from tests.events import written
from tests.scenarios import fault, scenario, server

from upwash.lab.faults.promises import History
from upwash.lab.faults.selection_promises import one_selection
from upwash.lab.run import Run, simulate


def fly(*faults: dict[str, Any], radios: int = 2, policy: str = "look-ahead") -> Run:
    """Along a line past s1 and s2, whose ranges overlap for some 40 m."""
    return simulate(
        scenario(
            server("s1", 40.0, 0.0),
            server("s2", 120.0, 0.0),
            faults=faults,
            columns=9,
            rows=1,
            policy={"name": policy},
            network={"radios": radios},
        )
    )


def times_s(run: Run, event: str, server: str) -> list[float]:
    return [
        each["t"] for each in written(run.events) if each["event"] == event and each.get("server") == server
    ]


def test_the_next_server_is_ready_before_the_one_before_is_left() -> None:
    run, single = fly(), fly(radios=1)
    assert (
        times_s(run, "joined", "s2")[0]
        < times_s(run, "started", "s2")[0]
        < times_s(run, "deselected", "s1")[0]
    )
    assert times_s(single, "deselected", "s1")[0] < times_s(single, "joined", "s2")[0]
    assert run.result.mission_time_s < single.result.mission_time_s - 1.0


def test_a_call_goes_to_the_server_in_use_while_the_next_is_checked() -> None:
    run = fly()
    begins_s, ends_s = times_s(run, "selected", "s2")[0], times_s(run, "started", "s2")[0]
    places = [
        call["place"]
        for call in written(run.events)
        if call["event"] == "call" and begins_s < call["at_s"] < ends_s
    ]
    assert places
    assert set(places) == {"s1"}


def test_a_network_that_is_lost_in_preparation_costs_nothing() -> None:
    run = fly(fault("link:s2", "off", from_s=0.0, to_s=64.0))
    alone = fly(fault("s2", "off"), radios=1)
    assert run.result.completed
    assert run.result.mission_time_s <= alone.result.mission_time_s


def test_with_one_radio_there_is_no_second_selection() -> None:
    for radios in (1, 2):
        run = fly(radios=radios)
        config = scenario(server("s1", 40.0, 0.0), server("s2", 120.0, 0.0), network={"radios": 1})
        breaches = list(one_selection(History(config, run)))
        assert bool(breaches) == (radios == 2)
