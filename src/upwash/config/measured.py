"""Files of measured servers, links and flights, beside the rest of a configuration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from upwash.config.drone import DroneConfig, MissionConfig, ServiceConfig, VehicleConfig
from upwash.config.places import frame_of, waypoints
from upwash.config.problems import Problem, listed
from upwash.config.traces import read_battery, read_goodput_trace, read_service_times, read_track, read_wind
from upwash.config.truth import keys_of
from upwash.config.world import TruthConfig
from upwash.core.geo import Position
from upwash.core.vehicle.track import NEAR_M, Track


def track_of(vehicle: VehicleConfig, mission: MissionConfig) -> Track | None:
    """The track that the simulated vehicle flies; None without one. Raises ConfigError for a file that is none.

    Times count from the file's first row. Without altitudes the track is as high as the mission's take-off.
    """
    if vehicle.track_csv is None:
        return None
    rows = read_track(vehicle.track_csv, frame_of(mission)).rows
    return Track(
        [row[0] - rows[0][0] for row in rows],
        [Position(row[1], row[2], max(0.0, row[3]) if row[3:] else mission.altitude_m) for row in rows],
    )


def flight_problems(config: DroneConfig) -> Iterator[Problem]:
    """What a measured flight does not fit."""
    vehicle = config.vehicle
    if vehicle.wind_csv is not None:
        read_wind(vehicle.wind_csv)
    if vehicle.battery_csv is not None:
        read_battery(vehicle.battery_csv)
        if vehicle.endurance_s is not None or (config.energy and config.energy.battery_wh is not None):
            beside = "vehicle.endurance_s" if vehicle.endurance_s is not None else "energy.battery_wh"
            yield (
                "vehicle.battery_csv",
                f"{beside} says too how long the battery lasts: leave one of the two out",
            )
    if (track := track_of(vehicle, config.mission)) is not None:
        yield from ((f"vehicle.{key}", problem) for key, problem in _track_problems(track, config))


def _track_problems(track: Track, config: DroneConfig) -> Iterator[Problem]:
    key = "track_csv"
    if config.drones:
        yield (
            key,
            "a track is one vehicle's, and the file has [[drone]] tables: leave them, or the track, out",
        )
        return
    if any(fault.target == "autopilot" for fault in config.faults):
        yield key, "a fault of the autopilot would take the vehicle off its track: leave one of the two out"
    if config.event is not None:
        yield key, "an answer with a demand would turn the vehicle back: leave [event], or the track, out"
    if track.risen_s(config.mission.altitude_m) is None:
        highest_m = max(place.altitude_m for place in track.places)
        yield (
            key,
            f"it rises to {highest_m:.1f} m, and mission.altitude_m is {config.mission.altitude_m:g}: set that lower,"
            " or give altitudes above home",
        )
    passed_s = 0.0
    for waypoint in waypoints(config.mission):
        at_s = track.passing_s(waypoint.position, after_s=passed_s)
        if at_s is None:
            near_m = track.nearest_m(waypoint.position)
            where, remedy = f"is {near_m:.0f} m from the track", f"give waypoints within {NEAR_M:g} m of it"
            if near_m <= NEAR_M:
                where, remedy = "is not passed after the one before", "give waypoints in the track's order"
            yield key, f"waypoint {waypoint.index} {where}: {remedy}"
            return
        passed_s = at_s


def times_problems(key: str, file: Path, services: Sequence[ServiceConfig]) -> Iterator[Problem]:
    """What the names in a file of measured times do not fit."""
    for operation in read_service_times(file):
        if not any(keys_of(operation, services)):
            known = listed(
                sorted({key or service.name for service in services for key in service.local_call_s})
            )
            yield key, f"{operation} is no operation with a local_call_s: name one of {known}"


def truth_problems(truth: TruthConfig, services: Sequence[ServiceConfig]) -> Iterator[Problem]:
    """What the files of a measured server do not fit."""
    if truth.service_csv is not None:
        yield from times_problems("service_csv", truth.service_csv, services)
    if truth.goodput_csv is not None:
        read_goodput_trace(truth.goodput_csv)
        if truth.radio != "fixed":
            yield "radio", "goodput_csv says how fast the link is: leave one of the two out"
