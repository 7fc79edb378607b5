"""Calls that a mission starts and does not wait for, on virtual time."""

from __future__ import annotations

import asyncio
import gc
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from tests.drone.test_resume import fly, scenario

from upwash import Drone, Position
from upwash.drone.answered_photos import AnsweredPhotos
from upwash.drone.calls import MissionCalls
from upwash.drone.mission import MissionThread
from upwash.drone.pending import why_failed
from upwash.errors import InstanceError, MissionFailed, UsageError
from upwash.eventlog import schema
from upwash.rpc.service import make_stub
from upwash.services import Detector
from upwash.sim.journal import MemoryJournal
from upwash.sim.loop import run_virtually

# A call on the drone takes 10 s, a leg of 20 m 9 s, a photo 1 s.
Program = Callable[[Drone, Detector], None]


def flown(program: Program, **mission: Any) -> list[Any]:
    """The events of a flight whose mission does that in the air."""
    part = fly(scenario(**mission), mission=in_the_air(program))
    assert part.error is None, part.error
    return part.events


def in_the_air(program: Program) -> Callable[[Drone], None]:
    def mission(drone: Drone) -> None:
        drone.autopilot.arm()
        drone.autopilot.takeoff(drone.altitude_m)
        program(drone, drone.service(Detector))
        drone.end_flight()
        drone.autopilot.disarm()

    return mission


def of(events: list[Any], kind: type[schema.Event]) -> list[Any]:
    return [event for event in events if isinstance(event, kind)]


def test_the_mission_flies_on_while_the_call_runs() -> None:
    done: list[bool] = []

    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        pending = drone.start(detector.process_photo, b"photo", mode="heavy")
        done.append(pending.done())
        drone.autopilot.goto(drone.plan[1])
        done.append(pending.done())
        assert pending.result() == pending.result() == []
        done.append(pending.done())

    events = flown(program)
    assert done == [False, False, True]
    (call,), (taken,) = of(events, schema.Call), of(events, schema.AnswerTaken)
    assert (call.delay_s, taken.waited_s) == (10.0, pytest.approx(1.0)), "9 s of it were flown"
    assert (taken.waypoint, taken.demanded) == (0, False)


def test_a_second_call_is_refused_until_the_first_is_over_or_dropped() -> None:
    def program(drone: Drone, detector: Detector) -> None:
        pending = drone.start(detector.process_photo, b"photo", mode="heavy")
        with pytest.raises(UsageError, match="another call is pending"):
            detector.process_photo(b"photo", mode="light")
        with pytest.raises(UsageError, match=r"result\(\).*cancel\(\)"):
            drone.start(detector.process_photo, b"photo", mode="light")
        pending.result()
        detector.process_photo(b"photo", mode="light")

    assert len(of(flown(program), schema.Call)) == 2


def test_a_dropped_call_computes_on_and_the_next_waits_for_its_end() -> None:
    def program(drone: Drone, detector: Detector) -> None:
        drone.start(detector.process_photo, b"photo", mode="heavy").cancel()
        detector.process_photo(b"photo", mode="light")

    events = flown(program)
    first, second = of(events, schema.Call)
    assert second.t - first.t == second.delay_s == pytest.approx(3.0), "and it is not slowed down by it"
    assert [started.waypoint for started in of(events, schema.CallStarted)] == [None]


def test_what_is_no_method_of_a_service_cannot_be_started() -> None:
    def program(drone: Drone, _: Detector) -> None:
        with pytest.raises(UsageError, match=r"print is no method of a service"):
            drone.start(print, "photo")

    flown(program)


def test_another_thread_than_the_missions_is_refused_at_once() -> None:
    refused: list[BaseException] = []

    def elsewhere(verb: Callable[[], object]) -> None:
        def run() -> None:
            try:
                verb()
            except UsageError as error:
                refused.append(error)

        thread = threading.Thread(target=run)
        thread.start()
        thread.join()

    def program(drone: Drone, detector: Detector) -> None:
        pending = drone.start(detector.process_photo, b"photo", mode="heavy")
        elsewhere(lambda: detector.process_photo(b"photo", mode="heavy"))
        elsewhere(lambda: drone.autopilot.goto(drone.plan[1]))
        elsewhere(pending.result)
        elsewhere(drone.camera.take_photo)
        elsewhere(pending.done)  # which is allowed
        pending.result()

    flown(program)
    assert len(refused) == 4
    assert all("drone.start" in str(error) for error in refused)


def test_a_mission_that_forgets_its_call_ends_all_the_same() -> None:
    def program(drone: Drone, detector: Detector) -> None:
        drone.start(detector.process_photo, b"photo", mode="heavy")

    def at_last(drone: Drone) -> None:
        in_the_air(lambda *_: None)(drone)
        program(drone, drone.service(Detector))

    assert of(flown(program), schema.MissionCompleted)
    events = fly(scenario(), mission=at_last).events
    assert of(events, schema.MissionCompleted)
    assert not of(events, schema.Call) and not of(events, schema.LocalFailed), "the call is broken off"


def test_what_the_mission_raises_ends_the_flight_and_the_call() -> None:
    def program(drone: Drone, detector: Detector) -> None:
        drone.start(detector.process_photo, b"photo", mode="heavy")
        drone.autopilot.goto(drone.plan[1])
        raise KeyError("lost")

    part = fly(scenario(), mission=in_the_air(program))
    assert isinstance(part.error, MissionFailed)
    assert part.position is not None and part.position.altitude_m == 0.0


@pytest.mark.parametrize("demanding", [True, False])
def test_it_turns_back_by_itself_where_the_mission_says_so(demanding: bool) -> None:
    seen: list[Any] = []

    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        pending = drone.start(detector.process_photo, b"photo", mode="light")
        seen.append(drone.autopilot.goto(drone.plan[1], unless=pending.demands(lambda _: demanding)))
        seen.append(drone.autopilot.position.east_m)

    flown(program)
    arrived, east_m = seen
    assert arrived is not demanding
    assert east_m == pytest.approx(9.0 if demanding else 20.0), "3 s at 1 m/s², and as far to brake"


def test_a_question_that_fails_stops_the_drone_and_is_raised() -> None:
    seen: list[float] = []

    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(drone.plan[0])
        pending = drone.start(detector.process_photo, b"photo", mode="light")
        with pytest.raises(ZeroDivisionError):
            drone.autopilot.goto(drone.plan[1], unless=pending.demands(lambda _: 1 / 0))
        seen.append(drone.autopilot.position.east_m)
        drone.autopilot.hover(5.0)
        seen.append(drone.autopilot.position.east_m)

    flown(program)
    assert seen == [pytest.approx(9.0)] * 2


def test_so_near_its_target_that_braking_would_lead_beyond_it_arrives() -> None:
    seen: list[Any] = []

    def program(drone: Drone, detector: Detector) -> None:
        drone.autopilot.goto(Position(0.0, 0.0, 20.0))
        pending = drone.start(detector.process_photo, b"photo", mode="light")
        near = Position(3.0, 0.0, 20.0)
        seen.append(drone.autopilot.goto(near, unless=pending.demands(lambda _: True)))
        seen.append(drone.autopilot.position.east_m)

    flown(program)
    assert seen[1] == pytest.approx(3.0)


def test_the_mission_stands_still_for_a_call_as_long_as_ever() -> None:
    def waits(drone: Drone, detector: Detector) -> None:
        detector.process_photo(b"photo", mode="heavy")

    def starts(drone: Drone, detector: Detector) -> None:
        drone.start(detector.process_photo, b"photo", mode="heavy").result()

    one, other = (of(flown(each), schema.MissionCompleted)[0].t for each in (waits, starts))
    assert one == other


@pytest.mark.parametrize(
    ("error", "failure"),
    [(ValueError("no such model"), "no such model"), (ValueError(), "ValueError"), (None, "")],
)
def test_a_call_that_failed_says_why(error: Exception | None, failure: str) -> None:
    async def compute() -> bytes:
        if error is not None:
            raise error
        return b""

    async def wait() -> str:
        call = asyncio.create_task(compute())
        await asyncio.wait([call])
        return why_failed(call)

    assert run_virtually(wait()) == failure


def test_calls_that_fail_and_are_never_asked_for_are_no_complaint_of_asyncio(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def fail(*_: object, **__: object) -> None:
        raise InstanceError("it has crashed")

    async def run() -> None:
        thread, journal = MissionThread(), MemoryJournal()
        journal.begin()
        offloading: Any = SimpleNamespace(invoke=fail, several=False)
        calls = MissionCalls(thread, offloading, journal, waypoint=lambda: None, photos=AnsweredPhotos())
        detector = make_stub(Detector, lambda *_: None)

        def program() -> None:
            for _ in range(2):
                pending = calls.start(detector.process_photo, b"photo", mode="light")
                while not pending.done():
                    thread.call(asyncio.sleep(0))

        await thread.run(program)

    asyncio.run(run())
    gc.collect()
    assert not caplog.records
