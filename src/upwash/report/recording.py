"""Runs as an MCAP file, which Foxglove and other viewers of robots' recordings open."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path

from foxglove import Channel, Context, open_mcap
from foxglove.messages import CompressedImage, LocationFix, Log, LogLevel, SceneUpdate, Timestamp

from upwash.core.geo import LocalFrame
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.narration import Narrator, Tone
from upwash.report.photos import PhotoShelf, Shot
from upwash.report.record import Record, place_of
from upwash.report.scene import FRAME, scene

Message = SceneUpdate | LocationFix | Log | CompressedImage

_NS = 1_000_000_000
_LEVELS = {Tone.TROUBLE: LogLevel.Warning, Tone.ALARM: LogLevel.Error}
_TOPICS: dict[type[Message], str] = {
    SceneUpdate: "/scene",
    LocationFix: "/fix",
    Log: "/log",
    CompressedImage: "/camera",
}


def write_mcap(records: Sequence[Record], *, photos: Path | None = None) -> bytes:
    """The file; of several runs each has its name before its topics.

    With `photos` it has those of that folder that the logs name. Raises UsageError where there are none of them.
    """
    shelf = PhotoShelf(photos)
    found: list[tuple[int, str, Message]] = []
    for record in records:
        prefix = f"/{record.name}" if len(records) > 1 else ""
        try:
            found += [(time_ns, prefix, message) for time_ns, message in _messages(record, shelf)]
        except (KeyError, OverflowError, TypeError, ValueError) as error:
            raise UsageError(
                f"{record.name} is not an event log that this version reads: {error!r}"
            ) from error
    if photos is not None and not any(isinstance(message, CompressedImage) for _, _, message in found):
        raise UsageError(f"{photos} has none of the photos that the logs name: give the folder of [camera]")
    file, context = io.BytesIO(), Context()
    channels: dict[str, Channel] = {}
    with open_mcap(file, context=context):
        for time_ns, prefix, message in sorted(found, key=lambda each: each[0]):
            topic = prefix + _TOPICS[type(message)]
            if topic not in channels:
                channels[topic] = Channel(
                    topic, schema=message.get_schema(), message_encoding="protobuf", context=context
                )
            channels[topic].log(message.encode(), log_time=time_ns)
    return file.getvalue()


class _Clock:
    """The time of day of the seconds of a mission; a simulated one happened in 1970."""

    def __init__(self, record: Record) -> None:
        opened_ns = round(record.opened.timestamp() * 1e6) * 1000 if record.opened else 0
        self._began_ns = opened_ns + round(record.began_s * _NS)

    def ns(self, at_s: float) -> int:
        """In nanoseconds since 1970."""
        return max(0, self._began_ns + round(at_s * _NS))

    def time(self, at_s: float) -> Timestamp:
        """As messages have it."""
        return Timestamp(*divmod(self.ns(at_s), _NS))


def _messages(record: Record, shelf: PhotoShelf) -> Iterator[tuple[int, Message]]:
    clock = _Clock(record)
    for at_s, update in scene(record, clock.time):
        yield clock.ns(at_s), update
    yield from _fixes(record, clock)
    yield from _lines(record, clock)
    yield from _photos(record, clock, shelf)


def _fixes(record: Record, clock: _Clock) -> Iterator[tuple[int, Message]]:
    if record.plan.home is None:
        return
    frame = LocalFrame(record.plan.home)
    for fix in record.track:
        place = frame.geo(fix.position)
        yield (
            clock.ns(fix.at_s),
            LocationFix(
                timestamp=clock.time(fix.at_s),
                frame_id=FRAME,
                latitude=place.latitude_deg,
                longitude=place.longitude_deg,
                altitude=fix.position.altitude_m,
            ),
        )


def _lines(record: Record, clock: _Clock) -> Iterator[tuple[int, Message]]:
    narrator = Narrator()
    for event in record.events:
        if (said := narrator.tell(event)) is not None:
            at_s = event.t - record.began_s
            level = _LEVELS.get(said.tone, LogLevel.Info)
            yield (
                clock.ns(at_s),
                Log(timestamp=clock.time(at_s), level=level, message=said.text, name=record.name),
            )


def _photos(record: Record, clock: _Clock, shelf: PhotoShelf) -> Iterator[tuple[int, Message]]:
    since_start, last = 0, None
    for event in record.events:
        last = place_of(event, last) or last
        if isinstance(event, schema.LogResumed):
            since_start = 0
        elif isinstance(event, schema.Photo):
            jpeg = shelf.find(Shot(event.source, last, since_start))
            since_start += 1
            taken_s = event.t - event.age_s - record.began_s
            if jpeg is not None:
                yield (
                    clock.ns(taken_s),
                    CompressedImage(
                        timestamp=clock.time(taken_s), frame_id="camera", data=jpeg, format="jpeg"
                    ),
                )
