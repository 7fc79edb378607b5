"""Maps that are kept between flights: whatever becomes of drone and file, the next flight begins."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from upwash.config.kept_maps import CoverageFile, DemandFile
from upwash.core.geo import FARTHEST_M, GeoPosition, Position
from upwash.core.knowledge.coverage import Coverage
from upwash.core.operation import Operation
from upwash.core.planning.demand_map import DemandMap
from upwash.errors import ConfigError

VOLOS, BERLIN = GeoPosition(39.36, 22.95), GeoPosition(52.52, 13.40)
HOMES = st.none() | st.builds(GeoPosition, st.floats(-90, 90), st.floats(-180, 180))
METRES = st.floats(-FARTHEST_M, FARTHEST_M)
Flight = Callable[[Path, GeoPosition | None, Position], int]


def demands_flown(file: Path, home: GeoPosition | None, at: Position) -> int:
    """The places that a flight knew at its beginning; its one answer is kept."""
    known = DemandFile(file).places(home)
    demands = DemandMap(known, near_m=20.0)
    demands.note(at, demanded=True)
    DemandFile(file).keep(demands, home)
    return len(known)


def calls_flown(file: Path, home: GeoPosition | None, at: Position) -> int:
    """The places that a flight knew at its beginning; its one call is kept."""
    known = CoverageFile(file).places(home).get("s1", [])
    coverage = Coverage({"s1": known})
    place = coverage.asked("s1", at, answered=True)
    place.note(Operation("detector", "process_photo", "heavy"), 1e9)
    place.carry(400_000, 1e9)
    CoverageFile(file).keep(coverage, home)
    return len(known)


FLIGHTS = pytest.mark.parametrize("fly", [demands_flown, calls_flown])


@FLIGHTS
@settings(max_examples=40, deadline=None)
@given(flights=st.lists(st.tuples(HOMES, METRES, METRES), min_size=1, max_size=8))
def test_what_a_flight_anywhere_wrote_the_next_one_anywhere_reads(
    fly: Flight, flights: list[tuple[GeoPosition | None, float, float]]
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for home, east_m, north_m in flights:
            fly(Path(folder, "map.json"), home, Position(east_m, north_m))
        assert not list(Path(folder).glob("*.damaged*"))


@FLIGHTS
def test_each_field_keeps_its_own_places(tmp_path: Path, fly: Flight) -> None:
    file, place = tmp_path / "map.json", Position(30.0, 40.0)
    assert [fly(file, home, place) for home in (VOLOS, BERLIN, None, BERLIN, VOLOS, None)] == [
        0,
        0,
        0,
        1,
        1,
        1,
    ]


@FLIGHTS
def test_a_map_torn_or_changed_at_any_byte_is_read_or_put_aside_or_refused(
    tmp_path: Path, fly: Flight
) -> None:
    file = tmp_path / "map.json"
    fly(file, VOLOS, Position(30.0, 40.0))
    fly(file, BERLIN, Position(30.0, 40.0))
    whole = file.read_bytes()
    changed = [whole[:at] for at in range(len(whole))]
    changed += [whole[:at] + b"\0" * 16 + whole[at + 16 :] for at in range(0, len(whole), 7)]
    for content in (*changed, b"\0" * len(whole)):
        file.write_bytes(content)
        try:
            fly(file, VOLOS, Position(30.0, 40.0))
        except ConfigError as error:
            assert "of upwash" in str(error)
            assert file.read_bytes() == content
            continue
        aside = tmp_path / "map.json.damaged"
        if aside.exists():
            assert aside.read_bytes() == content
            aside.unlink()
        fly(file, VOLOS, Position(30.0, 40.0))


def test_a_damaged_map_is_named_and_no_other_damaged_one_is_replaced(tmp_path: Path) -> None:
    file = tmp_path / "map.json"
    for content in (b'{"upwash_demands": 1, "plac', b'{"upwash_demands": 2}'):
        file.write_bytes(content)
        assert "is a damaged map of demands" in DemandFile(file).notice
        demands_flown(file, VOLOS, Position(0.0, 0.0))
        assert DemandFile(file).notice == ""
    assert (tmp_path / "map.json.damaged").read_bytes().endswith(b"plac")
    assert (tmp_path / "map.json.damaged1").read_bytes().endswith(b"2}")
