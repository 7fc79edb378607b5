"""Times of missions on rows beside a simple rule of earliest completion: `python -m bench.rows_rules`.

Fields are drawn: spots 12 to 60 m apart, and surveys whose photos overlap by 60 to 80 %; one or two servers. Answers
have no demands, and calls do not fail. A model of the rule, which shares no code with upwash, flies each mission too.
In the model a free place takes the first photo of the line that it answers before the other place gets to it. At the
end of the way the drone flies to a range if that ends the line sooner. `--json` writes the times, and `--beside FILE`
compares with the times of another version.
"""

from __future__ import annotations

import copy
import json
import math
import random
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from bench.program import command_line

from upwash.lab.processes import in_processes
from upwash.lab.simulation import simulate

FIELDS, QUICK_FIELDS = 120, 2
SURVEYS = 4  # each fourth field is one
STEP_S, PHOTO_S, TAKEOFF_S, LANDING_S, ACCELERATION_M_S2 = 0.02, 0.3, 10.0, 16.0, 1.5
CHECK_S, RUNNING_S, SWITCH, INSIDE = 11.5, 3.5, 0.25, 0.9
LOSES = 1.01


class Server(NamedTuple):
    """A server of a lane."""

    east_m: float
    north_m: float
    range_m: float
    call_s: float


class Field(NamedTuple):
    """Rows of spots, back and forth from the origin, and who answers photos of them."""

    is_survey: bool
    every_m: float
    across_m: float
    spots: int
    rows: int
    speed_m_s: float
    local_s: float
    servers: tuple[Server, ...]

    @property
    def row_m(self) -> float:
        """The length of a row."""
        return self.every_m * (self.spots - 1)


def drawn(number: int) -> Field:
    """The field of that number."""
    chance = random.Random(number)
    is_survey = number % SURVEYS == 0
    every_m = chance.uniform(4.0, 9.0) if is_survey else chance.uniform(12.0, 60.0)
    across_m = chance.uniform(8.0, 16.0) if is_survey else every_m
    spots, rows = (
        (chance.randint(15, 30), chance.randint(4, 8))
        if is_survey
        else (chance.randint(4, 9), chance.randint(3, 8))
    )
    east_m, north_m = every_m * (spots - 1), across_m * (rows - 1)
    servers = tuple(
        Server(
            round(chance.uniform(0.0, east_m), 1),
            round(chance.uniform(0.0, north_m), 1),
            round(chance.uniform(0.3, 1.2) * max(east_m, north_m, 40.0), 1),
            round(_between(chance, 0.2, 8.0), 2),
        )
        for _ in range(chance.choice([1, 2]))
    )
    local_s = round(_between(chance, 0.2, 33.0), 2)
    return Field(
        is_survey,
        round(every_m, 1),
        round(across_m, 1),
        spots,
        rows,
        chance.choice([4.0, 5.0, 6.0, 8.0]),
        local_s,
        servers,
    )


def _between(chance: random.Random, least: float, most: float) -> float:
    return math.exp(chance.uniform(math.log(least), math.log(most)))


def scenario(field: Field, policy: str = "look-ahead") -> dict[str, Any]:
    """The same as a scenario."""
    ends = []
    for row in range(field.rows):
        across = [(0.0, row * field.across_m), (field.row_m, row * field.across_m)]
        ends += across if row % 2 == 0 else across[::-1]
    return {
        "mission": {
            "ground_speed_m_s": field.speed_m_s,
            "waypoints_m": ends,
            "photos": {"every_m": field.every_m, "at_most": 1000},
        },
        "camera": {"photo_s": PHOTO_S},
        "vehicle": {
            "acceleration_m_s2": ACCELERATION_M_S2,
            "takeoff_s": TAKEOFF_S,
            "return_and_land_s": LANDING_S,
        },
        "service": [
            {"name": "detector", "local_call_s": {"light": field.local_s / 2, "heavy": field.local_s}}
        ],
        "server": [
            {
                "name": f"s{number}",
                "east_m": server.east_m,
                "north_m": server.north_m,
                "range_m": server.range_m,
                "check_s": CHECK_S,
                "check_running_s": RUNNING_S,
                "remote_call_s": {"light": server.call_s / 2, "heavy": server.call_s},
            }
            for number, server in enumerate(field.servers)
        ],
        "policy": {"name": policy},
    }


class Model:
    """The rule, in steps of time."""

    def __init__(self, field: Field) -> None:
        self.field = field
        self.now_s = TAKEOFF_S
        self.here = (0.0, 0.0)
        self.line: list[int] = []
        self.coming: list[tuple[float, int]] = []
        self.taken = self.answered = 0
        self.drone: tuple[float, int] | None = None  # the end, and the photo
        self.remote: tuple[float, int] | None = None
        self.server: int | None = None
        self.ready_s = 0.0
        self.started: set[int] = set()

    def flown_s(self) -> float:
        """The time of the mission."""
        field = self.field
        for row in range(field.rows):
            ends = (0.0, field.row_m) if row % 2 == 0 else (field.row_m, 0.0)
            self.fly((ends[0], row * field.across_m))
            self.photo()
            spots = [
                (ends[0] + (ends[1] - ends[0]) * n / (field.spots - 1), row * field.across_m)
                for n in range(1, field.spots)
            ]
            self.fly(spots[-1], spots)
        stays = [self.here, *(place for server in field.servers if (place := self.inside(server)))]
        return min(copy.deepcopy(self).rested_s(place) for place in stays)

    def inside(self, server: Server) -> tuple[float, float] | None:
        """The nearest place well inside the range."""
        east_m, north_m = self.here[0] - server.east_m, self.here[1] - server.north_m
        away_m = math.hypot(east_m, north_m)
        if away_m <= INSIDE * server.range_m:
            return None
        share = INSIDE * server.range_m / away_m
        return server.east_m + share * east_m, server.north_m + share * north_m

    def rested_s(self, place: tuple[float, float]) -> float:
        """When the drone is on the ground at home, after a wait at the place."""
        self.fly(place)
        while self.answered < self.taken:
            self.step(self.here)
        return self.now_s + LANDING_S

    def photo(self) -> None:
        """Take one."""
        self.coming.append((self.now_s + PHOTO_S, self.taken))
        self.taken += 1

    def fly(self, end: tuple[float, float], spots: list[tuple[float, float]] | None = None) -> None:
        """Fly there from rest to rest, and take a photo at each of the spots on the way."""
        start, begun_s = self.here, self.now_s
        length_m, passed = math.dist(start, end), list(spots or [])
        top_m_s = min(self.field.speed_m_s, math.sqrt(length_m * ACCELERATION_M_S2))
        ramp_s = top_m_s / ACCELERATION_M_S2
        whole_s = length_m / top_m_s + ramp_s if length_m > 0 else 0.0
        while self.now_s < begun_s + whole_s:
            flown_s = min(whole_s, self.now_s + STEP_S - begun_s)
            if flown_s < ramp_s:
                along_m = ACCELERATION_M_S2 * flown_s**2 / 2
            elif flown_s < whole_s - ramp_s:
                along_m = top_m_s * (flown_s - ramp_s / 2)
            else:
                along_m = length_m - ACCELERATION_M_S2 * (whole_s - flown_s) ** 2 / 2
            share = along_m / length_m
            self.step((start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])))
            while passed and (math.dist(start, passed[0]) <= along_m + 1e-6 or flown_s == whole_s):
                passed.pop(0)
                self.photo()
        self.here = end

    def step(self, here: tuple[float, float]) -> None:
        """Go on by one step of time."""
        self.now_s += STEP_S
        self.here = here
        while self.coming and self.coming[0][0] <= self.now_s:
            self.line.append(self.coming.pop(0)[1])
        for name in ("drone", "remote"):
            computed = getattr(self, name)
            if computed is not None and computed[0] <= self.now_s:
                setattr(self, name, None)
                self.answered += 1
        self.choose()
        self.compute()

    def choose(self) -> None:
        """Use the fastest server in range, with a check first."""
        servers, local_s = self.field.servers, self.field.local_s
        near = [
            number
            for number, server in enumerate(servers)
            if server.call_s < local_s
            and math.dist(self.here, (server.east_m, server.north_m)) <= server.range_m
        ]
        if self.server is not None and self.server not in near:
            if self.remote is not None:
                self.line = sorted([*self.line, self.remote[1]])
            self.server = self.remote = None
        best = min(near, key=lambda number: servers[number].call_s, default=None)
        if best is None or best == self.server or self.remote is not None:
            return
        if self.server is not None and servers[self.server].call_s - servers[best].call_s <= SWITCH * local_s:
            return
        self.server, self.ready_s = best, self.now_s + (RUNNING_S if best in self.started else CHECK_S)
        self.started.add(best)

    def compute(self) -> None:
        """Each free place takes the first photo that it answers before the other place gets to it."""
        local_s, is_ready = self.field.local_s, self.server is not None and self.ready_s <= self.now_s
        call_s = self.field.servers[self.server].call_s if is_ready and self.server is not None else math.inf
        if is_ready and self.remote is None and self.line:
            self.remote = self.now_s + call_s, self.line.pop(0)
        if self.drone is None:
            ahead_s = self.remote[0] if self.remote is not None else self.now_s
            for number in range(len(self.line)):
                ahead_s += call_s
                if self.now_s + local_s <= ahead_s:
                    self.drone = self.now_s + local_s, self.line.pop(number)
                    break
        elif is_ready and self.remote is None and not self.line:
            self.drone = min(self.drone[0], self.now_s + call_s), self.drone[1]


def fly(number: int) -> tuple[int, float, float, float]:
    """The field, and the seconds of its mission, of one of the drone alone, and of the model."""
    field = drawn(number)
    run, alone = simulate(scenario(field)), simulate(scenario(field, "local-only"))
    assert run.completed and alone.completed
    return number, run.mission_time_s, alone.mission_time_s, Model(field).flown_s()


def main() -> None:
    """Flies all fields and prints how the times compare."""
    program = command_line("rows_rules", __doc__)
    program.add_argument("--json", type=Path, help="write the times there")
    program.add_argument("--beside", type=Path, help="the times of another version")
    options = program.parse_args()
    numbers = list(range(1, 1 + (QUICK_FIELDS if options.quick else FIELDS)))
    with in_processes(fly, numbers) as results:
        flown = {number: times for number, *times in results}
    if options.json:
        options.json.write_text(json.dumps(flown))
    tell("beside the model", {n: (took, model) for n, (took, _, model) in flown.items()})
    tell("beside the drone alone", {n: (took, alone) for n, (took, alone, _) in flown.items()})
    if options.beside:
        before = json.loads(options.beside.read_text())
        tell("beside the other version", {n: (took, before[str(n)][0]) for n, (took, _, _) in flown.items()})


def tell(what: str, times: dict[int, tuple[float, float]]) -> None:
    """Print a line for each class of fields."""
    for name, are in (("all", None), ("spots", False), ("surveys", True)):
        shares = [took / other for n, (took, other) in times.items() if are in (None, drawn(n).is_survey)]
        if shares:
            gains = f"{fmean(shares) - 1:+.1%} in the mean, best {min(shares) - 1:+.1%}, worst {max(shares) - 1:+.1%}"
            losing = sum(share > LOSES for share in shares)
            print(f"{what}, {name} ({len(shares)}): {gains}; {losing} lose 1 % or more")


if __name__ == "__main__":
    main()
