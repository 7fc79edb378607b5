"""Runs as files for other tools: CSV, GeoJSON, and the results as JSON."""

from __future__ import annotations

import csv
import io
import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from upwash.core.geo import Circle, LocalFrame, Position
from upwash.errors import UpwashError, UsageError
from upwash.eventlog import schema
from upwash.eventlog.results import RunResult, as_json
from upwash.ports import Export
from upwash.report.antimeridian import cut_line, cut_ring
from upwash.report.palette import LIGHT
from upwash.report.record import Record, reviewed_of
from upwash.support.entry_points import EXPORTS, failing, plug_in
from upwash.support.text import escaped

SIDES = 64  # of the polygon that stands for a range
DIGITS = 7  # of a degree: about a centimetre
# Excel takes full-width signs too, and programs of most of Europe's languages split a line at each semicolon.
_FORMULA = re.compile("(^|[;|])([\\s\"']*[=+\\-@\uff1d\uff0b\uff0d\uff20])")


class Exported(msgspec.Struct, frozen=True, omit_defaults=True):
    """One run in the JSON export."""

    log: str
    result: RunResult
    local_only_time_s: float | None
    saved_s: float | None
    findings: ExportedFindings | None = None


class ExportedFindings(msgspec.Struct, frozen=True):
    """How many findings a run with reviews has, how many are reviewed, and how many of these are rejected."""

    found: int
    reviewed: int
    rejected: int


def write_json(records: Sequence[Record]) -> str:
    """The results as one JSON array, an object a run."""
    return msgspec.json.encode(as_json(list(map(_exported, records)))).decode()


def write_result(record: Record) -> str:
    """The result of one run, as `write_json` has it."""
    return msgspec.json.encode(as_json(_exported(record))).decode()


def _exported(record: Record) -> Exported:
    findings = None
    if record.reviews.by_finding:
        tally = reviewed_of([record]).tally
        findings = ExportedFindings(tally.found, tally.reviewed, tally.rejected)
    return Exported(
        record.name, record.result, record.result.local_only_time_s(), record.result.saved_s(), findings
    )


def export_of(kind: str, photos: Path | None) -> Callable[[Sequence[Record]], bytes]:
    """The export of a plug-in, with that folder of photos; raises UsageError, and UpwashError when it fails."""
    export: Export = plug_in(EXPORTS, kind)

    def write(records: Sequence[Record]) -> bytes:
        with failing(EXPORTS, kind, "failed", UpwashError):
            return bytes(export(records, photos))

    return write


def cell(value: object) -> object:
    """A value as a cell of CSV: a text is on one line, and no part of it a formula of a spreadsheet program."""
    if not isinstance(value, str):
        return value
    return _FORMULA.sub(r"\1'\2", escaped(value))


def as_rows(columns: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """CSV with a line for the columns' names and one for each row."""
    return as_csv(itertools.chain([columns], (map(cell, row) for row in rows)))


def as_csv(rows: Iterable[Iterable[object]]) -> str:
    """CSV of these cells as they are."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def write_csv(records: Sequence[Record]) -> str:
    """A row a call; numbers in full precision."""
    hidden = ["hidden_s"] if any(record.result.totals.hidden_s for record in records) else []
    columns = [
        "log", "waypoint", "at_s", "operation", "place", "delay_s", "waited_s", "wait", "fell_back", "east_m",
        "north_m", "decision", *hidden,
    ]  # fmt: skip

    def rows() -> Iterator[Sequence[object]]:
        for record in records:
            for call, place in zip(record.calls, record.places, strict=True):
                at_m = (place.east_m, place.north_m) if place else (None, None)
                yield (
                    record.name, call.waypoint, call.at_s, call.operation, call.place, call.delay_s, call.waited_s,
                    call.wait, int(call.fell_back), *at_m, call.decision, *(getattr(call, each) for each in hidden),
                )  # fmt: skip

    return as_rows(columns, rows())


def write_geojson(records: Sequence[Record]) -> str:
    """Tracks, waypoints, ranges, calls and photos on the Earth (RFC 7946); UsageError for a run without a home."""
    return collection(feature for record in records for feature in _features(record))


def collection(features: Iterable[object], **facts: object) -> str:
    """A GeoJSON document with these features."""
    return msgspec.json.encode({"type": "FeatureCollection", **facts, "features": list(features)}).decode()


def plan_geojson(record: Record) -> str | None:
    """Home, the planned way and the ranges, drawn in colours and named as Foxglove's map shows them.

    None for a run without a home.
    """
    if record.plan.home is None:
        return None
    frame = LocalFrame(record.plan.home)
    way = [_degrees(frame, Position(east_m, north_m)) for east_m, north_m in record.plan.way_m]
    features = list(_planned(record, frame))
    if len(way) > 1:  # one place is no line
        features.append(_line(record, "plan", way))
    for feature in features:
        facts = feature["properties"]
        colour = LIGHT.of_place(facts.get("server"), record.servers)
        facts["name"] = " ".join(str(facts[key]) for key in ("kind", "server", "waypoint") if key in facts)
        facts["style"] = {"color": colour, "weight": 2, "fillOpacity": 0.1}
    return collection(features)


def _features(record: Record) -> Iterator[dict[str, Any]]:
    if record.plan.home is None:
        raise UsageError(
            f"{record.name} does not say where home is, so nothing in it has coordinates: "
            "set mission.home in the configuration and fly again"
        )
    frame = LocalFrame(record.plan.home)
    yield from _planned(record, frame)
    track = [(*_degrees(frame, fix.position), fix.at_s) for fix in record.track]
    if len(track) > 1:
        yield _line(record, "track", track)
    for waypoint, place in record.turns:
        yield _feature(record, "turn", "Point", _degrees(frame, place), waypoint=waypoint)
    for call, made_at in zip(record.calls, record.places, strict=True):
        if made_at is not None:
            yield _feature(record, "call", "Point", _degrees(frame, made_at), **as_json(call))
    yield from _photos(record, frame)
    yield from _autopilot_photos(record)


def _autopilot_photos(record: Record) -> Iterator[dict[str, Any]]:
    for event in record.events:
        if not isinstance(event, schema.AutopilotPhoto) or event.longitude_deg is None:
            continue
        facts = {
            "camera": event.camera,
            "photo": event.number,
            "at_s": event.t - record.began_s,
            "altitude_m": event.position and event.position.altitude_m,
            "above_sea_m": event.above_sea_m,
            "time": event.taken and event.taken.isoformat(),
        }
        place = [event.longitude_deg, event.latitude_deg]
        yield _feature(record, "autopilot_photo", "Point", place, **_known(facts))


def _photos(record: Record, frame: LocalFrame) -> Iterator[dict[str, Any]]:
    """Each photo where it was taken, by its number from 0 on; what is not known of it is absent."""
    for photo, event in record.photos:
        place = _degrees(frame, event.position)
        if event.longitude_deg is not None and event.latitude_deg is not None:
            place = [event.longitude_deg, event.latitude_deg]
        facts = {
            "photo": photo.number,
            "source": event.source,
            "waypoint": photo.waypoint,
            "at_s": event.t - record.began_s,
            "altitude_m": event.position.altitude_m,
            "above_sea_m": event.above_sea_m,
        }
        yield _feature(record, "photo", "Point", place, **_known(facts))


def _planned(record: Record, frame: LocalFrame) -> Iterator[dict[str, Any]]:
    yield _feature(record, "home", "Point", _degrees(frame, Position(0.0, 0.0)))
    for name, area in record.plan.ranges.items():
        rings = [[ring] for ring in cut_ring(_ring(frame, area))]
        shape, coordinates = ("Polygon", rings[0]) if len(rings) == 1 else ("MultiPolygon", rings)
        yield _feature(record, "range", shape, coordinates, server=name, range_m=area.radius_m)
    for index, (east_m, north_m) in enumerate(record.plan.waypoints_m):
        place = _degrees(frame, Position(east_m, north_m))
        yield _feature(record, "waypoint", "Point", place, waypoint=index)


def _line(record: Record, kind: str, places: Sequence[Sequence[float]]) -> dict[str, Any]:
    """A line, in parts where it crosses the antimeridian; a third number of the places is their time."""
    parts = cut_line(places)
    lines = [[place[:2] for place in part] for part in parts]
    times_s = [[at_s for _, _, *at in part for at_s in at] for part in parts]
    has_times = len(places[0]) > 2
    if len(parts) == 1:
        return _feature(record, kind, "LineString", lines[0], **({"at_s": times_s[0]} if has_times else {}))
    return _feature(record, kind, "MultiLineString", lines, **({"at_s": times_s} if has_times else {}))


def _known(facts: Mapping[str, object]) -> dict[str, object]:
    return {key: each for key, each in facts.items() if each is not None}


def _feature(record: Record, kind: str, shape: str, coordinates: object, **facts: object) -> dict[str, Any]:
    return {
        "type": "Feature",
        "geometry": {"type": shape, "coordinates": coordinates},
        "properties": {"log": record.name, "kind": kind, **facts},
    }


def _degrees(frame: LocalFrame, place: Position) -> list[float]:
    """Longitude before latitude, as GeoJSON has them; heights there are not those above home, so none is given."""
    geo = frame.geo(place)
    return [round(geo.longitude_deg, DIGITS), round(geo.latitude_deg, DIGITS)]


def _ring(frame: LocalFrame, area: Circle) -> list[list[float]]:
    """The circle as a closed ring, anticlockwise."""
    corners = area.corners(SIDES)
    return [_degrees(frame, corner) for corner in (*corners, corners[0])]
