"""What two answers of one call gain, in accuracy and in time: `python -m bench.two_answers`.

Accuracy: rendered fields of the solar park, 121 photos each from 20 m; about one photo in ten shows a fault. The
bundled detector looks at each photo in both modes; missions are simulated with what it found. Recall and precision
are of faults, by the answer of each photo that counts at its deadline. A photo with an answer demands 5 s.

Time: the same field with 3 % noise on calls and 2 % on legs, where an answer demands 5 s with a chance of 10 %. The
gain is of the mission's time, in pairs of the same seed, against the same mission with one answer, heavy.
"""

from __future__ import annotations

import itertools
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, Literal, NamedTuple, get_args

from bench.program import command_line, machine
from bench.rows import SCENARIO

import upwash
from upwash.config.drone_file import drone_config
from upwash.config.places import waypoints
from upwash.config.reading import read_document
from upwash.eventlog import schema
from upwash.lab.processes import in_processes
from upwash.lab.run import simulate_fleet
from upwash.services import Detector
from upwash.services.solar_park import Park, View, photograph
from upwash.services.solar_park.geometry import Rates
from upwash.support.confidence import mean_of

Mode = Literal["light", "heavy"]
RATES = Rates(hot_spot=0.0005, broken=0.0002)
FIELDS, ALTITUDE_M, LEAST_OVERLAP = (1, 2, 3), 20.0, 0.5
LINKS_BIT_S = (54e6, 12e6, 4e6)
# on the drone and on a server without the link, in seconds; the thesis's detector, and a large model
MODELS: Mapping[str, tuple[dict[str, float], dict[str, float]]] = {
    "0.6 s": ({"light": 3.0, "heavy": 10.0}, {"light": 0.2, "heavy": 0.6}),
    "4 s": ({"light": 1.0, "heavy": 10.0}, {"light": 0.3, "heavy": 4.0}),
}
WITHIN_S = 20.0
ANSWERS: Mapping[str, tuple[Mode, str, bool]] = {  # mode, policy, whether two answers
    "light, drone alone": ("light", "local-only", False),
    "light": ("light", "look-ahead", False),
    "heavy, drone alone": ("heavy", "local-only", False),
    "heavy": ("heavy", "look-ahead", False),
    "two answers": ("heavy", "look-ahead", True),
}
MANNERS = ("rows", "stops")
SEEDS, QUICK_SEEDS = 30, 2


# --- what the detector finds ------------------------------------------------------------------------------------


class Seen(NamedTuple):
    """One photo: its faults, and by mode which of them were found, and -1 for each false alarm."""

    field: int
    waypoint: int
    faults: int
    found: dict[str, list[int]]


class Shot(NamedTuple):
    """A photo to be looked at."""

    field: int
    waypoint: int
    east_m: float
    north_m: float


def look(shot: Shot) -> Seen:
    """Renders the photo, and looks at it in both modes."""
    view = View(shot.east_m, shot.north_m, ALTITUDE_M)
    photo = photograph(Park(shot.field, RATES), view, shot=shot.waypoint)
    detector = Detector(threads=1)
    light, heavy = (
        _matched(detector.process_photo(photo.jpeg, mode), photo.truth) for mode in get_args(Mode)
    )
    return Seen(shot.field, shot.waypoint, len(photo.truth), {"light": light, "heavy": heavy})


def _matched(found: Sequence[Any], truth: Sequence[Any]) -> list[int]:
    """The number of the fault that each detection is of, the surest first; -1 for a false alarm."""
    free, numbers = dict(enumerate(truth)), list[int]()
    for detection in sorted(found, key=lambda each: -each.score):
        best = max(free, key=lambda number: _overlap(detection, free[number]), default=-1)
        is_hit = best >= 0 and _overlap(detection, free[best]) >= LEAST_OVERLAP
        if is_hit:
            del free[best]
        numbers.append(best if is_hit else -1)
    return numbers


def _overlap(found: Any, fault: Any) -> float:
    """The area that two boxes of one label have in common, as a share of what they cover together."""
    if found.label != fault.label:
        return 0.0
    both = _shared(found.left_px, found.width_px, fault.left_px, fault.width_px)
    both *= _shared(found.top_px, found.height_px, fault.top_px, fault.height_px)
    covered = found.width_px * found.height_px + fault.width_px * fault.height_px - both
    return float(both / covered)


def _shared(begin: float, length: float, other: float, its_length: float) -> float:
    return max(0.0, min(begin + length, other + its_length) - max(begin, other))


@upwash.service(profile_by="mode")
class Inspector:
    """Answers with what the detector found on the photo of a waypoint."""

    def __init__(self, *, seen: Path) -> None:
        self._found: list[dict[str, list[int]]] = json.loads(seen.read_text())

    def inspect(self, waypoint: int, mode: Mode) -> list[int]:
        """The faults that were found."""
        return self._found[waypoint][mode]


def survey(drone: upwash.Drone, mode: Mode) -> None:
    """The bundled survey with the inspector."""
    inspector = drone.service(Inspector)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        drone.camera.take_photo()
        pending = drone.start(inspector.inspect, waypoint.index, mode)
        drone.stay_or_go(pending, lambda _: drone.autopilot.hover(drone.action_s))
    drone.end_flight()
    drone.autopilot.disarm()


# --- missions ---------------------------------------------------------------------------------------------------


class Flight(NamedTuple):
    """One mission to be flown."""

    manner: str
    model: str
    link_bit_s: float
    answers: str
    seed: int
    seen: str = ""  # a file; without one the scenario's events count
    differ: float = 0.0  # the share of demands that light does not see


class Flown(NamedTuple):
    """A mission's time, the key whose answer counted at each waypoint, and the waypoints of its actions."""

    mission_s: float
    keys: dict[int, str]
    acted: list[int]


def fly(flight: Flight) -> tuple[Flight, Flown]:
    """Simulates the mission."""
    config = drone_config(_document(flight), SCENARIO)
    (run,) = simulate_fleet([config], computing=bool(flight.seen))
    assert run.result.completed, run.failure
    keys = {call.waypoint: call.key for call in run.result.calls if call.waypoint is not None}
    acted = [event.waypoint for event in run.events if isinstance(event, schema.Acted)]
    return flight, Flown(run.result.mission_time_s, keys, [each for each in acted if each is not None])


def _document(flight: Flight) -> dict[str, Any]:
    document = read_document(SCENARIO)
    mode, policy, has_two = ANSWERS[flight.answers]
    local_s, processing_s = MODELS[flight.model]
    document["seed"] = flight.seed
    document["mission"] |= {"mode": mode}
    if flight.manner == "stops":
        del document["mission"]["photos"]
    document["policy"] = {"name": policy}
    service: dict[str, Any] = {"name": "detector", "local_call_s": local_s}
    if has_two:
        service["two_answers"] = {"first": "light", "within_s": WITHIN_S}
    if flight.seen:
        service |= {
            "name": "inspector",
            "program": f"{__file__}:Inspector",
            "settings": {"seen": flight.seen},
        }
        document["mission"]["program"] = f"{__file__}:survey"
        del document["event"]
    else:
        document["event"] = {"probability": 0.1, "missed": {"light": flight.differ}}
        document["noise"] = {"call": 0.03, "leg": 0.02}
    document["service"] = [service]
    for server in document["server"]:
        del server["remote_call_s"]
        server |= {"processing_s": processing_s, "bandwidth_bit_s": flight.link_bit_s}
    return document


# --- tables -----------------------------------------------------------------------------------------------------


def accuracy(photos: Sequence[Seen], files: Mapping[int, str], quick: bool) -> Iterator[str]:
    """The rows of the first table."""
    manners, models = (("rows",), ("4 s",)) if quick else (MANNERS, tuple(MODELS))
    links = LINKS_BIT_S[:1] if quick else LINKS_BIT_S
    wanted = [
        Flight(manner, model, link, answers, 1, file)
        for manner, model, link, answers in itertools.product(manners, models, links, ANSWERS)
        for file in files.values()
        if link == links[0] or ANSWERS[answers][1] != "local-only"
    ]
    seen = {(photo.field, photo.waypoint): photo for photo in photos}
    with in_processes(fly, wanted) as results:
        flown = dict(results)
    yield f"| flies | heavy on a server | answers | {' | '.join(f'{link / 1e6:g} Mbit/s' for link in links)} |"
    for manner, model, answers in itertools.product(manners, models, ANSWERS):
        cells = []
        for link in links:
            its_link = links[0] if ANSWERS[answers][1] == "local-only" else link
            own = {
                field: flown[Flight(manner, model, its_link, answers, 1, file)]
                for field, file in files.items()
            }
            cells.append(_cell(own, seen))
        yield f"| {manner} | {model} | {answers} | {' | '.join(cells)} |"


def _cell(flown: Mapping[int, Flown], seen: Mapping[tuple[int, int], Seen]) -> str:
    faults = hits = alarms = 0
    for field, mission in flown.items():
        for waypoint, key in mission.keys.items():
            photo = seen[field, waypoint]
            numbers = photo.found[key]
            faults += photo.faults
            hits += sum(number >= 0 for number in numbers)
            alarms += numbers.count(-1)
    minutes = fmean(mission.mission_s for mission in flown.values()) / 60
    return f"{minutes:.1f} min, {hits / max(1, faults):.3f}, {hits / max(1, hits + alarms):.3f}"


def gains(quick: bool) -> Iterator[str]:
    """The rows of the second table."""
    seeds = range(1, 1 + (QUICK_SEEDS if quick else SEEDS))
    differs = (0.0,) if quick else (0.0, 0.1)
    heads = " | ".join(f"light misses {100 * differ:g} %" for differ in differs)
    yield f"| flies | heavy on a server | one answer, min | {heads} |"
    manners, models = (("rows",), ("4 s",)) if quick else (MANNERS, tuple(MODELS))
    for manner, model in itertools.product(manners, models):
        alone = [Flight(manner, model, 54e6, "heavy", seed) for seed in seeds]
        both = {
            differ: [one._replace(answers="two answers", differ=differ) for one in alone]
            for differ in differs
        }
        with in_processes(fly, [*alone, *itertools.chain(*both.values())]) as results:
            flown = dict(results)
        cells = []
        for flights in both.values():
            pairs = zip(alone, flights, strict=True)
            gain = mean_of([100 * (1 - flown[two].mission_s / flown[one].mission_s) for one, two in pairs])
            cells.append(f"{gain.value:.1f} ± {gain.margin:.1f} %")
        minutes = fmean(flown[one].mission_s for one in alone) / 60
        yield f"| {manner} | {model} | {minutes:.2f} | {' | '.join(cells)} |"


def main() -> None:
    """Looks at the photos, flies all missions, and prints both tables."""
    parser = command_line("two_answers", __doc__)
    parser.add_argument(
        "--seen", type=Path, help="a file that keeps what the detector found, for the next run"
    )
    options = parser.parse_args()
    places = waypoints(drone_config(read_document(SCENARIO), SCENARIO).mission)
    fields = FIELDS[:1] if options.quick else FIELDS
    shots = [
        Shot(field, place.index, place.position.east_m, place.position.north_m)
        for field in fields
        for place in (places[:4] if options.quick else places)
    ]
    if options.seen is not None and options.seen.exists():
        photos = [Seen(*photo) for photo in json.loads(options.seen.read_text())]
    else:
        with in_processes(look, shots) as looked:
            photos = list(looked)
    if options.seen is not None:
        options.seen.write_text(json.dumps(photos))
    faulty = sum(photo.faults > 0 for photo in photos)
    agree = fmean(bool(photo.found["light"]) == bool(photo.found["heavy"]) for photo in photos)
    print(
        f"{machine()}; {len(photos)} photos, {faulty} with a fault, {sum(photo.faults for photo in photos)} faults"
    )
    print(f"both modes agree whether something is to be done on {100 * agree:.1f} % of photos")
    with tempfile.TemporaryDirectory() as folder:
        files = {field: f"{folder}/{field}.json" for field in fields}
        for field, file in files.items():
            own = {photo.waypoint: photo.found for photo in photos if photo.field == field}
            nothing: dict[str, list[int]] = {"light": [], "heavy": []}
            Path(file).write_text(json.dumps([own.get(place.index, nothing) for place in places]))
        rest = {
            (field, place.index): Seen(field, place.index, 0, {"light": [], "heavy": []})
            for field in fields
            for place in places
        }
        all_photos = [*(rest | {(photo.field, photo.waypoint): photo for photo in photos}).values()]
        for row in accuracy(all_photos, files, options.quick):
            print(row)
    for row in gains(options.quick):
        print(row)


if __name__ == "__main__":
    main()
