"""Acts on rows, where they cost least or at once: `python -m bench.acts`.

The fields are those of rows_rules.py, and an answer demands an act of some seconds with some probability. Each
mission is flown three times, with the same demands: by upwash, by upwash with `policy.act_within_s = 0`, and by a
drone alone that acts at once.
"""

from __future__ import annotations

import random
from statistics import fmean, median
from typing import Any

from bench.program import command_line
from bench.rows_rules import LOSES, drawn, scenario

from upwash.eventlog import schema
from upwash.lab.processes import in_processes
from upwash.lab.simulation import simulate

FIELDS, QUICK_FIELDS = 120, 2
CHANCES, ACTION_S = (0.02, 0.05, 0.1, 0.2), (0.0, 5.0, 10.0)


def with_acts(number: int, **policy: Any) -> dict[str, Any]:
    """The scenario of the field of that number, with its demands."""
    chance = random.Random(f"acts {number}")
    document = scenario(drawn(number))
    document["policy"] |= policy
    document["mission"]["action_s"] = chance.choice(ACTION_S)
    return document | {"event": {"probability": chance.choice(CHANCES)}}


def fly(number: int) -> tuple[int, list[float], list[float]]:
    """The field; the seconds of its missions, and those from the photos to their acts, in the mean."""
    ways: list[dict[str, Any]] = [{}, {"act_within_s": 0.0}, {"act_within_s": 0.0, "name": "local-only"}]
    runs = [simulate(with_acts(number, **way), seed=number) for way in ways]
    assert all(run.completed for run in runs)
    return number, [run.mission_time_s for run in runs], [waited_s(run.events) for run in runs]


def waited_s(events: Any) -> float:
    """The mean time from a photo to its act."""
    taken_s, waits_s = {}, []
    for event in events:
        if isinstance(event, schema.CallStarted):
            taken_s[event.waypoint] = event.t
        elif isinstance(event, schema.Acted):
            waits_s.append(event.t - taken_s[event.waypoint])
    return fmean(waits_s) if waits_s else 0.0


def main() -> None:
    """Flies all fields and prints how the times compare."""
    options = command_line("acts", __doc__).parse_args()
    numbers = list(range(1, 1 + (QUICK_FIELDS if options.quick else FIELDS)))
    with in_processes(fly, numbers) as results:
        flown = {number: (times, waits) for number, times, waits in results}
    for name, number in (("acting at once", 1), ("the drone alone", 2)):
        for kind, are in (("all", None), ("spots", False), ("surveys", True)):
            times = [t for n, (t, _) in flown.items() if are in (None, drawn(n).is_survey)]
            shares = [each[0] / each[number] - 1 for each in times]
            if shares:
                losing = sum(1 + share > LOSES for share in shares)
                gains = f"{fmean(shares):+.1%} in the mean, best {min(shares):+.1%}, worst {max(shares):+.1%}"
                print(f"beside {name}, {kind} ({len(shares)}): {gains}; {losing} lose 1 % or more")
    cheapest, at_once = zip(*(waits[:2] for _, waits in flown.values()), strict=True)
    print(
        f"photo to act, median of the missions' means: {median(cheapest):.0f} s, at once {median(at_once):.0f} s"
    )


if __name__ == "__main__":
    main()
