"""The objects of a flight: which findings are claimed, as photos come one after the other."""

from __future__ import annotations

import random
from dataclasses import dataclass

import pytest

from upwash.core.camera.georeference import PhotoGeometry
from upwash.core.camera.lens import Lens
from upwash.core.geo import Position
from upwash.drone.answered_photos import NumberedPhoto
from upwash.drone.objects import Claim, FlightObjects, FoundObject
from upwash.eventlog.schema import FoundRecord

LENS, SIZE_PX, ALTITUDE_M = Lens(fov_deg=62.2, up_deg=0.0), (640, 480), 20.0


@dataclass
class Mark:
    label: str
    x: float
    y: float
    score: float = 0.5


def photo(number: int, east_m: float, north_m: float) -> NumberedPhoto:
    position = Position(east_m, north_m, ALTITUDE_M)
    return NumberedPhoto(number, PhotoGeometry(position=position, size_px=SIZE_PX, lens=LENS))


def marks(
    spots: list[tuple[float, float]], east_m: float, north_m: float, off_m: tuple[float, float] = (0.0, 0.0)
) -> list[Mark]:
    px_per_m = LENS.focal_in(SIZE_PX) / ALTITUDE_M
    found = [
        Mark(
            "stone",
            320 + px_per_m * (east - east_m + off_m[0]),
            240 - px_per_m * (north - north_m + off_m[1]),
        )
        for east, north in spots
    ]
    return [mark for mark in found if 0 <= mark.x <= 640 and 0 <= mark.y <= 480]


def always(_: FoundObject) -> bool:
    return True


@pytest.mark.parametrize("seed", range(4))
def test_each_object_is_claimed_once_in_a_survey_with_overlap(seed: int) -> None:
    rng, objects, claims = random.Random(seed), FlightObjects(), list[Claim]()
    spots = [
        (10.0 * column + rng.uniform(0, 5), 10.0 * row + rng.uniform(0, 5))
        for column in range(6)
        for row in range(6)
    ]
    number = 0
    for east_m in range(0, 61, 8):
        for north_m in range(0, 61, 6):
            shot = photo(number, east_m, north_m)
            found = marks(spots, east_m, north_m, (rng.gauss(0, 1), rng.gauss(0, 1)))
            claims += objects.claim(objects.take(found, shot, Position(0, 0, ALTITUDE_M)), always)
            number += 1
    alone = [claim for claim in claims if objects.is_alone(claim)]
    assert len(alone) == pytest.approx(len(spots), abs=1)


def test_an_object_has_the_best_score_and_a_place_by_all_photos() -> None:
    objects = FlightObjects()
    (first,) = objects.take([Mark("stone", 320, 240, 0.4)], photo(0, 0.0, 0.0), Position(0, 0, ALTITUDE_M))
    (claim,) = objects.claim([first], lambda found: found.score is not None and found.score < 0.6)
    second = objects.take([Mark("stone", 320, 240, 0.9)], photo(1, 0.8, 0.0), Position(0.8, 0, ALTITUDE_M))
    assert not list(objects.claim(second, always))
    found = objects.found(claim.key)
    assert (found.sightings, found.score) == (2, 0.9)
    assert 0.2 < found.position.east_m < 0.6 and found.position.altitude_m == ALTITUDE_M
    assert found.place is not None and found.over(5.0).altitude_m == pytest.approx(5.0)


def test_objects_of_the_mission_before_it_was_resumed_are_not_claimed_again() -> None:
    objects = FlightObjects()
    at = Position(0, 0, ALTITUDE_M)
    (claim,) = objects.claim(objects.take([Mark("stone", 320, 240)], photo(0, 5.0, 5.0), at), always)
    record = objects.record(claim)
    resumed = FlightObjects([record], last=record.number)
    assert not list(resumed.claim(resumed.take([Mark("stone", 320, 240)], photo(0, 5.5, 5.0), at), always))
    (other,) = resumed.claim(resumed.take([Mark("deer", 320, 240)], photo(1, 5.5, 5.0), at), always)
    assert other.number == record.number + 1


def test_findings_without_a_place_are_claimed_once_for_each_answer() -> None:
    objects, at = FlightObjects([FoundRecord(number=1, label="stone")]), Position(1.0, 2.0, ALTITUDE_M)
    found = objects.take([Mark("stone", 1, 1), Mark("stone", 9, 9)], NumberedPhoto(0, None), at)
    (claim,) = objects.claim(found, always)
    assert objects.found(claim.key).place is None and objects.found(claim.key).position == at
