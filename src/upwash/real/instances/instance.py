"""PROGRAM: one service instance, in a process that a runtime started.

`python -m upwash.real.instances.instance CONTROL [OUTSIDE]` gets two file descriptors: the control socket, and a
socket for calls, which listens outside a sandbox or is an end of a pair. Without OUTSIDE the instance listens itself.
The process imports the service, and serves as many calls at a time as the service declares. The default is one:
services need not be safe for threads.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import socket
import ssl
import sys
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from queue import SimpleQueue
from typing import BinaryIO, NoReturn

from upwash.core.admission.instance_gate import InstanceGate
from upwash.core.admission.limits import Allowance
from upwash.core.admission.queue import CallQueue
from upwash.errors import NotBegun, Refused, UsageError
from upwash.real.instances import control
from upwash.real.instances.control_credentials import ControlCredentials
from upwash.real.instances.foreign import ForeignProgram
from upwash.real.instances.limits import apply_limits
from upwash.real.link.direct import DirectListener
from upwash.real.link.listener import HealthCheck, Listener
from upwash.real.link.proxy import GrpcSocket, open_proxy
from upwash.real.link.requests import Caller, Requests
from upwash.real.link.streams import listening_socket
from upwash.rpc.protocol import service_path
from upwash.rpc.service import Method, carries_fault, load_service, spec_of, with_queue
from upwash.rpc.settings import construct
from upwash.support.apart import dies_first
from upwash.support.background import thread
from upwash.support.heat import Heat
from upwash.support.loading import look_here

_CONCURRENT_CALLS = 256  # most of them arrive or queue, all from drones with a lease
_CALLS_PER_DRONE = 4  # one, and others that it has given up
_LONGEST_REASON = 10_000  # characters
_LAST_REPLY_S = 1.0  # to get on its way, when the last call has ended


_Performed = tuple[bytes, control.Answered]  # the reply to a call, and the report of the call to the program


class ServiceInstance:
    """Serves the calls of one service object."""

    def __init__(self, begin: control.Begin, line: socket.socket, outside: socket.socket | None) -> None:
        cls = load_service(begin.program)
        spec = spec_of(cls)
        self._compute: Callable[[Method, bytes], tuple[str, bytes]]
        if begin.command:
            self._compute = ForeignProgram(
                begin.command, begin.settings, max_message_bytes=begin.max_message_bytes
            ).perform
        else:
            target: object = construct(cls, spec.settings, begin.settings)
            self._compute = lambda method, request: method.perform(target, request)
        self._methods: dict[str, Method] = {
            service_path(begin.service, method.name): method for method in spec.methods.values()
        }
        self._pace_s = begin.pace_s
        self._heat = Heat(begin.heats) if begin.heats else None
        self._line = line
        self._reporting = threading.Lock()
        self._calls = ThreadPoolExecutor(spec.concurrency, "upwash-call")
        self._gate = InstanceGate()
        self._queue = CallQueue(spec.concurrency)
        self._sharing = threading.Lock()  # for the queue, the heat and the pace of reports
        self._reports = Allowance(control.MOST_REPORTS_PER_S, at_once=control.MOST_REPORTS_PER_S)
        self._is_announced = begin.is_announced
        requests = Requests(
            self._answer,
            max_message_bytes=begin.max_message_bytes,
            concurrent=_CONCURRENT_CALLS,
            per_drone=_CALLS_PER_DRONE,
            gate=self._admit,
        )
        self._listener: Listener | DirectListener
        self._inside: GrpcSocket | None = None
        if not begin.listen:
            assert outside is not None  # noqa: S101 - its program's other end
            self._listener = DirectListener(outside, requests)
            return
        self._inside = GrpcSocket(begin.listen.removeprefix("unix:"))
        who_is = self._inside.client if begin.is_announced else None
        self._listener = Listener(begin.listen, requests, who_is=who_is)
        self._listener.add(HealthCheck())

    def serve(self, outside: socket.socket | None, context: ssl.SSLContext | None) -> None:
        """Begin to answer calls, also from the socket `outside`, and report the address."""
        self._listener.start()
        if outside is not None and self._inside is not None:
            open_proxy(outside, self._inside, is_announced=self._is_announced, context=context)
        self._report(control.Ready(self._listener.address))

    def admit(self, drones: list[str], finishing: list[str]) -> None:
        """Answer these drones only; of finishing drones, the calls that have arrived."""
        self._gate.admit(drones, finishing)
        self._report(control.Admitted())

    def drain(self, why: str) -> None:
        """Refuse further calls for that reason, and report when the last call has ended."""
        self._gate.close(why)
        thread(self._drain, name="drain", failed=_end_all).start()

    def _drain(self) -> None:
        self._calls.shutdown(wait=True, cancel_futures=True)
        self._listener.stop(grace_s=_LAST_REPLY_S)
        self._report(control.Drained())

    def _report(self, message: control.FromInstance) -> None:
        with self._reporting:
            self._line.sendall(control.line(message))

    def _admit(self, path: str, caller: Caller) -> None:
        if path not in self._methods:
            raise Refused(f"no method {path} here")
        self._gate.require(caller.client)

    def _answer(self, path: str, body: bytes, caller: Caller) -> bytes:
        """Have the call computed in a thread of the service's; calls queue in the order of their last byte.

        Raises NotBegun if the call does not begin in the time that its caller allows.
        """
        whole_s = time.monotonic()
        with self._sharing:
            number = self._queue.arrive(caller.may_queue_s, now_s=whole_s)
        try:
            call = self._calls.submit(self._perform, self._methods[path], body, caller, whole_s, number)
            call.add_done_callback(self._report_answer)
        except RuntimeError:  # no calls are taken any more
            raise Refused(self._gate.closed) from None
        try:
            if not _is_over(call, caller.may_queue_s) and call.cancel():
                raise NotBegun(self._behind(number))
            reply, report = call.result()
        except CancelledError:  # while it waited for its turn
            raise Refused(self._gate.closed) from None
        finally:
            queue_s = self._behind(number)
        return with_queue(reply, queued_s=report.queued_s, queue_s=queue_s)

    def _behind(self, number: int) -> float:
        """Let the call leave the queue; return the seconds that a new call has before it."""
        with self._sharing:
            self._queue.leave(number)
            return self._queue.ahead_s(now_s=time.monotonic())

    def _perform(
        self, method: Method, body: bytes, caller: Caller, whole_s: float, number: int
    ) -> _Performed:
        self._gate.require_still(caller.client)  # now that the call has arrived and its turn has come
        if not caller.is_waiting():
            raise Refused("the caller has hung up")
        drone, began_s = caller.client.key, time.monotonic()
        with self._sharing:
            self._queue.begin(number, now_s=began_s)
        self._report(control.Called(drone))
        key, reply = self._compute(method, body)
        short_s = self._least_s(key, method.name, began_s) - (time.monotonic() - began_s)
        time.sleep(max(0.0, short_s))
        with self._sharing:
            self._queue.end(number, now_s=time.monotonic())
        return reply, control.Answered(
            drone=drone,
            method=method.name,
            queued_s=began_s - whole_s,
            took_s=time.monotonic() - began_s,
            outcome="raised" if carries_fault(reply) else "value",
        )

    def _report_answer(self, call: Future[_Performed]) -> None:
        """Report the call in the service's thread, which delays its next call but not this reply."""
        if call.cancelled() or call.exception() is not None:
            return
        # A call has two reports, and the program hangs up on an instance that sends too many.
        with self._sharing:
            pause_s = self._reports.take_anyway_s(2, now_s=time.monotonic())
        time.sleep(max(0.0, pause_s))
        self._report(call.result()[1])

    def _least_s(self, key: str, method: str, began_s: float) -> float:
        """The least time of an operation, configured for its key, its method or all operations."""
        pace_s = next((self._pace_s[name] for name in (key, method, "") if name in self._pace_s), 0.0)
        if self._heat is None:
            return pace_s
        with self._sharing:
            return self._heat.work(pace_s, now_s=began_s)


def _is_over(call: Future[_Performed], within_s: float | None) -> bool:
    """Whether the call ends in that time; `futures.wait` does not see the end of a call that is cancelled in line."""
    try:
        call.exception(within_s)
    except TimeoutError:
        return False
    return True


def main() -> NoReturn:
    """Serve until the control socket is closed at its other end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program that started this
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)  # what a service prints is in the log at once
    dies_first()
    line = socket.socket(fileno=int(sys.argv[1]))
    lines = line.makefile("rb")
    outside = socket.socket(fileno=int(sys.argv[2])) if len(sys.argv) > 2 else None
    begin = control.to_instance.decode(lines.readline())
    if not isinstance(begin, control.Begin):
        raise SystemExit("the first control message must say what to be")
    orders: SimpleQueue[bytes] = SimpleQueue()
    # A cold start may take long, and the program may die meanwhile.
    thread(lambda: _listen(lines, orders), name="control line", failed=_end_all).start()
    look_here()
    try:
        if begin.limits is not None:
            apply_limits(begin.limits)
        instance = ServiceInstance(begin, line, outside)
    except UsageError as error:
        if error.__cause__ is not None:
            traceback.print_exception(error.__cause__)  # for the log of who started this
        line.sendall(control.line(control.InstanceFailed(str(error)[:_LONGEST_REASON])))
        raise SystemExit(1) from error
    context = None
    if begin.outside:
        outside = listening_socket(begin.outside)
        context = ControlCredentials.from_text(begin.credentials).context(is_server=True)
    instance.serve(outside, context)
    while True:
        message = control.to_instance.decode(orders.get())
        match message:
            case control.AdmitDrones(drones, finishing):
                instance.admit(drones, finishing)
            case control.Drain(why):
                instance.drain(why)


def _listen(lines: BinaryIO, orders: SimpleQueue[bytes]) -> None:
    with contextlib.suppress(OSError):  # the line breaks if the other end leaves reports unread
        for text in lines:
            orders.put(text)
    _end_all()


def _end_all(_: Exception | None = None) -> None:
    """End this process and all that the service started, at once."""
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    main()
