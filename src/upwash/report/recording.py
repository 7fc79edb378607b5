"""Runs as an MCAP file, which Foxglove and other viewers of robots' recordings open."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec
from foxglove import Channel, Context, open_mcap
from foxglove.messages import (
    CompressedImage,
    GeoJson,
    ImageAnnotations,
    LocationFix,
    Log,
    LogLevel,
    SceneUpdate,
    Timestamp,
)

from upwash.core.geo import LocalFrame
from upwash.errors import UsageError
from upwash.eventlog.narration import Narrator, Tone
from upwash.report.camera import photos
from upwash.report.exports import plan_geojson
from upwash.report.numbering import PlacedFinding
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record, reviewed_of
from upwash.report.scene import FRAME, scene
from upwash.report.series import Plotted, plotted_calls, plotted_states, schema_of

Recorded = SceneUpdate | LocationFix | Log | CompressedImage | ImageAnnotations | GeoJson | Plotted

_LEVELS = {Tone.TROUBLE: LogLevel.Warning, Tone.ALARM: LogLevel.Error}


def write_mcap(records: Sequence[Record], *, folder: Path | None = None) -> bytes:
    """The file; of several runs each has its name before its topics.

    With `folder` it has the photos there that the logs name. Raises UsageError where there are none of them.
    """
    shelf = PhotoShelf(folder)
    found: list[tuple[int, str, Recorded]] = []
    seen = reviewed_of(records)
    for index, record in enumerate(records):
        own = [seen.of_finding(index, number) for number in range(len(record.findings))]
        prefix = f"/{record.name}" if len(records) > 1 else ""
        try:
            messages = _messages(record, own, shelf)
            found += [(time_ns, prefix + topic, message) for time_ns, topic, message in messages]
        except (KeyError, OverflowError, TypeError, ValueError) as error:
            raise UsageError(
                f"{record.name} is not an event log that this version reads: {error!r}"
            ) from error
    if folder is not None and not any(isinstance(message, CompressedImage) for _, _, message in found):
        raise UsageError(f"{folder} has none of the photos that the logs name: give the folder of [camera]")
    file, context = io.BytesIO(), Context()
    channels: dict[str, Channel] = {}
    with open_mcap(file, context=context):
        for time_ns, topic, message in sorted(found, key=lambda each: each[0]):
            if topic not in channels:
                channels[topic] = _channel(topic, message, context)
            channels[topic].log(_encoded(message), log_time=time_ns)
    return file.getvalue()


def _channel(topic: str, message: Recorded, context: Context) -> Channel:
    if isinstance(message, Plotted):
        return Channel(topic, schema=schema_of(type(message)), message_encoding="json", context=context)
    return Channel(topic, schema=message.get_schema(), message_encoding="protobuf", context=context)


def _encoded(message: Recorded) -> bytes:
    return msgspec.json.encode(message) if isinstance(message, Plotted) else message.encode()


def _messages(
    record: Record, objects: Sequence[PlacedFinding], shelf: PhotoShelf
) -> Iterator[tuple[int, str, Recorded]]:
    narrator = Narrator()

    def time_of(at_s: float) -> Timestamp:
        return Timestamp(*divmod(record.ns(at_s), 1_000_000_000))

    for at_s, update in scene(record, time_of):
        yield record.ns(at_s), "/scene", update
    if (plan := plan_geojson(record)) is not None:
        yield record.ns(0.0), "/plan", GeoJson(geojson=plan)
    for at_s, fix in _fixes(record, time_of):
        yield record.ns(at_s), "/fix", fix
    for event in record.events:
        if (said := narrator.tell(event)) is not None:
            at_s = event.t - record.began_s
            time, level = time_of(at_s), _LEVELS.get(said.tone, LogLevel.Info)
            yield (
                record.ns(at_s),
                "/log",
                Log(timestamp=time, level=level, message=said.text, name=record.name),
            )
    for taken_s, image, boxes in photos(record, objects, time_of, shelf):
        yield record.ns(taken_s), "/camera", image
        yield record.ns(taken_s), "/camera/annotations", boxes
    for at_s, call in plotted_calls(record):
        yield record.ns(at_s), "/calls", call
    for server, at_s, state in plotted_states(record):
        yield record.ns(at_s), f"/servers/{server}", state


def _fixes(record: Record, time_of: Callable[[float], Timestamp]) -> Iterator[tuple[float, LocationFix]]:
    if record.plan.home is None:
        return
    frame = LocalFrame(record.plan.home)
    for fix in record.track:
        place = frame.geo(fix.position)
        yield (
            fix.at_s,
            LocationFix(
                timestamp=time_of(fix.at_s),
                frame_id=FRAME,
                latitude=place.latitude_deg,
                longitude=place.longitude_deg,
                altitude=fix.above_sea_m,
            ),
        )
