"""Whatever becomes of a good file, reading it gives a usable configuration or a ConfigError."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from upwash.config.daemon import daemon_config
from upwash.config.drone_file import drone_config, fleet_of
from upwash.config.places import server_position, waypoints
from upwash.config.truth import server_truth
from upwash.errors import ConfigError

FOLDER = Path(__file__).parent
VALUES: st.SearchStrategy[object] = st.recursive(
    st.one_of(
        st.integers(-(2**63), 2**63 - 1),
        st.floats(allow_nan=False, allow_infinity=False),
        st.booleans(),
        st.text(max_size=8),
        st.sampled_from(["light", "detector", "s1", "fixed", ":7", "[:7", "\0", "x" * 5000]),
    ),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=4,
)


def places(value: object, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """The way to everything in the document."""
    if isinstance(value, dict):
        inner = [place for name, each in value.items() for place in places(each, (*path, name))]
    elif isinstance(value, list):
        inner = [place for index, each in enumerate(value) for place in places(each, (*path, index))]
    else:
        inner = []
    return [path, *inner] if path else inner


def mutilate(data: st.DataObject, document: dict[str, Any]) -> None:
    """Deletes, renames or replaces one thing somewhere in the document."""
    *way, last = data.draw(st.sampled_from(places(document)))
    parent: Any = document
    for step in way:
        parent = parent[step]
    match data.draw(st.sampled_from(["delete", "rename", "replace"])):
        case "rename" if isinstance(parent, dict):
            parent[data.draw(st.text(min_size=1, max_size=6))] = parent.pop(last)
        case "replace":
            parent[last] = data.draw(VALUES)
        case _:
            del parent[last]


@settings(max_examples=300, deadline=None)
@given(data=st.data(), name=st.sampled_from(["full", "several", "fleet"]), mutilations=st.integers(1, 3))
def test_of_a_drone(data: st.DataObject, name: str, mutilations: int) -> None:
    document = tomllib.loads((FOLDER / f"{name}.toml").read_text())
    for _ in range(mutilations):
        mutilate(data, document)
    try:
        config = drone_config(document, Path("/nowhere/drone.toml"))
    except ConfigError as refusal:
        assert refusal.key
        assert refusal.problem
        return
    assert all(waypoints(drone.mission) for drone in fleet_of(config))
    for server in config.servers:
        assert server_position(server, config.mission.home)
        assert server_truth(server, config.services).start_s >= 0


@settings(max_examples=150, deadline=None)
@given(data=st.data(), mutilations=st.integers(1, 3))
def test_of_a_daemon(data: st.DataObject, mutilations: int) -> None:
    document = tomllib.loads((FOLDER / "daemon.toml").read_text())
    for _ in range(mutilations):
        mutilate(data, document)
    try:
        config = daemon_config(document, Path("/nowhere/server.toml"))
    except ConfigError as refusal:
        assert refusal.key
        assert refusal.problem
        return
    assert config.images
    assert config.identities
