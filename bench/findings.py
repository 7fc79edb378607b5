"""Where findings lie, and how many objects they are, against the truth: `python -m bench.findings`.

A drone surveys a rendered solar park in rows, its photos overlap by 75 %. It leans as in wind, and its reports are
off: each photo's position by a GPS error of its own, altitude, tilt and heading by theirs. OpenCV projects the park's
faults onto the photos, which is another way than the code under test takes. A detector misses one in 20 of them, and
its boxes are a pixel off. For each altitude, tilt of the camera and GPS error there is a row. It has the errors
of single sightings and of objects, how often the stated errors hold, and precision and recall of the objects.
First the program prints the time for 1,000 photos with 10 boxes each.
"""

from __future__ import annotations

import argparse
import math
import random
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median, quantiles

import cv2
import numpy as np
from bench.program import machine

from upwash.core.camera.catalogue import Catalogue, Sighting
from upwash.core.camera.georeference import Accuracy, Ground, PhotoGeometry, Place, Sight
from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.core.vehicle.telemetry import Attitude
from upwash.services.solar_park.geometry import Area, Park

SIZE_PX = (1440, 1080)
FOV_DEG = 62.2
OVERLAP = 0.75
MISSED = 0.05
LEAN_DEG = 4.0  # of the vehicle in wind
TILT_DEG, HEADING_DEG, ALTITUDE_M = 1.0, 2.0, 0.5  # standard errors of the reports
FIELD_M = 60.0


@dataclass(frozen=True)
class Fault:
    """A fault of the park: what it is, its middle and its outline on the ground."""

    number: int
    label: str
    outline_m: Sequence[tuple[float, float]]

    @property
    def middle_m(self) -> tuple[float, float]:
        """The middle of its upright box."""
        east, north = zip(*self.outline_m, strict=True)
        return (min(east) + max(east)) / 2, (min(north) + max(north)) / 2


@dataclass(frozen=True)
class Box:
    """A box in a photo and the fault that it is around."""

    x_px: float
    y_px: float
    width_px: float
    height_px: float
    fault: Fault


def faults(seed: int, size_m: float) -> list[Fault]:
    """The faults of a park around home."""
    area = Area(-size_m, size_m, 2 * size_m, 2 * size_m)
    return [
        Fault(number, type(module.fault).__name__, module.fault.outline(module.area))
        for number, module in enumerate(
            module for table in Park(seed).tables(area) for module in table.modules if module.fault
        )
        if module.fault is not None
    ]


def rows(altitude_m: float) -> Iterator[tuple[float, float, float]]:
    """East, north and heading of each photo, back and forth."""
    step_m = 2 * altitude_m * math.tan(math.radians(FOV_DEG / 2)) * (1 - OVERLAP)
    ahead_m = step_m * SIZE_PX[1] / SIZE_PX[0]
    half = FIELD_M / 2
    for row in range(int(FIELD_M / step_m) + 1):
        heading_deg = 0.0 if row % 2 == 0 else 180.0
        steps = range(int(FIELD_M / ahead_m) + 1)
        for step in steps if row % 2 == 0 else reversed(steps):
            yield row * step_m - half, step * ahead_m - half, heading_deg


def about(axis: int, angle_deg: float) -> np.ndarray:
    """The matrix of a turn about an axis."""
    vector = np.zeros(3)
    vector[axis] = math.radians(angle_deg)
    return cv2.Rodrigues(vector)[0]


def boxes(true: PhotoGeometry, field: Sequence[Fault], rng: random.Random) -> list[Box]:
    """What a detector finds on the photo."""
    attitude, lens = true.attitude, true.lens
    assert attitude is not None
    vehicle = about(2, attitude.yaw_deg) @ about(1, attitude.pitch_deg) @ about(0, attitude.roll_deg)
    optical = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    camera = (vehicle @ about(1, -lens.tilt_deg) @ optical).T
    focal_px = SIZE_PX[0] / 2 / math.tan(math.radians(FOV_DEG / 2))
    matrix = np.array([[focal_px, 0, SIZE_PX[0] / 2], [0, focal_px, SIZE_PX[1] / 2], [0, 0, 1]])
    found = []
    for fault in field:
        corners = np.array(
            [
                (north - true.position.north_m, east - true.position.east_m, true.position.altitude_m)
                for east, north in fault.outline_m
            ]
        )
        seen = corners @ camera.T
        if seen[:, 2].min() <= 0.1:
            continue
        pixels = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), matrix, np.zeros(5))[0][:, 0]
        low, high = pixels.min(0), pixels.max(0)
        seen_low, seen_high = low.clip(0, SIZE_PX), high.clip(0, SIZE_PX)
        if np.prod(seen_high - seen_low) < 0.5 * np.prod(high - low) or rng.random() < MISSED:
            continue
        left, top, right, bottom = (value + rng.gauss(0, 1.0) for value in (*seen_low, *seen_high))
        width, height = max(1.0, right - left), max(1.0, bottom - top)
        x, y = min(max((left + right) / 2, 0), SIZE_PX[0]), min(max((top + bottom) / 2, 0), SIZE_PX[1])
        found.append(Box(x, y, width, height, fault))
    return found


@dataclass
class Scores:
    """The figures of one survey."""

    photos: int
    single_m: list[float]
    single_inside: list[bool]
    objects_m: list[float]
    objects_inside: list[bool]
    precision: float
    recall: float


def survey(seed: int, altitude_m: float, tilt_deg: float, gps_m: float) -> Scores:
    """Flies it and compares the findings with the truth."""
    rng = random.Random(seed)
    field = faults(seed, FIELD_M)
    catalogue = Catalogue()
    seen, single = dict[int, Fault](), list[tuple[float, bool]]()
    truth = dict[tuple[int, int], int]()  # the fault of each sighting, by photo and index
    photos = 0
    for photo, (east, north, heading_deg) in enumerate(rows(altitude_m)):
        lean = Attitude(rng.gauss(0, LEAN_DEG), rng.gauss(0, LEAN_DEG), heading_deg + rng.gauss(0, 3))
        lens = Lens(fov_deg=FOV_DEG, tilt_deg=90 - tilt_deg)
        true = PhotoGeometry(
            position=Position(east, north, altitude_m), size_px=SIZE_PX, lens=lens, attitude=lean
        )
        told = PhotoGeometry(
            position=Position(
                east + rng.gauss(0, gps_m), north + rng.gauss(0, gps_m), altitude_m + rng.gauss(0, ALTITUDE_M)
            ),
            size_px=SIZE_PX,
            lens=lens,
            attitude=Attitude(
                lean.roll_deg + rng.gauss(0, TILT_DEG),
                lean.pitch_deg + rng.gauss(0, TILT_DEG),
                lean.yaw_deg + rng.gauss(0, HEADING_DEG),
            ),
            ground=Ground(error_m=0.1),
            accuracy=Accuracy(
                position_m=max(gps_m, 0.05), altitude_m=ALTITUDE_M, tilt_deg=TILT_DEG, heading_deg=HEADING_DEG
            ),
        )
        sight = told.sight
        assert isinstance(sight, Sight)
        found = boxes(true, field, rng)
        sightings = []
        for index, box in enumerate(found):
            place = sight.place_of(box.x_px, box.y_px, box.width_px, box.height_px)
            if isinstance(place, Place):
                sightings.append(Sighting((photo, index), box.fault.label, place))
                away_m = away(place, box.fault)
                single.append((away_m, away_m <= place.error_m))
                seen[box.fault.number] = box.fault
        photos += 1
        catalogue.take(photo, sightings, told.footprint_m())
        truth |= {sighting.key: found[sighting.key[1]].fault.number for sighting in sightings}
    catalogue.settle()
    first = dict[int, Place]()
    for entry in catalogue.entries:
        numbers = Counter(truth[sighting.key] for sighting in entry.sightings.values())
        first.setdefault(numbers.most_common(1)[0][0], entry.place())
    objects = [(away(place, seen[number]), place) for number, place in first.items()]
    return Scores(
        photos,
        [away_m for away_m, _ in single],
        [inside for _, inside in single],
        [away_m for away_m, _ in objects],
        [away_m <= place.error_m for away_m, place in objects],
        len(first) / max(1, len(catalogue.entries)),
        len(first) / max(1, len(seen)),
    )


def away(place: Place, fault: Fault) -> float:
    """How far the place is from the fault."""
    return math.dist((place.position.east_m, place.position.north_m), fault.middle_m)


def share(values: Sequence[bool]) -> float:
    """The share of the true ones, in percent."""
    return 100 * sum(values) / max(1, len(values))


def of_95(values: Sequence[float]) -> float:
    """The quantile of 95 %."""
    return quantiles(values, n=20)[-1] if len(values) > 1 else math.nan


def time_of_1000() -> float:
    """Processor seconds for 1,000 photos with 10 boxes each, from the boxes to the objects."""
    rng = random.Random(1)
    lens, altitude_m = Lens(fov_deg=FOV_DEG), 20.0
    focal_px = lens.focal_in(SIZE_PX)
    half_east, half_north = (side / 2 / focal_px * altitude_m for side in SIZE_PX)
    objects = [
        (rng.uniform(-20, 220), rng.uniform(-20, 180))
        for _ in range(round(10 * 240 * 200 / (4 * half_east * half_north)))
    ]
    photos = []
    for index in range(1000):
        east, north = 6.0 * (index % 32), 4.5 * (index // 32)
        told = Position(east + rng.gauss(0, 1.5), north + rng.gauss(0, 1.5), altitude_m)
        seen = [
            (
                SIZE_PX[0] / 2 + (x - east) / altitude_m * focal_px,
                SIZE_PX[1] / 2 - (y - north) / altitude_m * focal_px,
            )
            for x, y in objects
            if abs(x - east) < half_east and abs(y - north) < half_north
        ]
        level = Attitude(0.0, 0.0, 0.0)
        photos.append((PhotoGeometry(position=told, size_px=SIZE_PX, lens=lens, attitude=level), seen))
    start_s = time.process_time()
    catalogue = Catalogue()
    for index, (photo, points) in enumerate(photos):
        sight = photo.sight
        assert isinstance(sight, Sight)
        sightings = [
            Sighting((index, number), "fault", place)
            for number, (x, y) in enumerate(points)
            if isinstance(place := sight.place_of(x, y, 20.0, 20.0), Place)
        ]
        catalogue.take(index, sightings, photo.footprint_m())
    catalogue.settle()
    return time.process_time() - start_s


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3, help="surveys for each row (default: 3)")
    parser.add_argument("--quick", action="store_true", help="one survey, at 40 m, straight down")
    arguments = parser.parse_args()
    seeds = 1 if arguments.quick else arguments.seeds
    print(machine())
    print(
        f"1,000 photos with 10 boxes each, processor time: {median(time_of_1000() for _ in range(3)):.2f} s"
    )
    print(
        "altitude tilt   gps | photos | sighting: median, 95 %, held | object: median, 95 %, held | precision recall"
    )
    for altitude_m in (40.0,) if arguments.quick else (10.0, 20.0, 40.0, 60.0):
        for tilt_deg in (0.0,) if arguments.quick else (0.0, 15.0, 30.0):
            for gps_m in (0.0, 1.5):
                scores = [survey(seed, altitude_m, tilt_deg, gps_m) for seed in range(seeds)]
                single = [value for score in scores for value in score.single_m]
                objects = [value for score in scores for value in score.objects_m]
                print(
                    f"{altitude_m:5.0f} m {tilt_deg:3.0f}° {gps_m:3.1f} m | {scores[0].photos:6} | "
                    f"{median(single):5.2f} m {of_95(single):6.2f} m "
                    f"{share([held for score in scores for held in score.single_inside]):5.1f} % | "
                    f"{median(objects):5.2f} m {of_95(objects):6.2f} m "
                    f"{share([held for score in scores for held in score.objects_inside]):5.1f} % | "
                    f"{sum(score.precision for score in scores) / seeds:6.3f} "
                    f"{sum(score.recall for score in scores) / seeds:6.3f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
