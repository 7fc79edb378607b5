"""Parts that make requests smaller before they are sent: in processes and as models, and whatever becomes of them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.children import expect_no_child
from tests.drone.test_onboard import Diary
from tests.events import written
from tests.scenarios import scenario, server
from tests.services_for_tests import Carrier, Halve

from upwash.core.operation import Operation
from upwash.drone.before_sending import BeforeSending, NotReduced, RunningPart
from upwash.drone.onboard import OnboardServices
from upwash.lab.run import Run, simulate, simulate_fleet
from upwash.ports import Dialer, InstanceSpec, Program, Runtime
from upwash.real.instances.runtime import OwnProcesses
from upwash.rpc.service import Reduced, spec_of
from upwash.sim.link import ModelDialer, Switchboard
from upwash.sim.runtime import ModelRuntime

METHOD = spec_of(Carrier).methods["echo"]
Ready = Callable[..., AbstractAsyncContextManager[tuple[BeforeSending, Diary]]]


class Prompt:
    async def start(self, spec: InstanceSpec) -> None:
        """At once."""

    async def compute(self, spec: InstanceSpec, operation: Operation, *, less: bool = False) -> float:
        return asyncio.get_running_loop().time()


@asynccontextmanager
async def running(
    runtime: Runtime, dialer: Dialer, program: str
) -> AsyncIterator[tuple[BeforeSending, Diary]]:
    diary = Diary()
    onboard = OnboardServices(
        [InstanceSpec("heron", "halve", Program(program), before="carrier")],
        start_timeout_s=60.0,
        runtime=runtime,
        dialer=dialer,
        journal=diary,
    )
    part = BeforeSending({"carrier": RunningPart("halve", 0.1, onboard)}, diary)
    await part.start()
    try:
        yield part, diary
    finally:
        await part.close()


@pytest.fixture(params=["model", "process"])
def ready(request: pytest.FixtureRequest, services: Path) -> Ready:
    def made(cls: str = "Halve") -> AbstractAsyncContextManager[tuple[BeforeSending, Diary]]:
        if request.param == "process":
            own = OwnProcesses("heron", max_message_bytes=1_000_000)
            return running(own, own, f"{services}:{cls}")
        board = Switchboard({})
        model = ModelRuntime({"halve": spec_of(Halve)}, Prompt(), board, objects={"halve": Halve()})
        return running(model, ModelDialer("heron", board), "")

    return made


def asked(data: bytes) -> bytes:
    return METHOD.encode((data, 3), {})[1]


async def reduced(part: BeforeSending, data: bytes, deadline_s: float = 20.0) -> bytes:
    return await part.reduce("carrier", METHOD, asked(data), deadline_s=deadline_s)


async def test_a_part_changes_its_own_parameter_and_leaves_the_others(ready: Ready) -> None:
    async with ready() as (part, _):
        made = await reduced(part, b"12345678")
    assert made == asked(b"1234")
    assert isinstance(made, Reduced)


async def test_a_part_that_raises_or_makes_more_says_so_and_the_next_request_is_made_smaller(
    ready: Ready,
) -> None:
    async with ready() as (part, _):
        with pytest.raises(NotReduced, match=r"halve: .*Overheated: 91\.5 °C"):
            await reduced(part, b"raise")
        with pytest.raises(NotReduced, match=r"halve made \d+ bytes to \d+"):
            await reduced(part, b"grows a lot")
        assert await reduced(part, b"equal") == asked(b"equal")
        assert await reduced(part, b"1234") == asked(b"12")


async def test_a_part_that_crashes_or_hangs_costs_a_moment_and_is_started_again(services: Path) -> None:
    own = OwnProcesses("heron", max_message_bytes=1_000_000)
    async with running(own, own, f"{services}:Halve") as (part, diary):
        for count, data in ((2, b"crash"), (3, b"hangs")):
            began_s = asyncio.get_running_loop().time()
            with pytest.raises(NotReduced):
                await reduced(part, data, deadline_s=1.0)
            assert asyncio.get_running_loop().time() - began_s < 5.0
            await diary.until("local_ready", count)
        assert await reduced(part, b"1234") == asked(b"12")
    expect_no_child()


async def test_a_part_that_does_not_start_fails_at_each_call_and_holds_nothing_up(services: Path) -> None:
    own = OwnProcesses("heron", max_message_bytes=1_000_000)
    async with running(own, own, f"{services}:Nobody") as (part, diary):
        assert diary.count("local_failed") == 1
        with pytest.raises(NotReduced):
            await reduced(part, b"1234", deadline_s=1.0)


# --- in a mission -------------------------------------------------------------------------------------------


def fly(*, most_loss: float, bandwidth_bit_s: float = 4e6, **tables: Any) -> Run:
    """Heavy calls take 1.16 s at 4 Mbit/s, and 0.52 s with less to send."""
    s1 = server("s1", 0.0, 0.0, range_m=500.0, bandwidth_bit_s=bandwidth_bit_s)
    del s1["remote_call_s"]
    s1["processing_s"] = {"light": 0.1, "heavy": 0.3}
    detector = {
        "name": "detector",
        "request_bytes": 430_000,
        "local_call_s": {"light": 3.0, "heavy": 10.0},
        "before_sending": {"takes_s": 0.02, "request_bytes": 98_000, "loss": {"heavy": 0.012}},
    }
    policy = {"name": "look-ahead", "most_loss": most_loss}
    return simulate(scenario(s1, service=[detector], policy=policy, **tables))


def calls(run: Run) -> list[dict[str, Any]]:
    return [event for event in written(run.events) if event["event"] == "call"]


@pytest.mark.parametrize("most_loss", [0.0, 0.01])
def test_all_is_sent_whole_where_the_user_allows_less_loss_than_a_part_has(most_loss: float) -> None:
    run = fly(most_loss=most_loss)
    assert not any("sent_bytes" in call for call in calls(run))
    assert calls(run)[-1]["delay_s"] == pytest.approx(1.161)


def test_less_is_sent_where_that_is_quicker_and_the_log_says_what_and_why() -> None:
    run = fly(most_loss=0.02)
    last = calls(run)[-1]
    assert last["delay_s"] == pytest.approx(0.517)
    assert last["sent_bytes"] < last["whole_bytes"]
    assert last["part_s"] == pytest.approx(0.02)
    assert last["decision"].endswith(
        "made smaller before sending: 0.52 s expected with less to send, 1.16 s whole"
    )
    assert run.result.mission_time_s < fly(most_loss=0.0).result.mission_time_s - 10.0


def test_a_fast_link_gets_the_request_whole() -> None:
    last = calls(fly(most_loss=0.02, bandwidth_bit_s=200e6))[-1]
    assert "sent_bytes" not in last
    assert last["decision"].endswith("sent whole: 0.32 s expected with less to send, 0.32 s whole")


def test_a_delay_that_is_given_from_end_to_end_is_shorter_by_the_transfer_that_is_saved() -> None:
    s1 = server("s1", 0.0, 0.0, range_m=500.0, bandwidth_bit_s=12e6)
    detector = {
        "name": "detector",
        "request_bytes": 425_000,
        "local_call_s": {"light": 3.0, "heavy": 10.0},
        "before_sending": {"takes_s": 0.02, "request_bytes": 125_000, "loss": 0.012},
    }
    run = simulate(scenario(s1, service=[detector], policy={"most_loss": 0.02}))
    assert calls(run)[-1]["delay_s"] == pytest.approx(0.7 - 0.2 + 0.02)


FUSSY = """
from upwash import service

@service
class Clip:
    def look(self, photo: bytes) -> bytes:
        return b""

@service(where="servers", before_sending=Clip)
class Fussy:
    def look(self, photo: bytes) -> int:
        if not photo:
            raise ValueError("no photo")
        return len(photo)

def fly(drone):
    fussy = drone.service(Fussy, unanswered=None)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    drone.autopilot.hover(20.0)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        drone.user.notify(fussy.look(b"1234"), at=waypoint)
    drone.end_flight()
    drone.autopilot.disarm()
"""


def test_a_server_that_refuses_what_a_part_made_answers_the_whole_and_the_part_is_given_up(
    tmp_path: Path,
) -> None:
    (tmp_path / "fussy.py").write_text(FUSSY)
    s1 = server("s1", 0.0, 0.0, range_m=500.0, bandwidth_bit_s=1e6, remote_call_s=3.0)
    fussy = {
        "name": "fussy",
        "program": f"{tmp_path}/fussy.py:Fussy",
        "request_bytes": 300_000,
        "before_sending": {"takes_s": 0.1, "request_bytes": 3_000, "loss": 0.01},
    }
    config = scenario(
        s1,
        service=[fussy],
        policy={"most_loss": 0.02},
        mission={"program": f"{tmp_path}/fussy.py:fly", "grid": {"columns": 5, "rows": 1, "spacing_m": 9.0}},
    )
    (run,) = simulate_fleet([config], computing=True)
    told = [event for event in written(run.events) if event["event"] in ("notified", "sent_whole")]
    assert [event["message"] for event in told if event["event"] == "notified"] == [4] * 5
    assert [event.get("given_up", False) for event in told if event["event"] == "sent_whole"] == [
        False,
        False,
        True,
    ]
