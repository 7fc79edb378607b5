"""What a mission that has to be over in time keeps of its accuracy: planned, and with heavy calls until none fits.

The thesis's survey with its own policy. "Planned" is `[mission] finish_by_s` and `lighter`. "First" makes
heavy calls first and then light ones: the largest number of heavy calls that ends in time, found by flying it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bench.program import command_line

import upwash
from upwash.services import Detector

SCENARIO = Path(__file__).parents[1] / "scenarios" / "thesis.toml"
HEAVY_AP50, LIGHT_AP50 = 0.987, 0.941  # docs/detector.md
BUDGETS_S = (1450, 1400, 1372, 1336, 1320, 1300)
CALLS = 121


@dataclass(frozen=True)
class Flown:
    """One mission: how many of its calls were heavy, and when it was over."""

    heavy: int
    mission_time_s: float

    @property
    def mean_ap50(self) -> float:
        """Over all photos, each with what its mode has on the test photos."""
        return (self.heavy * HEAVY_AP50 + (CALLS - self.heavy) * LIGHT_AP50) / CALLS


def main() -> None:
    """Prints the rows of the page."""
    parser = command_line("lighter", __doc__)
    budgets_s = BUDGETS_S[2:3] if parser.parse_args().quick else BUDGETS_S
    print("| finish_by_s | planned: heavy | over after | AP50 | first: heavy | over after | AP50 |")
    print("|---|---|---|---|---|---|---|")
    for budget_s in budgets_s:
        cells = [_cells(flown) for flown in (planned(budget_s), first(budget_s))]
        print(f"| {budget_s} | {' | '.join(cells)} |")


def planned(budget_s: float) -> Flown:
    """The mission as upwash flies it."""
    return _fly({"mission.finish_by_s": float(budget_s), "mission.lighter": {"heavy": "light"}})


def first(budget_s: float) -> Flown:
    """The mission with as many heavy calls as it may begin with; with none where that is too long as well."""
    best, fewest, most = heavy_then_light(0), 1, CALLS
    while fewest <= most:
        tried = heavy_then_light((fewest + most) // 2)
        if tried.mission_time_s <= budget_s:
            best, fewest = tried, tried.heavy + 1
        else:
            most = tried.heavy - 1
    return best


def heavy_then_light(heavy: int) -> Flown:
    """The mission with `heavy` heavy calls and then light ones."""
    return _fly({"mission.program": f"{__file__}:survey", "mission.mode": str(heavy)})


def survey(drone: upwash.Drone, mode: str) -> None:
    """The bundled survey, whose first calls, as many as `mode` says, are heavy, and the others light."""
    detector = drone.service(Detector)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        photo = drone.camera.take_photo()
        detector.process_photo(photo, mode="heavy" if waypoint.index < int(mode) else "light")
    drone.end_flight()
    drone.autopilot.disarm()


def _fly(overrides: dict[str, object]) -> Flown:
    flight = upwash.simulate(SCENARIO, overrides=overrides)
    return Flown(sum(call.key == "heavy" for call in flight.calls), flight.mission_time_s)


def _cells(flown: Flown) -> str:
    return f"{flown.heavy} | {flown.mission_time_s:.1f} s | {flown.mean_ap50:.3f}"


if __name__ == "__main__":
    main()
