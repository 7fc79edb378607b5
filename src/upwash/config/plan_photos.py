"""Where the triggers of a plan take photos: spots on the legs between its waypoints.

    a trigger     Photos begin at the place of the waypoint before it, and go on around corners, as an autopilot does.
    a row         A straight way over one or more legs; the drone passes the spots on it, and rests at its end.
    other places  A waypoint without a photo, such as a turn-around, is flown to on the way to the next spot.

A trigger may take a photo at once, as those of QGroundControl do at the end of each transect. Where that follows the
photo before it sooner than the camera can, the photo before it is taken earlier: no two photos lie farther apart.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from upwash.config.drone import DroneConfig, MissionConfig, PhotosConfig
from upwash.config.problems import Problem
from upwash.core.geo import LocalFrame, Position, Via, Waypoint, distance_m, ground_distance_m, part_way
from upwash.plans import FlightPlan, PhotoTrigger

MOST_SPOTS = 100_000
_SAME_PLACE_M = 0.05
_STRAIGHT_M = 0.3  # beside a straight way: coordinates have centimetres, and rows on the Earth are a bit bent
_MOST_LEGS = 50  # of a straight way, so that each is compared with few others
_ROUNDING = 0.01  # the share of the distance between spots that a leg may lack for its last photo


@dataclass(frozen=True, slots=True)
class PlannedPhotos:
    """The spots of a plan, the places that the drone flies to after the last of them, and all where it rests."""

    waypoints: tuple[Waypoint, ...] = ()
    leaving: tuple[Via, ...] = ()
    way: tuple[Position, ...] = ()


@dataclass(frozen=True, slots=True)
class _Corner:
    position: Position
    ground_speed_m_s: float  # of the way there
    above_sea_m: float | None
    hold_s: float
    triggers: tuple[PhotoTrigger, ...]

    def via(self) -> Via:
        return Via(self.position, self.ground_speed_m_s, self.hold_s)


@dataclass(frozen=True, slots=True)
class PhotoLeg:
    """How photos are taken on a leg: the lowest altitude, the speed, and the distance between two of them."""

    altitude_m: float
    ground_speed_m_s: float
    step_m: float


@dataclass(frozen=True, slots=True)
class _PlannedLeg(PhotoLeg):
    corner: int
    trigger: PhotoTrigger


@dataclass(frozen=True, slots=True)
class _Shot:
    """A photo, by the metres over the ground from the first waypoint; `corner`: at a waypoint, taken at once."""

    at_m: float
    corner: int | None = None


def planned_photos(mission: MissionConfig) -> PlannedPhotos:
    """The spots of the triggers of the mission's plan; none of a mission without a plan or without photos."""
    if mission.plan is None or mission.photos is None:
        return PlannedPhotos()
    return _Course(mission, mission.plan.plan).photos()


def photo_legs(mission: MissionConfig) -> Sequence[PhotoLeg]:
    """The legs with photos of a mission that takes them in flight; all rows that are no plan's are one."""
    photos, speed_m_s = mission.photos, mission.ground_speed_m_s
    if photos is None:
        return []
    if mission.plan is None:
        step_m = photos.step_m(speed_m_s)
        return [] if step_m is None else [PhotoLeg(mission.altitude_m, speed_m_s, step_m)]
    return _Course(mission, mission.plan.plan).legs


def speed_set_at(plan: FlightPlan, photos: PhotosConfig) -> int | None:
    """The first item of the plan that sets a speed, or photos by time; None without one."""
    for waypoint in plan.waypoints:
        if waypoint.ground_speed_m_s is not None:
            return waypoint.item
        for trigger in waypoint.triggers:
            if trigger.every_s is not None and photos.every_m is None:
                return trigger.item
    return None


def photo_plan_problems(config: DroneConfig) -> Iterator[Problem]:
    """What keeps the triggers of the mission's plan from being flown; nothing for a mission without photos."""
    mission, key = config.mission, "mission.photos"
    if mission.plan is None or mission.photos is None:
        return
    file, plan, step_m = mission.plan.file, mission.plan.plan, mission.photos.step_m(mission.ground_speed_m_s)
    triggers = [trigger for waypoint in plan.waypoints for trigger in waypoint.triggers]
    for trigger in triggers:
        problem = trigger.problem or (_pace_problem(trigger, config.camera.photo_s) if step_m is None else "")
        if problem:
            yield key, f"{file}: item {trigger.item}: {trigger.command} {problem}"
            return
    course = _Course(mission, plan)
    if not any(trigger.now for trigger in triggers) and not course.legs:
        others = "; ".join(str(notice) for notice in plan.notices if notice.of_camera)
        yield (
            key,
            f"{file} triggers no camera{f' ({others})' if others else ''}: plan a survey with a camera, or leave "
            "photos out, and the drone stops at each waypoint for a photo",
        )
        return
    if (count := course.least_photos()) > MOST_SPOTS:
        yield key, f"{file}: more than {MOST_SPOTS:,} photos ({count:,.0f}): set photos.every_m larger"
        return
    photo_s = config.camera.photo_s
    for leg in course.legs if mission.speed == "given" else ():
        if photo_s * leg.ground_speed_m_s > leg.step_m * (1 + 1e-9):
            yield (
                key,
                f"{file}: item {leg.trigger.item}: {leg.trigger.command} is too dense: a photo takes "
                f"camera.photo_s = {photo_s:g} s, so that one every {leg.step_m:g} m allows at most "
                f"{leg.step_m / photo_s:.3g} m/s, and the plan has {leg.ground_speed_m_s:g} m/s there: fly slower, "
                "or set photos.every_m larger",
            )
            return
    if not course.photos().waypoints:
        yield key, f"{file}: no leg is as long as its trigger's distance: set photos.every_m smaller"


def _pace_problem(trigger: PhotoTrigger, photo_s: float) -> str:
    """What is wrong with a trigger's distance or time, as a continuation of its command; "" for nothing."""
    every_m, every_s = trigger.every_m, trigger.every_s
    if every_m is not None and not 0 < every_m < math.inf:
        says = "names no distance" if math.isnan(every_m) else f"takes a photo each {every_m:g} m"
        return f"{says}: expected a distance above 0 (DO_SET_CAM_TRIGG_DIST, 206), or set photos.every_m"
    if every_s is not None and not max(0.0, photo_s) <= every_s < math.inf:
        return (
            f"takes a photo each {every_s:g} s, and a photo takes camera.photo_s = {photo_s:g} s: plan a longer "
            "time (IMAGE_START_CAPTURE counts in seconds, DO_SET_CAM_TRIGG_INTERVAL in milliseconds), or set "
            "photos.every_m"
        )
    return ""


class _Course:
    """The plan's waypoints in metres, and the legs with photos between them."""

    def __init__(self, mission: MissionConfig, plan: FlightPlan) -> None:
        assert mission.photos is not None and mission.home is not None  # noqa: S101 - the callers saw to it
        self._photo_s = plan.photo_s
        self._photos = mission.photos
        frame = LocalFrame(mission.home.place)
        self.corners = _without_repeats(
            _Corner(
                frame.position(item.place),
                item.ground_speed_m_s or mission.ground_speed_m_s,
                item.above_sea_m,
                item.hold_s,
                item.triggers,
            )
            for item in plan.waypoints
        )
        places = [corner.position for corner in self.corners]
        lengths_m = (ground_distance_m(*ends) for ends in itertools.pairwise(places))
        self._reached_m = list(itertools.accumulate(lengths_m, initial=0.0))
        self.legs = list(self._legs_with_photos())

    def photos(self) -> PlannedPhotos:
        rows = list(self._rows())
        rests = [0, *(end for _, end in rows)]  # the corners where the drone rests
        waypoints: list[Waypoint] = []
        following = 0  # of the rests, the first that is not behind the last spot
        for (corner, share), _ in itertools.groupby(map(self._place_of, self._shots())):
            number = bisect.bisect_left(rests, corner + (share > 0))  # of the rest where its row ends
            start, end = rows[max(0, number - 1)] if rows else (0, 0)
            is_rest = not share and rests[number] == corner
            last = number if is_rest else number - 1  # the rest before it, or where it is
            via = tuple(self.corners[rest].via() for rest in rests[following : last + (not is_rest)])
            following = max(following, last + 1)
            waypoints.append(
                replace(
                    self._spot(corner, share),
                    index=len(waypoints),
                    ground_speed_m_s=self.corners[corner if is_rest else end].ground_speed_m_s,
                    hold_s=self.corners[corner].hold_s if is_rest else 0.0,
                    row_start=self.corners[start].position if rows else None,
                    row_end=self.corners[end].position if rows else None,
                    via=via,
                )
            )
        return PlannedPhotos(
            tuple(waypoints),
            leaving=tuple(self.corners[rest].via() for rest in rests[following:]),
            way=tuple(self.corners[rest].position for rest in rests),
        )

    def least_photos(self) -> float:
        return sum(
            (self._reached_m[leg.corner] - self._reached_m[leg.corner - 1]) / leg.step_m for leg in self.legs
        )

    def _legs_with_photos(self) -> Iterator[_PlannedLeg]:
        on: PhotoTrigger | None = None
        for number, corner in enumerate(self.corners[:-1], start=1):
            for trigger in corner.triggers:
                if not trigger.leaves_on:
                    on = trigger if trigger.every_m is not None or trigger.every_s is not None else None
            if on is not None:
                end = self.corners[number]
                step_m = self._photos.step_m(end.ground_speed_m_s)
                if step_m is None:
                    step_m = on.every_m or (on.every_s or 0.0) * end.ground_speed_m_s
                lowest_m = min(corner.position.altitude_m, end.position.altitude_m)
                yield _PlannedLeg(lowest_m, end.ground_speed_m_s, step_m, number, on)

    def _shots(self) -> list[_Shot]:
        shots: list[_Shot] = []
        legs = {leg.corner - 1: leg for leg in self.legs}
        share, since_m = 0.0, 0.0  # of a step, since the last photo; where photos began
        left = math.inf  # how many photos
        for number, corner in enumerate(self.corners):
            at_m = self._reached_m[number]
            for trigger in corner.triggers:
                if trigger.now:
                    share = 0.0
                    self._take_at_once(shots, number, since_m)
                if not trigger.leaves_on:
                    share, since_m = 0.0, at_m
                    left = math.inf if trigger.most is None else trigger.most - trigger.now
            leg = legs.get(number)
            if leg is None:
                continue
            length_m = self._reached_m[number + 1] - at_m
            done_m = (1 - share) * leg.step_m
            while done_m <= length_m + min(_SAME_PLACE_M, _ROUNDING * leg.step_m) and left > 0:
                shots.append(_Shot(at_m + min(done_m, length_m)))
                done_m += leg.step_m
                left -= 1
            share = 1 - (done_m - length_m) / leg.step_m
        return shots

    def _take_at_once(self, shots: list[_Shot], number: int, since_m: float) -> None:
        corner, at_m = self.corners[number], self._reached_m[number]
        if (
            shots
            and distance_m(self._spot(*self._place_of(shots[-1])).position, corner.position) < _SAME_PLACE_M
        ):
            return
        needed_m = self._photo_s * corner.ground_speed_m_s
        if shots and shots[-1].corner is None and at_m - shots[-1].at_m < needed_m:
            before_m = shots[-2].at_m if len(shots) > 1 else since_m
            shots[-1] = _Shot(max(at_m - needed_m, (before_m + at_m) / 2, since_m))
        shots.append(_Shot(at_m, number))

    def _place_of(self, shot: _Shot) -> tuple[int, float]:
        """The corner at or before the photo, and the share of the leg from there."""
        if shot.corner is not None:
            return shot.corner, 0.0
        after = bisect.bisect_left(self._reached_m, shot.at_m - _SAME_PLACE_M)
        if self._reached_m[after] - shot.at_m <= _SAME_PLACE_M:
            return after, 0.0
        start_m, end_m = self._reached_m[after - 1 : after + 1]
        return after - 1, (shot.at_m - start_m) / (end_m - start_m)

    def _spot(self, corner: int, share: float) -> Waypoint:
        start = self.corners[corner]
        if not share:
            return Waypoint(0, start.position, above_sea_m=start.above_sea_m)
        end = self.corners[corner + 1]
        above_sea_m = None
        if start.above_sea_m is not None and end.above_sea_m is not None:
            above_sea_m = start.above_sea_m + share * (end.above_sea_m - start.above_sea_m)
        return Waypoint(0, part_way(start.position, end.position, share), above_sea_m=above_sea_m)

    def _rows(self) -> Iterator[tuple[int, int]]:
        """The straight ways: the corners where each begins and ends."""
        start = 0
        while start + 1 < len(self.corners):
            end = start + 1
            while end + 1 < len(self.corners) and self._is_straight(start, end + 1):
                end += 1
            yield start, end
            start = end

    def _is_straight(self, start: int, end: int) -> bool:
        ways, inner = self.corners[start + 1 : end + 1], self.corners[start + 1 : end]
        if end - start > _MOST_LEGS or any(corner.hold_s for corner in inner):
            return False
        if len({corner.ground_speed_m_s for corner in ways}) > 1:
            return False
        first, last = self.corners[start].position, self.corners[end].position
        length_m = distance_m(first, last)
        along_m = 0.0
        for corner in inner:
            from_m, to_m = distance_m(first, corner.position), distance_m(corner.position, last)
            if from_m < along_m or from_m > length_m or to_m > length_m:
                return False
            along_m = from_m
            share = from_m / length_m
            if distance_m(corner.position, part_way(first, last, share)) > _STRAIGHT_M:
                return False
        return True


def _without_repeats(corners: Iterator[_Corner]) -> Sequence[_Corner]:
    found: list[_Corner] = []
    for corner in corners:
        if found and distance_m(found[-1].position, corner.position) < _SAME_PLACE_M:
            last = found[-1]
            found[-1] = replace(
                last, hold_s=last.hold_s + corner.hold_s, triggers=last.triggers + corner.triggers
            )
        else:
            found.append(corner)
    return found
