"""Reads the figures of recorded flights of a PX4, which tests compare the stand-in with, out of the recordings.

Run from the repository: python -m bench.px4_figures FOLDER > tests/vehicle/px4/data/figures.csv, and with --profiles
for profiles.csv. FOLDER holds a NAME.tlog (MAVLink as received) and a NAME.log (what happened, in words) for each.
"""

from __future__ import annotations

import csv
import math
import re
import statistics
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from pymavlink import mavutil

LEGS = {"reposition_4": 4.0, "reposition_8": 8.0, "offboard_4": 4.0, "offboard_default": 12.0}
LEG_M = 40.0
METRES_PER_DEGREE = 111_037.0, 86_172.0  # of latitude and longitude, at 39.37 degrees north
HOME_DEG = 39.3666, 22.9507
PROFILE_STEP_S, PROFILE_S = 0.5, 14.5


@dataclass(frozen=True)
class Sample:
    """Where the vehicle was, in metres from home, and how it moved."""

    time_s: float
    east_m: float
    north_m: float
    up_m: float
    east_m_s: float
    north_m_s: float


@dataclass(frozen=True)
class Along:
    """The same, along a leg."""

    time_s: float
    way_m: float
    speed_m_s: float


def samples(folder: Path, name: str) -> list[Sample]:
    """What GLOBAL_POSITION_INT said."""
    log = mavutil.mavlink_connection(str(folder / f"{name}.tlog"), dialect="ardupilotmega")
    found = []
    while (message := log.recv_match(type="GLOBAL_POSITION_INT")) is not None:
        north_m = (message.lat / 1e7 - HOME_DEG[0]) * METRES_PER_DEGREE[0]
        east_m = (message.lon / 1e7 - HOME_DEG[1]) * METRES_PER_DEGREE[1]
        time_s = message.time_boot_ms / 1e3
        up_m = message.relative_alt / 1e3
        found.append(Sample(time_s, east_m, north_m, up_m, message.vy / 100, message.vx / 100))
    return found


def moments(folder: Path, name: str, pattern: str) -> list[float]:
    """The times of a message in the log, in seconds after boot."""
    lines = (folder / f"{name}.log").read_text(encoding="utf-8").splitlines()
    return [float(line[1 : line.index("]")]) for line in lines if re.search(pattern, line)]


def legs(folder: Path, kind: str) -> list[list[Along]]:
    """The eleven legs of 40 m, each from when it was commanded."""
    name = f"ref_{kind}"
    arrivals = []
    for line in (folder / f"{name}.log").read_text(encoding="utf-8").splitlines():
        if found := re.match(r"\[ *([\d.]+)\] arrival at ([\d.]+),([\d.]+),\S+ \w+: ([\d.]+) s", line):
            time_s, east_m, north_m, took_s = map(float, found.groups())
            arrivals.append((time_s - took_s, east_m, north_m))
    every = samples(folder, name)
    ends_s = [begun_s for begun_s, _, _ in arrivals[2:]] + [arrivals[-1][0] + 20]
    found_legs = []
    for before, leg, end_s in zip(arrivals, arrivals[1:], ends_s, strict=False):
        begun_s, (east, north) = leg[0], ((leg[1] - before[1]) / LEG_M, (leg[2] - before[2]) / LEG_M)
        along = [
            Along(
                each.time_s - begun_s,
                (each.east_m - before[1]) * east + (each.north_m - before[2]) * north,
                each.east_m_s * east + each.north_m_s * north,
            )
            for each in every
            if begun_s <= each.time_s < end_s
        ]
        found_legs.append(along)
    return found_legs


def arrival_s(leg: list[Along]) -> float:
    """When it was within 1 m over the ground and slower than 0.5 m/s."""
    return next(
        (
            each.time_s
            for each in leg
            if abs(LEG_M - each.way_m) < 1 and each.time_s > 3 and each.speed_m_s < 0.5
        ),
        math.nan,
    )


def spans(folder: Path, begins: str, ends: str, names: str = "*") -> list[float]:
    """How long it took from one line of a log to the first of another kind after it, in all logs that have both."""
    found = []
    for log in sorted(folder.glob(f"{names}.log")):
        for begun_s in moments(folder, log.stem, begins)[:1]:
            later = [time_s for time_s in moments(folder, log.stem, ends) if time_s > begun_s]
            found += [later[0] - begun_s] if later else []
    return found


def numbers(folder: Path, pattern: str) -> list[float]:
    """The numbers that the logs tell at some place of a line."""
    texts = [log.read_text(encoding="utf-8") for log in sorted(folder.glob("*.log"))]
    return [float(number) for text in texts for number in re.findall(pattern, text)]


def way_to_rest_m(folder: Path, name: str, begins: str, within_s: float) -> list[float]:
    """How far it went from a line of the log until it first stood still."""
    begun_s = moments(folder, name, begins)[0]
    later = [sample for sample in samples(folder, name) if begun_s <= sample.time_s <= begun_s + within_s]
    still = next(each for each in later if math.hypot(each.east_m_s, each.north_m_s) < 0.25)
    return [math.hypot(still.east_m - later[0].east_m, still.north_m - later[0].north_m)]


LANDED = "LANDED_STATE ON_GROUND"
LAND = "land at destination"


def figures(folder: Path) -> Iterator[tuple[str, list[float]]]:
    """Each figure, and what the recordings say about it."""
    for kind in LEGS:
        flown = legs(folder, kind)
        yield f"leg_{kind}_s", [arrival_s(leg) for leg in flown]
        yield (
            f"half_leg_{kind}_s",
            [next(each.time_s for each in leg if each.way_m > LEG_M / 2) for leg in flown],
        )
        yield f"top_{kind}_m_s", [max(each.speed_m_s for each in leg) for leg in flown]
    yield "lifts_s", numbers(folder, r"lift \(0.3 m\) after ([\d.]+) s")
    yield "takeoff_s", numbers(folder, r"AUTO.LOITER after ([\d.]+) s at")
    yield "takeoff_ends_m", numbers(folder, r"AUTO.LOITER after [\d.]+ s at ([\d.]+) m")
    yield "return_144_m_s", spans(folder, r"\[1, 4, 5, 0", LANDED, "ref_reposition_*")
    yield "return_80_m_s", spans(folder, r"\[1, 4, 5, 0", LANDED, "fault_companion_link_lost")
    yield (
        "landing_from_30_m_s",
        [
            span
            for names in ("ref_*", "fault_companion*", "fault_geofence*")
            for span in spans(folder, LAND, LANDED, names)
        ],
    )
    yield (
        "landing_from_10_m_s",
        [
            *spans(folder, LAND, LANDED, "fault_low_battery"),
            *spans(folder, "MODE .*AUTO.LAND", LANDED, "fault_low_battery"),
            *spans(folder, r"\[1, 4, 5, 0", LANDED, "fault_offboard_loss_act3"),
        ],
    )
    yield "disarms_s", spans(folder, "landing_detected", "commander_disarmed_by")
    yield "disarms_unflown_s", spans(folder, "commander_armed_by", "auto preflight", "fault_prearm_refused")
    yield "offboard_lost_s", spans(folder, "companion silent", "Failsafe activated", "fault_offboard_loss_*")
    yield "companion_lost_s", spans(folder, "companion silent", "mission_comp_lost")
    yield "ground_station_lost_s", spans(folder, "GCS gone", "commander_gcs_lost")
    yield "ground_station_lost_returns_s", spans(folder, "GCS gone", "MODE .*AUTO.RTL")
    yield "gps_lost_descends_s", spans(folder, "SIM_GPS_USED = 0", "MODE AUTO.LAND", "fault_gps_lost")
    yield "descends_from_10_m_s", spans(folder, "MODE AUTO.LAND", LANDED, "fault_gps_lost")
    yield "sinks_from_10_m_s", spans(folder, "MODE .*POSCTL", LANDED, "fault_offboard_loss_act0")
    yield (
        "holds_from_9_6_m_s_within_m",
        way_to_rest_m(folder, "fault_offboard_loss_act5", "left OFFBOARD", 20),
    )
    yield (
        "stops_from_3_3_m_s_within_m",
        way_to_rest_m(folder, "pilot_mode_switch", "pilot switches to POSCTL", 9),
    )


def profiles(folder: Path) -> Iterator[tuple[str, float, float, float]]:
    """The median way and speed on the legs of each kind, from when they were commanded on."""

    def median(leg_list: list[list[Along]], at_s: float, value: Callable[[Along], float]) -> float | None:
        near = [min(leg, key=lambda each: abs(each.time_s - at_s)) for leg in leg_list]
        there = [value(each) for each in near if abs(each.time_s - at_s) < 0.15]
        return statistics.median(there) if len(there) > len(leg_list) / 2 else None

    for kind in LEGS:
        flown = legs(folder, kind)
        for step in range(int(PROFILE_S / PROFILE_STEP_S) + 1):
            at_s = step * PROFILE_STEP_S
            way_m = median(flown, at_s, lambda each: each.way_m)
            speed_m_s = median(flown, at_s, lambda each: each.speed_m_s)
            if way_m is not None and speed_m_s is not None:
                yield kind, at_s, round(way_m, 2), round(speed_m_s, 2)


def main() -> None:
    """Writes one of the tables to the standard output."""
    folder, out = Path(sys.argv[1]), csv.writer(sys.stdout, lineterminator="\n")
    if "--profiles" in sys.argv:
        out.writerow(("kind", "time_s", "way_m", "speed_m_s"))
        out.writerows(profiles(folder))
        return
    out.writerow(("figure", "median", "least", "most", "times"))
    for name, values in figures(folder):
        known = [value for value in values if not math.isnan(value)]
        row = (round(statistics.median(known), 2), round(min(known), 2), round(max(known), 2), len(known))
        out.writerow((name, *row))


if __name__ == "__main__":
    main()
