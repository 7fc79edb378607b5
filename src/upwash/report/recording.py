"""Runs as an MCAP file, which Foxglove and other viewers of robots' recordings open."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
from mcap.writer import Writer

from upwash.core.geo import LocalFrame
from upwash.errors import UsageError
from upwash.narration import Narrator, Tone
from upwash.report.foxglove import (
    ERROR,
    INFO,
    WARNING,
    CompressedImage,
    LocationFix,
    Log,
    Message,
    SceneUpdate,
    Time,
    json_schema,
)
from upwash.report.photos import PhotoShelf, Shot
from upwash.report.record import Record, place_of
from upwash.report.scene import FRAME, scene

_NS = 1_000_000_000
_LEVELS = {Tone.TROUBLE: WARNING, Tone.ALARM: ERROR}
_NO_COVARIANCE = [0.0] * 9
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
        except (KeyError, TypeError, ValueError) as error:
            raise UsageError(
                f"{record.name} is not an event log that this version reads: {error!r}"
            ) from error
    if photos is not None and not any(isinstance(message, CompressedImage) for _, _, message in found):
        raise UsageError(f"{photos} has none of the photos that the logs name: give the folder of [camera]")
    file = io.BytesIO()
    writer = Writer(file)
    writer.start()
    schemas = {
        message: writer.register_schema(
            message.schema, "jsonschema", msgspec.json.encode(json_schema(message))
        )
        for message in _TOPICS
    }
    channels: dict[str, int] = {}
    for time_ns, prefix, message in sorted(found, key=lambda each: each[0]):
        topic = prefix + _TOPICS[type(message)]
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "json", schemas[type(message)])
        writer.add_message(channels[topic], time_ns, msgspec.json.encode(message), time_ns)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()


class _Clock:
    """The time of day of the seconds of a mission; a simulated one happened in 1970."""

    def __init__(self, record: Record) -> None:
        opened_ns = round(record.opened.timestamp() * 1e6) * 1000 if record.opened else 0
        self._began_ns = opened_ns + round(record.began_s * _NS)

    def ns(self, at_s: float) -> int:
        """In nanoseconds since 1970."""
        return max(0, self._began_ns + round(at_s * _NS))

    def time(self, at_s: float) -> Time:
        """As messages have it."""
        return Time(*divmod(self.ns(at_s), _NS))


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
                clock.time(fix.at_s),
                FRAME,
                place.latitude_deg,
                place.longitude_deg,
                fix.position.altitude_m,
                _NO_COVARIANCE,
            ),
        )


def _lines(record: Record, clock: _Clock) -> Iterator[tuple[int, Message]]:
    narrator = Narrator()
    for event in record.events:
        if (said := narrator.tell(event)) is not None:
            at_s = event["t"] - record.began_s
            level = _LEVELS.get(said.tone, INFO)
            yield clock.ns(at_s), Log(clock.time(at_s), level, said.text, record.name)


def _photos(record: Record, clock: _Clock, shelf: PhotoShelf) -> Iterator[tuple[int, Message]]:
    since_start, last = 0, None
    for event in record.events:
        last = place_of(event, last) or last
        if event["event"] == "log_resumed":
            since_start = 0
        elif event["event"] == "photo":
            jpeg = shelf.find(Shot(event["source"], last, since_start))
            since_start += 1
            taken_s = event["t"] - event["age_s"] - record.began_s
            if jpeg is not None:
                yield clock.ns(taken_s), CompressedImage(clock.time(taken_s), "camera", jpeg)
