"""The instances of one server: at most one of each service, each known by its number.

    ABSENT ─ begin ─► STARTING ─ ready ─► RUNNING ─ stop ─► STOPPING ─ gone ─► ABSENT

An instance that is starting may be stopped too, and each may be gone at any time. An instance of another version
starts beside a running one. Once ready it has the place, and the former serves until drones know the new address.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum

from msgspec import Struct

from upwash.core.admission.clients import InstanceStatus
from upwash.core.admission.watchdog import InstanceFailures, Limit, Useless, Watch


class InstanceState(StrEnum):
    """Where an instance is in its life."""

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
    """Stop that instance; if there is a reason let the calls under way end first, and refuse every other for it.

    The calls of an instance that is of no use get little time.
    """

    server: str
    service: str
    number: int
    why: str = ""
    is_useless: bool = False


@dataclass(slots=True)
class InstancePlace:
    """The instance of one service, or the place for it."""

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


class Instances:
    """The instances of one server; `numbers` gives each that is begun a number of its own."""

    def __init__(self, server: str, services: Iterable[str], numbers: Iterator[int]) -> None:
        self._server = server
        self._numbers = numbers
        self._instances: dict[str, InstancePlace] = {}
        self.offer(services)

    def __getitem__(self, service: str) -> InstancePlace:
        return self._instances[service]

    def offer(self, services: Iterable[str]) -> None:
        """From now on there is a place for instances of these services too."""
        for service in sorted(services):
            self._instances.setdefault(service, InstancePlace())

    def endpoints(self, services: Iterable[str]) -> dict[str, str]:
        """Where those of the services can be called that run."""
        return {
            service: self[service].endpoint
            for service in services
            if self[service].state is InstanceState.RUNNING
        }

    def begin(self, service: str) -> list[StartInstance]:
        """Has an instance started, unless there is one."""
        instance = self[service]
        if instance.state is not InstanceState.ABSENT:
            return []
        instance.state = InstanceState.STARTING
        instance.number = next(self._numbers)
        instance.not_renewed = ""
        return [StartInstance(self._server, service, instance.number)]

    def renew(self, service: str, why: str) -> list[StartInstance | StopInstance]:
        """Has an instance of another version take the place of a running one, once it is ready.

        An instance that is starting is stopped for that reason; drones that wait for it wait for the next.
        """
        instance = self[service]
        if instance.state is not InstanceState.RUNNING:
            return [*self.stop(service, why)]
        outdated = (
            [StopInstance(self._server, service, instance.successor, why)] if instance.successor else []
        )
        instance.successor = next(self._numbers)
        return [*outdated, StartInstance(self._server, service, instance.successor)]

    def ready(
        self,
        service: str,
        number: int,
        endpoint: str,
        *,
        lanes: int = 1,
        former_until_s: float = 0.0,
        now_s: float,
    ) -> bool:
        """The instance of that number can be called at the endpoint; returns whether that is news.

        An instance whose place it takes serves until `former_until_s`.
        """
        instance = self[service]
        if number == instance.successor:
            if instance.state is InstanceState.RUNNING:
                instance.former_s[instance.number] = former_until_s
            instance.number, instance.successor = number, 0
            instance.renewed += 1
            instance.not_renewed = ""
        elif instance.number != number or instance.state is not InstanceState.STARTING:
            return False
        instance.state = InstanceState.RUNNING
        instance.endpoint = endpoint
        instance.used_s = now_s
        instance.watch = Watch(lanes=lanes, now_s=now_s)
        return True

    def gone(self, service: str, number: int, why: str = "", *, now_s: float = 0.0) -> bool:
        """The instance of that number has ended, for that reason if by itself; returns whether it was of no use."""
        instance = self[service]
        instance.former_s.pop(number, None)
        if number == instance.successor:
            instance.successor, instance.not_renewed = 0, why
        if instance.number != number or instance.state is InstanceState.ABSENT:
            return False
        if why and instance.state is not InstanceState.STOPPING:
            had_started = instance.state is InstanceState.RUNNING
            callers = instance.watch.callers if had_started else frozenset()
            instance.failures.add(why, callers, had_started=had_started, now_s=now_s)
        was_condemned = instance.state is InstanceState.STOPPING and instance.watch.is_condemned
        instance.state = InstanceState.STARTING if instance.successor else InstanceState.ABSENT
        instance.number, instance.successor = instance.successor or number, 0
        instance.endpoint = ""
        return was_condemned

    def condemn(self, service: str, useless: Useless, *, now_s: float) -> list[StopInstance]:
        """Has the instance stopped, which runs and is of no use."""
        instance = self[service]
        if instance.state is not InstanceState.RUNNING:
            return []
        instance.watch.is_condemned = True
        instance.replaced += 1
        instance.failures.add(useless.why, useless.drones, had_started=True, now_s=now_s)
        return self.stop(service, f"{service} of {self._server} is replaced: {useless.why}", is_useless=True)

    def stop(self, service: str, why: str = "", *, is_useless: bool = False) -> list[StopInstance]:
        """Has the instance stopped, if one runs or is starting, with those of other versions."""
        instance = self[service]
        numbers = [*instance.former_s, *filter(None, [instance.successor])]
        instance.former_s, instance.successor = {}, 0
        if instance.state in (InstanceState.STARTING, InstanceState.RUNNING):
            instance.state = InstanceState.STOPPING
            instance.endpoint = ""
            numbers.append(instance.number)
        return [
            StopInstance(self._server, service, number, why, is_useless and number == instance.number)
            for number in numbers
        ]

    def stop_former(self, *, now_s: float) -> list[StopInstance]:
        """Has those stopped that had the place, and whose time is over."""
        over = [
            (service, number)
            for service, instance in self._instances.items()
            for number, until_s in instance.former_s.items()
            if until_s <= now_s
        ]
        for service, number in over:
            del self[service].former_s[number]
        why = f"{self._server} has another version of"
        return [
            StopInstance(self._server, service, number, f"{why} {service} now") for service, number in over
        ]

    def stop_all(self, why: str) -> list[StopInstance]:
        """Has every instance stopped."""
        return [command for service in self._instances for command in self.stop(service, why)]

    def stop_idle(self, idle_s: float, *, now_s: float) -> list[StopInstance]:
        """Stop instances that were not called for that long."""
        idle = [service for service, instance in self._running() if now_s - instance.used_s >= idle_s]
        return [command for service in idle for command in self.stop(service)]

    @property
    def any_running(self) -> bool:
        """Whether there is an instance that runs."""
        return bool(self._running()) or bool(self.former_until_s())

    def former_until_s(self) -> list[float]:
        """Until when each instance serves that had a place."""
        return [until_s for instance in self._instances.values() for until_s in instance.former_s.values()]

    def used_s(self) -> list[float]:
        """When each instance that runs became ready or was last called."""
        return [instance.used_s for _, instance in self._running()]

    def status(self, offered: Collection[str], *, now_s: float) -> list[InstanceStatus]:
        """The status of the offered services, and of others whose instance has not ended yet."""
        return [
            InstanceStatus(
                service,
                instance.state.value,
                instance.endpoint,
                now_s - instance.used_s if instance.state is InstanceState.RUNNING else 0.0,
                replaced=instance.replaced,
                failures=instance.failures.count,
                last_failure=instance.failures.why,
                paused_s=instance.failures.left_s(now_s=now_s),
                renewed=instance.renewed,
                not_renewed=instance.not_renewed,
            )
            for service, instance in sorted(self._instances.items())
            if service in offered or instance.state is not InstanceState.ABSENT
        ]

    def _running(self) -> list[tuple[str, InstancePlace]]:
        return [
            (service, instance)
            for service, instance in self._instances.items()
            if instance.state is InstanceState.RUNNING
        ]
