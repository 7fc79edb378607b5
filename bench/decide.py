"""What a decision of the look-ahead policy costs: `python -m bench.decide`.

A drone flies over a field of 50 servers and decides at each event: begin of a leg, arrival, call, end of a call. It
looks 20 calls ahead. Times are processor time, the least of three flights with the same decisions.
"""

from __future__ import annotations

import itertools
import random
import time
from collections.abc import Callable, Iterator
from statistics import median

from bench.program import command_line, machine

from upwash.core.geo import Circle, Position, Waypoint
from upwash.core.knowledge.estimates import Beliefs, Estimates
from upwash.core.operation import Operation
from upwash.core.planning.mission_model import MissionBeliefs, StopCall
from upwash.core.policies.look_ahead import HORIZON
from upwash.core.policies.names import make_policy
from upwash.core.selection.events import CheckAnswered, LegBegun, LegEnded, LocalCallEnded, RemoteCallEnded
from upwash.core.selection.selection import Selection

HEAVY = Operation("detector", "process_photo", "heavy")
SERVERS, SIDE, SPACING_M = 50, 20, 20.0
LOCAL_S, REMOTE_S, LEG_S, PHOTO_S = 10.0, 1.0, 9.0, 1.0
MOST_MS = 5.0
FLIGHTS = 3
QUICK_SIDE, QUICK_FLIGHTS = 3, 1
RANGES_M = {"50 m": (50.0, 50.0), "50 to 300 m": (50.0, 300.0), "everywhere": (2000.0, 2000.0)}


def main() -> None:
    """Measures and prints; a missed limit is printed as such and is no failure."""
    quick = command_line("decide", __doc__).parse_args().quick
    side, flown = (QUICK_SIDE, QUICK_FLIGHTS) if quick else (SIDE, FLIGHTS)
    print(f"{SERVERS} servers, {HORIZON} calls ahead; limit {MOST_MS:g} ms; {machine()}")
    for name, (least_m, most_m) in RANGES_M.items():
        flights = [fly(least_m, most_m, side) for _ in range(flown)]
        took_ms = [1e3 * min(same) for same in zip(*flights, strict=True)]
        late = sum(each > MOST_MS for each in took_ms)
        print(
            f"range {name:12s} median {median(took_ms):.2f} ms, 95 % within "
            f"{sorted(took_ms)[int(0.95 * len(took_ms))]:.2f} ms, longest {max(took_ms):.2f} ms, "
            f"{late} of {len(took_ms)} over the limit"
        )


def fly(least_m: float, most_m: float, side: int) -> Iterator[float]:
    """The seconds of each decision of a flight among servers with ranges between these."""
    selection, plan = world(least_m, most_m, side)
    now_s = 0.0
    for start, end in itertools.pairwise(plan):
        begun = LegBegun(end.position, None)
        yield timed(selection.handle, begun, now_s=now_s, position=start.position)
        now_s += LEG_S
        yield timed(selection.handle, LegEnded(), now_s=now_s, position=end.position)
        current = selection.current
        if current is not None and selection.is_awaited(current.check):
            answered = CheckAnswered(current.check, running=True)
            yield timed(selection.handle, answered, now_s=now_s, position=end.position)
        now_s += PHOTO_S
        yield timed(selection.decide, HEAVY, now_s=now_s, position=end.position)
        current = selection.current
        delay_s = LOCAL_S if current is None else REMOTE_S
        now_s += delay_s
        ended = (
            LocalCallEnded(HEAVY, delay_s)
            if current is None
            else RemoteCallEnded(current.name, HEAVY, delay_s)
        )
        yield timed(selection.handle, ended, now_s=now_s, position=end.position)


def timed(ask: Callable[..., object], *about: object, **known: object) -> float:
    """The seconds of processor time that the answer takes."""
    begun_s = time.process_time()
    ask(*about, **known)
    return time.process_time() - begun_s


def world(least_m: float, most_m: float, side: int) -> tuple[Selection, list[Waypoint]]:
    """A square field of waypoints among unlike servers."""
    chance = random.Random(1)
    width_m = (side - 1) * SPACING_M
    areas = {
        f"s{number}": Circle(
            Position(chance.uniform(0, width_m), chance.uniform(0, width_m)), chance.uniform(least_m, most_m)
        )
        for number in range(SERVERS)
    }
    beliefs = {name: Beliefs(11.5, 3.5, {HEAVY: chance.uniform(0.5, 6.0)}) for name in areas}
    plan = [
        Waypoint(number, Position(SPACING_M * (number % side), SPACING_M * (number // side), 20.0))
        for number in range(side * side)
    ]
    selection = Selection(
        areas,
        estimates=Estimates(local_s={HEAVY: LOCAL_S}, servers=beliefs),
        policy=make_policy("look-ahead", gain_switch=0.25, gain_wait=0.25),
        mission=MissionBeliefs(plan, stop=[StopCall(HEAVY, PHOTO_S)]),
    )
    return selection, plan


if __name__ == "__main__":
    main()
