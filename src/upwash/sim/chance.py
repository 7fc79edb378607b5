"""All random numbers of a run, from its seed. Each consumer draws from a stream of its own name."""

from __future__ import annotations

import math
import random

from upwash.config.drone import DroneConfig
from upwash.config.world import NoiseConfig


class Chance:
    """Random streams by name: a new consumer does not change what the others draw."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._streams: dict[str, random.Random] = {}

    def stream(self, name: str) -> random.Random:
        """The stream of that name; later calls continue it."""
        if name not in self._streams:
            self._streams[name] = random.Random(f"{self._seed}/{name}")  # noqa: S311 - not for secrets
        return self._streams[name]

    def factor(self, name: str, deviation: float) -> float:
        """A positive factor with mean 1 and that relative standard deviation (log-normal); 1 for deviation 0."""
        if deviation == 0:
            return 1.0
        sigma = math.sqrt(math.log1p(deviation**2))
        return self.stream(name).lognormvariate(-(sigma**2) / 2, sigma)


def plays_a_part(config: DroneConfig) -> bool:
    """Whether simulated missions of the scenario differ from seed to seed."""
    drawn = config.event is not None and config.event.probability is not None
    return drawn or config.noise != NoiseConfig()
