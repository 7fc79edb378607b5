"""The file that keeps between flights what servers without a range came to."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.config.drone_file import read_drone_config
from upwash.config.kept_maps import FORGOTTEN_AFTER, CoverageFile
from upwash.config.places import coverage_of, server_areas, true_areas
from upwash.core.geo import GeoPosition, Position
from upwash.core.knowledge.coverage import Coverage
from upwash.core.operation import Operation
from upwash.errors import ConfigError

HEAVY = Operation("detector", "process_photo", "heavy")
HOME = GeoPosition(39.36, 22.95)
PLACE = Position(30.0, 40.0)
DRONE = """
[mission]
waypoints_m = [[0, 0], [30, 40]]
{mission}
[network]
{network}
[[service]]
name = "detector"
local_call_s = {{ heavy = 10.0 }}
[[server]]
name = "s1"
remote_call_s = 1.0
{server}
"""


def written(
    folder: Path, *, server: str = 'range_m = "measured"', network: str = "", mission: str = ""
) -> Path:
    file = folder / "drone.toml"
    text = DRONE.format(server=server, network=network, mission=mission)
    file.write_text(text.replace("[mission]", '[mission]\nmode = "heavy"', 1))
    return file


def measured() -> Coverage:
    known = Coverage({"s1": ()})
    place = known.asked("s1", PLACE, answered=True)
    place.note(HEAVY, 1.5)
    place.carry(400_000, 1.5)
    return known


def test_what_a_flight_has_measured_is_there_for_the_next_one(tmp_path: Path) -> None:
    CoverageFile(tmp_path / "map.json").keep(measured(), None)
    config = read_drone_config(written(tmp_path, network='coverage_map = "map.json"'))
    known = coverage_of(config)
    assert known is not None
    place = known.at("s1", PLACE)
    assert place is not None
    assert (place.tried, place.answered, place.call_s(HEAVY)) == (1, 1, 1.5)
    assert place.goodput_bit_s == pytest.approx(8 * 400_000 / 1.5)


def test_a_file_that_is_not_there_is_a_first_flight(tmp_path: Path) -> None:
    known = coverage_of(read_drone_config(written(tmp_path, network='coverage_map = "none.json"')))
    assert known is not None
    assert list(known.places("s1")) == []


def test_places_stay_where_they_are_on_the_earth(tmp_path: Path) -> None:
    CoverageFile(tmp_path / "map.json").keep(measured(), HOME)
    north = GeoPosition(HOME.latitude_deg + 0.001, HOME.longitude_deg)
    (place,) = CoverageFile(tmp_path / "map.json").places(north)["s1"]
    assert place.position.east_m == pytest.approx(PLACE.east_m, abs=0.1)
    assert place.position.north_m == pytest.approx(PLACE.north_m - 111.0, abs=0.2)


def test_a_place_where_nothing_is_asked_any_more_is_forgotten(tmp_path: Path) -> None:
    file = tmp_path / "map.json"
    CoverageFile(file).keep(measured(), None)
    flights = 0
    while places := CoverageFile(file).places(None)["s1"]:
        CoverageFile(file).keep(Coverage({"s1": places}), None)
        flights += 1
    assert flights == FORGOTTEN_AFTER + 1


def test_servers_that_are_not_of_this_mission_stay_in_the_file(tmp_path: Path) -> None:
    file = tmp_path / "map.json"
    CoverageFile(file).keep(measured(), None)
    CoverageFile(file).keep(Coverage({"s2": ()}), None)
    assert len(CoverageFile(file).places(None)["s1"]) == 1


@pytest.mark.parametrize(
    "content",
    [
        b"[]",
        b'{"upwash_demands": 1}',
    ],
)
def test_a_file_that_is_no_map_is_refused_by_its_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "map.json").write_bytes(content)
    with pytest.raises(ConfigError, match=r"map\.json.*no coverage map of upwash.*delete it"):
        read_drone_config(written(tmp_path, network='coverage_map = "map.json"'))


def test_a_map_without_servers_for_it_is_refused(tmp_path: Path) -> None:
    file = written(
        tmp_path, server="range_m = 50\neast_m = 0\nnorth_m = 0", network='coverage_map = "map.json"'
    )
    with pytest.raises(ConfigError, match=r'network\.coverage_map.*no server has range_m = "measured"'):
        read_drone_config(file)


def test_a_server_without_a_range_needs_no_place(tmp_path: Path) -> None:
    config = read_drone_config(written(tmp_path))
    assert server_areas(config)["s1"].contains(Position(1e6, 1e6))


def test_how_far_it_is_truly_reached_needs_a_place(tmp_path: Path) -> None:
    file = written(tmp_path, server='range_m = "measured"\ntruth = { range_m = 45.0 }')
    with pytest.raises(ConfigError, match=r"east_m.*missing, with north_m: truth\.range_m counts from where"):
        read_drone_config(file)
    placed = 'range_m = "measured"\neast_m = 0\nnorth_m = 0\ntruth = { range_m = 45.0 }'
    config = read_drone_config(written(tmp_path, server=placed))
    assert server_areas(config)["s1"].contains(PLACE)
    assert not true_areas(config)["s1"].contains(PLACE)


def test_a_range_is_a_number_or_that_word(tmp_path: Path) -> None:
    file = written(tmp_path, server='range_m = "far"\neast_m = 0\nnorth_m = 0')
    with pytest.raises(ConfigError, match=r'expected a number above 0, in metres, or "measured"'):
        read_drone_config(file)
    with pytest.raises(ConfigError, match=r"range_m.*missing"):
        read_drone_config(written(tmp_path, server="east_m = 0\nnorth_m = 0"))
