"""The worlds that baselines fly in: named scenarios, one field with computers of several speeds, and drawn worlds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

from bench.baselines.manners import MANNERS, Manner, Part, demanding, stopping
from bench.hedging import WAYS
from bench.hedging import world as faulty_world
from msgspec.structs import replace

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.lab.campaigns.comparison import read_scenarios
from upwash.lab.worlds import HELD_OUT, draw_world

SCENARIOS = Path(__file__).parents[2] / "scenarios"
NAMED = (
    "thesis", "cold-far-server", "demonstration", "dense-city", "fast-flight", "flapping-servers", "loaded-server",
    "power-line", "power-line-heavy", "power-line-light", "two-services",
)  # fmt: skip
QUICK_NAMED = ("demonstration",)
FAULTY = ("answers 3 s late", "no answer", "link silent", "link lost")
LOCAL_S, QUICK_LOCAL_S = (0.1, 0.7, 1.0, 3.0, 10.0), (10.0,)
CALM, ASKED = 0.0, 0.1  # shares of answers that demand an action
WITHOUT_DEMANDS: Sequence[Manner] = ("waits", "learns", "moves")  # going is learning there


def named(seeds: int, *, quick: bool = False) -> Iterator[Part]:
    """The scenarios, once without demands and once where a tenth of the answers demands 5 s at its waypoint."""
    for name in QUICK_NAMED if quick else NAMED:
        config = scenario(name)
        for share, seed in product((CALM, ASKED), range(1, seeds + 1)):
            manners = tuple(MANNERS) if share else WITHOUT_DEMANDS
            own = demanding(config, share, action_s=5.0)
            yield Part(f"{100 * share:g} %", name, replace(own, seed=seed), manners)


def speeds(seeds: int, *, quick: bool = False) -> Iterator[Part]:
    """The thesis's field with a drone's computer of each speed, cool and with the thesis's heat."""
    config = scenario("thesis")
    speeds_s, heats = (QUICK_LOCAL_S, (False,)) if quick else (LOCAL_S, (False, True))
    for local_s, hot, share in product(speeds_s, heats, (CALM, ASKED)):
        services = tuple(
            replace(service, local_call_s={**service.local_call_s, "heavy": local_s})
            for service in config.services
        )
        own = replace(demanding(config, share), services=services, heat=config.heat if hot else None)
        for seed in range(1, seeds + 1):
            world = f"{local_s:g} s, {'hot' if hot else 'cool'}"
            yield Part(f"{100 * share:g} %", world, replace(own, seed=seed), ("waits", "learns", "moves"))


def drawn(count: int) -> Iterator[Part]:
    """Worlds of the held-out set, of one drone each; an answer demands an action where the world says."""
    for seed in list(HELD_OUT)[:count]:
        document = draw_world(seed)
        document["mission"].pop("photos", None)  # each manner has its own
        config = stopping(drone_config(document, Path(f"world-{seed}.toml")))
        local_s = config.services[0].local_call_s[config.mission.mode]
        manners = tuple(MANNERS) if config.event else WITHOUT_DEMANDS
        yield Part("demands" if config.event else "none", f"{seed}, {local_s:g} s", config, manners)


def crowded(seeds: int, count: int, *, quick: bool = False) -> Iterator[Part]:
    """The worlds of the clients that compute twice, without heat, in their favour."""
    for name, seed in product(QUICK_NAMED if quick else NAMED, range(1, seeds + 1)):
        yield Part("scenarios", name, cool(replace(scenario(name), seed=seed)), clients=True)
    for way, seed in product(FAULTY[1:2] if quick else FAULTY, range(1, seeds + 1)):
        yield Part("faulty servers", way, cool(faulty_world(seed, WAYS[way], None)), clients=True)
    for part in drawn(count):
        yield part._replace(
            group="held out", config=cool(replace(part.config, event=None)), manners=(), clients=True
        )


def scenario(name: str) -> DroneConfig:
    """The scenario with noise, of a drone that waits."""
    (found,) = read_scenarios([SCENARIOS / f"{name}.toml"])
    return demanding(stopping(found.config), CALM)


def cool(config: DroneConfig) -> DroneConfig:
    """The world where the drone's computer does not get hot."""
    return replace(config, heat=None)
