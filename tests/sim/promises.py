"""The promises of a flight, as far as its event log shows them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from upwash.config import DroneConfig, server_position, waypoints
from upwash.core.geo import Circle, Position
from upwash.core.servers import SELECTED, TRANSITIONS, Event, State
from upwash.lab.run import Run

_CHANGES = frozenset(event.value for event in Event)
_SLACK_S = 0.1
_FAREWELL_S = 0.5  # a drone says goodbye to its last server


def assert_kept(run: Run, config: DroneConfig, *, local_only_s: float) -> None:
    """The mission was completed, and no event of its log breaks a promise."""
    assert run.failure == "" and run.result.completed
    assert [event for event in run.events if event["event"] == "offloading_failed"] == []
    assert_every_waypoint_has_one_result(run, config)
    assert_calls_are_bounded(run, config)
    assert_one_selection(run)
    assert_remote_calls_in_range(run, config)
    assert_blacklisted_are_left_alone(run, config)
    assert_no_harm(run, local_only_s=local_only_s)


def assert_every_waypoint_has_one_result(run: Run, config: DroneConfig) -> None:
    assert [call.waypoint for call in run.result.calls] == [each.index for each in waypoints(config.mission)]


def assert_calls_are_bounded(run: Run, config: DroneConfig) -> None:
    """The longest worthwhile wait, the remote deadline and one local call; what was not allowed counts 0."""
    for decisions, call in _calls(run):
        allowed_s = sum(each.get("at_most_s", 0.0) + each.get("deadline_s", 0.0) for each in decisions)
        assert call["delay_s"] <= allowed_s + local_s(config, call["operation"]) + _SLACK_S, call


def assert_one_selection(run: Run) -> None:
    """Each change starts in the state where the last one ended, is one of the table's, and one server is selected."""
    states: dict[str, State] = {}
    for event in run.events:
        if event["event"] not in _CHANGES:
            continue
        before, after = State(event["before"]), State(event["after"])
        assert states.get(event["server"], State.AVL) is before
        assert TRANSITIONS[before, Event(event["event"])] is after
        states[event["server"]] = after
        assert sum(state in SELECTED for state in states.values()) <= 1


def assert_remote_calls_in_range(run: Run, config: DroneConfig) -> None:
    areas = {
        server.name: Circle(server_position(server, config.mission.home), server.range_m)
        for server in config.servers
    }
    for event in run.events:
        if event["event"] == "decided" and event["decision"] == "remote":
            assert areas[event["server"]].contains(Position(**event["position"]))


def assert_blacklisted_are_left_alone(run: Run, config: DroneConfig) -> None:
    """Neither selected nor called before their time."""
    until_s: dict[str, float] = {}
    for event in run.events:
        if event["event"] in _CHANGES and event["after"] == State.BLACKLISTED:
            until_s[event["server"]] = event["t"] + config.policy.blacklist_s
        elif event["event"] == Event.SELECTED or event.get("decision") in ("remote", "wait"):
            assert event["t"] >= until_s.get(event["server"], 0.0) - 1e-6


def assert_no_harm(run: Run, *, local_only_s: float) -> None:
    """No later than with the drone alone, but for the waits and deadlines that the rules allowed."""
    allowed_s = sum(
        each.get("at_most_s", 0.0) + each.get("deadline_s", 0.0)
        for decisions, _ in _calls(run)
        for each in decisions
    )
    assert run.result.mission_time_s <= local_only_s + allowed_s + _FAREWELL_S + _SLACK_S


def local_s(config: DroneConfig, operation: str) -> float:
    """How long the operation takes on the drone, where nothing is hot and nothing noisy."""
    service = next(each for each in config.services if operation.startswith(f"{each.name}."))
    return max(service.local_call_s.values()) + service.local_first_extra_s


def _calls(run: Run) -> Iterator[tuple[list[dict[str, Any]], dict[str, Any]]]:
    """Each call with the decisions that were made for it."""
    decisions: list[dict[str, Any]] = []
    for event in run.events:
        if event["event"] == "decided":
            decisions.append(event)
        elif event["event"] == "call":
            yield decisions, event
            decisions = []
