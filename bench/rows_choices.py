"""What settings of missions on rows gain in drawn worlds with demands: `python -m bench.rows_choices`.

Each world of one drone on rows whose answers may demand an action is flown with the defaults, and with one setting
changed: the same seed, and the same demands. With `speed = "auto"` the world's own speed is the highest.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from typing import Any

from bench.program import command_line, machine

from upwash.config.reading import Document
from upwash.errors import UpwashError
from upwash.lab import processes
from upwash.lab.run import simulate
from upwash.lab.scenario import read_scenario
from upwash.lab.worlds import draw_world
from upwash.support.confidence import mean_of

FIRST, WORLDS, QUICK_WORLDS = 300_001, 80, 2
MUCH = 1.0  # %
DEFAULTS: Mapping[str, Any] = {"policy.stay_or_go": "stay", "mission.photos.order": "oldest"}
CHOICES: Mapping[str, Mapping[str, Any]] = {
    'photos.order = "newest"': {"mission.photos.order": "newest"},
    'policy.stay_or_go = "go"': {"policy.stay_or_go": "go"},
    'policy.stay_or_go = "learn"': {"policy.stay_or_go": "learn"},
    'mission.speed = "auto"': {"mission.speed": "auto"},
}


def main() -> None:
    """Prints a row for each choice."""
    parser = command_line("rows_choices", __doc__)
    parser.add_argument("--worlds", type=int, default=WORLDS)
    parser.add_argument("--first", type=int, default=FIRST, help="the number of the first world")
    parser.add_argument("--policy", default="look-ahead")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    wanted = QUICK_WORLDS if options.quick else options.worlds
    logging.disable()  # of the servers' faults
    print(f"{machine()}; {options.policy}, {wanted} worlds from {options.first} on\n")
    parts = [
        (number, options.policy) for number, _ in zip(_worlds(options.first), range(wanted), strict=False)
    ]
    gains: dict[str, list[float]] = {name: [] for name in CHOICES}
    with processes.here_first(gained, parts, workers=options.workers) as results:
        for found in results:
            for name, gain in found.items():
                gains[name].append(gain)
    print("| in place of the default | worlds | saved | 1 % or more saved | lost | best | worst |")
    print("|---|---|---|---|---|---|---|")
    for name, saved in gains.items():
        print(_row(name, saved))


def _worlds(first: int) -> Iterator[int]:
    """The numbers of worlds of one drone on rows, with demands."""
    for number in count(first):
        document = draw_world(number)
        if "drone" not in document and "photos" in document["mission"] and document.get("event"):
            yield number


def gained(part: tuple[int, str]) -> dict[str, float]:
    """What each choice saves in a world, in % of the mission's time; choices that are refused are left out."""
    number, policy = part
    document = draw_world(number)
    flown_s = _flown_s(document, number, policy, DEFAULTS)
    assert flown_s is not None
    times_s = {
        name: _flown_s(document, number, policy, {**DEFAULTS, **keys}) for name, keys in CHOICES.items()
    }
    return {name: 100 * (1 - time_s / flown_s) for name, time_s in times_s.items() if time_s is not None}


def _flown_s(document: Document, number: int, policy: str, keys: Mapping[str, Any]) -> float | None:
    try:
        config = read_scenario(document, policy=policy, seed=number, overrides=dict(keys))
        run = simulate(config)
    except UpwashError:
        return None
    return run.result.mission_time_s if run.result.completed else None


def _row(name: str, saved: Sequence[float]) -> str:
    if not saved:
        return f"| `{name}` | 0 |" + " - |" * 5
    mean = mean_of(saved)
    margin = "" if math.isinf(mean.margin) else f" ± {mean.margin:.1f}"
    much, lost = (sum(sign * save >= MUCH for save in saved) for sign in (1, -1))
    ends = f"{max(saved):.1f} % | {min(saved):.1f} %"
    return f"| `{name}` | {len(saved)} | {mean.value:.1f}{margin} % | {much} | {lost} | {ends} |"


if __name__ == "__main__":
    main()
