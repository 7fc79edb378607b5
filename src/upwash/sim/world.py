"""What is true in a simulated world: the air between drone and servers, and their computers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence

from upwash.config import ServerTruth, ServiceConfig
from upwash.core.estimates import Operation
from upwash.core.geo import Circle, Position, ground_distance_m
from upwash.errors import InstanceError
from upwash.ports import InstanceSpec
from upwash.sim.chance import Chance
from upwash.sim.faults import Faults
from upwash.sim.heat import Heat
from upwash.sim.radio import goodput_of


class Wire:
    """Between the drone and its own services: no distance, no time."""

    def connected(self, server: str) -> bool:
        """Always."""
        return True

    async def send(self, server: str, path: str, *, reply: bool) -> None:
        """At once."""


class Radio:
    """Between the drone and the servers: nothing arrives out of range, and bytes take their time."""

    def __init__(
        self,
        areas: Mapping[str, Circle],
        truths: Mapping[str, ServerTruth],
        services: Sequence[ServiceConfig],
        *,
        faults: Faults,
        position: Callable[[], Position],
    ) -> None:
        self._areas = areas
        self._goodputs = {
            (server, service.name): goodput_of(truth, service.name)
            for server, truth in truths.items()
            for service in services
        }
        self._services = {f"/upwash.service.{service.name}/": service for service in services}
        self._faults = faults
        self._position = position

    def connected(self, server: str) -> bool:
        """Whether the drone is in range and the link is not down."""
        fault = self._faults.now(f"link:{server}")
        down = fault is not None and fault.kind != "slow"
        return not down and self._areas[server].contains(self._position())

    def is_up(self, server: str) -> bool:
        """Whether the server's network can be joined, as far as its link is concerned."""
        fault = self._faults.now(f"link:{server}")
        return fault is None or fault.kind != "off"

    async def goes_down(self, server: str) -> None:
        """Returns as soon as the server's network is not up."""
        await self._faults.befalls(f"link:{server}", "off")

    async def send(self, server: str, path: str, *, reply: bool) -> None:
        """The transfer time at the drone's distance; what is no service's call is too small to count."""
        fault = self._faults.now(f"link:{server}")
        if fault is not None and fault.kind == "slow":
            await asyncio.sleep(fault.extra_s / 2)
        service = self._services.get(path[: path.rfind("/") + 1])
        goodput = self._goodputs[server, service.name] if service else None
        if service is None or goodput is None:
            return
        distance_m = ground_distance_m(self._position(), self._areas[server].centre)
        data_bytes = service.reply_bytes if reply else service.request_bytes
        await asyncio.sleep(goodput.transfer_s(data_bytes, distance_m))


class DroneComputer:
    """Runs the drone's own services: at the profiled delays, slower the hotter it gets."""

    def __init__(
        self, services: Sequence[ServiceConfig], *, heat: Heat | None, noise: float, chance: Chance
    ) -> None:
        self._services = {service.name: service for service in services}
        self._cold = set(self._services)
        self._heat = heat
        self._noise = noise
        self._chance = chance

    async def start(self, spec: InstanceSpec) -> None:
        """Before the mission: no time of it."""

    async def compute(self, spec: InstanceSpec, operation: Operation) -> None:
        """The profiled delay, with the extra of the first call."""
        service = self._services[spec.service]
        call_s = delay_of(operation, service.local_call_s)
        call_s *= self._chance.factor(f"call/local/{operation}", self._noise)
        if spec.service in self._cold:
            self._cold.remove(spec.service)
            call_s += service.local_first_extra_s
        if self._heat is not None:
            call_s = self._heat.work(call_s, now_s=asyncio.get_running_loop().time())
        await asyncio.sleep(call_s)


class ServerComputer:
    """Runs the services of one server in the times that are true; while it is to crash, they die half-way."""

    def __init__(
        self, name: str, truth: ServerTruth, *, faults: Faults, noise: float, chance: Chance
    ) -> None:
        self._name = name
        self._truth = truth
        self._cold: set[str] = set()  # services that have not been called since their start
        self._faults = faults
        self._noise = noise
        self._chance = chance

    async def start(self, spec: InstanceSpec) -> None:
        """The cold start."""
        await self._take(self._truth.start_s, f"{spec.name} crashed while it started")
        self._cold.add(spec.service)

    async def compute(self, spec: InstanceSpec, operation: Operation) -> None:
        """The true delay of a call, end to end where the scenario says it so, else the processing alone.

        The first call after a start takes longer by the extra.
        """
        call_s = computing_s(operation, self._truth)
        call_s *= self._chance.factor(f"call/{self._name}/{operation}", self._noise)
        if spec.service in self._cold:
            self._cold.remove(spec.service)
            call_s += self._truth.first_extra_s
        await self._take(call_s, f"{spec.name} crashed in a call")

    async def _take(self, time_s: float, crash: str) -> None:
        fault = self._faults.now(self._name)
        if fault is not None and fault.kind == "crash":
            await asyncio.sleep(time_s / 2)
            raise InstanceError(crash)
        await asyncio.sleep(time_s)


def computing_s(operation: Operation, truth: ServerTruth) -> float:
    """The true delay of a call on a server: end to end where that is told, else of the processing alone."""
    told = truth.remote_call_s.get(operation.service, {})
    return delay_of(operation, told or truth.processing_s[operation.service])


def delay_of(operation: Operation, delays_s: Mapping[str, float]) -> float:
    """The delay of an operation in a table by profile key, by method, or of a single number."""
    for key in (operation.key, operation.method, ""):
        if key in delays_s:
            return delays_s[key]
    raise KeyError(f"no delay of {operation} among {', '.join(delays_s)}")
