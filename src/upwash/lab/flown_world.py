"""Worlds that fit the log of a flight, drawn as scenarios.

What was measured is drawn around its mean, wider for few observations. What the log does not know is drawn as
docs/worlds.md draws worlds: servers that were never used, faults, and the heat of the drone's computer.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean, median, stdev
from typing import Any, NamedTuple, TypeVar

import msgspec

from upwash.core.knowledge.servers import State
from upwash.core.planning.legs import Leg
from upwash.lab.flown import LEAST_S, FlownMission, FlownServer
from upwash.lab.worlds import LONGEST_FAULT_S
from upwash.support.heat import Heat, Surroundings

_SERVER_HAS_FAULT = 0.25  # in a mission, as in drawn worlds
_IS_HOT, _AMBIENTS_C, _LOAD_W = 0.25, range(20, 69), 4.0  # 8 W at 50 °C slow calls down as 4 W at 65 °C do
_TWO_RADIOS = _PEERS = 0.15
_BELIEF = 5  # calls, which a profile of the ground is worth
_USUAL_NOISE = 0.15  # of calls, joins and starts
_ABOVE_LEAST = (0.7, 0.85, 0.95, 1.0, 1.03, 1.08, 1.15, 1.25, 1.4, 1.6, 1.9, 2.3, 3.0, 4.0, 6.0)


class _Pace(NamedTuple):
    """How the vehicle may fly, and the logarithm of how probable that is; `noise` is of its legs."""

    log_likelihood: float
    speed_m_s: float
    acceleration_m_s2: float
    noise: float


class _Computer(NamedTuple):
    """The drone's computer at a temperature of the air, with its cool delays; None: the computer never gets hot.

    Other loads need no case of their own: what slows calls down is the distance to the limit, in kelvins per watt.
    """

    log_likelihood: float
    ambient_c: int | None
    call_s: Mapping[str, float]


_Case = TypeVar("_Case", _Pace, _Computer)


@dataclass(slots=True)
class FlownWorld:
    """Draws scenarios that fit the log."""

    flown: FlownMission
    _paces: Sequence[_Pace] = field(init=False)
    _computers: Sequence[_Computer] = field(init=False)
    _keys: dict[str, str] = field(init=False)  # profile keys by operation

    def __post_init__(self) -> None:
        self._paces = _paces(self.flown.legs)
        self._computers = [_computer(self.flown, ambient_c) for ambient_c in (None, *_AMBIENTS_C)]
        named = list(dict.fromkeys([*self.flown.operations, *self.flown.believed_s]))
        own = [operation.partition("[")[2].removesuffix("]") for operation in named]
        self._keys = {
            operation: key if key.isidentifier() and own.count(key) == 1 else f"op{number}"
            for number, (operation, key) in enumerate(zip(named, own, strict=True))
        }

    def draw(self, seed: int, *, as_measured: bool = False) -> dict[str, Any]:
        """A scenario that fits the log, without a policy, as its tables.

        The drone believes what it believed, or `as_measured` what it measured of the servers in the flight.
        """
        flown, keys, chance = self.flown, self._keys, random.Random(f"flown/{seed}")  # noqa: S311 - not for secrets
        computer, pace = _one_of(self._computers, chance), _one_of(self._paces, chance)
        noise = self._noise(computer, chance)
        local_s = {operation: self._local_s(operation, computer, noise, chance) for operation in keys}
        servers = [
            self._server(name, server, local_s, noise, chance) for name, server in flown.servers.items()
        ]
        if (chance.random() < _PEERS) if flown.peers is None else flown.peers:
            for table in servers:
                table["truth"]["peers"] = [other["name"] for other in servers if other is not table]
        if as_measured:
            self._believe_measured(servers)
        calls = [[keys[operation] for operation in calls] for calls in flown.calls.values()]
        alike = len(calls[0]) == 1 and all(called == calls[0] for called in calls)
        acted = [place for index, place in flown.stops.items() if index in flown.demanding]
        circle = {"radius_m": 0.5, "probability": 1.0}
        document: dict[str, Any] = {
            "seed": seed,
            "mission": {
                "program": "upwash.lab.flown:fly_again",
                "mode": calls[0][0] if alike else msgspec.json.encode(calls).decode(),
                "waypoints_m": [list(place) for place in flown.stops.values()],
                "altitude_m": max(0.1, flown.altitude_m),
                "ground_speed_m_s": pace.speed_m_s,
                "action_s": flown.action_s,
            },
            "vehicle": {
                "acceleration_m_s2": pace.acceleration_m_s2,
                "takeoff_s": max(0.0, flown.takeoff_s),
                "return_and_land_s": flown.landing_s,
            },
            "camera": {"photo_s": flown.stop_s},
            "network": {"radios": flown.radios or (2 if chance.random() < _TWO_RADIOS else 1)},
            "noise": {"call": noise, "leg": pace.noise, "join": _USUAL_NOISE, "start": _USUAL_NOISE},
            "service": [
                {
                    "name": "flown",
                    "program": "upwash.lab.flown:Flown",
                    "local_call_s": {keys[operation]: call_s for operation, call_s in local_s.items()},
                }
            ],
            "server": servers,
            "fault": [
                fault
                for name, server in flown.servers.items()
                for fault in _faults(name, server, flown.time_s, chance)
            ],
            "event": {
                "probability": 0.0,
                "areas": [{"east_m": east_m, "north_m": north_m} | circle for east_m, north_m in acted],
            },
            "policy": {"stay_or_go": flown.stay_or_go},
        }
        if computer.ambient_c is not None:
            document["heat"] = {"ambient_c": computer.ambient_c + chance.uniform(-1.5, 1.5)}
        return document

    def _noise(self, computer: _Computer, chance: random.Random) -> float:
        """A relative deviation of calls that fits the log; a few slow outliers are faults rather than noise."""
        flown = self.flown
        groups = [[call_s for _, call_s in calls] for calls in flown.local_s.values()]
        groups += [calls for server in flown.servers.values() for calls in server.call_s.values()]
        groups = [group for group in groups if len(group) > 2]
        off = sorted(math.log(call_s / median(group)) ** 2 for group in groups for call_s in group)
        if len(off) > 20:
            off = off[: int(0.95 * len(off))]
        freedom = max(0, len(off) - len(groups)) + 3
        noise = math.sqrt((sum(off) + 3 * _USUAL_NOISE**2) / freedom) if freedom > 3 else _USUAL_NOISE
        noise *= math.sqrt(freedom / sum(chance.gauss(0, 1) ** 2 for _ in range(freedom)))
        return min(0.5, max(0.01, noise))

    def _local_s(self, operation: str, computer: _Computer, noise: float, chance: random.Random) -> float:
        """A delay on a cool drone: what was believed counts as some more calls."""
        count = len(self.flown.local_s.get(operation, ()))
        believed_s = self.flown.believed_s.get(operation)
        if operation not in computer.call_s:
            return max(LEAST_S, (believed_s or 1.0) * math.exp(chance.gauss(0, 0.05)))
        mean_s = computer.call_s[operation]
        if believed_s:
            mean_s = mean_s ** (count / (count + _BELIEF)) * believed_s ** (_BELIEF / (count + _BELIEF))
            count += _BELIEF
        deviation = noise / math.sqrt(count)
        return max(LEAST_S, mean_s * math.exp(chance.gauss(0, deviation)))

    def _server(
        self,
        name: str,
        server: FlownServer,
        local_s: Mapping[str, float],
        noise: float,
        chance: random.Random,
    ) -> dict[str, Any]:
        share = server.share
        if share is None or share >= 1:  # it was out of range, or believed to be no faster
            share = (
                chance.uniform(0.5, 1.2) if chance.random() < 0.15 else 0.03 * (0.5 / 0.03) ** chance.random()
            )
        as_believed = chance.random() < 0.6
        factor = 1.0 if as_believed else 0.5 * 6 ** chance.random()
        believed_s, true_s = {}, {}
        for operation, call_s in local_s.items():
            key, measured = self._keys[operation], server.call_s.get(operation)
            believed = server.believed_s.get(operation) or share * self.flown.believed_s.get(
                operation, call_s
            )
            mean_s = believed * factor
            if measured:
                off = stdev(map(math.log, measured)) if len(measured) > 2 else 0.2
                mean_s = fmean(measured) * math.exp(
                    chance.gauss(0, max(off, noise) / math.sqrt(len(measured)))
                )
            believed_s[key], true_s[key] = max(LEAST_S, believed), max(LEAST_S, mean_s)
        join_s, start_s = _drawn(server.join_s, chance), _drawn(server.start_s, chance)
        check_s, running_s = server.check_s.get(State.CHECK), server.check_s.get(State.CHECK_R)
        if running_s is None:
            running_s = join_s if join_s is not None else chance.uniform(0.5, 6.0)
        if check_s is None:
            check_s = running_s + (start_s if start_s is not None else chance.uniform(0.0, 15.0))
        running_s = min(running_s, check_s)
        factor = 1.0 if as_believed else chance.uniform(0.5, 2.0)
        return {
            "name": name,
            "east_m": server.circle.centre.east_m,
            "north_m": server.circle.centre.north_m,
            "range_m": max(1.0, server.circle.radius_m),
            "check_running_s": running_s,
            "check_s": check_s,
            "remote_call_s": believed_s,
            "truth": {
                "join_s": join_s if join_s is not None else running_s * factor,
                "start_s": start_s if start_s is not None else (check_s - running_s) * factor,
                "remote_call_s": true_s,
                "range_m": _true_range_m(server, chance),
            },
        }

    def _believe_measured(self, servers: Sequence[dict[str, Any]]) -> None:
        for table in servers:
            server = self.flown.servers[table["name"]]
            for operation, measured in server.call_s.items():
                if operation in self._keys:
                    table["remote_call_s"][self._keys[operation]] = fmean(measured)
            if server.join_s:
                start_s = table["check_s"] - table["check_running_s"]
                table["check_running_s"] = fmean(server.join_s)
                table["check_s"] = table["check_running_s"] + fmean(server.start_s or [start_s])


def _paces(legs: Sequence[tuple[float, float]]) -> list[_Pace]:
    """Speeds and accelerations that explain the legs; those of one length have many such pairs."""
    legs = [leg for leg in legs if leg[0] > 0.5 and leg[1] > 0.1]
    usual_m = median(length_m for length_m, _ in legs) if legs else 0.0
    legs = [leg for leg in legs if leg[0] > usual_m / 2][:60]  # shorter ones are mostly settling
    if not legs:
        return [_Pace(1.0, 4.0, 1.0, 0.02)]
    found = []
    least_m_s2 = median(4 * length_m / took_s**2 for length_m, took_s in legs)  # at any speed
    for factor in _ABOVE_LEAST:
        acceleration_m_s2 = factor * least_m_s2
        low, high = 0.1, 60.0
        for _ in range(25):
            speed_m_s = math.sqrt(low * high)
            ratios = [
                took_s / Leg(length_m, speed_m_s, acceleration_m_s2).duration_s for length_m, took_s in legs
            ]
            low, high = (low, speed_m_s) if median(ratios) > 1 else (speed_m_s, high)
        near = sorted((ratio - 1) ** 2 for ratio in ratios)[: max(1, int(0.9 * len(ratios)))]
        off = max(0.002, math.sqrt(fmean(near)))
        found.append(_Pace(-len(ratios) * math.log(off), speed_m_s, acceleration_m_s2, min(0.3, off)))
    return found


def _computer(flown: FlownMission, ambient_c: int | None) -> _Computer:
    calls = {
        begun: operation for operation, made in flown.local_s.items() for begun in made if begun[1] > LEAST_S
    }
    base = {
        operation: flown.believed_s.get(operation) or fmean(call_s for _, call_s in made)
        for operation, made in flown.local_s.items()
    }
    slow = dict.fromkeys(calls, 1.0)
    for _ in range(3 if ambient_c is not None else 1):
        if ambient_c is not None:
            heat = Heat(Surroundings(ambient_c=ambient_c, load_w=_LOAD_W))
            for begun in flown.busy:
                work_s = base.get(calls.get(begun, ""), begun[1])
                took_s = heat.work(work_s, now_s=max(0.0, begun[0]))
                if begun in slow:
                    slow[begun] = took_s / work_s
        for operation in set(calls.values()):
            base[operation] = fmean(
                begun[1] / slow[begun] for begun in flown.local_s[operation] if begun in slow
            )
    log_likelihood = math.log(1 - _IS_HOT if ambient_c is None else _IS_HOT / len(_AMBIENTS_C))
    off = [math.log(begun[1] / slow[begun] / base[operation]) ** 2 for begun, operation in calls.items()]
    if off:
        log_likelihood -= len(off) * math.log(max(0.02, math.sqrt(fmean(off))))
    for operation, base_s in base.items():
        if believed_s := flown.believed_s.get(operation):
            log_likelihood -= (math.log(base_s / believed_s) / 0.1) ** 2 / 2
    return _Computer(log_likelihood, ambient_c, base)


def _one_of(cases: Sequence[_Case], chance: random.Random) -> _Case:
    """A case, drawn as probable as it is."""
    best = max(case.log_likelihood for case in cases)
    return chance.choices(cases, [math.exp(case.log_likelihood - best) for case in cases])[0]


def _drawn(times_s: Sequence[float], chance: random.Random) -> float | None:
    """A mean that fits the measured times; None without any."""
    if not times_s:
        return None
    return max(0.0, fmean(times_s)) * math.exp(chance.gauss(0, _USUAL_NOISE / math.sqrt(len(times_s))))


def _true_range_m(server: FlownServer, chance: random.Random) -> float:
    """Between the farthest contact and the nearest failure beyond it; mostly as believed where nothing failed."""
    believed_m = max(1.0, server.circle.radius_m)
    reached_m = max((met.distance_m for met in server.contacts if met.good), default=0.0)
    failed_m = [met.distance_m for met in server.contacts if not met.good and met.distance_m > reached_m]
    if failed_m and reached_m and chance.random() < 0.7:
        return max(1.0, chance.uniform(reached_m, min(failed_m)))
    if chance.random() < 0.65:
        return believed_m
    least_m = max(reached_m, 0.6 * believed_m)
    return chance.uniform(least_m, max(least_m, 1.1 * believed_m))


def _faults(name: str, server: FlownServer, time_s: float, chance: random.Random) -> Iterator[dict[str, Any]]:
    """When the server failed: the times that the flight saw, and drawn times at which it did not look."""
    radius_m = server.circle.radius_m
    met = sorted(
        (met for met in server.contacts if met.good or met.distance_m <= radius_m), key=lambda met: met.t
    )
    index = 0
    while index < len(met):
        if met[index].good:
            index += 1
            continue
        first, by_call = index, False
        while index < len(met) and (not met[index].good or (by_call and not met[index].by_call)):
            by_call |= met[index].by_call
            index += 1
        before_s = met[first - 1].t if first else 0.0
        after_s = met[index].t if index < len(met) else LONGEST_FAULT_S
        last_s = max(one.t for one in met[first:index] if not one.good)
        if after_s == LONGEST_FAULT_S and chance.random() < 0.5:
            after_s = last_s + 60.0 * chance.random()
        begins_s = chance.uniform(before_s, max(before_s, met[first].t - LEAST_S))
        ends_s = after_s if after_s == LONGEST_FAULT_S else chance.uniform(last_s, max(last_s, after_s))
        yield _fault(name, "stuck" if by_call else "off", begins_s, ends_s)
    watched = len({int(10 * one.t / max(time_s, 1.0)) for one in met if one.good}) / 10
    if chance.random() < _SERVER_HAS_FAULT * (1 - min(1.0, watched)):
        begins_s = chance.uniform(0.0, time_s)
        lasts_s = chance.choice((2.0, 12.0, 40.0, 120.0, LONGEST_FAULT_S))
        yield _fault(name, chance.choice(("off", "stuck")), begins_s, begins_s + lasts_s)


def _fault(name: str, kind: str, begins_s: float, ends_s: float) -> dict[str, Any]:
    begins_s = max(0.0, begins_s)
    return {"target": name, "kind": kind, "from_s": begins_s, "to_s": max(ends_s, begins_s + LEAST_S)}
