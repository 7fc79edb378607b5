"""Missions held against the vehicle's own fence before arming: each part of a flight, and what each refusal says."""

from __future__ import annotations

from dataclasses import replace

import pytest
from msgspec import structs

from upwash.core.geo import Circle, Position, Via, Waypoint
from upwash.core.vehicle.geofence import AreaUnion, Fence, Polygon
from upwash.drone.home import PlannedHome
from upwash.drone.site import Site
from upwash.errors import AutopilotRefused
from upwash.plans import Ending
from upwash.ports import FenceNames, VehicleLimits

STANDS = Position(0.0, 0.0)
NAMES = FenceNames("FENCE_ALT_MAX", "FENCE_ALT_MIN", "FENCE_MARGIN", "RTL_ALT")


def box(west_m: float, south_m: float, east_m: float, north_m: float) -> Polygon:
    corners = (west_m, south_m), (east_m, south_m), (east_m, north_m), (west_m, north_m)
    return Polygon(tuple(Position(*corner) for corner in corners))


def keep_out(west_m: float, south_m: float, east_m: float, north_m: float) -> VehicleLimits:
    area = Fence("area 1 of the vehicle's fence", box(west_m, south_m, east_m, north_m), inclusion=False)
    return VehicleLimits(home=STANDS, fences=[area])


def keep_in(*areas: Polygon | Circle) -> VehicleLimits:
    fences = [Fence(f"area {number}", area, inclusion=True) for number, area in enumerate(areas, 1)]
    return VehicleLimits(home=STANDS, fences=fences)


def heights(highest_m: float | None = None, lowest_m: float | None = None, **more: float) -> VehicleLimits:
    return VehicleLimits(home=STANDS, highest_m=highest_m, lowest_m=lowest_m, names=NAMES, **more)  # type: ignore[arg-type]


def site(*places: tuple[float, float, float], takeoff_m: float = 15.0, ending: Ending = "return") -> Site:
    waypoints = [Waypoint(index, Position(*place)) for index, place in enumerate(places)]
    return Site(waypoints, (), farthest_start_m=500.0, takeoff_m=takeoff_m, ending=ending)


def refusal(flown: Site, limits: VehicleLimits, stands: Position = STANDS) -> str:
    with pytest.raises(AutopilotRefused, match="nothing was sent") as caught:
        flown.require_within(limits, stands)
    return str(caught.value)


AROUND = site((40.0, 0.0, 15.0), (40.0, 40.0, 15.0), (0.0, 40.0, 15.0))  # home again along the fourth side

TURNING = structs.replace(  # around a corner without a photo, and on to another after the last photo
    AROUND,
    waypoints=[
        AROUND.waypoints[0],
        Waypoint(1, Position(0.0, 40.0, 15.0), via=(Via(Position(40.0, 40.0, 15.0)),)),
    ],
    leaving=[Via(Position(-40.0, 40.0, 15.0))],
)


@pytest.mark.parametrize(
    ("flown", "limits", "said"),
    [
        (
            AROUND,
            keep_out(-5, -5, 5, 5),
            "the place where the vehicle stands (0 m east, 0 m north): it lies inside area 1",
        ),
        (
            AROUND,
            keep_out(15, -5, 25, 5),
            "waypoint 0: the way there from where the vehicle stands (0 m east, 0 m north) crosses",
        ),
        (AROUND, keep_out(35, 15, 45, 25), "waypoint 1: the way there from waypoint 0 crosses area 1"),
        (AROUND, keep_out(35, -5, 45, 5), "waypoint 0: it lies inside area 1"),
        (AROUND, keep_out(15, 35, 25, 45), "waypoint 2: the way there from waypoint 1 crosses area 1"),
        (AROUND, keep_out(-5, 15, 5, 25), "the way home from waypoint 2: it crosses area 1"),
        (
            TURNING,
            keep_out(35, 35, 45, 45),
            "a place on the way to waypoint 1 (40 m east, 40 m north): it lies",
        ),
        (
            TURNING,
            keep_out(15, 35, 25, 45),
            "waypoint 1: the way there from a place on the way to waypoint 1",
        ),
        (
            TURNING,
            keep_out(-45, 35, -35, 45),
            "a place after the last photo (-40 m east, 40 m north): it lies",
        ),
        (TURNING, keep_out(-25, 15, -15, 25), "the way home from a place after the last photo"),
        (AROUND, keep_in(box(-5, -5, 45, 30)), "waypoint 1: it lies outside area 1"),
        (AROUND, keep_in(box(10, -5, 45, 45)), "stands (0 m east, 0 m north): it lies outside area 1"),
        (AROUND, keep_in(box(-5, -5, 45, 45), box(-5, -5, 45, 20)), "waypoint 1: it lies outside area 2"),
        (
            AROUND,
            keep_in(Circle(STANDS, 50.0)),
            "waypoint 1: it lies outside area 1, 57 m from its centre with a radius of 50 m",
        ),
        (
            AROUND,
            heights(10.0),
            "the take-off to 15 m: it is 15 m up, the fence ends at FENCE_ALT_MAX = 10 m",
        ),
        (
            AROUND,
            heights(15.0),
            "the take-off to 15 m: it is 15 m up, the fence ends at FENCE_ALT_MAX = 15 m",
        ),
        (
            site((0, 9, 22), takeoff_m=5.0),
            heights(20.0),
            "waypoint 0: it is 22 m up, the fence ends at FENCE_ALT_MAX = 20 m",
        ),
        (
            site((0, 9, 12)),
            heights(lowest_m=12.0),
            "waypoint 0: it is 12 m up, the fence begins at FENCE_ALT_MIN = 12 m",
        ),
        (
            site((0, 9, 30), takeoff_m=5.0),
            heights(lowest_m=10.0),
            "the take-off to 5 m: it is 5 m up, the fence begins",
        ),
        (
            AROUND,
            heights(20.0, returns_at_m=30.0),
            "the way home at RTL_ALT = 30 m: it ends at FENCE_ALT_MAX = 20 m; lower RTL",
        ),
        (AROUND, heights(20.0, returns_at_m=20.0), "the way home at RTL_ALT = 20 m: it ends at"),
        (
            structs.replace(AROUND, home=PlannedHome(above_sea_m=488.0, counts_from_sea=True)),
            replace(VehicleLimits(), home_above_sea_m=519.0),
            "the vehicle's home is now at 519 m",
        ),
    ],
)
def test_what_the_vehicles_fence_forbids_is_refused_with_its_place(
    flown: Site, limits: VehicleLimits, said: str
) -> None:
    assert said in refusal(flown, limits)


@pytest.mark.parametrize(
    ("flown", "limits"),
    [
        (AROUND, VehicleLimits()),
        (AROUND, keep_out(10, 10, 30, 30)),  # in the middle of its way
        (AROUND, keep_in(box(-5, -5, 45, 45), Circle(STANDS, 60.0))),
        (AROUND, heights(20.0, 5.0, returns_at_m=18.0)),
        (AROUND, heights(lowest_m=-10.0)),
        (
            structs.replace(AROUND, ending="land"),
            keep_out(-5, 15, 5, 25),
        ),  # across its way home, which it does not fly
        (site(), keep_out(10, 10, 30, 30)),
    ],
)
def test_what_the_vehicles_fence_allows_is_flown(flown: Site, limits: VehicleLimits) -> None:
    flown.require_within(limits, STANDS)


def test_of_joined_areas_one_is_enough() -> None:
    joined = Fence("all", AreaUnion((box(-5, -5, 45, 20), box(-5, 20, 45, 45))), inclusion=True)
    AROUND.require_within(VehicleLimits(home=STANDS, fences=[joined]), STANDS)
    gap = Fence("all 2 areas", AreaUnion((box(-5, -5, 45, 19), box(-5, 21, 45, 45))), inclusion=True)
    said = refusal(AROUND, VehicleLimits(home=STANDS, fences=[gap]))
    assert "waypoint 1: the way there from waypoint 0 leaves all 2 areas" in said


def test_the_way_home_leads_to_the_vehicles_home_which_is_not_where_it_stands() -> None:
    elsewhere = replace(keep_out(15, 15, 25, 25), home=Position(40.0, 0.0))
    assert "the way home from waypoint 2: it crosses area 1" in refusal(AROUND, elsewhere)
    assert "the landing at the vehicle's home (20 m east, 20 m north)" in refusal(
        AROUND, replace(elsewhere, home=Position(20.0, 20.0))
    )


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        (
            heights(16.0, margin_m=2.0),
            ["the take-off at 15 m is nearer than FENCE_MARGIN = 2 m to FENCE_ALT_MAX = 16 m"],
        ),
        (
            replace(keep_in(box(-5, -5, 41, 41)), margin_m=2.0, names=NAMES),
            ["waypoint 0 is 1.0 m from the border of area 1"],
        ),
        (replace(VehicleLimits(), untold=("FENCE_ENABLE",)), ["the vehicle did not tell FENCE_ENABLE"]),
        (keep_out(10, 10, 30, 30), ["a straight way home from waypoint 1 crosses area 1"]),
        (heights(17.0, margin_m=2.0), []),
        (replace(keep_in(box(-5, -5, 42, 42)), margin_m=2.0, names=NAMES), []),
        (VehicleLimits(home=Position(0.0, -21.0)), ["the vehicle stands 21 m from its own home"]),
        (VehicleLimits(home=Position(0.0, -20.0)), []),
    ],
)
def test_what_the_vehicles_fence_allows_with_doubt_is_told(limits: VehicleLimits, said: list[str]) -> None:
    AROUND.require_within(limits, STANDS)
    told = list(AROUND.doubts(limits, STANDS))
    assert len(told) == len(said)
    assert all(part in sentence for part, sentence in zip(said, told, strict=True))


def test_of_several_straight_ways_home_that_cross_a_fence_the_first_is_named() -> None:
    flown = site((40.0, 0.0, 15.0), (40.0, 40.0, 15.0), (44.0, 44.0, 15.0))
    (said,) = flown.doubts(keep_out(10, 10, 30, 30), STANDS)
    assert said.startswith("a straight way home from 2 waypoints, the first of them 1, crosses area 1")


@pytest.mark.parametrize(
    ("away_m", "said"),
    [(500.0, ""), (501.0, "501 m"), (999.0, "999 m"), (1000.0, "1.0 km"), (900_000.0, "900.0 km")],
)
def test_the_vehicle_starts_no_farther_from_the_mission_than_configured(away_m: float, said: str) -> None:
    stands = Position(40.0 + away_m, 0.0)
    if not said:
        AROUND.require_reachable(stands)
        structs.replace(site(), farthest_start_m=0.0).require_reachable(stands)  # it has no waypoints
        return
    with pytest.raises(AutopilotRefused, match=f"the vehicle stands {said} from the nearest waypoint"):
        AROUND.require_reachable(stands)


@pytest.mark.parametrize(
    ("start", "target", "why"),
    [
        (Position(0, 0, 15), Position(40, 0, 15), "area 1 of the vehicle's fence is in the way"),
        (Position(0, 0, 15), Position(20, 0, 15), "area 1 of the vehicle's fence is in the way"),
        (Position(0, 0, 15), Position(0, 40, 15), ""),
        (Position(20, 0, 15), Position(40, 0, 15), ""),  # it has to come out
    ],
)
def test_a_leg_beside_the_plan_keeps_to_the_vehicles_fence_too(
    start: Position, target: Position, why: str
) -> None:
    limits = keep_out(15, -5, 25, 5)
    if why:
        with pytest.raises(AutopilotRefused, match=f"goto .* {why}; nothing was sent"):
            AROUND.require_leg(limits, start, target)
    else:
        AROUND.require_leg(limits, start, target)
    with pytest.raises(AutopilotRefused, match="it is 40 m up, the fence ends at FENCE_ALT_MAX = 20 m"):
        AROUND.require_leg(heights(20.0), STANDS, Position(0, 0, 40))
