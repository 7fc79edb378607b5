"""One object, one entry: sightings on overlapping photos, whose places are off together, are joined by object."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterable, Sequence

import pytest

from upwash.core.camera.catalogue import Catalogue, Entry, Sighting
from upwash.core.camera.georeference import Place
from upwash.core.geo import Position

HALF_M = 12.0  # of a photo's side
Spot = tuple[str, float, float]


def sighting(key: tuple[int, int], spot: Spot, shift: tuple[float, float] = (0.0, 0.0)) -> Sighting:
    label, east_m, north_m = spot
    position = Position(east_m + shift[0], north_m + shift[1])
    return Sighting(key, label, Place(position, 3.7, variance=(2.25, 0.0, 2.25), apart_m=0.1))


def corners(east_m: float, north_m: float) -> list[tuple[float, float]]:
    sides = ((-1, 1), (1, 1), (1, -1), (-1, -1))
    return [(east_m + HALF_M * east, north_m + HALF_M * north) for east, north in sides]


def surveyed(spots: Sequence[Spot], *, seed: int, gps_m: float, missed: float = 0.1) -> tuple[Catalogue, int]:
    """A survey in rows with an overlap of 75 %; returns how many of the spots were seen too."""
    rng, catalogue, seen = random.Random(seed), Catalogue(), set[int]()
    photos = [(6.0 * column, 6.0 * row) for row in range(8) for column in range(8)]
    for number, (east_m, north_m) in enumerate(photos):
        shift = rng.gauss(0, gps_m), rng.gauss(0, gps_m)
        shown = [
            index
            for index, (_, east, north) in enumerate(spots)
            if max(abs(east - east_m), abs(north - north_m)) < HALF_M and rng.random() > missed
        ]
        seen.update(shown)
        found = [sighting((number, index), spots[index], shift) for index in shown]
        catalogue.take(number, found, [(x + shift[0], y + shift[1]) for x, y in corners(east_m, north_m)])
    catalogue.settle()
    return catalogue, len(seen)


def of_one(entry: Entry) -> bool:
    return len({found.key[1] for found in entry.sightings.values()}) == 1


@pytest.mark.parametrize("seed", range(4))
def test_each_object_of_a_survey_is_one_entry(seed: int) -> None:
    rng = random.Random(100 + seed)
    spots = [("fault", rng.uniform(0, 42), rng.uniform(0, 42)) for _ in range(40)]
    catalogue, seen = surveyed(spots, seed=seed, gps_m=1.5)
    assert len(catalogue.entries) == pytest.approx(seen, abs=1)
    assert sum(map(of_one, catalogue.entries)) >= seen - 2


def test_a_single_object_far_from_others_is_one_entry() -> None:
    catalogue, _ = surveyed([("fault", 20.0, 20.0)], seed=1, gps_m=1.5)
    (entry,) = catalogue.entries
    assert len(entry.sightings) > 10
    place = entry.place()
    assert (place.position.east_m, place.position.north_m) == pytest.approx((20.0, 20.0), abs=1.5)
    assert place.error_m == pytest.approx(3.7), "the errors of the photos may all be the same"


def test_neighbours_of_a_photo_stay_apart_however_unsure_their_places_are() -> None:
    spots = [("fault", 20.0, 20.0), ("fault", 21.2, 20.0), ("fault", 20.0, 21.5)]
    catalogue, _ = surveyed(spots, seed=2, gps_m=1.5, missed=0.0)
    assert len(catalogue.entries) == 3
    assert all(map(of_one, catalogue.entries))


def test_two_kinds_at_one_place_are_two_entries() -> None:
    catalogue, _ = surveyed([("weed", 20.0, 20.0), ("stone", 20.0, 20.0)], seed=3, gps_m=0.5)
    assert Counter(entry.label for entry in catalogue.entries) == {"weed": 1, "stone": 1}


def test_what_lies_farther_apart_than_the_errors_is_never_joined() -> None:
    catalogue = Catalogue()
    for number, east_m in enumerate((0.0, 15.0)):
        catalogue.take(number, [sighting((number, 0), ("fault", east_m, 0.0))], corners(east_m, 0.0))
    catalogue.settle()
    assert len(catalogue.entries) == 2


def test_messages_about_one_photo_may_come_one_by_one() -> None:
    catalogue = Catalogue()
    for spot in (("fault", 0.0, 0.0), ("fault", 1.0, 0.0)):
        catalogue.take(0, [sighting((0, 0), spot)], corners(0.0, 0.0))
    assert len(catalogue.entries) == 2


@pytest.mark.parametrize("values", [[], [("fault", 1e9, -1e9)] * 3])
def test_odd_surveys_do_no_harm(values: Iterable[Spot]) -> None:
    catalogue = Catalogue()
    catalogue.take(0, [sighting((0, index), spot) for index, spot in enumerate(values)], None)
    catalogue.settle()
    assert len(catalogue.entries) == len(list(values))


def test_places_however_unsure_take_no_longer() -> None:
    catalogue = Catalogue()
    for number in range(50):
        place = Place(Position(1e8 * number, 0.0), 1e9, variance=(1e18, 0.0, 1e18), apart_m=1e9)
        catalogue.take(
            number,
            [Sighting((number, 0), "fault", place)],
            [(-1e9, 1e9), (1e9, 1e9), (1e9, -1e9), (-1e9, -1e9)],
        )
    catalogue.settle()
    assert 1 <= len(catalogue.entries) <= 50
