"""Warnings: everything that a person should know, and perhaps change, before take-off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from msgspec import Struct

from upwash.config.checks import never_made_smaller, never_offloaded, only_on_servers
from upwash.config.drone import DroneConfig, PolicyConfig, ServerConfig, unsigned_port
from upwash.config.flight_times import finish_by_s, reserve_percent, usable_s
from upwash.config.values import MDNS
from upwash.config.world import EnergyConfig
from upwash.core.policies.policy import WaitRule
from upwash.drone.speed import photo_doubts
from upwash.preflight.prediction import AS_CONFIGURED, LOCAL_ONLY, Prediction, without
from upwash.preflight.waypoints import PX4_LOW_PERCENT, ServerCoverage, farthest
from upwash.support.text import lasting

_LATE_S = 1.0  # less is what the forecast of the last calls was off
_WORTH_SAYING = 0.01  # of a mission time: less is the luck of when a check happened to begin


class PreflightWarning(Struct, frozen=True):
    """One warning: its kind, which stays the same from version to version, and what a person reads."""

    kind: str
    text: str


class Belief(Struct, frozen=True, kw_only=True):
    """What a call is believed to take on the drone, and on each server that offers it."""

    operation: str
    local_s: float
    remote_s: Mapping[str, float]


def usable_wh(config: DroneConfig) -> float | None:
    """What the simulated battery gives above the mission's reserve; None where the configuration does not say."""
    if config.energy is None or config.energy.battery_wh is None:
        return None
    return config.energy.battery_wh * (1 - _level_percent(config, config.energy) / 100)


def _level_percent(config: DroneConfig, energy: EnergyConfig) -> float:
    """The battery level that ends the flight."""
    return max(reserve_percent(config) or 0.0, energy.failsafe_percent)


def warnings(
    config: DroneConfig,
    covered: Sequence[ServerCoverage],
    beliefs: Sequence[Belief],
    predictions: Sequence[Prediction],
) -> list[PreflightWarning]:
    """All warnings, without those that `upwash fly` turns into refusals.

    The beliefs are those of the operations that the mission calls.
    """
    found: list[PreflightWarning] = []
    if config.policy.name != LOCAL_ONLY:
        found += _range_concerns(config.servers, covered)
        found += _operation_concerns(config, beliefs)
        gains_time = not any(
            service.two_answers or only_on_servers(service) for service in config.services
        )  # else better answers, or answers at all
        if gains_time and not config.mission.lighter:  # else each case takes the time that it may
            found += _gain_concerns(config, predictions)
    found += _failure_concerns(predictions)
    found += (PreflightWarning(kind, text) for kind, text in photo_doubts(config))
    found += _time_concerns(config, predictions)
    found += _battery_concerns(config, predictions)
    found += _energy_concerns(config, predictions)
    found += _way_home_concerns(config)
    found += _address_concerns(config.servers)
    if is_for_flight(config):
        if problem := unsigned_port(config.autopilot):
            found.append(PreflightWarning("unsigned-port", problem))
        found += _stage_concerns(config)
    return found


def is_for_flight(config: DroneConfig) -> bool:
    """Whether the file has a real autopilot or server; else it is a scenario, for simulation only."""
    return config.autopilot.connection is not None or any(server.address for server in config.servers)


def _range_concerns(
    servers: Sequence[ServerConfig], covered: Sequence[ServerCoverage]
) -> Iterator[PreflightWarning]:
    checks = {server.name: server for server in servers}
    for coverage in covered:
        server = checks[coverage.server]
        if coverage.range_m is None or coverage.nearest_m is None:
            if not coverage.waypoints:
                yield PreflightWarning(
                    "covers-nothing",
                    f"{coverage.server} did not answer at any waypoint on earlier flights, by network.coverage_map",
                )
        elif not coverage.waypoints:
            yield PreflightWarning(
                "covers-nothing",
                f"{coverage.server} covers no waypoint: the nearest is {coverage.nearest_m:.0f} m away, its range is "
                f"{coverage.range_m:g} m",
            )
        elif coverage.longest_stay_s <= server.check_running_s:
            yield PreflightWarning(
                "too-short",
                f"{coverage.server} is in range for at most {lasting(coverage.longest_stay_s)} at a time, less than "
                f"a check takes (check_running_s = {server.check_running_s:g}): it is never ready in time",
            )
        elif coverage.longest_stay_s <= server.check_s:
            yield PreflightWarning(
                "too-short",
                f"{coverage.server} is in range for at most {lasting(coverage.longest_stay_s)} at a time, less than "
                f"a check takes that starts the services (check_s = {server.check_s:g}): it helps only if "
                "they run already",
            )


def _operation_concerns(config: DroneConfig, beliefs: Sequence[Belief]) -> Iterator[PreflightWarning]:
    if not config.servers:
        return
    for problem in never_offloaded(config):
        yield PreflightWarning("not-offered", problem)
    if problem := never_made_smaller(config):
        yield PreflightWarning("sent-whole", problem)
    for belief in beliefs:
        fastest_s = min(belief.remote_s.values(), default=None)
        if fastest_s is not None and fastest_s >= belief.local_s:
            yield PreflightWarning(
                "not-faster",
                f"no server is faster for {belief.operation}: {belief.local_s:g} s on the drone, {fastest_s:g} s "
                "on the fastest server",
            )
    for server in config.servers:
        yield from _wait_concerns(server.name, config.policy, beliefs)


def _wait_concerns(
    server: str, policy: PolicyConfig, beliefs: Sequence[Belief]
) -> Iterator[PreflightWarning]:
    """Warn of a faster server that saves too little on every operation for any wait."""
    rule = WaitRule(gain_wait=policy.gain_wait)
    faster = [
        (1 - remote_s / belief.local_s, belief)
        for belief in beliefs
        if (remote_s := belief.remote_s.get(server)) is not None and remote_s < belief.local_s
    ]
    if not faster or any(
        rule.longest_s(local_s=belief.local_s, remote_s=belief.remote_s[server]) > 0 for _, belief in faster
    ):
        return
    saved, best = max(faster, key=lambda pair: pair[0])
    yield PreflightWarning(
        "never-waits",
        f"the drone never waits for {server}: a call there saves at most {100 * saved:.0f} % "
        f"({best.operation}), and policy.gain_wait = {policy.gain_wait:g} wants more",
    )


def _gain_concerns(config: DroneConfig, predictions: Sequence[Prediction]) -> Iterator[PreflightWarning]:
    by_case = {prediction.case: prediction for prediction in predictions}
    configured = by_case.get(AS_CONFIGURED)
    if configured is None or configured.mission_time_s is None:
        return
    local_only = by_case.get(LOCAL_ONLY)
    if config.servers and local_only is not None and not _is_slower(local_only, configured, sure=False):
        yield PreflightWarning(
            "no-gain",
            f"the servers gain next to nothing: {lasting(configured.mission_time_s)} as configured, "
            f"{lasting(local_only.mission_time_s or 0.0)} with every call on the drone",
        )
    for server in config.servers:
        other = by_case.get(without(server.name))
        if other is not None and _is_slower(configured, other):
            yield PreflightWarning(
                "hurts",
                f"{server.name} makes the mission slower: {lasting(configured.mission_time_s)} with it, "
                f"{lasting(other.mission_time_s or 0.0)} with it dead",
            )


def _is_slower(this: Prediction, than: Prediction, *, sure: bool = True) -> bool:
    """Whether it is slower by enough for a warning; if `sure`, also by more than the margins of both."""
    if this.mission_time_s is None or than.mission_time_s is None:
        return this.mission_time_s is None and than.mission_time_s is not None
    margin_s = this.certain_margin_s + than.certain_margin_s if sure else 0.0
    least_s = max(_WORTH_SAYING * than.mission_time_s, margin_s)
    return this.mission_time_s - than.mission_time_s > least_s


def _failure_concerns(predictions: Sequence[Prediction]) -> Iterator[PreflightWarning]:
    cases: dict[str, list[str]] = {}  # by reason
    for prediction in predictions:
        if prediction.failures:
            case = f"{prediction.case} ({len(prediction.failures)} of {prediction.missions})"
            cases.setdefault(prediction.failures[0], []).append(case)
    for reason, failed in cases.items():
        yield PreflightWarning(
            "not-completed", f"simulated missions were not completed, {', '.join(failed)}: {reason}"
        )


def _time_concerns(config: DroneConfig, predictions: Sequence[Prediction]) -> Iterator[PreflightWarning]:
    by_s = finish_by_s(config)
    if by_s is None:
        return
    late = [
        f"{prediction.case} ({lasting(prediction.mission_time_s)})"
        for prediction in predictions
        if prediction.mission_time_s is not None and prediction.mission_time_s > by_s + _LATE_S
    ]
    if late:
        given = config.mission.finish_by_s is not None
        limit = f"mission.finish_by_s = {by_s:g}" if given else "what the battery allows"
        yield PreflightWarning(
            "late",
            f"{limit} ({lasting(by_s)}) is not kept, as lighter calls do not save enough: {', '.join(late)}",
        )


def _battery_concerns(config: DroneConfig, predictions: Sequence[Prediction]) -> Iterator[PreflightWarning]:
    lasts_s = usable_s(config)
    too_long = [
        f"{prediction.case} ({lasting(time_s)})"
        for prediction in predictions
        if prediction.mission_time_s is not None
        and lasts_s is not None
        and (time_s := prediction.mission_time_s + prediction.certain_margin_s) > lasts_s
    ]
    if too_long and lasts_s is not None:
        yield PreflightWarning(
            "battery",
            f"the battery lasts {lasting(lasts_s)}{_above_the_reserve(config)}, which is not enough for the mission "
            f"{', '.join(too_long)}",
        )


def _energy_concerns(config: DroneConfig, predictions: Sequence[Prediction]) -> Iterator[PreflightWarning]:
    given_wh = usable_wh(config)
    too_much = [
        f"{prediction.case} ({energy_wh:.1f} Wh)"
        for prediction in predictions
        if prediction.energy_wh is not None
        and given_wh is not None
        and (energy_wh := prediction.energy_wh + (prediction.energy_margin_wh or 0.0)) > given_wh
    ]
    if too_much and config.energy is not None:
        yield PreflightWarning(
            "battery",
            f"the battery gives {given_wh:.1f} Wh down to {_level_percent(config, config.energy):g} %, where the "
            f"flight ends, which is not enough for the mission {', '.join(too_much)}",
        )


def _above_the_reserve(config: DroneConfig) -> str:
    reserve = reserve_percent(config)
    if not reserve:
        return ""
    if reserve == config.mission.reserve_percent:
        return f" above the reserve of {reserve:g} %"
    return f" above the reserve of {config.mission.reserve_s:g} s"


def _way_home_concerns(config: DroneConfig) -> Iterator[PreflightWarning]:
    """Warn of a waypoint that is too far to return from."""
    lasts_s = usable_s(config)
    if config.mission.reserve_s is None:
        return
    if lasts_s is None:
        yield PreflightWarning(
            "endurance",
            "mission.reserve_s is given and vehicle.endurance_s is not: what the way home needs is not known until a "
            "minute has been flown, and nothing says here whether the battery lasts",
        )
        return
    far = farthest(config)
    if far.out_s + far.home_s > lasts_s:
        yield PreflightWarning(
            "too-far",
            f"waypoint {far.waypoint} is {far.away_m:.0f} m from home: {lasting(far.out_s)} there and "
            f"{lasting(far.home_s)} back are more than the battery lasts"
            f"{_above_the_reserve(config)}, {lasting(lasts_s)}",
        )


def _stage_concerns(config: DroneConfig) -> Iterator[PreflightWarning]:
    """Warn of a reserve below the vehicle's own low-battery stage."""
    reserve = reserve_percent(config)
    if config.mission.reserve_s is None or reserve is None or reserve >= PX4_LOW_PERCENT:
        return
    yield PreflightWarning(
        "low-battery-stage",
        f"the reserve is {reserve:.0f} % of the battery, and a PX4 calls its own low at {PX4_LOW_PERCENT:g} %, "
        "unless BAT_LOW_THR was changed; an ArduPilot's stage (BATT_LOW_*) is known only once it is connected. The "
        "higher one counts, and the mission ends the sooner: to plan with it, give reserve_percent = "
        f"{PX4_LOW_PERCENT:g} or more",
    )


def _address_concerns(servers: Sequence[ServerConfig]) -> Iterator[PreflightWarning]:
    by_address: dict[str, list[str]] = {}
    for server in servers:
        if server.address and server.address != MDNS:
            by_address.setdefault(server.address, []).append(server.name)
    for address, names in by_address.items():
        if len(names) > 1:
            yield PreflightWarning(
                "same-address",
                f"{' and '.join(names)} have one address, {address}: right only if one daemon offers them all, "
                "or each has it in a network of its own",
            )
