"""Whether the servers are worth carrying to the field: what they save a drone that is flown well without them too.

A drone that waits at each waypoint gains much by servers, and a drone that flies on before its answers hides most of
what they save. So each side is flown in every manner that the file allows, and the quickest of each is compared.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from upwash.config.checks import only_on_servers
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.reading import Document
from upwash.errors import ConfigError
from upwash.lab.campaigns.campaign import Fly
from upwash.preflight.acts import events_share
from upwash.preflight.prediction import (
    AS_CONFIGURED,
    LOCAL_ONLY,
    Prediction,
    changed,
    predict,
)
from upwash.support.text import counted, lasting

_WORTH_CARRYING = 0.01  # of the mission time without servers; less is no reason to carry a box


class Worth(Struct, frozen=True, kw_only=True):
    """The quickest forecasts of the mission without any server and with all of them, and what servers save by them.

    A `case` is the manner of flying. `margin_s` is the sum of both margins; None for single missions. `spare` are
    the servers that are not worth carrying beside the others, with the seconds that each of them saves.
    """

    alone: Prediction
    served: Prediction
    saved_s: float
    margin_s: float | None
    worth: bool
    spare: dict[str, float] = {}


def is_asked(config: DroneConfig) -> bool:
    """Whether there is a choice: servers that may be left at home, and missions that take the time they need."""
    if any(only_on_servers(service) or service.deadline is not None for service in config.services):
        return False
    return bool(config.servers) and config.policy.name != LOCAL_ONLY and not config.mission.lighter


def manners(document: Document, config: DroneConfig, file: Path) -> Iterator[tuple[str, Document]]:
    """The file in each manner of flying that it allows, first as it is."""
    yield AS_CONFIGURED, changed(document)
    if config.mission.photos is not None and config.event is None:
        return  # on rows, where no answer demands an act, the drone that learns rests more, and is no quicker
    learns = changed(document)
    learns.setdefault("policy", {})["stay_or_go"] = "learn"
    if config.policy.stay_or_go != "learn":
        yield 'policy.stay_or_go = "learn"', learns
    grid = config.mission.grid
    if grid is None or config.mission.photos is not None:
        return
    for name, base in (("", changed(document)), (' and policy.stay_or_go = "learn"', learns)):
        moving = copy.deepcopy(base)
        moving["mission"]["photos"] = {"every_m": grid.spacing_m}
        try:
            drone_config(moving, file)
        except ConfigError:  # such as a camera that is too slow for this speed
            return
        yield f"on the move: mission.photos.every_m = {grid.spacing_m:g}{name}", moving


def flown_well(document: Document, config: DroneConfig, file: Path, worth: Worth | None) -> DroneConfig:
    """The configuration in its quickest manner with servers; as it is if no manner was judged."""
    if worth is None or worth.served.case == AS_CONFIGURED:
        return config
    return drone_config(dict(manners(document, config, file))[worth.served.case], file)


def missions_to_judge(document: Document, config: DroneConfig, file: Path) -> int:
    """How many missions `judge` flies at most, for each seed."""
    if not is_asked(config):
        return 0
    others = len(config.servers) if len(config.servers) > 1 else 0
    return 2 * (len(list(manners(document, config, file))) - 1) + others


def judge(
    document: Document,
    config: DroneConfig,
    file: Path,
    predictions: list[Prediction],
    *,
    seeds: int,
    fly: Fly,
    flown: Callable[[int], None] = lambda _: None,
) -> Worth | None:
    """Flies what the predictions of the configured manner leave open; None where no mission can be compared."""
    if not is_asked(config):
        return None
    documents = dict(manners(document, config, file))
    further = dict(list(documents.items())[1:])
    own = {prediction.case: prediction for prediction in predictions}
    alone = {name: changed(other, policy=LOCAL_ONLY) for name, other in further.items()}

    def quickest(case: str, others: dict[str, Document]) -> Prediction | None:
        found = [own[case], *predict(others, file, seeds=seeds, fly=fly, flown=flown)]
        completed = [each for each in found if each.mission_time_s is not None and not each.failures]
        return min(completed, key=lambda each: each.mission_time_s or 0.0, default=None)

    left, served = quickest(LOCAL_ONLY, alone), quickest(AS_CONFIGURED, further)
    if left is None or served is None:
        return None
    worth = _judged(left, served)
    if not worth.worth or len(config.servers) == 1:
        return worth
    fewer = {server.name: _left_at_home(documents[served.case], server.name) for server in config.servers}
    found = predict(fewer, file, seeds=seeds, fly=fly, flown=flown)
    judged = {other.case: _judged(other, served) for other in found if other.mission_time_s is not None}
    spare = {server: other.saved_s for server, other in judged.items() if not other.worth}
    return replace(worth, spare=spare)


def told_worth(worth: Worth, config: DroneConfig) -> str:
    """The same in a sentence with its condition, and the servers that the others make superfluous."""
    share = events_share(config)
    demands = f"{100 * share:.3g} % of the answers demand an act" if share else "no answer demands an act"
    if config.mission.only_tells:
        demands = "answers only tell"
    is_one = len(config.servers) == 1
    verdict = f"{'is' if is_one else 'are'}{'' if worth.worth else ' not'} worth carrying to the field"
    them = "it" if is_one else "them"
    spare = ", ".join(
        f"{name} (saves {lasting(saved_s)} beside the others)" for name, saved_s in worth.spare.items()
    )
    can_stay = f"; {'one of ' * (len(worth.spare) > 1)}{spare} can stay at home then" if spare else ""
    share_saved = worth.saved_s / (worth.alone.mission_time_s or 1.0)
    return (
        f"{counted(len(config.servers), 'server')} {verdict} if the drone flies in its quickest manner and "
        f"{demands}: {lasting(worth.saved_s, worth.margin_s)} saved, {100 * share_saved:z.0f} %, "
        f"{_time(worth.served)} with {them} and "
        f"{_time(worth.alone)} without {them}{can_stay}"
    )


def _time(prediction: Prediction) -> str:
    manner = AS_CONFIGURED if prediction.case == LOCAL_ONLY else prediction.case
    return f"{lasting(prediction.mission_time_s or 0.0)} ({manner})"


def _left_at_home(document: Document, server: str) -> Document:
    """The document without that server."""
    other = copy.deepcopy(document)
    other["server"] = [each for each in other["server"] if each["name"] != server]
    for each in other["server"]:
        truth = each.get("truth", {})
        if "peers" in truth:
            truth["peers"] = [peer for peer in truth["peers"] if peer != server]
    if "fault" in other:
        other["fault"] = [each for each in other["fault"] if each["target"].rpartition(":")[2] != server]
    return other


def _judged(alone: Prediction, served: Prediction) -> Worth:
    alone_s, served_s = alone.mission_time_s or 0.0, served.mission_time_s or 0.0
    margins = (alone.margin_s, served.margin_s)
    margin_s = None if None in margins else alone.certain_margin_s + served.certain_margin_s
    saved_s = alone_s - served_s
    return Worth(
        alone=alone,
        served=served,
        saved_s=saved_s,
        margin_s=margin_s,
        worth=saved_s > max(_WORTH_CARRYING * alone_s, margin_s or 0.0),
    )
