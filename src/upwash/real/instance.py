"""One service instance: a process of its own that a runtime started.

`python -m upwash.real.instance CONTROL [OUTSIDE]`, two file descriptors: the control socket, and in a sandbox the
socket that listens outside. It imports the service, pays its cold start, and serves one call after the other, as
services need not be safe for threads.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import socket
import ssl
import sys
import threading
import time
from concurrent.futures import CancelledError, ThreadPoolExecutor
from queue import SimpleQueue
from typing import BinaryIO, NoReturn

from upwash.core.allowance import Allowance
from upwash.errors import Refused, UsageError
from upwash.protocol import service_path
from upwash.real.announced import Inside
from upwash.real.control import (
    MOST_REPORTS_PER_S,
    Admit,
    Admitted,
    Answered,
    Begin,
    Called,
    Drain,
    Drained,
    Failed,
    Ready,
    line,
    to_instance,
)
from upwash.real.doorway import Doorway
from upwash.real.leash import Leash
from upwash.real.listener import Caller, Health, Listener
from upwash.real.streams import listening_socket
from upwash.service import Method, load_service, spec_of
from upwash.settings import construct

_CONCURRENT_CALLS = (
    256  # one runs, the others arrive or queue until their deadlines: of drones with a lease alone
)
_CALLS_PER_DRONE = 4  # one, and others that it has given up
_LONGEST_REASON = 10_000  # characters
_REPORT_PERIOD_S = 1.0  # leases last far longer than this
_LAST_REPLY_S = 1.0  # to get on its way, when the last call has ended


class ServiceInstance:
    """Serves the calls of one service object."""

    def __init__(self, begin: Begin, control: socket.socket) -> None:
        cls = load_service(begin.program)
        spec = spec_of(cls)
        self._target: object = construct(cls, spec.settings, begin.settings)
        self._methods: dict[str, Method] = {
            service_path(begin.service, method.name): method for method in spec.methods.values()
        }
        self._pace_s = begin.pace_s
        self._control = control
        self._reporting = threading.Lock()
        self._calls = ThreadPoolExecutor(1, "upwash-call")  # a service need not be safe for threads
        self._closed = ""  # why no call is answered any more
        self._admitted: frozenset[str] = frozenset()
        self._reported_s: dict[str, float] = {}  # when each drone's calls were last reported
        self._reports = Allowance(MOST_REPORTS_PER_S, at_once=MOST_REPORTS_PER_S)
        self._is_announced = begin.is_announced
        self._inside = Inside(begin.listen.removeprefix("unix:"))
        self._listener = Listener(
            begin.listen,
            self._answer,
            max_message_bytes=begin.max_message_bytes,
            concurrent_requests=_CONCURRENT_CALLS,
            requests_per_drone=_CALLS_PER_DRONE,
            gate=self._admit,
            who_is=self._inside.visitor if begin.is_announced else None,
        )
        self._listener.add(Health())

    def serve(self, outside: socket.socket | None, context: ssl.SSLContext | None) -> None:
        """Begins to answer, also who connects to the socket from outside, and says so."""
        self._listener.start()
        if outside is not None:
            Doorway(outside, self._inside, is_announced=self._is_announced, context=context).open()
        self._report(Ready(self._listener.address))

    def admit(self, drones: list[str]) -> None:
        """From now on only these drones get an answer."""
        self._admitted = frozenset(drones)
        self._report(Admitted())

    def drain(self, why: str) -> None:
        """From now on nobody gets an answer, for that reason; says so when the last call has ended."""
        self._closed = why
        threading.Thread(target=self._drain, name="drain", daemon=True).start()

    def _drain(self) -> None:
        self._calls.shutdown(wait=True, cancel_futures=True)
        self._listener.stop(grace_s=_LAST_REPLY_S)
        self._report(Drained())

    def _report(self, message: Ready | Admitted | Drained | Called | Answered) -> None:
        with self._reporting:
            self._control.sendall(line(message))

    def _admit(self, path: str, caller: Caller) -> None:
        if path not in self._methods:
            raise Refused(f"no method {path} here")
        self._refuse_unwelcome(caller)

    def _answer(self, path: str, body: bytes, caller: Caller) -> bytes:
        """In the service's own thread, one call after the other, in the order in which they were whole."""
        try:
            call = self._calls.submit(self._perform, self._methods[path], body, caller)
        except RuntimeError:  # no calls are taken any more
            raise Refused(self._closed) from None
        try:
            return call.result()
        except CancelledError:  # while it waited for its turn
            raise Refused(self._closed) from None

    def _refuse_unwelcome(self, caller: Caller) -> None:
        if self._closed:
            raise Refused(self._closed)
        if caller.visitor.key not in self._admitted:
            raise Refused(f"drone {caller.visitor.name or '(unnamed)'} has no lease here")

    def _perform(self, method: Method, body: bytes, caller: Caller) -> bytes:
        self._refuse_unwelcome(
            caller
        )  # its lease may have ended while the call arrived and waited for its turn
        if not caller.is_waiting():
            raise Refused("nobody waits for this call any more")
        drone, began_s = caller.visitor.key, time.monotonic()
        if began_s - self._reported_s.get(drone, -math.inf) >= _REPORT_PERIOD_S:
            self._reported_s[drone] = began_s
            self._report(Called(drone))
        key, reply = method.perform(self._target, body)
        short_s = self._least_s(key, method.name) - (time.monotonic() - began_s)
        if short_s > 0:
            time.sleep(short_s)
        ended_s = time.monotonic()
        time.sleep(self._reports.take_anyway_s(1, now_s=ended_s))  # or its program would hang up
        self._report(Answered(method.name, ended_s - began_s))
        return reply

    def _least_s(self, key: str, method: str) -> float:
        """The least time of an operation; a configuration may tell operations apart by key, by method or not."""
        return next((self._pace_s[name] for name in (key, method, "") if name in self._pace_s), 0.0)


def main() -> NoReturn:
    """Serves until the control socket says that whoever started this is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program that started this
    control = socket.socket(fileno=int(sys.argv[1]))
    lines = control.makefile("rb")
    outside = socket.socket(fileno=int(sys.argv[2])) if len(sys.argv) > 2 else None
    begin = to_instance.decode(lines.readline())
    if not isinstance(begin, Begin):
        raise SystemExit("the first control message must say what to be")
    orders: SimpleQueue[bytes] = SimpleQueue()
    # From now on, as a cold start may take long and its program may die meanwhile.
    threading.Thread(target=_listen, args=(lines, orders), name="leash", daemon=True).start()
    try:
        if begin.limits is not None:
            begin.limits.apply()
        instance = ServiceInstance(begin, control)
    except UsageError as error:
        control.sendall(line(Failed(str(error)[:_LONGEST_REASON])))
        raise SystemExit(1) from error
    context = None
    if begin.outside:
        outside = listening_socket(begin.outside)
        context = Leash.from_text(begin.leash).context(is_server=True)
    instance.serve(outside, context)
    while True:
        message = to_instance.decode(orders.get())
        match message:
            case Admit(drones):
                instance.admit(drones)
            case Drain(why):
                instance.drain(why)


def _listen(lines: BinaryIO, orders: SimpleQueue[bytes]) -> None:
    with contextlib.suppress(OSError):  # the line breaks where the other end leaves reports unread
        for text in lines:
            orders.put(text)
    # The whole group, as the service may have started processes too; at once, as nobody is left to wait.
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    main()
