"""The delays that the drone expects: a moving mean for each operation and place (thesis section 3.3).

Symbols of Table 3.1: `Call` is `local_s`, `Call_s` is `remote_s`, `Check_s` and `CheckR_s` are `check_s`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from types import MappingProxyType

from msgspec import Struct

from upwash.core.geo import Position
from upwash.core.knowledge.coverage import Coverage
from upwash.core.knowledge.sending import BothWays, Less
from upwash.core.operation import Operation

WINDOW_LENGTH = 3
_WINDOWS_KEPT = 256  # that have seen nothing yet: servers are often believed to be equal


@dataclass(frozen=True)
class Window:
    """The last three observations; it starts filled with the offline estimate."""

    values: tuple[float, ...]

    @classmethod
    @lru_cache(_WINDOWS_KEPT, typed=True)
    def filled(cls, estimate_s: float) -> Window:
        """A window filled with the offline estimate."""
        return cls((estimate_s,) * WINDOW_LENGTH)

    def observe(self, delay_s: float) -> Window:
        """The window with `delay_s` in place of the oldest observation."""
        return Window((*self.values[1:], delay_s))

    @cached_property
    def mean_s(self) -> float:
        """The estimate: the mean of the three delays, in seconds."""
        first = self.values[0]
        if all(value == first for value in self.values):
            return first  # so that an offline estimate is met to the last bit
        return sum(self.values) / len(self.values)


_ALONE_FACTOR = 4.0  # times the slowest call at a server: a call that no server is there for
_MOST_FAILURES = 3  # of a part before sending, in a row
_CALLS_BEFORE_WEIGHING = 3  # until then every operation counts the same


class Beliefs(Struct, frozen=True):
    """The delays expected of one server before the first contact, from tests on the ground.

    `remote_s` has an entry for every operation that the server hosts. `transfer_s` has the part of it that sends the
    request, as far as that is known. A check takes from selection to READY: `check_s` if services must be started,
    `check_running_s` if they run.
    """

    check_s: float
    check_running_s: float
    remote_s: Mapping[Operation, float]
    transfer_s: Mapping[Operation, float] = {}


def offline_remote_s(*, processing_s: float, data_bytes: int, bandwidth_bit_s: float) -> float:
    """The first estimate (s) of a remote call: processing, and transfer at the nominal bandwidth (eq. 3.1)."""
    return processing_s + 8 * data_bytes / bandwidth_bit_s


@dataclass(slots=True)
class _Calls:
    """The calls of an operation at a server; all that is learnt counts as of calls sent whole."""

    offline_s: float
    way: BothWays | None  # how less is sent; None if all is sent whole
    window: Window
    slow_s: float | None = None  # of the last call, where the call was slow and stays out of the mean
    last_s: float = math.inf  # when the last one ended


@dataclass(slots=True)
class _AtServer:
    check: Window
    check_running: Window
    calls: Mapping[Operation, _Calls]
    warm: set[str] = field(default_factory=set)  # services called since their start


class Estimates:
    """Every estimate of one drone, learnt from its calls and checks.

    The operations are the keys of `local_s`, and those of the services `on_servers`, which no drone can run. A server
    hosts those that its beliefs name. With `slow_apart` a call
    slower than on the drone stays out of the mean: it is the lower bound of the next call, until a faster call or
    `forget_slow_calls`; a call that was cut short teaches nothing.

    For servers without a range, measurements of `coverage` near a place replace the mean. `at` is a place; None is
    where the drone is.

    Where sending `less` loses no more than `most_loss`, and that is above 0, a remote call takes the shorter of both
    ways.
    """

    def __init__(
        self,
        *,
        local_s: Mapping[Operation, float],
        servers: Mapping[str, Beliefs],
        slow_apart: bool = False,
        coverage: Coverage | None = None,
        on_servers: Collection[str] = (),
        less: Mapping[Operation, Less] = MappingProxyType({}),
        most_loss: float = 0.0,
    ) -> None:
        self.coverage = coverage
        self._on_servers = frozenset(on_servers)
        self._slow_apart = slow_apart
        self._local = {operation: Window.filled(delay_s) for operation, delay_s in local_s.items()}
        hosted = [operation for beliefs in servers.values() for operation in beliefs.remote_s]
        self._counts = dict.fromkeys([*local_s, *filter(self.needs_server, hosted)], 0)  # of calls
        sent_less = {each: part for each, part in less.items() if part.loss <= most_loss and most_loss > 0}
        self._servers = {name: self._believed(beliefs, sent_less) for name, beliefs in servers.items()}
        self._parts_failed = Counter[str]()  # in a row, by service
        self._here: Position | None = None
        # What the coverage says of the servers, where the drone is.
        self._seen: Sequence[object] = [None for _ in coverage.servers] if coverage else ()
        self._weights = dict.fromkeys(self._counts, 1 / max(1, len(self._counts)))
        self._mean_call_s: dict[str | None, float] = {}  # asked for since a window or a weight last changed

    def _believed(self, beliefs: Beliefs, less: Mapping[Operation, Less]) -> _AtServer:
        calls = {}
        for operation, whole_s in beliefs.remote_s.items():
            if operation in self._counts:
                part, transfer_s = less.get(operation), beliefs.transfer_s.get(operation)
                way = None
                if part is not None and transfer_s is not None:
                    way = BothWays(part, max(0.0, whole_s - transfer_s))
                calls[operation] = _Calls(whole_s, way, Window.filled(whole_s))
        return _AtServer(Window.filled(beliefs.check_s), Window.filled(beliefs.check_running_s), calls)

    @property
    def operations(self) -> Iterable[Operation]:
        """The operations with an offline estimate; no other may be offloaded."""
        return self._counts.keys()

    def needs_server(self, operation: Operation) -> bool:
        """Whether no drone can run the operation."""
        return operation.service in self._on_servers

    def locate(self, position: Position) -> bool:
        """Set where the drone is; return whether that changes the estimate of a server without a range."""
        if self.coverage is None:
            return False
        self._here = position
        before, coverage = self._seen, self.coverage
        self._seen = [coverage.at(server, position) for server in coverage.servers]
        return any(one is not other for one, other in zip(before, self._seen, strict=True))

    def local_s(self, operation: Operation) -> float | None:
        """Expected delay (s) of a local call (`Call`); None for an operation without an offline estimate."""
        window = self._local.get(operation)
        return window.mean_s if window else None

    def alone_s(self, operation: Operation) -> float | None:
        """What a call counts (s) that no server takes: `local_s`, or four times the slowest server's delay.

        The second is for operations that no drone can run, so that every server of theirs is worth its use.
        """
        if not self.needs_server(operation):
            return self.local_s(operation)
        hosting = [calls for its in self._servers.values() if (calls := its.calls.get(operation))]
        return _ALONE_FACTOR * max(calls.window.mean_s for calls in hosting) if hosting else None

    def remote_s(
        self, server: str, operation: Operation, at: Position | None = None, *, slow: bool = True
    ) -> float | None:
        """Expected delay (s) of a remote call, transfer included (`Call_s`); None if the server does not host it.

        Unless `slow`, the last slow call of `slow_apart` does not count.
        """
        calls = self._servers[server].calls.get(operation)
        if calls is None:
            return None
        whole_s = self._whole_s(server, operation, at, slow=slow)
        return self.alone_s(operation) if whole_s is None else self._sooner_s(operation, calls, whole_s)

    def offline_s(self, server: str, operation: Operation) -> float | None:
        """The delay (s) of a remote call sent whole, as believed before any call; None if not hosted there."""
        calls = self._servers[server].calls.get(operation)
        return None if calls is None else calls.offline_s

    def may_send_less(self, server: str, operation: Operation) -> bool:
        """Whether a part may make requests to the server smaller."""
        return self._way(server, operation) is not None

    def both_ways_s(self, server: str, operation: Operation) -> tuple[float, float] | None:
        """Expected delays (s) of a remote call sent whole, and with less to send; None if all is sent whole."""
        way = self._way(server, operation)
        if way is None or not self.tries_part(operation.service):
            return None
        whole_s = self._whole_s(server, operation, None, slow=True)
        return None if whole_s is None else (whole_s, way.less_s(whole_s))

    def as_whole_s(self, server: str, operation: Operation, less_s: float) -> float:
        """The delay (s) that a call would have had if it had been sent whole, for one with less to send."""
        way = self._way(server, operation)
        return less_s if way is None else way.whole_s(less_s)

    def as_less_s(self, server: str, operation: Operation, whole_s: float) -> float:
        """The reverse of `as_whole_s`."""
        way = self._way(server, operation)
        return whole_s if way is None else way.less_s(whole_s)

    def part_failed(self, service: str) -> None:
        """Note that the part of that service before sending failed."""
        self._parts_failed[service] += 1
        self._mean_call_s.clear()

    def tries_part(self, service: str) -> bool:
        """Whether the part of that service may be tried: it has not failed three times in a row."""
        return self._parts_failed[service] < _MOST_FAILURES

    def is_hosted(self, server: str, operation: Operation) -> bool:
        """Whether the server's beliefs name the operation."""
        return operation in self._servers[server].calls

    def is_first_call(self, server: str, operation: Operation) -> bool:
        """Whether the server is not known to have computed a call of the service since the service's start."""
        return operation.service not in self._servers[server].warm

    def check_s(self, server: str, *, running: bool) -> float:
        """Expected delay (s) from selection to READY: `CheckR_s` if the services run already, else `Check_s`."""
        its = self._servers[server]
        return (its.check_running if running else its.check).mean_s

    def start_s(self, server: str) -> float:
        """The seconds that starting the services adds to a check."""
        return max(0.0, self.check_s(server, running=False) - self.check_s(server, running=True))

    def mean_call_s(self, server: str | None = None, at: Position | None = None) -> float:
        """Mean delay (s) of this drone's calls with the server ready, or on the drone if `server` is None.

        Each call counts with the faster of both places; operations are weighted by their calls so far. With a single
        operation this is the thesis's min(Call, Call_s).
        """
        is_alike = not self.is_measured(server)  # at all places
        if is_alike and (known_s := self._mean_call_s.get(server)) is not None:
            return known_s
        mean_s = 0.0
        for operation, weight in self._weights.items():
            call_s = self.alone_s(operation) or 0.0
            remote_s = self.remote_s(server, operation, at) if server else None
            mean_s += weight * (call_s if remote_s is None else min(call_s, remote_s))
        if is_alike:
            self._mean_call_s[server] = mean_s
        return mean_s

    def is_measured(self, server: str | None) -> bool:
        """Whether the server has no configured range, so that its delays are measured for each place."""
        return self.coverage is not None and server in self.coverage.servers

    def observe_local(self, operation: Operation, delay_s: float, *, asked: Operation | None = None) -> None:
        """Add the delay of a local call, or of the first answer to a call as it was `asked` for, which counts."""
        if operation in self._local:
            self._local[operation] = self._local[operation].observe(delay_s)
            self._count(asked or operation)

    def observe_remote(
        self,
        server: str,
        operation: Operation,
        delay_s: float,
        *,
        now_s: float,
        late: bool = False,
        less: bool = False,
    ) -> None:
        """Add the delay of a remote call that succeeded; with `less` its request was made smaller before.

        A `late` call was counted as a local call already.
        """
        self._learn_remote(server, operation, delay_s, now_s=now_s, less=less)
        if less:
            self._parts_failed.pop(operation.service, None)
        if not late and not self.needs_server(operation):
            self._count(operation)

    def call_waits(self, operation: Operation) -> None:
        """Count a call that only servers compute: it matters from the moment that it is made."""
        if operation in self._counts:
            self._count(operation)

    def observe_remote_cut(
        self, server: str, operation: Operation, waited_s: float, *, now_s: float, less: bool = False
    ) -> None:
        """Add a remote call given up after `waited_s`, which is the least that it would have taken.

        Otherwise a server slower than its deadline would never look slow, as its calls never end
        (docs/decisions/calls-cut-short.md). A wait no longer than the estimate says nothing.
        """
        self._servers[server].warm.add(operation.service)
        estimate_s = self.remote_s(server, operation)
        if not self._slow_apart and estimate_s is not None and waited_s > estimate_s:
            self._learn_remote(server, operation, waited_s, now_s=now_s, less=less)

    def observe_check(self, server: str, delay_s: float, *, started: bool) -> None:
        """Add the delay of a check that ended READY and `started` services, or found them running."""
        its = self._servers[server]
        if started:
            its.check = its.check.observe(delay_s)
        else:
            its.check_running = its.check_running.observe(delay_s)

    def services_started(self, server: str) -> None:
        """Note that services were started on the server: the next call of each counts as its first."""
        self._servers[server].warm.clear()

    def forget_slow_calls(self, server: str, *, now_s: float, retry_s: float) -> bool:
        """Give a server slower than the drone another chance, `retry_s` after its last slow call.

        Only calls change the estimate of a remote call, and a slow server gets none. Return whether an estimate
        changed.
        """
        forgot = False
        for operation, calls in self._servers[server].calls.items():
            if now_s - calls.last_s < retry_s:
                continue
            if self._is_known_slow(operation, calls):
                calls.window = Window.filled(calls.offline_s)
            elif calls.slow_s is None:
                continue
            else:
                calls.slow_s = None
            self._mean_call_s.clear()
            forgot = True
        return forgot

    def next_forgetting_s(self, server: str, *, retry_s: float) -> float:
        """The time at which `forget_slow_calls` next changes an estimate; infinite if never."""
        return min(
            (
                calls.last_s + retry_s
                for operation, calls in self._servers[server].calls.items()
                if calls.slow_s is not None or self._is_known_slow(operation, calls)
            ),
            default=math.inf,
        )

    def _is_known_slow(self, operation: Operation, calls: _Calls) -> bool:
        return self._is_slow(operation, self._sooner_s(operation, calls, calls.window.mean_s))

    def _whole_s(self, server: str, operation: Operation, at: Position | None, *, slow: bool) -> float | None:
        """The delay of a call sent whole, by what was measured near the place, or else by the server's calls.

        None near a place where the server was not reached.
        """
        position = at or self._here
        place = None if self.coverage is None or position is None else self.coverage.at(server, position)
        known_s = place.call_s(operation) if place is not None else None
        if known_s is not None or (place is not None and not place.reached):
            return known_s
        calls = self._servers[server].calls[operation]
        return max(calls.window.mean_s, (calls.slow_s or 0.0) if slow else 0.0)

    def _way(self, server: str, operation: Operation) -> BothWays | None:
        calls = self._servers[server].calls.get(operation)
        return None if calls is None else calls.way

    def _sooner_s(self, operation: Operation, calls: _Calls, whole_s: float) -> float:
        """The delay (s) by the quicker way of sending, of a call that would take `whole_s` sent whole."""
        if calls.way is None or not self.tries_part(operation.service):
            return whole_s
        return min(whole_s, calls.way.less_s(whole_s))

    def _learn_remote(
        self, server: str, operation: Operation, delay_s: float, *, now_s: float, less: bool = False
    ) -> None:
        whole_s = self.as_whole_s(server, operation, delay_s) if less else delay_s
        its = self._servers[server]
        calls = its.calls[operation]
        if self._slow_apart and self._is_slow(operation, delay_s):
            calls.slow_s = whole_s
        else:
            calls.slow_s, calls.window = None, calls.window.observe(whole_s)
        its.warm.add(operation.service)
        calls.last_s = now_s
        self._mean_call_s.clear()

    def _is_slow(self, operation: Operation, delay_s: float) -> bool:
        """Whether the drone would not be slower; never of an operation that it cannot run."""
        return not self.needs_server(operation) and delay_s >= self._local[operation].mean_s

    def _count(self, operation: Operation) -> None:
        self._counts[operation] += 1
        if (calls := sum(self._counts.values())) >= _CALLS_BEFORE_WEIGHING:
            self._weights = {operation: count / calls for operation, count in self._counts.items()}
        self._mean_call_s.clear()
