"""A server that says of every call that the service raised there harms no mission, whatever class it names."""

from __future__ import annotations

import msgspec
import pytest
from tests.scenarios import scenario, server

from upwash.core.admission.clients import Client
from upwash.lab.run import simulate
from upwash.sim.faults import FaultyServer
from upwash.sim.link import Handler

pytestmark = [pytest.mark.system, pytest.mark.long]

NAMED = (  # upwash's own among them, which the drone might take for the truth
    *("upwash.drone.flight:AutopilotOverruled", "upwash.drone.coming_down:AutopilotOverruled"),
    *("upwash.errors:AutopilotOverruled", "upwash.drone.mission:MissionStopped"),
    *("upwash.drone.calling:UpwashError", "builtins:ValueError", "nobody.knows:This"),
)
PHOTOS = 6


@pytest.fixture(params=NAMED)
def _lying(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every server says of every call that it raised the class."""
    fault = {"type": request.param, "message": "mission: the pilot has the vehicle"}
    lie = msgspec.msgpack.encode({"fault": fault})
    plug = FaultyServer.plug

    def plug_liar(self: FaultyServer, address: str, instance: Handler) -> None:
        async def answer(path: str, body: bytes, client: Client) -> bytes:
            await instance(path, body, client)  # which takes its time
            return lie

        plug(self, address, answer)

    monkeypatch.setattr(FaultyServer, "plug", plug_liar)


@pytest.mark.usefixtures("_lying")
@pytest.mark.parametrize("hedged", [False, True])
def test_a_server_that_says_a_call_raised_harms_no_mission(*, hedged: bool) -> None:
    policy = {"blacklist_s": 1.0, **({"hedge": {"after": "p50", "budget": 0.5}} if hedged else {})}
    near = server("s1", 0.0, 0.0, range_m=1000.0)
    run = simulate(scenario(near, columns=3, rows=PHOTOS // 3, policy=policy))
    assert run.result.completed
    assert [call.place for call in run.result.calls] == ["local"] * PHOTOS
    names = {event.kind for event in run.events}
    assert "remote_raised" in names
    assert not names & {"safe_end", "left_to_pilot"}
