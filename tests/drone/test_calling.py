"""What the core, the log and the server's session hear of a call, on virtual time."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from upwash import service
from upwash.core.geo import Position
from upwash.core.operation import Operation
from upwash.core.policies.policy import Inputs, Local, Remote
from upwash.core.selection import events
from upwash.core.selection.deadlines import Deadline, Deadlines
from upwash.core.selection.lanes import Lanes
from upwash.drone.calling import CallAnswer, Calling, Invocation
from upwash.errors import DeadlineExceeded, LinkError, NoLease, NotBegun, Refused, Unreachable
from upwash.eventlog import schema
from upwash.rpc.service import Method, spec_of, with_queue
from upwash.sim.loop import run_virtually


@service
class Gripper:
    def look(self, number: int) -> int:
        return number


LOOK = spec_of(Gripper).methods["look"]
OPERATION = Operation("gripper", "look")
CALL = Invocation(OPERATION, LOOK, LOOK.encode((7,), {})[1])
BEGAN_S = 100.0
HERE = Position(30.0, 40.0)
CHECK = 4
ALONE = Remote("s1", 2.0, "server ready")
RACED = Remote("s1", 2.0, "on trial", raced=True)
AT_HOME = Local("no server")
VALUE = msgspec.msgpack.encode({"value": 7})
FAULT = LOOK.fault_reply(LookupError("nothing"))
SAID = "builtins.LookupError: nothing"


@dataclass
class Field:
    """All that stands around calls; a reply that is an exception is raised."""

    server: bytes | BaseException = VALUE
    server_s: float = 0.5
    drone: bytes | BaseException = VALUE
    drone_s: float = 10.0
    is_there: bool = True  # a range of the server is not known
    expected_s: float | None = 10.0
    told: list[Any] = field(default_factory=list)  # to the core or the log
    known_s: list[float] = field(default_factory=list)  # delays of the server for later hedges
    denied: list[str] = field(default_factory=list)
    asked: list[Any] = field(default_factory=list)  # of the drone's own service
    cut: events.RemoteCallCut | None = None
    deadlines: Deadlines = field(default_factory=Deadlines)
    is_left: bool = False  # the server, while a part made the request smaller
    sent: list[bytes] = field(default_factory=list)  # to the server
    overtakes = False
    position = HERE

    def __post_init__(self) -> None:
        this: Any = self
        own: Any = SimpleNamespace(call=self._onboard)
        self.session = self.selection = self.estimates = this
        self.lanes = Lanes()
        self.servers = {"s1": SimpleNamespace(check=CHECK)}
        self.calling = Calling(this, this, own, this, this, deadlines=self.deadlines, before_sending=this)

    async def reduce(self, service: str, method: Method, request: bytes, *, deadline_s: float) -> bytes:
        await asyncio.sleep(0.25)
        return request[1:]

    def may_send(self, server: str, check: int) -> bool:
        return not self.is_left

    def second(self, operation: Operation, *, beside: str) -> None: ...

    def hold(self, computing: asyncio.Task[Any], place: str, takes_s: float | None) -> None:
        self.lanes.hold(computing, place, 0.0)
        computing.add_done_callback(self.lanes.release)

    def remote_s(self, server: str, operation: Operation) -> float | None:
        return None

    def may_queue_s(self, server: str, operation: Operation, deadline_s: float) -> float:
        return deadline_s

    def tell(self, event: object) -> None:
        self.told.append(event)

    def record(self, event: object) -> None:
        self.told.append(event)

    def fall_back(self, operation: Operation) -> None: ...
    def called(self, operation: Operation) -> None: ...
    def plan(self, *_: object, **__: object) -> None: ...

    def answered(self, server: str, operation: Operation, delay_s: float, *, less: bool) -> None:
        assert (server, operation) == ("s1", OPERATION)
        self.known_s.append(delay_s)

    def is_measured(self, server: str) -> bool:
        return self.is_there

    def local_s(self, operation: Operation) -> float | None:
        return self.expected_s

    def worker_at(self, server: str) -> Field:
        return self

    def deny(self, service: str) -> None:
        self.denied.append(service)

    async def call(self, service: str, method: str, request: bytes, **limits: float) -> bytes:
        self.sent.append(request)
        return await _given(self.server, self.server_s)

    async def _onboard(self, service: str, method: str, request: bytes, **how: Any) -> bytes:
        self.asked.append((service, method, request, how))
        return await _given(self.drone, self.drone_s)


async def _given(reply: bytes | BaseException, after_s: float) -> bytes:
    await asyncio.sleep(after_s)
    if isinstance(reply, BaseException):
        raise reply
    return reply


def answered(decision: Any, *more: Any, lasts_s: float = 0.0, **facts: Any) -> tuple[Field, CallAnswer]:
    """The field, some time after the last of the calls, and the answer of that call."""

    async def told() -> tuple[Field, CallAnswer]:
        await asyncio.sleep(BEGAN_S)
        field = Field(**facts)
        for each in (decision, *more):
            answer = await field.calling.answer(each, CALL)
        await asyncio.sleep(lasts_s)
        return field, answer

    return run_virtually(told())


def reached(reply: bytes | None) -> events.Reached:
    size_bytes = len(CALL.request) + (0 if reply is None else len(reply))
    return events.Reached("s1", HERE, reply is not None, OPERATION, 0.5, size_bytes)


COMPUTED = events.LocalCallEnded(OPERATION, 10.0)


def failed(why: str, *, late: bool = False) -> list[Any]:
    return [
        schema.RemoteFailed(server="s1", check=CHECK, why=why),
        events.RemoteCallFailed("s1", CHECK, why, late),
    ]


def test_a_value_in_time_is_told_to_the_core_with_its_delay_and_place() -> None:
    field, answer = answered(ALONE)
    assert (answer.reply.value, answer.server, field.asked) == (7, "s1", [])
    assert field.told == [events.RemoteCallEnded("s1", OPERATION, 0.5), reached(VALUE)]
    assert field.known_s == [0.5]


@pytest.mark.parametrize(
    ("error", "is_reached", "is_cut"),
    [
        (Unreachable("silent"), True, False),
        (DeadlineExceeded("late"), True, True),
        (Refused("no such method"), False, False),
    ],
)
def test_a_failure_is_told_with_what_it_shows_of_the_path_and_of_the_servers_speed(
    error: LinkError, is_reached: bool, is_cut: bool
) -> None:
    field, answer = answered(ALONE, server=error)
    assert (answer.reply.value, answer.server, answer.fell_back) == (7, None, True)
    assert field.told == [*failed(str(error)), *([reached(None)] if is_reached else []), COMPUTED]
    assert field.cut == (events.RemoteCallCut("s1", OPERATION, 0.5) if is_cut else None)
    assert field.known_s == []


def test_a_call_without_an_answer_counts_as_late_in_what_a_deadline_promises() -> None:
    known = Deadlines({OPERATION: Deadline(1.0, 0.9, 0.1)}, {("s1", OPERATION): [0.5] * 100})
    before = known.prospect(OPERATION, "s1", None)
    answered(ALONE, server=Unreachable("silent"), deadlines=known)
    after = known.prospect(OPERATION, "s1", None)
    assert before is not None and after is not None
    assert after.probability < before.probability


@pytest.mark.parametrize("is_left", [False, True])
def test_a_call_whose_server_was_left_while_its_request_was_made_smaller_is_not_sent(is_left: bool) -> None:
    less = replace(ALONE, inputs=Inputs(whole_s=1.0, less_s=0.8))
    field, answer = answered(less, is_left=is_left)
    assert field.sent == ([] if is_left else [CALL.request[1:]])
    assert answer.server == (None if is_left else "s1")
    assert answer.reply.value == 7


def test_a_slot_that_was_taken_in_a_call_is_no_failure_of_the_server() -> None:
    field, answer = answered(ALONE, server=NoLease("another drone has it"))
    assert (answer.reply.value, answer.fell_back) == (7, True)
    assert field.told == [events.SlotTaken(CHECK, "another drone has it", in_call=True), COMPUTED]


def test_a_call_that_the_server_did_not_begin_is_no_failure_and_the_drone_answers_it() -> None:
    field, answer = answered(ALONE, server=NotBegun(6.0, "s1"))
    assert (answer.reply.value, answer.server, answer.fell_back) == (7, None, True)
    why = "s1 has 6.0 s of calls in its queue"
    assert field.told == [
        schema.RemoteQueued(server="s1", check=CHECK, waited_s=0.5, queue_s=6.0, why=why),
        events.RemoteCallQueued("s1", why, 0.5, 6.0),
        COMPUTED,
    ]
    assert field.known_s == [] and field.cut is None


@pytest.mark.parametrize(("stated_s", "queued_s"), [(0.25, 0.25), (99.0, 0.5), (-1.0, 0.0), (math.nan, 0.0)])
def test_what_a_server_says_of_its_queue_is_told_to_the_core_within_bounds(
    stated_s: float, queued_s: float
) -> None:
    field, _ = answered(ALONE, server=with_queue(VALUE, queued_s=stated_s, queue_s=7e9))
    assert field.told[0] == events.RemoteCallEnded("s1", OPERATION, 0.5, queued_s=queued_s, queue_s=600.0)


@pytest.mark.parametrize("server", [VALUE, FAULT, Unreachable("silent")])
def test_of_a_server_with_a_range_no_place_is_told(server: bytes | BaseException) -> None:
    field, _ = answered(ALONE, server=server, is_there=False)
    assert not any(isinstance(event, events.Reached) for event in field.told)


@pytest.mark.parametrize("is_true", [True, False])
def test_an_exception_that_a_server_reports_is_tested_on_the_drone(is_true: bool) -> None:
    field, answer = answered(ALONE, server=FAULT, drone=FAULT if is_true else VALUE)
    assert answer.remote_fault == ("confirmed" if is_true else "denied")
    assert (field.known_s, field.denied) == (([0.5], []) if is_true else ([], ["gripper"]))
    why = f"it says that gripper.look raised {SAID}, which did not raise on the drone"
    assert field.told == [
        schema.RemoteRaised(server="s1", check=CHECK, operation="gripper.look", raised=SAID),
        events.RemoteCallRaised("s1", f"s1 says that gripper.look raised {SAID}"),
        reached(FAULT),
        *([] if is_true else [schema.RemoteFailed(server="s1", check=CHECK, why=f"s1: {why}")]),
        events.RemoteFaultTested("s1", CHECK, OPERATION, 0.5, why, is_true),
        COMPUTED,
    ]


def test_in_a_race_an_exception_of_the_server_waits_for_the_drones_own_answer() -> None:
    field, answer = answered(RACED, server=FAULT)
    assert (answer.reply.value, answer.remote_fault, answer.onboard_s) == (7, "denied", 10.0)
    assert [type(event) for event in field.told] == [
        schema.RemoteRaised,
        events.RemoteCallRaised,
        events.Reached,
        schema.RemoteFailed,
        events.RemoteFaultTested,
        events.LocalCallEnded,
    ]


@pytest.mark.parametrize(
    ("server", "told"),
    [
        (
            VALUE,
            [
                schema.Dropped(operation="gripper.look", place="s1"),
                events.RemoteCallEnded("s1", OPERATION, 30.0, late=True),
            ],
        ),
        (Unreachable("silent"), failed("silent", late=True)),
        (
            FAULT,
            [
                schema.RemoteRaised(server="s1", check=CHECK, operation="gripper.look", raised=SAID),
                schema.RemoteFailed(
                    server="s1",
                    check=CHECK,
                    why=f"s1: it says that gripper.look raised {SAID}, which did not raise on the drone",
                ),
                events.RemoteFaultTested(
                    "s1",
                    CHECK,
                    OPERATION,
                    30.0,
                    f"it says that gripper.look raised {SAID}, which did not raise on the drone",
                    confirmed=False,
                ),
            ],
        ),
    ],
)
def test_a_server_that_is_later_than_the_drone_is_told_to_be_late(
    server: bytes | BaseException, told: list[Any]
) -> None:
    field, answer = answered(RACED, server=server, server_s=30.0, is_there=False, lasts_s=30.0)
    assert (answer.server, answer.fell_back, answer.remote_fault) == (None, False, "")
    assert field.told == [COMPUTED, *told]


def test_a_server_is_not_late_where_the_drone_has_no_answer() -> None:
    field, answer = answered(RACED, server_s=30.0, drone=Unreachable("crashed"), is_there=False)
    assert (answer.server, answer.reply.value) == ("s1", 7)
    assert field.told[0] == events.RemoteCallEnded("s1", OPERATION, 30.0, late=False)


def test_a_defect_after_the_answer_is_raised_in_a_later_call_and_a_broken_connection_is_not() -> None:
    late = {"server_s": 15.0, "is_there": False}
    with pytest.raises(ZeroDivisionError):
        answered(RACED, AT_HOME, RACED, server=ZeroDivisionError("a defect"), **late)
    _, answer = answered(RACED, AT_HOME, RACED, server=asyncio.CancelledError(), **late)
    assert answer.reply.value == 7


@pytest.mark.parametrize(
    ("expected_s", "timeout_s"), [(None, 30.0), (2.0, 30.0), (3.0, 30.0), (3.1, 31.0), (10.0, 100.0)]
)
def test_the_drones_own_service_has_ten_times_what_it_is_expected_to_take(
    expected_s: float | None, timeout_s: float
) -> None:
    field, _ = answered(AT_HOME, expected_s=expected_s)
    assert field.asked == [("gripper", "look", CALL.request, {"timeout_s": timeout_s, "once": False})]
