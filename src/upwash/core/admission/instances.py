"""The place for the instance of a service: at most one instance has it, and each is known by its number.

    ABSENT ─ begin ─► STARTING ─ ready ─► RUNNING ─ stop ─► STOPPING ─ gone ─► ABSENT

An instance that is starting may be stopped too, and each may be gone at any time. An instance of another version
starts beside a running one. Once ready it has the place, and the former serves until drones know the new address.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from msgspec import Struct

from upwash.core.admission.clients import InstanceStatus
from upwash.core.admission.watchdog import InstanceFailures, Limit, Useless, Watch


class InstanceState(StrEnum):
    """The states of an instance."""

    ABSENT = "absent"
    STARTING = "starting"
    RUNNING = "running"
    STOPPING = "stopping"


class StartInstance(Struct, frozen=True):
    """Start an instance of the service for the server."""

    server: str
    service: str
    number: int


class StopInstance(Struct, frozen=True):
    """Stop that instance. With a reason `why`, calls under way may end first, and new calls are refused with it.

    If `is_useless`, calls under way get little time.
    """

    server: str
    service: str
    number: int
    why: str = ""
    is_useless: bool = False


@dataclass(slots=True)
class InstancePlace:
    """The state of one service's instance, or its absence; `numbers` gives each new instance its number."""

    server: str
    service: str
    numbers: Iterator[int]
    state: InstanceState = InstanceState.ABSENT
    number: int = 0
    endpoint: str = ""
    used_s: float = 0.0  # when it became ready or was last called
    watch: Watch = field(default_factory=Watch)
    limit: Limit = field(default_factory=Limit)
    failures: InstanceFailures = field(default_factory=InstanceFailures)
    replaced: int = 0  # instances that were of no use
    successor: int = 0  # an instance of another version that is starting; 0: none
    former_s: dict[int, float] = field(default_factory=dict)  # until when former instances serve
    renewed: int = 0  # instances that took over in another version
    not_renewed: str = ""  # why the other version did not start last time

    @property
    def is_running(self) -> bool:
        """Whether its instance can be called."""
        return self.state is InstanceState.RUNNING

    def begin(self) -> list[StartInstance]:
        """Start an instance, unless one exists."""
        if self.state is not InstanceState.ABSENT:
            return []
        self.state = InstanceState.STARTING
        self.number = next(self.numbers)
        self.not_renewed = ""
        return [StartInstance(self.server, self.service, self.number)]

    def renew(self, why: str) -> list[StartInstance | StopInstance]:
        """Start an instance of another version, which replaces the running one once it is ready.

        If no instance runs, stop the starting instance for the reason `why`; drones then wait for the next instance.
        Former instances serve on.
        """
        if not self.is_running:
            return [*self._stop_own(why)]
        outdated = [self._stop(self.successor, why)] if self.successor else []
        self.successor = next(self.numbers)
        return [*outdated, StartInstance(self.server, self.service, self.successor)]

    def ready(self, number: int, endpoint: str, *, lanes: int, former_until_s: float, now_s: float) -> bool:
        """Note that the instance of that number can be called at the endpoint; return False for a stale report.

        An instance that it replaces serves until `former_until_s`.
        """
        if number == self.successor:
            if self.is_running:
                self.former_s[self.number] = former_until_s
            self.number, self.successor = number, 0
            self.renewed += 1
            self.not_renewed = ""
        elif self.number != number or self.state is not InstanceState.STARTING:
            return False
        self.state = InstanceState.RUNNING
        self.endpoint = endpoint
        self.used_s = now_s
        self.watch = Watch(lanes=lanes, now_s=now_s)
        return True

    def gone(self, number: int, why: str = "", *, now_s: float = 0.0) -> bool:
        """Note that the instance ended; return whether it had been condemned. `why` is set if it ended by itself."""
        self.former_s.pop(number, None)
        if number == self.successor:
            self.successor, self.not_renewed = 0, why
        if self.number != number or self.state is InstanceState.ABSENT:
            return False
        if why and self.state is not InstanceState.STOPPING:
            callers = self.watch.callers if self.is_running else frozenset()
            self.failures.add(why, callers, had_started=self.is_running, now_s=now_s)
        was_condemned = self.state is InstanceState.STOPPING and self.watch.is_condemned
        self.state = InstanceState.STARTING if self.successor else InstanceState.ABSENT
        self.number, self.successor = self.successor or number, 0
        self.endpoint = ""
        return was_condemned

    def condemn(self, useless: Useless, *, now_s: float) -> list[StopInstance]:
        """Has a running instance stopped that is of no use."""
        if not self.is_running:
            return []
        self.watch.is_condemned = True
        self.replaced += 1
        self.failures.add(useless.why, useless.drones, had_started=True, now_s=now_s)
        return self.stop(f"{self.service} of {self.server} is replaced: {useless.why}", is_useless=True)

    def stop(self, why: str = "", *, is_useless: bool = False) -> list[StopInstance]:
        """Stop the running or starting instance, and the instances of other versions."""
        numbers = [*self.former_s, *filter(None, [self.successor])]
        self.former_s, self.successor = {}, 0
        return [*(self._stop(number, why) for number in numbers), *self._stop_own(why, is_useless)]

    def stop_former(self, *, now_s: float) -> list[StopInstance]:
        """Stop replaced instances whose time is over."""
        over = [number for number, until_s in self.former_s.items() if until_s <= now_s]
        for number in over:
            del self.former_s[number]
        why = f"{self.server} has another version of {self.service} now"
        return [self._stop(number, why) for number in over]

    def status(self, *, now_s: float) -> InstanceStatus:
        """The instance as it is now."""
        return InstanceStatus(
            self.service,
            self.state.value,
            self.endpoint,
            now_s - self.used_s if self.is_running else 0.0,
            replaced=self.replaced,
            failures=self.failures.count,
            last_failure=self.failures.why,
            paused_s=self.failures.left_s(now_s=now_s),
            renewed=self.renewed,
            not_renewed=self.not_renewed,
        )

    def _stop_own(self, why: str, is_useless: bool = False) -> list[StopInstance]:
        if not (self.is_running or self.state is InstanceState.STARTING):
            return []
        self.state = InstanceState.STOPPING
        self.endpoint = ""
        return [self._stop(self.number, why, is_useless)]

    def _stop(self, number: int, why: str, is_useless: bool = False) -> StopInstance:
        return StopInstance(self.server, self.service, number, why, is_useless)
