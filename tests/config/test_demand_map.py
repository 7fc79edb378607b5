"""The file that keeps between flights where answers had demands."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.scenarios import scenario

from upwash.config.kept_maps import FORGOTTEN_AFTER, DemandFile
from upwash.config.places import demand_map_of, demands_kept, waypoints
from upwash.core.geo import GeoPosition, Position
from upwash.core.planning.demand_map import DemandMap
from upwash.errors import ConfigError

HOME = GeoPosition(39.36, 22.95)
PLACE = Position(30.0, 40.0)
MISSION = {"waypoints_m": [[0, 0], [30, 40]]}


def noted() -> DemandMap:
    known = DemandMap((), near_m=20.0)
    known.note(PLACE, demanded=True)
    known.note(PLACE, demanded=False)
    return known


def test_demands_of_a_flight_are_there_half_for_the_next_one(tmp_path: Path) -> None:
    config = scenario(policy={"demand_map": str(tmp_path / "map.json")})
    assert demand_map_of(scenario(), waypoints(config.mission)) is None
    demands_kept(config, noted())
    config = scenario(policy={"demand_map": str(tmp_path / "map.json")})
    known = demand_map_of(config, waypoints(config.mission))
    assert known is not None
    (place,) = known.places()
    assert (place.position, place.answers, place.demands, place.flights_ago) == (PLACE, 1.0, 0.5, 1)


def test_places_stay_where_they_are_on_the_earth(tmp_path: Path) -> None:
    DemandFile(tmp_path / "map.json").keep(noted(), HOME)
    north = GeoPosition(HOME.latitude_deg + 0.001, HOME.longitude_deg)
    (place,) = DemandFile(tmp_path / "map.json").places(north)
    assert place.position.east_m == pytest.approx(PLACE.east_m, abs=0.1)
    assert place.position.north_m == pytest.approx(PLACE.north_m - 111.0, abs=0.2)


def test_a_place_without_answers_is_forgotten_after_five_flights(tmp_path: Path) -> None:
    file = tmp_path / "map.json"
    DemandFile(file).keep(noted(), None)
    flights = 0
    while places := DemandFile(file).places(None):
        DemandFile(file).keep(DemandMap(places, near_m=20.0), None)
        flights += 1
    assert flights == FORGOTTEN_AFTER + 1


@pytest.mark.parametrize(
    "content",
    [
        b"[]",
        b'{"upwash_coverage": 1}',
        b"\xff\xff",
        b'name = "d1"',
    ],
)
def test_a_file_that_is_no_map_is_refused_by_its_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "map.json").write_bytes(content)
    with pytest.raises(ConfigError, match=r"map\.json.*no map of demands of upwash.*delete it"):
        scenario(policy={"demand_map": str(tmp_path / "map.json")})


def test_more_demands_than_answers_count_as_a_demand_each(tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text(
        '{"upwash_demands": 1, "places": [{"east_m": 0, "north_m": 0, "answers": 2, "demands": 9}]}'
    )
    (place,) = DemandFile(tmp_path / "map.json").places(None)
    assert place.demands == place.answers == 1.0
