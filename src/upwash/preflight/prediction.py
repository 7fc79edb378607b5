"""How long the mission will take, with all that may be missing: from simulated missions."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from msgspec import Struct

from upwash.config.drone import DroneConfig
from upwash.config.places import waypoints
from upwash.config.reading import Document
from upwash.lab.campaigns.campaign import Fly, fly_sweep
from upwash.lab.campaigns.file import CampaignRow
from upwash.lab.campaigns.sweep import Combination, ParameterSweep
from upwash.support.confidence import Mean

LOCAL_ONLY, AS_CONFIGURED, ALONE = "local-only", "as configured", "without any server"
MOST_WORLDS = 5
_PHOTOS = 240  # of one case's missions together: the chance of calls and legs evens out over many


class Prediction(Struct, frozen=True, kw_only=True):
    """The simulated missions of one case.

    `mission_time_s` is the mean of the completed ones, None without any; the true mean lies within `margin_s` of it
    with a probability of 95 %. The margin is None for a single mission. `energy_wh` is the mean energy from the
    battery, with `[energy]` in the file, and `lighter` the mean number of lighter calls, with `mission.lighter`.
    `failures` are the reasons of missions that were not completed.
    """

    case: str
    missions: int
    mission_time_s: float | None
    margin_s: float | None
    failures: tuple[str, ...] = ()
    energy_wh: float | None = None
    energy_margin_wh: float | None = None
    lighter: float | None = None

    @property
    def certain_margin_s(self) -> float:
        """The margin, 0 for a single mission."""
        return self.margin_s or 0.0


def drawn_worlds(config: DroneConfig) -> int:
    """How many worlds each case is flown in where chance plays a part: the fewer, the more photos there are."""
    return max(1, min(MOST_WORLDS, _PHOTOS // len(waypoints(config.mission))))


def without(server: str) -> str:
    """The case without that server."""
    return f"without {server}"


def predict(
    documents: dict[str, Document],
    file: Path,
    *,
    seeds: int,
    fly: Fly,
    flown: Callable[[int], None] = lambda _: None,
    done: Sequence[CampaignRow] = (),
) -> list[Prediction]:
    """Flies each of the named documents with the seeds 1 to `seeds`, but what is `done`."""
    combinations = tuple(Combination((case,), document) for case, document in documents.items())
    summaries = fly_sweep(ParameterSweep(file, (), combinations, seeds), fly=fly, flown=flown, done=done)
    return [
        prediction_of(
            summary.values[0],
            seeds,
            time_s=summary.mission_time_s,
            energy_wh=summary.energy_wh,
            lighter=summary.lighter,
            failures=list(summary.failures.values()),
        )
        for summary in summaries
    ]


def prediction_of(
    case: str,
    missions: int,
    *,
    time_s: Mean | None,
    energy_wh: Mean | None,
    lighter: Mean | None,
    failures: Sequence[str],
) -> Prediction:
    """The prediction by the means over the completed missions."""
    return Prediction(
        case=case,
        missions=missions,
        mission_time_s=time_s.value if time_s else None,
        margin_s=time_s.margin if time_s and time_s.count > 1 else None,
        failures=tuple(failures),
        energy_wh=energy_wh.value if energy_wh else None,
        energy_margin_wh=energy_wh.margin if energy_wh and energy_wh.count > 1 else None,
        lighter=lighter.value if lighter else None,
    )


def cases(document: Document, config: DroneConfig) -> Iterator[tuple[str, Document]]:
    """The mission local-only, as configured, with each server dead and with all of them dead."""
    names = [server.name for server in config.servers]
    yield LOCAL_ONLY, changed(document, policy=LOCAL_ONLY)
    if config.policy.name == LOCAL_ONLY:
        return
    yield AS_CONFIGURED, changed(document)
    for name in names:
        yield without(name), changed(document, dead=[name])
    if len(names) > 1:
        yield ALONE, changed(document, dead=names)


def changed(document: Document, *, policy: str | None = None, dead: Sequence[str] = ()) -> Document:
    """The document under another policy, or with dead servers; flown to the end, as if no battery ended it."""
    other = copy.deepcopy(document)
    for reserve in ("reserve_percent", "reserve_s"):
        other["mission"].pop(reserve, None)
    other.get("energy", {}).pop("battery_wh", None)
    if policy is not None:
        other.setdefault("policy", {})["name"] = policy
    if dead:
        other["fault"] = [{"target": name, "kind": "off"} for name in dead] + other.get("fault", [])
    return other
