"""The next server made ready by the one before: flights between two simulated daemons, peers or not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tests.events import written
from tests.scenarios import fault, scenario, server

from upwash.lab.run import Run, simulate


def fly(
    *faults: dict[str, Any], peers: Sequence[str] = ("s2",), knows: Sequence[str] = ("s1",), **s2_truth: Any
) -> Run:
    """Along a line past s1 and then s2, which needs 20 s for a start; `peers` are s1's, `knows` are s2's."""
    return simulate(
        scenario(
            server("s1", 40.0, 0.0, truth={"peers": list(peers)}),
            server("s2", 120.0, 0.0, check_s=23.5, truth={"peers": list(knows), **s2_truth}),
            faults=faults,
            columns=9,
            rows=1,
            policy={"name": "look-ahead"},
        )
    )


def events(run: Run, *names: str, of: str = "s2") -> list[dict[str, Any]]:
    return [event for event in written(run.events) if event["event"] in names and event.get("server") == of]


def steps(run: Run) -> list[str]:
    """What became of s2."""
    return [event["event"] for event in events(run, "prepared", "selected", "found_running", "started")]


def why_not(run: Run) -> str:
    (event,) = events(run, "not_prepared")[:1]
    return str(event["why"])


def test_the_second_server_is_warm_on_arrival() -> None:
    run, alone = fly(), fly(peers=(), knows=())
    assert steps(run)[:3] == ["prepared", "selected", "found_running"]
    assert steps(alone)[:2] == ["selected", "started"]
    assert run.result.mission_time_s < alone.result.mission_time_s - 5.0
    prepared, found = events(run, "prepared", "found_running")[:2]
    assert (prepared["before"], prepared["after"], prepared["why"]) == ("AVL", "AVL-R", "by s1")
    assert found["t"] - prepared["t"] > 20.0, "there was time for the start"


def test_a_server_without_peers_is_asked_for_nothing() -> None:
    assert fly(peers=()).log() == fly(peers=(), knows=()).log()


def test_a_refusal_costs_nothing_and_is_logged_with_its_reason() -> None:
    alone = fly(peers=(), knows=())
    for run, why in (
        (fly(knows=()), "s1 is no peer of this daemon"),
        (fly(images=[]), "s2 has no image of detector"),
        (fly(fault("s2", "off", to_s=60.0)), "s2 does not answer"),
        (fly(fault("s2", "stuck", to_s=60.0)), "no answer within 3.0 s"),
        (fly(fault("s2", "full", to_s=60.0)), "s2 has no free slot: 4 of 4 in use"),
        (fly(fault("s2", "garbage", to_s=60.0)), "cannot be decoded"),
    ):
        assert why in why_not(run)
        assert "prepared" not in steps(run)
        assert run.result.completed
        if "image" not in why:
            assert run.result.mission_time_s <= alone.result.mission_time_s + 0.001


def test_a_server_that_is_not_as_was_promised_is_started_then() -> None:
    run = fly(fault("s2", "wrong", to_s=60.0))
    assert "prepared" in steps(run)
    assert events(run, "found_stopped")
    assert run.result.completed


def test_the_rest_of_a_start_teaches_nothing_about_starts() -> None:
    run = fly(start_s=45.0)
    assert {"prepared", "found_stopped", "started"} <= {
        event["event"] for event in events(run, *steps(run), "found_stopped")
    }
    checks_s = [
        event["check_s"]
        for event in written(run.events)
        if event["event"] == "decided" and event["selected"] == "s2"
    ]
    assert set(checks_s) <= {23.5, 3.5}
