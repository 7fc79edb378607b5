"""The start of a flight: the core's objects from the configuration, and the order of the waypoints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, get_args

from msgspec.structs import replace

from upwash.config.checks import only_on_servers
from upwash.config.drone import DroneConfig, ServerConfig, ServiceConfig
from upwash.config.flight_times import finish_by_s, pace_in_numbers, told_pace
from upwash.config.places import coverage_of, ending, geofence, server_areas, stands, sweeps_of, waypoints
from upwash.config.plan_photos import planned_photos
from upwash.config.values import MDNS
from upwash.core.call.calls import Calls
from upwash.core.geo import Position, Waypoint
from upwash.core.knowledge.estimates import Beliefs, Estimates, offline_remote_s
from upwash.core.knowledge.sending import Less
from upwash.core.operation import Operation
from upwash.core.planning.legs import PACES
from upwash.core.planning.mission_model import MissionBeliefs, StopCall
from upwash.core.planning.order import Forecaster, Order, best_order
from upwash.core.policies.policy import Policy
from upwash.core.selection.hedging import Hedging
from upwash.core.selection.selection import Selection
from upwash.core.selection.settings import LighterSettings, SelectionSettings, TwoAnswers
from upwash.core.vehicle.geofence import breached_by_way
from upwash.core.vehicle.way_home import ARDUCOPTER, PX4, time_home_s
from upwash.drone.before_sending import BeforeSending, RunningPart
from upwash.drone.deadlines import make_deadlines
from upwash.drone.offloading import CallPorts, Offloading
from upwash.drone.onboard import OnboardServices
from upwash.drone.own_policy import policy_of
from upwash.drone.server_session import ServerEndpoint
from upwash.errors import UsageError
from upwash.ports import Finder, InstanceSpec, Program
from upwash.rpc.service import Method, ServiceSpec, Specs, spec_of
from upwash.support.text import counted


def make_selection(
    config: DroneConfig,
    specs: Specs,
    plan: Sequence[Waypoint],
    *,
    instead: Policy | None = None,
) -> Selection:
    """The drone's `Selection`, with the configured estimates, for a flight over these waypoints.

    A policy `instead` stands in for the configured one.
    """
    policy, estimates = config.policy, make_estimates(config, specs)
    return Selection(
        server_areas(config),
        estimates=estimates,
        policy=instead or policy_of(policy),
        settings=SelectionSettings(
            blacklist_s=policy.left_alone_s,
            idle_s=policy.idle_s,
            retry_s=policy.retry_s,
            radios=config.network.radios,
            gain_slot=policy.gain_slot,
            probing=policy.probing,
            lighter=_lighter(config, specs, estimates),
            two_answers=two_answers(config, specs, estimates),
            with_second=any(service.deadline for service in config.services),
            takeoff_m=config.mission.altitude_m,
            lands=ending(config.mission) == "land",
        ),
        mission=mission_beliefs(config, specs, estimates, plan),
    )


def onboard_services(
    config: DroneConfig, specs: Specs, programs: Mapping[str, Program], ports: CallPorts
) -> OnboardServices:
    """The configured services on the drone, which are yet to be started."""
    instances = [
        InstanceSpec(
            config.name, service.name, programs[service.name], service.local_pace_s, heats=config.heat
        )
        for service in config.services
        if specs[service.name].on_drone
    ]
    return _started_by(ports, config, instances)


def _started_by(ports: CallPorts, config: DroneConfig, instances: Sequence[InstanceSpec]) -> OnboardServices:
    return OnboardServices(
        instances,
        start_timeout_s=config.start_timeout_s,
        runtime=ports.onboard_runtime,
        dialer=ports.onboard_dialer,
        journal=ports.journal,
    )


def _parts_before_sending(
    config: DroneConfig, specs: Specs, programs: Mapping[str, Program], ports: CallPorts
) -> BeforeSending:
    parts = {}
    for service in config.services if config.policy.most_loss else ():
        cls, measured = specs[service.name].before_sending, service.before_sending
        if cls is not None and measured is not None and service.name in programs:
            name = spec_of(cls).name
            instance = InstanceSpec(config.name, name, programs[service.name], before=service.name)
            parts[service.name] = RunningPart(name, measured.takes_s, _started_by(ports, config, [instance]))
    return BeforeSending(parts, ports.journal)


def make_offloading(
    config: DroneConfig,
    specs: Specs,
    selection: Selection,
    ports: CallPorts,
    *,
    programs: Mapping[str, Program],
    parts: Mapping[str, Program],
    first: Literal["oldest", "newest"] | None = None,
) -> Offloading:
    """What makes the drone's calls; `first` is the order of several that are open, in place of the mission's.

    `programs` and `parts`, those before sending, are by their services' names.
    """
    photos, estimates = config.mission.photos, selection.estimates
    waiting_bytes = {
        service.name: service.waiting_bytes for service in config.services if not specs[service.name].on_drone
    }
    calls = Calls(
        selection,
        Hedging(estimates, config.policy.hedging),
        make_deadlines(config, specs, estimates),
        first=first or (photos.order if photos else "oldest" if waiting_bytes else None),
        waiting_bytes=waiting_bytes,
    )
    return Offloading(
        calls,
        endpoints(config, estimates, ports.finder),
        ports,
        onboard_services(config, specs, programs, ports),
        _parts_before_sending(config, specs, parts, ports),
        period_s=config.policy.period_s,
    )


def make_estimates(config: DroneConfig, specs: Specs) -> Estimates:
    """The offline estimates of every operation that has a local delay in the file, or that only servers run."""
    for service in config.services:
        _require_agreement(service, specs[service.name])
    local_s: dict[Operation, float] = {}
    less: dict[Operation, Less] = {}
    remote_s: dict[str, dict[Operation, float]] = {server.name: {} for server in config.servers}
    transfer_s: dict[str, dict[Operation, float]] = {server.name: {} for server in config.servers}
    for service in config.services:
        spec = specs[service.name]
        for operation, key in _profile(service, spec):
            method = spec.methods[operation.method]
            if spec.on_drone:
                local_s[operation] = service.local_call_s[key]
            if method.before is not None and (part := _less(service, operation, key)) is not None:
                less[operation] = part
            for server in config.servers:
                if not method.once and (delay_s := _remote_s(server, service, key)) is not None:
                    remote_s[server.name][operation] = delay_s
                if operation in less and server.bandwidth_bit_s is not None:
                    transfer_s[server.name][operation] = 8 * service.request_bytes / server.bandwidth_bit_s
    return Estimates(
        local_s=local_s,
        servers={
            server.name: Beliefs(
                check_s=server.check_s,
                check_running_s=server.check_running_s,
                remote_s=remote_s[server.name],
                transfer_s=transfer_s[server.name],
            )
            for server in config.servers
        },
        slow_apart=config.policy.probing is not None,
        coverage=coverage_of(config),
        on_servers=[name for name, spec in specs.items() if not spec.on_drone],
        less=less,
        most_loss=config.policy.most_loss,
    )


def _require_agreement(service: ServiceConfig, spec: ServiceSpec) -> None:
    """Raise UsageError where the file has a delay on the drone of a service that only servers run, or has none."""
    if spec.on_drone and only_on_servers(service):
        raise UsageError(
            f"service {service.name}: local_call_s is missing: add what a call takes on the drone, in seconds, or "
            'declare the service with @service(where="servers") if no drone can run it'
        )
    if not spec.on_drone and not only_on_servers(service):
        both = 'it has a local_call_s, and is declared with where="servers"'
        raise UsageError(f"service {service.name}: {both}: leave one of the two out")


def _less(service: ServiceConfig, operation: Operation, key: str) -> Less | None:
    if (measured := service.before_sending) is None:
        return None
    names = [name for name in (key, operation.method, "") if name in measured.loss]
    share = measured.request_bytes / max(1, service.request_bytes)
    return Less(measured.takes_s, share, measured.loss[names[0]]) if names else None


def endpoints(
    config: DroneConfig, estimates: Estimates, finder: Finder | None = None
) -> dict[str, ServerEndpoint]:
    """The address of each server, and the services used there: those with an estimate of their delay.

    The finder looks up addresses that the configuration does not have.
    """

    def hosts(server: str, service: str) -> bool:
        own = (operation for operation in estimates.operations if operation.service == service)
        return any(estimates.is_hosted(server, operation) for operation in own)

    return {
        server.name: ServerEndpoint(
            name=server.name,
            network=server.network,
            address=server.address or "",
            finder=finder if server.address == MDNS else None,
            connects=any(service.deadline for service in config.services),
            services=tuple(service.name for service in config.services if hosts(server.name, service.name)),
        )
        for server in config.servers
    }


def _lighter(config: DroneConfig, specs: Specs, estimates: Estimates) -> LighterSettings | None:
    lighter, by_s = config.mission.lighter, finish_by_s(config)
    if by_s is None:
        return None
    operations: dict[Operation, Operation] = {}
    for asked in estimates.operations:
        spec = specs[asked.service]
        method = spec.methods[asked.method]
        # A lighter call of a service that only servers run saves the mission no time.
        if asked.key in lighter and spec.on_drone and not method.once:
            operations[asked] = Operation(asked.service, asked.method, lighter[asked.key])
    for key in lighter:
        if not any(operation.key == key for operation in operations):
            raise UsageError(
                f"mission.lighter.{key}: no service has a method with that profile key: declare the service with "
                "@service(profile_by=...), and name a value of that parameter"
            )
    for asked, wanted in operations.items():
        _require_key(specs[asked.service].methods[asked.method], wanted.key, f"mission.lighter.{asked.key}")
    return LighterSettings(by_s, operations)


def two_answers(config: DroneConfig, specs: Specs, estimates: Estimates) -> dict[Operation, TwoAnswers]:
    """The operations whose calls have a first answer of the drone, which itself is an operation with one answer."""
    found: dict[Operation, TwoAnswers] = {}
    for service in config.services:
        if (two := service.two_answers) is None:
            continue
        for operation in estimates.operations:
            if operation.service != service.name or operation.key == two.first:
                continue
            method = specs[service.name].methods[operation.method]
            if method.profile_by and not method.once:
                _require_key(method, two.first, f"service.{service.name}.two_answers.first")
                first = Operation(service.name, method.name, two.first)
                found[operation] = TwoAnswers(first, two.within_s)
        if not any(operation.service == service.name for operation in found):
            raise UsageError(
                f"service.{service.name}.two_answers.first: no method of {service.name} has a profile key: declare "
                "it with @service(profile_by=...), or leave two_answers out"
            )
    return found


def unkept_deadlines(config: DroneConfig, specs: Specs) -> Iterator[str]:
    """Each operation whose better answers no server has in time, as a sentence."""
    estimates = make_estimates(config, specs)
    for operation, two in two_answers(config, specs, estimates).items():
        servers = [estimates.remote_s(server.name, operation) for server in config.servers]
        least_s = min((call_s for call_s in servers if call_s is not None), default=None)
        if least_s is not None and least_s > two.within_s and operation.key in ("", config.mission.mode):
            yield (
                f"no server answers {operation} within {two.within_s:g} s, the fastest takes {least_s:g} s: the "
                "first answer of each call counts alone"
            )


def _require_key(method: Method, key: str, where: str) -> None:
    try:
        method.argument(key)
    except ValueError as error:
        raise UsageError(f'{where}: {method.service} has no "{key}": {error}: name another key') from error


def mission_beliefs(
    config: DroneConfig, specs: Specs, estimates: Estimates, plan: Sequence[Waypoint]
) -> MissionBeliefs:
    """The mission expected before take-off: its plan, and at each stop a photo and a call of each operation.

    Operations that run once are left out, because no policy decides where they run.
    """
    mission, told = config.mission, told_pace(config.vehicle)
    operations = [
        operation
        for operation in estimates.operations
        if operation.key in ("", mission.mode) and not specs[operation.service].methods[operation.method].once
    ]
    pauses_s = (config.camera.photo_s, *(0.0 for _ in operations[1:]))
    return MissionBeliefs(
        plan=plan,
        leaving=planned_photos(mission).leaving,
        ground_speed_m_s=mission.ground_speed_m_s,
        pace=told or pace_in_numbers(config.vehicle),
        stop=[StopCall(operation, pause_s) for operation, pause_s in zip(operations, pauses_s, strict=False)],
        assumed=told is None,
    )


def _profile(service: ServiceConfig, spec: ServiceSpec) -> Iterator[tuple[Operation, str]]:
    """Each operation that has a local delay, with the key of that delay.

    A method with a profile argument has one operation per key; any other has its own name's, or else the single
    number's.
    """
    keys = [key for key in service.local_call_s if key and key not in spec.methods]
    for method in spec.methods.values():
        if method.profile_by is None:
            own = [key for key in (method.name, "") if key in service.local_call_s]
            yield from ((Operation(service.name, method.name), key) for key in own[:1])
            continue
        if not keys:
            examples = [value for value in get_args(method.key_type) if isinstance(value, str)] or ["KEY"]
            raise UsageError(
                f"service {service.name}: local_call_s must have one delay per {method.profile_by}, as {method.name} "
                f"is slower or faster by it: for example {{ {', '.join(f'{key} = 1.0' for key in examples)} }}; "
                "upwash profile measures them"
            )
        yield from ((Operation(service.name, method.name, key), key) for key in keys)


def _remote_s(server: ServerConfig, service: ServiceConfig, key: str) -> float | None:
    measured_s = server.remote_call_s.get(service.name, {}).get(key)
    processing_s = server.processing_s.get(service.name, {}).get(key)
    if measured_s is not None or processing_s is None or server.bandwidth_bit_s is None:
        return measured_s
    return offline_remote_s(
        processing_s=processing_s,
        data_bytes=service.request_bytes + service.reply_bytes,
        bandwidth_bit_s=server.bandwidth_bit_s,
    )


_HOME = Position(0.0, 0.0)
_WAYS_HOME = {"arducopter": ARDUCOPTER, "px4": PX4}


def order_of(config: DroneConfig, specs: Specs) -> Order:
    """The order of the waypoints by `mission.order`, for a configuration that was read from a file."""
    mission = config.mission
    given = waypoints(mission)
    if mission.order in ("given", "by-index"):  # which is given too, of a drone that is none of several
        return Order(given)
    possible = sweeps_of(mission)
    if isinstance(mission.order, int):
        sweep = possible[mission.order]
        return Order(sweep.waypoints, str(sweep), mission.order)
    estimates = make_estimates(config, specs)
    beliefs = mission_beliefs(config, specs, estimates, given)
    if not beliefs.stop:
        return Order(given, "as given: nothing is known of any call that could be forecast")
    start = stands(mission)
    forecaster = Forecaster(
        beliefs,
        estimates,
        {} if config.policy.name == "local-only" else server_areas(config),
        gain_wait=config.policy.gain_wait,
        stands=start,
        home_s=lambda place: home_s(config, place, start),
    )
    ways = [[_HOME, *(waypoint.position for waypoint in sweep.waypoints)] for sweep in possible]
    fences = geofence(mission)
    allowed = [
        sweep for sweep, way in zip(possible, ways, strict=True) if breached_by_way(fences, way) is None
    ]
    best = best_order(given, allowed, forecaster.mission_s)
    if forbidden := len(possible) - len(allowed):
        sweeps = counted(len(possible), "sweep")
        return replace(best, why=f"{best.why}; the geofence forbids {forbidden} of {sweeps}")
    return best


def home_s(config: DroneConfig, place: Position, start: Position) -> float:
    """Seconds of the simulated vehicle from `place` to the ground; without a profile the same from everywhere."""
    profile = config.vehicle.profile
    if profile is None or ending(config.mission) == "land":
        return config.vehicle.return_and_land_s
    return PACES[profile].home_share * time_home_s(place, start, _WAYS_HOME[profile])
