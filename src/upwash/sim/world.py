"""The true behaviour of a simulated world: the radio paths between drone and servers, and their computers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from statistics import fmean

from upwash.config.drone import ServiceConfig
from upwash.config.truth import ServerTruth, times_of
from upwash.config.world import NoiseConfig
from upwash.core.geo import Position, Reach, ground_distance_m
from upwash.core.operation import Operation
from upwash.errors import InstanceError
from upwash.ports import InstanceSpec, Network
from upwash.sim.chance import Chance
from upwash.sim.energy import EnergyMeter
from upwash.sim.faults import Faults
from upwash.sim.link import Observe, Wire, unobserved
from upwash.sim.radio import Spot, SteadyGoodput, goodput_of
from upwash.sim.runtime import Hangs, Raises
from upwash.support.heat import Heat

_NOWHERE = Spot(0.0)
_BREAKING = ("hung", "poisoned")  # the instance, also after the fault


class ModelRadio(Wire):
    """The radio path between the drone and its servers: silent out of range, with a transfer time for calls."""

    def __init__(
        self,
        areas: Mapping[str, Reach],
        places: Mapping[str, Position],
        truths: Mapping[str, ServerTruth],
        services: Sequence[ServiceConfig],
        *,
        faults: Faults,
        position: Callable[[], Position],
        energy: EnergyMeter | None = None,
        reached: Callable[[str, Position], bool] = lambda _server, _position: True,
    ) -> None:
        self._areas = areas
        self._places = places
        self._reached = reached  # whether a server in range answers at a position
        self._goodputs = {
            (server, service.name): goodput_of(truth, service.name)
            for server, truth in truths.items()
            for service in services
        }
        self._services = {f"/upwash.service.{service.name}/": service for service in services}
        self._faults = faults
        self._position = position
        self._energy = energy
        self._bandwidths = {
            server: SteadyGoodput(truth.bandwidth_bit_s)
            for server, truth in truths.items()
            if truth.bandwidth_bit_s
        }

    def connected(self, server: str) -> bool:
        """Whether the drone is in range and the link is not down."""
        fault = self._faults.now(f"link:{server}")
        down = fault is not None and fault.kind != "slow"
        position = self._position()
        return not down and self._areas[server].contains(position) and self._reached(server, position)

    def is_up(self, server: str) -> bool:
        """Whether the server's network can be joined, as far as its link is concerned."""
        fault = self._faults.now(f"link:{server}")
        return fault is None or fault.kind != "off"

    async def goes_down(self, server: str) -> None:
        """Wait until the server's network is not up."""
        await self._faults.befalls(f"link:{server}", "off")

    async def send(self, server: str, path: str, *, reply: bool, less: bool = False) -> None:
        """Wait for the transfer time of a call at the drone's distance; other requests take none."""
        fault = self._faults.now(f"link:{server}")
        if fault is not None and fault.kind == "slow":
            await asyncio.sleep(fault.extra_s / 2)
        service = self._services.get(path[: path.rfind("/") + 1])
        if service is None:
            return
        data_bytes = service.reply_bytes if reply else service.request_bytes
        if less and service.before_sending is not None:
            data_bytes = service.before_sending.request_bytes
        goodput = self._goodputs[server, service.name]
        if goodput is None:
            if self._energy is not None and server in self._bandwidths:  # the delay is given as a whole
                self._energy.transfer(self._bandwidths[server].transfer_s(data_bytes, _NOWHERE))
            return
        here, begun_s = self._position(), asyncio.get_running_loop().time()
        spot = Spot(ground_distance_m(here, self._places[server]), here, begun_s)
        try:
            await asyncio.sleep(goodput.transfer_s(data_bytes, spot))
        finally:  # a cancelled transfer has been on the air too
            if self._energy is not None:
                self._energy.transfer(asyncio.get_running_loop().time() - begun_s)


class DroneComputer:
    """The drone's computer: calls take the profiled delays, and longer if it is hot or while a radio joins."""

    def __init__(
        self,
        services: Sequence[ServiceConfig],
        *,
        heat: Heat | None,
        joining: Joining,
        noise: float,
        chance: Chance,
        energy: EnergyMeter | None = None,
        observe: Observe = unobserved,
    ) -> None:
        self._services = {service.name: service for service in services}
        self._cold = set(self._services)
        self._heat = heat
        self._joining = joining
        self._energy = energy
        self._noise = noise
        self._chance = chance
        self._observe = observe  # gets each call that is over ("computed")

    async def start(self, spec: InstanceSpec) -> None:
        """Return at once, as services start before the mission."""

    async def compute(self, spec: InstanceSpec, operation: Operation, *, less: bool = False) -> float:
        """Wait for the profiled delay, with the extra of a first call; return the time."""
        clock = asyncio.get_running_loop().time
        began_s = clock()
        if spec.before:
            part = self._services[spec.before].before_sending
            takes_s = part.takes_s if part is not None else 0.0
            await asyncio.sleep(
                self._work_s(takes_s * self._chance.factor(f"part/{spec.before}", self._noise))
            )
            return clock()
        service = self._services[spec.service]
        call_s = delay_of(operation, service.local_call_s)
        call_s *= self._chance.factor(f"call/local/{operation}", self._noise)
        if spec.service in self._cold:
            self._cold.remove(spec.service)
            call_s += service.local_first_extra_s
        slowdown = _of(operation, service.local_joining_slowdown) or 0.0
        await self._joining.work(self._work_s(call_s), slowdown)
        self._observe("computed", operation=str(operation), took_s=clock() - began_s)
        return clock()

    def _work_s(self, call_s: float) -> float:
        """The time of a call at the present heat, and meter its energy."""
        heat, energy = self._heat, self._energy
        if heat is None:
            if energy is not None:
                energy.compute(energy.load_w * call_s)
            return call_s
        before_j = heat.burnt_j
        took_s = heat.work(call_s, now_s=asyncio.get_running_loop().time())
        if energy is not None:
            energy.compute(heat.burnt_j - before_j)
        return took_s


class ServerComputer:
    """A server's computer: starts and calls take their true times; during a crash fault instances die half-way."""

    def __init__(
        self, name: str, truth: ServerTruth, *, faults: Faults, noise: NoiseConfig, chance: Chance
    ) -> None:
        self._name = name
        self._truth = truth
        self._cold: set[str] = set()  # services that have not been called since their start
        self._broken: dict[str, str] = {}  # how, by service, until its instance is replaced
        self._faults = faults
        self._noise = noise
        self._chance = chance

    async def start(self, spec: InstanceSpec) -> None:
        """Wait for the cold start; raises InstanceError during a fault."""
        self._broken.pop(spec.service, None)
        start_s = self._truth.start_s * self._chance.factor(f"start/{self._name}", self._noise.start)
        await self._take(start_s, f"{spec.name} crashed while it started")
        if self._kind() == "unstartable":
            raise InstanceError(f"{spec.name} did not start: it has no graphics card")
        self._cold.add(spec.service)

    async def compute(self, spec: InstanceSpec, operation: Operation, *, less: bool = False) -> float:
        """Wait while the call occupies the instance; return the time of the answer.

        The first call after a start takes longer by the extra.
        """
        call_s = computing_s(operation, self._truth, less=less)
        occupied_s = occupying_s(operation, self._truth, less=less)
        stretch = self._chance.factor(f"call/{self._name}/{operation}", self._noise.call)
        call_s, occupied_s = stretch * call_s, stretch * occupied_s
        times_s = times_of(operation, self._truth.service_times)
        if times_s and (mean_s := fmean(times_s)):
            drawn = self._chance.stream(f"service/{self._name}/{operation}").choice(times_s) / mean_s
            call_s += (drawn - 1) * occupied_s
            occupied_s *= drawn
        if spec.service in self._cold:
            self._cold.remove(spec.service)
            call_s += self._truth.first_extra_s
            occupied_s += self._truth.first_extra_s
        answered_s = asyncio.get_running_loop().time() + call_s
        kind = self._kind()
        if kind in _BREAKING:
            self._broken[spec.service] = kind
        if self._broken.get(spec.service) == "hung":
            raise Hangs
        await self._take(call_s, f"{spec.name} crashed in a call", occupied_s=occupied_s)
        if self._broken.get(spec.service) == "poisoned":
            raise Raises(f"{spec.name} cannot compute any more")
        return answered_s

    async def _take(self, time_s: float, crash: str, *, occupied_s: float | None = None) -> None:
        if self._kind() == "crash":
            await asyncio.sleep(time_s / 2)
            raise InstanceError(crash)
        await asyncio.sleep(time_s if occupied_s is None else occupied_s)

    def _kind(self) -> str:
        fault = self._faults.now(self._name)
        return fault.kind if fault is not None else ""


def computing_s(operation: Operation, truth: ServerTruth, *, less: bool = False) -> float:
    """The true delay (s) of a call on a server: end to end if that is given, else of the processing alone.

    With `less` to send, a delay from end to end is shorter by the transfer that is saved.
    """
    told = truth.remote_call_s.get(operation.service, {})
    call_s = delay_of(operation, told or truth.processing_s[operation.service])
    return max(0.0, call_s - truth.saved_s.get(operation.service, 0.0)) if told and less else call_s


def occupying_s(operation: Operation, truth: ServerTruth, *, less: bool = False) -> float:
    """The part (s) of a call's true delay that occupies its instance; the rest is the transfer."""
    call_s = computing_s(operation, truth, less=less)
    if truth.radio != "fixed" or truth.goodput_csv is not None:  # whose transfers come on top
        return call_s
    processing_s = _of(operation, truth.occupying_s.get(operation.service, {}))
    return call_s if processing_s is None else min(processing_s, call_s)


def delay_of(operation: Operation, delays_s: Mapping[str, float]) -> float:
    """The delay of an operation in a table by profile key, by method, or of a single number."""
    delay_s = _of(operation, delays_s)
    if delay_s is None:
        raise KeyError(f"no delay of {operation} among {', '.join(delays_s)}")
    return delay_s


def _of(operation: Operation, table: Mapping[str, float]) -> float | None:
    for key in (operation.key, operation.method, ""):
        if key in table:
            return table[key]
    return None


class Joining:
    """Counts the drone's radios that are joining a network now."""

    def __init__(self) -> None:
        self._radios = 0
        self._changed = asyncio.Event()

    def begun(self) -> None:
        """Add one radio."""
        self._count(1)

    def over(self) -> None:
        """Remove one radio."""
        self._count(-1)

    async def work(self, work_s: float, slowdown: float) -> None:
        """Wait for work of `work_s`, which takes longer by the share `slowdown` while a radio joins."""
        if slowdown == 0:
            await asyncio.sleep(work_s)
            return
        clock, left_s = asyncio.get_running_loop().time, work_s
        while True:
            began_s, changed, stretch = clock(), self._changed, 1 + slowdown if self._radios else 1.0
            try:
                async with asyncio.timeout(left_s * stretch):
                    await changed.wait()
            except TimeoutError:
                return
            left_s -= (clock() - began_s) / stretch

    def _count(self, more: int) -> None:
        self._radios += more
        self._changed.set()
        self._changed = asyncio.Event()


class JoinedSlowly:
    """A network whose joins are counted in `Joining`; `observe` gets "joined" and "left"."""

    def __init__(
        self, network: Network, joining: Joining, *, radio: int = 0, observe: Observe = unobserved
    ) -> None:
        self._network = network
        self._joining = joining
        self._radio = radio
        self._observe = observe

    async def join(self, network: str, *, timeout_s: float) -> None:
        """Join the network, counted meanwhile."""
        self._joining.begun()
        try:
            await self._network.join(network, timeout_s=timeout_s)
        finally:
            self._joining.over()
        self._observe("joined", network=network, radio=self._radio)

    async def lost(self) -> str:
        """Wait until the network is lost; return why."""
        return await self._network.lost()

    async def leave(self) -> None:
        """Leave the network."""
        await self._network.leave()
        self._observe("left", radio=self._radio)
