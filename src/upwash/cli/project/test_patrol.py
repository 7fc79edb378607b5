"""Flies the mission on virtual time: python -m pytest."""

from pathlib import Path

import upwash

DRONE = Path(__file__).with_name("drone.toml")
WAYPOINTS = 6


def test_every_waypoint_is_inspected() -> None:
    flight = upwash.simulate(DRONE)
    assert flight.completed
    assert len(flight.calls) == WAYPOINTS
    assert any(call.place == "s1" for call in flight.calls)


def test_the_drone_goes_on_alone_without_the_server() -> None:
    flight = upwash.simulate(DRONE, overrides={"fault": [{"target": "s1", "kind": "off"}]})
    assert flight.completed
    assert [call.place for call in flight.calls] == ["local"] * WAYPOINTS
