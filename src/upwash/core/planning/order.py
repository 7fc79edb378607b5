"""The order of a mission's waypoints: as given, or the sweep with the shortest forecast.

A sweep flies a field of waypoints back and forth, from one of four corners, by rows or by columns. Rows and columns
are found from the places themselves, however the field lies: a row runs east and west, or nearly so. The forecast is
of the whole mission: every leg, every call where the quickest schedule has it, and the way home.
"""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from msgspec import Struct

from upwash.core.geo import Position, Reach, Waypoint, ground_way
from upwash.core.knowledge.estimates import Estimates
from upwash.core.knowledge.servers import Server
from upwash.core.planning.forecast import make_forecast
from upwash.core.planning.mission_model import MissionBeliefs, MissionModel
from upwash.core.planning.schedule import quickest

SWEEPS = 8
_SAME_LINE = 0.25  # of the distance to the nearest waypoint: places less far off a row belong to it

_Lines = list[list[Waypoint]]


class Sweep(Struct, frozen=True):
    """All waypoints of a field, line by line, each line in the opposite direction to the one before."""

    number: int
    name: str
    waypoints: tuple[Waypoint, ...]

    def __str__(self) -> str:
        return f"sweep {self.number}, {self.name}"


def sweeps(given: Sequence[Waypoint]) -> tuple[Sweep, ...]:
    """The eight sweeps of the waypoints; empty if they form no full grid of rows and columns.

    The first sweep begins at the corner and in the direction of the given order, and is that order if that is a
    sweep. Sweeps from the other corners follow, then those across.
    """
    rows = _rows(given)
    if not rows:
        return ()
    columns = [list(column) for column in zip(*rows, strict=True)]
    top = any(given[0] in row for row in rows[(len(rows) + 1) // 2 :])
    right = any(given[0] in column for column in columns[(len(columns) + 1) // 2 :])
    by_rows = len(columns) > 1 and any(given[0] in row and given[1] in row for row in rows)
    corners = ((False, False), (True, True), (True, False), (False, True))
    ways = itertools.product((by_rows, not by_rows), corners)
    found = []
    for number, (along, (up, across)) in enumerate(ways):
        from_top, from_right = top ^ up, right ^ across
        lines, from_last, from_end = (
            (rows, from_top, from_right) if along else (columns, from_right, from_top)
        )
        waypoints: list[Waypoint] = []
        for line in reversed(lines) if from_last else lines:
            waypoints += reversed(line) if from_end else line
            from_end = not from_end
        corner = f"{'top' if from_top else 'bottom'}-{'right' if from_right else 'left'}"
        name = f"by {'rows' if along else 'columns'} from the {corner}"
        found.append(Sweep(number, name, tuple(waypoints)))
    return tuple(found)


def _rows(given: Sequence[Waypoint]) -> _Lines:
    """Rows from south to north, each from west to east; empty without a full grid."""
    if len(given) < 2:
        return []
    # In a full grid the waypoint nearest to any other one is its neighbour in a row or in a column.
    first, *others = (waypoint.position for waypoint in given)
    to_near = min((ground_way(first, place) for place in others), key=abs)
    if not to_near:
        return []
    same_m, turned = _SAME_LINE * abs(to_near), math.remainder(cmath.phase(to_near), math.pi / 2)
    east, north = math.cos(turned), math.sin(turned)
    places = [waypoint.position for waypoint in given]
    columns = _lines([place.east_m * east + place.north_m * north for place in places], same_m)
    rows = _lines([place.north_m * east - place.east_m * north for place in places], same_m)
    cells = {(row, column): waypoint for row, column, waypoint in zip(rows, columns, given, strict=True)}
    width, height = 1 + max(columns), 1 + max(rows)
    if not len(cells) == len(given) == width * height:
        return []
    return [[cells[row, column] for column in range(width)] for row in range(height)]


def _lines(across_m: Sequence[float], same_m: float) -> list[int]:
    """For each place, the number of the line that it lies on."""
    numbers = [0] * len(across_m)
    in_order = sorted(range(len(across_m)), key=across_m.__getitem__)
    for before, number in itertools.pairwise(in_order):
        numbers[number] = numbers[before] + (across_m[number] - across_m[before] > same_m)
    return numbers


LEAST_SAVED = 0.02  # of the given order's time: what is less is within what a forecast can be wrong by


class Order(Struct, frozen=True):
    """The waypoints in the order of the flight, each with its index in the plan.

    `why` explains the order, "" for the given order by default; `sweep` is the number of its sweep, None for none.
    """

    waypoints: tuple[Waypoint, ...]
    why: str = ""
    sweep: int | None = None


class Forecaster(Struct, frozen=True):
    """Forecasts the duration of a mission over waypoints in some order, from above where the vehicle stands.

    `home_s` gives the seconds from a waypoint to the ground at the mission's end.
    """

    beliefs: MissionBeliefs
    estimates: Estimates
    areas: Mapping[str, Reach]
    gain_wait: float
    stands: Position
    home_s: Callable[[Position], float]

    def mission_s(self, waypoints: Sequence[Waypoint]) -> float:
        """The forecast in seconds, from the first leg to the ground."""
        first, last = waypoints[0].position, waypoints[-1].position
        model = MissionModel(replace(self.beliefs, plan=waypoints), self.areas)
        start = self.stands.at_altitude(first.altitude_m)
        model.leg_begun(start, first, waypoints[0].ground_speed_m_s, now_s=0.0, via=waypoints[0].via)
        calls = len(waypoints) * len(self.beliefs.stop)
        forecast = make_forecast(
            model.coming(start, now_s=0.0, count=calls),
            {name: Server(name, area) for name, area in self.areas.items()},
            self.estimates,
            (),
            now_s=0.0,
            banned_s={},
            idle_s=0.0,
        )
        schedule = quickest(forecast.calls, forecast.checks, gain_wait=self.gain_wait)
        return sum(call.gap_s for call in forecast.calls) + schedule.total_s + self.home_s(last)


def best_order(
    given: Sequence[Waypoint], candidates: Sequence[Sweep], mission_s: Callable[[Sequence[Waypoint]], float]
) -> Order:
    """The quickest sweep if it saves at least LEAST_SAVED (2 %) of the given order's time, else the given order."""
    given_s = mission_s(given)
    times_s = [(mission_s(sweep.waypoints), sweep) for sweep in candidates]
    best_s, best = min(times_s, key=lambda pair: pair[0], default=(given_s, None))
    saved = 1 - best_s / given_s
    if best is None or saved <= 0:
        return Order(tuple(given), "as given: by forecast no sweep is quicker")
    best_min, given_min = (f"{int(s) // 60}:{int(s) % 60:02}" for s in (best_s, given_s))
    gain = f"{100 * saved:.1f} % by forecast ({best_min} instead of {given_min})"
    if saved < LEAST_SAVED:
        least = f"less than {100 * LEAST_SAVED:g} %"
        return Order(tuple(given), f"as given: the best, {best}, saves {gain}, {least}")
    return Order(best.waypoints, f"{best}: saves {gain}", best.number)
