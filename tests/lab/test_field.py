"""A simulated server is made when somebody first speaks to it: most of a thousand servers cost nothing."""

from __future__ import annotations

from typing import Any

import pytest

import upwash
from upwash.lab import field
from upwash.server.daemon import EdgeServer

SCENARIO: dict[str, Any] = {
    "mission": {"grid": {"columns": 3, "rows": 1, "spacing_m": 20.0}},
    "service": [{"name": "detector", "local_call_s": {"light": 3.0, "heavy": 10.0}}],
}


def server(name: str, east_m: float) -> dict[str, Any]:
    return {
        "name": name,
        "east_m": east_m,
        "north_m": 0.0,
        "range_m": 60.0,
        "remote_call_s": {"light": 0.3, "heavy": 0.7},
    }


def test_a_server_to_which_nobody_speaks_is_never_made(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[EdgeServer] = []

    class Counted(EdgeServer):
        def __init__(self, *args: Any, **settings: Any) -> None:
            super().__init__(*args, **settings)
            made.append(self)

    monkeypatch.setattr(field, "EdgeServer", Counted)
    near, far = server("near", 20.0), [server(f"far{number}", 1_000.0 * number) for number in range(1, 50)]
    run = upwash.simulate({**SCENARIO, "server": [near, *far]})
    assert run.completed
    assert run.totals.remote.get("near")
    assert len(made) == 1
