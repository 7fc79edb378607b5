"""One number for each finding of a flight or a fleet, and a sentence about all of them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

import pytest

from upwash.core.camera.georeference import Place
from upwash.core.geo import GeoPosition, LocalFrame, Position
from upwash.eventlog.objects import Outline
from upwash.report.findings import Finding, TakenPhoto
from upwash.report.numbering import FlightFindings, numbered, what_was_found
from upwash.report.photos import Shot

NEW_YEAR = datetime(2026, 1, 1, tzinfo=UTC)


def finding(label: str, at_s: float = 0.0) -> Finding:
    """A box of that label, a result without a box where there is none."""
    box = Outline(1.0, 2.0, 3.0, 4.0, label) if label else None
    return Finding(at_s, label or "words", None, None, Position(0.0, 0.0), box, None)


def flight(drone: str | None, *at_s: float, opened: datetime | None = None) -> FlightFindings:
    return FlightFindings(
        f"log of {drone}", drone, opened, 0.0, None, [finding("car", each) for each in at_s]
    )


def numbers(*flights: FlightFindings) -> list[tuple[int, str | None, float]]:
    return [(each.number, each.flight.drone, each.finding.at_s) for each in numbered(flights).objects]


def test_the_findings_of_a_fleet_are_one_list_in_the_order_of_time() -> None:
    late = NEW_YEAR + timedelta(seconds=10)
    fleet = flight("d1", 1.0, 12.0, 12.0, opened=NEW_YEAR), flight("d2", 1.0, 3.0, opened=late)
    assert numbers(*fleet) == [
        (1, "d1", 1.0),
        (2, "d2", 1.0),
        (3, "d1", 12.0),
        (4, "d1", 12.0),
        (5, "d2", 3.0),
    ]
    world = flight("d1", 5.0), flight("d2", 4.0)
    assert numbers(*world) == [(1, "d2", 4.0), (2, "d1", 5.0)]


def test_what_is_found_later_changes_no_number() -> None:
    fleet = flight("d1", 1.0, 4.0), flight("d2", 2.0)
    later = flight("d1", 1.0, 4.0, 9.0), flight("d2", 2.0, 7.0)
    assert numbers(*later)[:3] == numbers(*fleet)


def test_a_log_whose_clock_was_set_back_keeps_its_order() -> None:
    assert numbers(flight("d1", 9.0, 1.0, 10.0), flight("d2", 9.5)) == [
        (1, "d1", 9.0), (2, "d1", 1.0), (3, "d2", 9.5), (4, "d1", 10.0)
    ]  # fmt: skip


def test_flights_of_one_drone_are_numbered_from_one_each() -> None:
    assert numbers(flight("d", 1.0, 2.0), flight("d", 1.5)) == [(1, "d", 1.0), (2, "d", 2.0), (1, "d", 1.5)]


@pytest.mark.parametrize(
    ("labels", "words"),
    [
        ([], ""),
        ([""], "1 finding"),
        (["", ""], "2 findings"),
        (["hot-spot"], "1 hot-spot"),
        (["broken-module"] * 2, "2 broken modules"),
        (["broken-module"] * 5 + ["hot-spot"] * 7, "12 faults: 7 hot-spots, 5 broken modules"),
        (["hot-spot", "broken-module"], "2 faults: 1 hot-spot, 1 broken module"),
        (["hot-spot", "car"], "2 findings: 1 hot-spot, 1 car"),
        (["", "car", "car"], "3 findings: 2 cars, 1 result"),
        (["person"] * 3 + ["bus"] * 2, "5 findings: 3 people, 2 buses"),
        (["wine glass"] * 2, "2 wine glasses"),
        (["tennis_racket"] * 2, "2 tennis rackets"),
        (["skis"] * 2, "2 skis"),
        (["puppy"] * 2, "2 puppies"),
        (["donkey"] * 2, "2 donkeys"),
        (["class 3"] * 2, "2 x class 3"),
        (["a\nb"], "1 a\\nb"),
        (list("aabcdefghi"), "10 findings: 2 as, 1 b, 1 c, 1 d, 1 e, 1 f, 3 of other kinds"),
    ],
)  # fmt: skip
def test_what_was_found_is_said_in_a_sentence(labels: Sequence[str], words: str) -> None:
    assert what_was_found(map(finding, labels)) == words


def test_a_sentence_is_no_longer_for_a_long_label() -> None:
    assert len(what_was_found([finding("x" * 10_000)])) < 60


def seen_at(east_m: float, north_m: float, score: float, *, photo: int, at_s: float) -> Finding:
    """A fault with a place of its own."""
    shot = TakenPhoto(photo, Shot("x.jpg", Position(0.0, 0.0), photo), None)
    place = Place(Position(east_m, north_m), 1.2, variance=(0.25, 0.0, 0.25), apart_m=0.1)
    box = Outline(1.0, 2.0, 3.0, 4.0, "fault", score)
    return Finding(at_s, "fault", score, None, Position(0.0, 0.0), box, shot, place)


def test_of_equally_sure_sightings_the_first_counts() -> None:
    seen = [seen_at(110.0, 5.0, 0.7, photo=photo, at_s=1.0 + photo) for photo in range(3)]
    flights = [FlightFindings(name, name, None, 0.0, GeoPosition(47.0, 8.0), seen) for name in ("a", "b")]
    (found,) = numbered(flights).objects
    assert (found.sightings, found.best, found.first) == (6, (0, 0), (0, 0))


def test_an_object_that_two_drones_saw_is_one_finding_wherever_their_homes_are() -> None:
    home = GeoPosition(47.0, 8.0)
    east = LocalFrame(home).geo(Position(100.0, 0.0))
    one = FlightFindings("a", "d1", None, 0.0, home, [seen_at(110.0, 5.0, 0.7, photo=0, at_s=1.0)])
    other = FlightFindings(
        "b", "d2", None, 0.0, east,
        [seen_at(10.2, 5.2, 0.9, photo=0, at_s=2.0), seen_at(40.0, 5.0, 0.5, photo=1, at_s=3.0)],
    )  # fmt: skip
    found = numbered([one, other])
    assert found.positions == [[0], [0, 1]]
    both, single = found.objects
    assert (both.sightings, both.flight.log, both.finding.score) == (2, "b", 0.9)
    assert (both.first, both.best) == ((0, 0), (1, 0))
    assert both.earth == pytest.approx(_earth(home, Position(110.1, 5.1)), rel=0, abs=3e-7)
    assert single.earth == pytest.approx(_earth(home, Position(140.0, 5.0)), rel=0, abs=3e-7)


def _earth(home: GeoPosition, place: Position) -> tuple[float, float]:
    geo = LocalFrame(home).geo(place)
    return geo.latitude_deg, geo.longitude_deg


def test_flights_of_one_drone_join_no_objects_of_each_other() -> None:
    flights = [
        FlightFindings(name, "d", None, 0.0, None, [seen_at(1.0, 1.0, 0.9, photo=0, at_s=1.0)])
        for name in "ab"
    ]
    assert [(each.number, each.sightings) for each in numbered(flights).objects] == [(1, 1), (1, 1)]
