"""What a flight tells of its drone each second."""

from __future__ import annotations

import asyncio

import pytest
from tests.conftest import SCENARIOS
from tests.drone.test_reserve import survey_far

from upwash.config.drone import DroneConfig
from upwash.drone.flight import Flight
from upwash.eventlog import schema
from upwash.lab.run import simulate
from upwash.lab.scenario import read_scenario


def reports_of(config: DroneConfig) -> list[schema.PositionReport]:
    """The reports of a simulated flight, a second apart."""
    found: list[schema.PositionReport] = []
    run = Flight.run

    async def watched(self: Flight) -> None:
        async def watch() -> None:
            while True:
                found.append(self.position_report())
                await asyncio.sleep(1.0)

        watching = asyncio.create_task(watch())
        await run(self)
        watching.cancel()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Flight, "run", watched)
        simulate(config)
    return found


@pytest.fixture(scope="module")
def reports() -> list[schema.PositionReport]:
    """Those of the thesis's mission."""
    return reports_of(read_scenario(SCENARIOS / "thesis.toml"))


def test_it_has_the_speed_over_the_ground_and_where_the_nose_points(
    reports: list[schema.PositionReport],
) -> None:
    assert (reports[0].ground_speed_m_s, reports[0].heading_deg) == (0.0, None)
    assert 4.0 in {report.ground_speed_m_s for report in reports}  # mission.ground_speed_m_s, on long legs
    flown = {report.heading_deg for report in reports if report.ground_speed_m_s}
    assert {90.0, 180.0, 270.0} <= flown  # east, then a row further south, then west


def test_what_the_vehicle_does_not_say_is_absent(reports: list[schema.PositionReport]) -> None:
    assert {report.battery_percent for report in reports} == {None}  # a scenario without an endurance


def test_it_has_the_battery_in_tenths_of_a_percent() -> None:
    percents = [report.battery_percent for report in reports_of(survey_far(reserve_s=0.0, endurance_s=160.0))]
    assert percents[0] == 100.0
    assert {99.4, 98.8, 98.1, 97.5} <= set(percents)  # it falls by 0.625 a second


def test_it_has_the_server_in_use_and_how_long_its_daemon_took_to_answer(
    reports: list[schema.PositionReport],
) -> None:
    assert {report.server for report in reports} == {None, "s1", "s2"}
    answered = [report for report in reports if report.round_trip_s is not None]
    assert {each.server for each in answered} == {"s1", "s2"}
    assert all(0.0 <= (each.round_trip_s or 0.0) < 5.0 for each in answered)
    assert not [report for report in reports if report.server is None and report.round_trip_s is not None]


def test_it_has_the_vehicles_mode_arming_and_gps(reports: list[schema.PositionReport]) -> None:
    assert {report.armed for report in reports} == {False, True}
    flown = [report for report in reports if report.ground_speed_m_s]
    assert {(report.mode, report.gps) for report in flown} >= {("GUIDED", "3d")}
    assert all(report.satellites for report in reports)
