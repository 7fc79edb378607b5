"""What a server says was raised is doubted: the drone's own service is asked before the mission hears of it."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import msgspec
import pytest
from tests.events import written

from upwash.config.drone_file import drone_config
from upwash.core.call import steps
from upwash.core.call.calls import Calls
from upwash.core.selection.events import LocalCallEnded, RemoteCallEnded
from upwash.core.selection.selection import Selection
from upwash.drone.offloading import Offloading
from upwash.drone.server_session import ServerSession
from upwash.eventlog.narration import Narrator
from upwash.eventlog.reasons import explained_calls
from upwash.lab.run import Run, simulate_fleet

PROGRAM = """
from upwash import Drone, once, service

released = []

@service
class Gripper:
    def look(self, number: int) -> int:
        if number % 2:
            raise LookupError("nothing to see in", number)
        return number

    @once
    def release(self, number: int) -> int:
        released.append(number)
        return len(released)

def _survey(drone: Drone, at_waypoint) -> None:
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        drone.user.notify(at_waypoint(waypoint.index), at=waypoint)
    drone.end_flight()

def looking(drone: Drone) -> None:
    gripper = drone.service(Gripper)
    def look(number):
        try:
            return gripper.look(number)
        except LookupError as error:
            return repr(error)
    _survey(drone, look)

def releasing(drone: Drone) -> None:
    gripper = drone.service(Gripper)
    _survey(drone, lambda number: [gripper.look(2 * number), gripper.release(number)])
"""
HEARD = [0, "LookupError('nothing to see in', 1)", 2, "LookupError('nothing to see in', 3)", 4]
LOCAL_S, REMOTE_S = 10.0, 0.5


def fly(tmp_path: Path, mission: str, **policy: Any) -> Run:
    """Past one server that is always in range, and claims to be as fast at what must run once."""
    file = tmp_path / "gripping.py"
    file.write_text(PROGRAM)
    document = {
        "mission": {
            "program": f"{file}:{mission}",
            "waypoints_m": [[20.0 * number, 0.0] for number in range(5)],
        },
        "policy": {"blacklist_s": 1.0, **policy},
        "service": [{"name": "gripper", "program": f"{file}:Gripper", "local_call_s": {"": LOCAL_S}}],
        "server": [
            {
                "name": "s1",
                "east_m": 0.0,
                "north_m": 0.0,
                "range_m": 1000.0,
                "remote_call_s": {"gripper": {"": REMOTE_S}},
            }
        ],
    }
    (run,) = simulate_fleet([drone_config(document, tmp_path / "scenario.toml")], computing=True)
    assert run.failure == ""
    return run


def events(run: Run, name: str) -> list[dict[str, Any]]:
    return [event for event in written(run.events) if event["event"] == name]


def heard(run: Run) -> list[Any]:
    return [event["message"] for event in events(run, "notified")]


@contextlib.contextmanager
def lying(named: str = "builtins:LookupError") -> Iterator[None]:
    """Every call to a server comes back with that exception."""
    call = ServerSession.call

    async def lie(self: ServerSession, service: str, method: str, request: bytes, **limits: Any) -> bytes:
        await call(self, service, method, request, **limits)
        return msgspec.msgpack.encode({"fault": {"type": named, "message": "a lie", "args": ["a lie"]}})

    with patch.object(ServerSession, "call", lie):
        yield


@pytest.mark.parametrize("hedge", [None, {"after": "p50", "budget": 0.5}])
def test_the_mission_hears_the_same_wherever_calls_run(tmp_path: Path, hedge: dict[str, Any] | None) -> None:
    hedging = {} if hedge is None else {"hedge": hedge}
    assert heard(fly(tmp_path, "looking", **hedging)) == HEARD
    with lying():
        assert heard(fly(tmp_path, "looking", **hedging)) == HEARD
    assert heard(fly(tmp_path, "looking", name="local-only")) == HEARD


def test_an_exception_that_the_drone_confirms_leaves_the_server_in_use(tmp_path: Path) -> None:
    run = fly(tmp_path, "looking")
    calls = events(run, "call")
    assert [call["place"] for call in calls] == ["s1", "local", "s1", "local", "s1"]
    raised = calls[1::2]
    for call in raised:
        assert (call["remote_fault"], call["fell_back"]) == ("confirmed", True)
        assert call["delay_s"] == pytest.approx(REMOTE_S + LOCAL_S)
        assert call["onboard_s"] == pytest.approx(LOCAL_S)
    assert len(events(run, "remote_raised")) == len(raised)
    assert events(run, "remote_failed") == []
    assert events(run, "call_failed_in_range") == []


def test_a_server_whose_exception_the_drone_does_not_confirm_is_blacklisted(tmp_path: Path) -> None:
    with lying():
        run = fly(tmp_path, "looking", blacklist_s=1000.0)
    denied = [call for call in events(run, "call") if call.get("remote_fault") == "denied"]
    (failed,) = events(run, "call_failed_in_range")
    assert (failed["server"], failed["after"]) == ("s1", "BLACKLISTED")
    assert "says that gripper.look raised builtins.LookupError: a lie" in failed["why"]
    assert "did not raise on the drone" in failed["why"]
    assert len(denied) == len(events(run, "remote_failed")) == 1
    assert [call["place"] for call in events(run, "call")] == ["local"] * 5


def test_the_log_says_why_a_call_was_made_again_on_the_drone(tmp_path: Path) -> None:
    with lying():
        run = fly(tmp_path, "looking", blacklist_s=1000.0)
    sentences = [call.reasons[0] for call in explained_calls(run.events)]
    cause = "s1 said that it raised builtins.LookupError: a lie, which the drone did not raise"
    assert any(sentence.endswith(f" because {cause}.") for sentence in sentences)
    said = [Narrator().tell(event) for event in run.events if event.kind == "remote_raised"]
    assert [each.text for each in said if each] == [
        "s1 says that gripper.look raised builtins.LookupError: a lie; making the call on the drone"
    ]


def test_what_runs_once_runs_on_the_drone_and_once(tmp_path: Path) -> None:
    run = fly(tmp_path, "releasing", name="opportunistic")
    releases = [call for call in events(run, "call") if call["operation"] == "gripper.release"]
    assert [message[1] for message in heard(run)] == [1, 2, 3, 4, 5]
    assert {call["place"] for call in releases} == {"local"}
    assert {call["decision"] for call in releases} == {"it runs once, and on the drone"}
    assert {call["waited_s"] for call in releases} == {0.0}
    assert "s1" in [call["place"] for call in events(run, "call")]


@pytest.mark.parametrize("failing", ["during the first release", "before it"])
def test_a_defect_of_offloading_has_nothing_run_a_second_time(tmp_path: Path, failing: str) -> None:
    handle, begun = Calls.handle, itertools.count()

    def fails(self: Calls, event: Any, **when: Any) -> Any:
        steps_ = handle(self, event, **when)
        is_begun = any(isinstance(each, steps.Compute) and each.computing.call.asked.once for each in steps_)
        if is_begun and next(begun) == 0:
            loop = asyncio.get_running_loop()
            loop.call_later(LOCAL_S / 2, self.__dict__.__setitem__, "_broken", True)
        if "_broken" in self.__dict__ or (failing == "before it" and is_begun):
            raise KeyError("a defect")
        return steps_

    with patch.object(Calls, "handle", fails):
        run = fly(tmp_path, "releasing", name="opportunistic")
    assert len(events(run, "offloading_failed")) == 1
    assert [message[1] for message in heard(run)] == [1, 2, 3, 4, 5]
    releases = [call for call in events(run, "call") if call["operation"] == "gripper.release"]
    assert len(releases) == 5 and {call["onboard_s"] for call in releases} == {LOCAL_S}


def test_a_defect_in_a_call_on_the_drone_has_that_call_answered_all_the_same(tmp_path: Path) -> None:
    reply, count = Offloading._onboard_reply, itertools.count()

    async def fails(self: Offloading, *call: Any) -> Any:
        found = await reply(self, *call)
        if next(count) == 0:
            raise ZeroDivisionError("a defect")
        return found

    with patch.object(Offloading, "_onboard_reply", fails):
        run = fly(tmp_path, "looking", name="local-only")
    assert heard(run) == HEARD
    assert len(events(run, "offloading_failed")) == 1


def test_what_runs_once_waits_for_a_service_that_is_busy_with_a_dropped_call(tmp_path: Path) -> None:
    with patch.object(ServerSession, "call", _slow(ServerSession.call)):
        run = fly(tmp_path, "releasing", hedge={"after": "p50", "budget": 0.9})
    queued = [call for call in events(run, "call") if call.get("queued_s")]
    assert [call["operation"] for call in queued][:1] == ["gripper.release"]
    assert [message[1] for message in heard(run)] == [1, 2, 3, 4, 5]
    for call in queued:
        assert call["onboard_s"] == pytest.approx(LOCAL_S)


def test_a_defect_in_deciding_has_nothing_run_again_that_runs_once(tmp_path: Path) -> None:
    handle = Selection.handle

    def defective(self: Selection, event: object, **where: Any) -> Any:
        if isinstance(event, RemoteCallEnded | LocalCallEnded):
            raise RuntimeError("planted")  # noqa: TRY004 - a defect of any kind
        return handle(self, event, **where)  # type: ignore[arg-type]

    with patch.object(Selection, "handle", defective):
        run = fly(tmp_path, "releasing")
    assert events(run, "offloading_failed")
    assert [message[1] for message in heard(run)] == [1, 2, 3, 4, 5]


def _slow(call: Any) -> Any:
    async def slow(self: ServerSession, service: str, method: str, request: bytes, **limits: Any) -> bytes:
        reply: bytes = await call(self, service, method, request, **limits)
        await asyncio.sleep(1.5)
        return reply

    return slow
