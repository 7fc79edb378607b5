"""A server that names exceptions of its choice harms no mission."""

from __future__ import annotations

import pytest
from tests.system.attacks.lying_faults import NAMED, PHOTOS, attack

from upwash.lab.run import Run

pytestmark = [pytest.mark.system, pytest.mark.long]


@pytest.mark.parametrize("named", NAMED)
@pytest.mark.parametrize("hedged", [False, True])
def test_a_server_that_says_a_call_raised_harms_no_mission(named: str, *, hedged: bool) -> None:
    policy = {"blacklist_s": 1.0, **({"hedge": {"after": "p50", "budget": 0.5}} if hedged else {})}
    run = attack(named, policy=policy)
    assert isinstance(run, Run), run
    assert run.result.completed
    assert [call.place for call in run.result.calls] == ["local"] * PHOTOS
    names = {event.kind for event in run.events}
    assert "remote_raised" in names
    assert not names & {"safe_end", "left_to_pilot"}
