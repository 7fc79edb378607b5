"""What answers have the drone do, and the mission with acts where nothing says how many answers demand one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from statistics import fmean

from msgspec import Struct

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.places import waypoints
from upwash.config.reading import Document
from upwash.lab.believed import demand_chances
from upwash.lab.campaigns.campaign import Fly
from upwash.lab.run import simulate
from upwash.lab.speed import with_speed
from upwash.preflight.prediction import (
    AS_CONFIGURED,
    LOCAL_ONLY,
    Prediction,
    changed,
    drawn_worlds,
    predict,
)
from upwash.support.text import counted, lasting

_ASSUMED = 0.75  # a survey whose rows overlap shows each object on several photos


class WithActs(Struct, frozen=True, kw_only=True):
    """Forecasts of the mission with acts; a `share` of the answers demands one.

    `source` says where the share is from: `policy.demand_map` or `assumed`.
    """

    share: float
    source: str
    predictions: tuple[Prediction, ...]


def demanding_share(config: DroneConfig) -> float | None:
    """The share of answers that demand an act at their waypoint. None if the drone stays or only tells."""
    stays = config.policy.stay_or_go == "stay"
    return None if stays or config.mission.only_tells else events_share(config)


def events_share(config: DroneConfig) -> float:
    """The share of answers that demand an act at their waypoint, by `[event]`."""
    if config.event is None:
        return 0.0
    if config.event.every is not None:
        return 1 / config.event.every
    if config.event.objects:  # each has one act
        return min(1.0, len(config.event.objects) / len(waypoints(config.mission)))
    chances = [config.event.chance(waypoint.position) for waypoint in waypoints(config.mission)]
    return fmean(chances) if config.event.areas else config.event.probability or 0.0


def acts_cost(config: DroneConfig) -> bool:
    """Whether acts make the mission longer, and nothing says how many there are."""
    goes_on = config.mission.photos is not None or config.policy.stay_or_go != "stay"
    costs = (goes_on and not config.mission.only_tells) or config.mission.action_s > 0
    return costs and config.event is None


def act_worlds(config: DroneConfig, seeds: int) -> int:
    """How many worlds each case is flown in with acts: chance decides which answers demand one."""
    return max(seeds, drawn_worlds(config))


def fly_with_acts(
    document: Document,
    config: DroneConfig,
    file: Path,
    *,
    seeds: int,
    fly: Fly,
    flown: Callable[[int], None] = lambda _: None,
) -> WithActs | None:
    """Fly the mission with acts, alone and as configured; None where `acts_cost` is false."""
    if not acts_cost(config):
        return None
    chances = demand_chances(config)
    share, source = (fmean(chances), "policy.demand_map") if chances else (_ASSUMED, "assumed")
    documents = {LOCAL_ONLY: changed(document, policy=LOCAL_ONLY)}
    if config.policy.name != LOCAL_ONLY:
        documents[AS_CONFIGURED] = changed(document)
    for each in documents.values():
        known, _ = with_speed(drone_config(each, file), simulate)  # the drone chooses without the event
        each["mission"] |= {
            "speed": known.mission.speed,
            "ground_speed_m_s": known.mission.ground_speed_m_s,
        }
        each["event"] = {"probability": share}
    flown_with = predict(documents, file, seeds=act_worlds(config, seeds), fly=fly, flown=flown)
    return WithActs(share=share, source=source, predictions=tuple(flown_with))


def told_acts(config: DroneConfig, without: tuple[Prediction, ...] = (), acts: WithActs | None = None) -> str:
    """What answers have the drone do, in a sentence; empty where the drone stays and acts take no time."""
    if config.mission.only_tells:
        why = "mission.action_s is 0 and there is no mission.second_look"
        return f"answers only tell what was found, as {why}: the drone turns back for none"
    if config.mission.photos is not None:
        does = "the drone goes on before answers are there, and turns back for acts; "
    elif config.policy.stay_or_go != "stay":
        does = "the drone may go on before answers are there (policy.stay_or_go); "
    elif config.mission.action_s > 0:
        does = ""
    else:
        return ""
    if config.event is not None:
        said = f"here {100 * events_share(config):.3g} % of the answers demand an act, as [event] says"
        return f"{does}{said}{_MAP_UNUSED if config.policy.demand_map else ''}"
    said = "the forecasts above have no act, as there is no [event]"
    if acts is None:
        return f"{does}{said}"
    some = "three of four answers demand" if acts.source == "assumed" else f"{100 * acts.share:.3g} % demand"
    why = "" if acts.source == "assumed" else f", as {acts.source} says"
    worlds = counted(acts.predictions[0].missions, "drawn world")
    return (
        f"{does}{said}: {_times(without)} if answers only tell, {_times(acts.predictions)} if {some} an act{why} "
        f"({worlds})"
    )


_MAP_UNUSED = "; policy.demand_map counts in the choice of a speed alone"


def _times(predictions: tuple[Prediction, ...]) -> str:
    told = {
        each.case: "not completed"
        if each.mission_time_s is None
        else lasting(each.mission_time_s, each.margin_s)
        for each in predictions
    }
    if AS_CONFIGURED not in told:
        return told[LOCAL_ONLY]
    return f"{told[AS_CONFIGURED]} ({told[LOCAL_ONLY]} without servers)"
