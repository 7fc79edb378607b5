"""The user is told of objects on the photo of the call that found them, on virtual time."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import pytest
from tests.drone.test_pending import in_the_air
from tests.drone.test_resume import at_once, fly
from tests.drone.test_rows import PLAN, rows

from upwash import Drone, Position, Waypoint
from upwash.core.camera.georeference import PhotoGeometry, Place, Unplaced
from upwash.core.camera.lens import Lens
from upwash.drone.answered_photos import AnsweredPhotos
from upwash.drone.pending import Pending
from upwash.drone.photographer import PhotoPose
from upwash.ports import Photo
from upwash.report.findings import Finder
from upwash.services import Detection, Detector
from upwash.sim.camera import ModelCamera

BOX = Detection(1.0, 2.0, 3.0, 4.0, label="car", score=0.9)
Late = Callable[[Drone, Waypoint, Pending[list[Detection]]], object]


@pytest.fixture(autouse=True)
def _different_photos(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bytes of each photo are its own, as those of a camera."""
    shoot, numbers = ModelCamera.take_photo, itertools.count()

    async def take_photo(camera: ModelCamera, at: Position) -> Photo:
        photo = await shoot(camera, at)
        return Photo(photo.jpeg + str(next(numbers)).encode(), photo.captured_s, photo.source)

    monkeypatch.setattr(ModelCamera, "take_photo", take_photo)


def told(late: Late) -> dict[int, int | None]:
    """The photos of the messages, each by the waypoint that the mission names, of a flight with 12 late answers."""
    names: dict[Position, int] = {}

    def program(drone: Drone, detector: Detector) -> None:
        for waypoint in drone.plan:
            names[waypoint.position] = waypoint.index
            drone.autopilot.goto(waypoint)
            late(
                drone, waypoint, drone.start(detector.process_photo, drone.camera.take_photo(), mode="heavy")
            )

    part = fly(at_once(rows()), mission=in_the_air(program), shows=list(PLAN.values()))
    assert part.error is None, part.error
    finder = Finder()
    for event in part.events:
        finder.take(event)
    return {names[found.named]: found.photo.number if found.photo else None for found in finder.found}


def in_demands(drone: Drone, waypoint: Waypoint, pending: Pending[list[Detection]]) -> None:
    def tell(found: list[Detection]) -> None:
        drone.user.notify(found, at=waypoint)

    drone.stay_or_go(pending, lambda _: None, demands=tell)


def in_demands_in_other_words(drone: Drone, waypoint: Waypoint, pending: Pending[list[Detection]]) -> None:
    def tell(found: list[Detection]) -> None:
        drone.user.notify([{"x": box.left_px, "y": box.top_px, "label": "car"} for box in found], at=waypoint)

    drone.stay_or_go(pending, lambda _: None, demands=tell)


def after_another_photo(drone: Drone, waypoint: Waypoint, pending: Pending[list[Detection]]) -> None:
    def tell(found: list[Detection]) -> None:
        drone.camera.take_photo()
        drone.user.notify(found[0], at=waypoint)

    drone.stay_or_go(pending, tell)


def test_a_late_answer_is_told_with_the_photo_of_its_call() -> None:
    its_own = {index: index for index in range(12)}
    assert told(in_demands) == its_own
    assert told(in_demands_in_other_words) == its_own


def test_an_answer_told_after_another_photo_has_the_photo_of_its_call() -> None:
    taken = iter(range(1000))
    photos: dict[int, int] = {}

    def late(drone: Drone, waypoint: Waypoint, pending: Pending[list[Detection]]) -> None:
        photos[waypoint.index] = next(taken)
        found = pending.result()
        drone.camera.take_photo()
        next(taken)
        drone.user.notify({"seen": found}, at=waypoint)
        drone.user.notify(found[:1], at=waypoint)  # a list of the mission's own

    assert told(late) == photos


def test_what_is_told_of_a_second_look_is_about_its_photo() -> None:
    def late(drone: Drone, waypoint: Waypoint, pending: Pending[list[Detection]]) -> None:
        pending.result()
        drone.camera.take_photo()
        drone.user.notify({"seen": "nearer"}, at=waypoint)

    assert told(late) == {index: 2 * index + 1 for index in range(12)}


def test_a_call_is_about_the_photo_that_it_has_and_not_the_last_one() -> None:
    photos, found = AnsweredPhotos(), [BOX]
    for jpeg in (b"first", b"second", b"third"):
        photos.take(jpeg, None)
    photo = photos.of_call(["heavy", b"second"])
    assert photos.of_call([bytearray(b"second")]) is photo is photos.of_call([memoryview(b"second")])
    assert photo is not None and photo.number == 1
    photos.answered(found, photo)
    assert [photos.number_of(told) for told in (found, BOX, [BOX], {"a": (BOX,)}, "text")] == [
        1,
        1,
        1,
        1,
        None,
    ]
    last = photos.of_call([b"a part of a photo"])
    assert last is not None and last.number == 2


def test_what_is_known_of_photos_and_answers_is_bounded() -> None:
    photos = AnsweredPhotos()
    for number in range(5000):
        photos.take(str(number).encode(), None)
        photos.answered([BOX], photos.of_call([]))
    assert len(photos._by_hash) <= 1000 and len(photos._of_objects) <= 4096


def test_a_message_that_contains_itself_is_looked_at_once() -> None:
    photos, endless = AnsweredPhotos(), []  # type: ignore[var-annotated]
    endless.append(endless)
    assert photos.number_of(endless) is None


def test_a_pose_places_an_answers_object_by_the_photo_of_its_call() -> None:
    def geometry(east_m: float) -> PhotoGeometry:
        return PhotoGeometry(
            lens=Lens(fov_deg=62.2, up_deg=0.0), size_px=(640, 480), position=Position(east_m, 0.0, 20.0)
        )

    photos = AnsweredPhotos()
    photos.take(b"first", geometry(10.0))
    photos.take(b"second", geometry(50.0))
    pose = PhotoPose(Position(50.0, 0.0, 20.0), None, None, None, geometry(50.0), photos)
    middle = Detection(310.0, 230.0, 20.0, 20.0, label="car", score=0.9)
    assert east_m(pose.place_of(middle)) == pytest.approx(50.0)
    photos.answered([middle], photos.of_call([b"first"]))
    assert east_m(pose.place_of(middle)) == pytest.approx(10.0)


def east_m(place: Place | Unplaced) -> float:
    assert isinstance(place, Place), place
    return place.position.east_m
