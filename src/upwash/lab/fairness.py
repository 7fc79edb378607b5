"""What each of several drones saved against flying alone with every call on the drone, and how evenly.

A drone that may go on before answers are there may do so alone, too: what it saves is what servers save it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import msgspec

from upwash.config import DroneConfig, PolicyConfig, Presence
from upwash.lab.run import Run, simulate_fleet
from upwash.sim.chance import plays_a_part

_NEVER_S = 1e6  # for which a drone without servers does not look around
_LEAST_S = 1e-3  # what is less is the rounding of times


def saved_s(
    runs: Mapping[str, Run], fleet: Sequence[DroneConfig], there: Sequence[Presence]
) -> dict[str, float]:
    """By name, the seconds that each drone saved which completed its mission here and would have completed it alone.

    Those that fly the same mission with the same computer and chance are flown alone once.
    """
    alone = _Alone()
    saved: dict[str, float] = {}
    for config, presence in zip(fleet, there, strict=True):
        run = runs[config.name]
        if run.result.completed and (alone_s := alone.time_s(config, presence)) is not None:
            saved[config.name] = alone_s - run.result.mission_time_s
    return saved


def jain(saved: Iterable[float]) -> float | None:
    """Jain's index: 1 where all saved the same, one n-th where one of n saved all; None of nobody.

    Who lost time counts as having saved none, and where nobody saved anything that is even.
    """
    shares = [share if share > _LEAST_S else 0.0 for share in saved]
    if not shares:
        return None
    squares = sum(share**2 for share in shares)
    return sum(shares) ** 2 / (len(shares) * squares) if squares else 1.0


class _Alone:
    """Flies missions alone with every call on the drone, on batteries that do not end them."""

    def __init__(self) -> None:
        self._flown: list[tuple[DroneConfig, Presence, float | None]] = []

    def time_s(self, config: DroneConfig, presence: Presence) -> float | None:
        """The mission's time; None where it is not completed alone either."""
        config, presence = _by_itself(config), _counted(config, presence)
        for other, there, time_s in self._flown:
            if other == config and there == presence:
                return time_s
        (run,) = simulate_fleet([config], there=[presence])
        time_s = run.result.mission_time_s if run.result.completed else None
        self._flown.append((config, presence, time_s))
        return time_s


def _by_itself(config: DroneConfig) -> DroneConfig:
    """The same mission without servers, and without what makes no difference to its time then."""
    replace = msgspec.structs.replace
    return replace(
        config,
        name="alone",
        seed=config.seed if plays_a_part(config) else 0,
        policy=PolicyConfig(name="local-only", period_s=_NEVER_S, stay_or_go=config.policy.stay_or_go),
        servers=(),
        faults=tuple(fault for fault in config.faults if fault.target == "autopilot"),
        energy=None,
        mission=replace(config.mission, reserve_percent=None, reserve_s=None),
        vehicle=replace(config.vehicle, endurance_s=None),
    )


def _counted(config: DroneConfig, presence: Presence) -> Presence:
    """Its departure where faults strike it at seconds of the simulation."""
    struck = any(fault.target == "autopilot" for fault in config.faults)
    return Presence(presence.departs_s) if struck else Presence()
