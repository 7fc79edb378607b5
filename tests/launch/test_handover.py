"""Findings are handed over during the flight: in order, again after a failure, and never at the flight's cost."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import pytest
from tests.events import event

from upwash.core.geo import GeoPosition
from upwash.eventlog.schema import Event
from upwash.launch.handover import Handover, HandoverFacts
from upwash.launch.recipients import Facts, NotTaken

LOST = NotTaken("no network")
HERE = {"east_m": 20.0, "north_m": 0.0, "altitude_m": 10.0}
BOX = {
    "left_px": 1.0,
    "top_px": 2.0,
    "width_px": 30.0,
    "height_px": 20.0,
    "label": "hot-spot",
    "score": 0.874,
}
OPENED = datetime(2026, 5, 1, 12, tzinfo=UTC)


class Scripted:
    """Takes findings, `takes_s` each, but for the failures of its script, one a try, which then come again."""

    name = "the desk"

    def __init__(
        self, *script: Exception | None, takes_s: float = 0.0, then: Exception | None = None
    ) -> None:
        self.script, self.takes_s, self.then = list(script), takes_s, then
        self.tries: list[tuple[float, str]] = []
        self.taken: list[str] = []

    async def take(self, facts: Facts) -> None:
        self.tries.append((asyncio.get_running_loop().time(), facts["label"]))
        await asyncio.sleep(self.takes_s)
        if (failure := self.script.pop(0) if self.script else self.then) is not None:
            raise failure
        self.taken.append(facts["label"])


def told(label: str) -> Event:
    return event("notified", 1.0, message=label, at=HERE)


async def flown(desk: Scripted, *labels: str, for_s: float = 0.0) -> list[Event]:
    """What the log says of a flight of `for_s` that finds these things at its beginning."""
    log: list[Event] = []
    handover = Handover([desk], drone="heron", home=None)
    async with handover.running(log.append):
        for label in labels:
            handover.follow(told(label))
        await asyncio.sleep(for_s)
    return log


def said(log: list[Event]) -> list[tuple[str, Any, Any]]:
    return [(entry.kind, getattr(entry, "count", None), getattr(entry, "why", None)) for entry in log]


@pytest.mark.virtual
async def test_a_lost_link_is_tried_at_growing_pauses_and_told_at_its_begin_and_its_end() -> None:
    desk = Scripted(*[LOST] * 9)
    log = await flown(desk, "a", "b", for_s=600.0)
    seconds = [at for at, _ in desk.tries]
    pauses = [after - before for before, after in itertools.pairwise(seconds)]
    assert pauses == pytest.approx([1, 2, 4, 8, 16, 32, 60, 60, 60, 0])
    assert desk.taken == ["a", "b"]
    assert said(log) == [("handover_trouble", None, "no network"), ("handover_trouble", None, "")]


@pytest.mark.virtual
async def test_after_a_success_pauses_begin_anew() -> None:
    desk = Scripted(LOST, LOST, LOST, None, LOST)
    await flown(desk, "a", "b", for_s=60.0)
    assert [at - desk.tries[0][0] for at, _ in desk.tries] == pytest.approx([0, 1, 3, 7, 7, 8])


@pytest.mark.virtual
async def test_a_finding_that_was_refused_is_not_tried_again_and_is_counted() -> None:
    desk = Scripted(NotTaken("it answered 400 Bad Request", for_good=True))
    log = await flown(desk, "a", "b", for_s=5.0)
    assert [label for _, label in desk.tries] == ["a", "b"]
    assert said(log)[-1] == ("handover_failed", 1, "1 refused: it answered 400 Bad Request")


@pytest.mark.virtual
async def test_beyond_a_thousand_the_oldest_are_dropped_and_counted() -> None:
    desk = Scripted(LOST, LOST)
    log = await flown(desk, *(str(number) for number in range(1200)), for_s=60.0)
    assert desk.taken == [str(number) for number in range(200, 1200)]
    assert said(log)[0] == ("handover_trouble", None, "more than 1,000 wait: the oldest are dropped")
    assert said(log)[-1] == ("handover_failed", 200, "200 dropped, as more than 1,000 waited")


@pytest.mark.virtual
@pytest.mark.parametrize("takes_s", [0.0, 3600.0])
async def test_the_end_waits_for_some_seconds_only(takes_s: float) -> None:
    began_s = asyncio.get_running_loop().time()
    log = await flown(Scripted(then=LOST, takes_s=takes_s), "a", "b", "c", for_s=100.0)
    assert asyncio.get_running_loop().time() - began_s <= 106.0
    why = "there was no time" if takes_s else "no network"
    assert said(log)[-1] == ("handover_failed", 3, f"3 left at the end: {why}")


@pytest.mark.virtual
async def test_what_waits_out_a_long_pause_is_tried_at_the_end() -> None:
    desk = Scripted(*[LOST] * 7)
    began_s = asyncio.get_running_loop().time()
    log = await flown(desk, "a", "b", for_s=70.0)  # in the pause from 63 s to 123 s
    assert desk.taken == ["a", "b"]
    assert asyncio.get_running_loop().time() - began_s == pytest.approx(70.0)
    assert said(log)[-1] == ("handover_trouble", None, "")


@pytest.mark.virtual
async def test_a_program_that_must_end_at_once_does() -> None:
    log: list[Event] = []
    handover = Handover([Scripted(then=LOST)], drone="heron", home=None)
    handover.follow(told("a"))

    async def fly() -> None:
        async with handover.running(log.append):
            await asyncio.sleep(3600.0)

    flight = asyncio.get_running_loop().create_task(fly())
    await asyncio.sleep(10.0)
    flight.cancel()
    ended_s = asyncio.get_running_loop().time()
    with pytest.raises(asyncio.CancelledError):
        await flight
    assert asyncio.get_running_loop().time() == ended_s
    assert said(log)[-1] == ("handover_failed", 1, "1 left at the end: no network")


@pytest.mark.virtual
async def test_a_defect_ends_handing_over_to_one_recipient_and_not_the_flight() -> None:
    broken, desk, log = Scripted(KeyError("uid")), Scripted(), list[Event]()
    handover = Handover([broken, desk], drone="heron", home=None)
    async with handover.running(log.append):
        handover.follow(told("a"))
        await asyncio.sleep(5.0)
        handover.follow(told("b"))
    assert desk.taken == ["a", "b"]
    assert said(log) == [("handover_failed", 2, "2 left at the end: a defect of upwash: KeyError")]


def flight() -> Iterator[Event]:
    yield event("log_opened", 0.0, time=OPENED.isoformat())
    yield event("mission_started", 10.0, drone="heron")
    yield event("arrived", 14.0, waypoint=3)
    yield event("photo", 15.0, source="1.jpg", position=HERE, latitude_deg=39.5, longitude_deg=22.5)
    yield event("notified", 16.5, message=[BOX], at=HERE)


def facts(*events: Event, home: GeoPosition | None = None) -> list[Facts]:
    told = HandoverFacts("heron", home)
    return [found for entry in events for found in told.by(entry)]


def test_a_box_is_told_by_the_names_of_the_columns_of_files() -> None:
    (found,) = facts(*flight())
    assert found == {
        "uid": "upwash-heron-20260501T120000.000000-1",
        "drone": "heron",
        "label": "hot-spot",
        "score": 0.874,
        "waypoint": 3,
        "t_s": 6.5,
        "time": "2026-05-01T12:00:16.500Z",
        "latitude_deg": 39.5,
        "longitude_deg": 22.5,
        "east_m": 20.0,
        "north_m": 0.0,
        "error_m": None,
        "place_is": "the drone's place when the photo was taken: the camera's lens is unknown",
        "photo": "1.jpg",
        "left_px": 1.0,
        "top_px": 2.0,
        "width_px": 30.0,
        "height_px": 20.0,
    }


def test_a_plain_message_is_its_label_in_one_line() -> None:
    (found,) = facts(
        event("log_opened", 0.0, time=OPENED.isoformat()), told("two\nlines"), home=GeoPosition(39.0, 22.0)
    )
    assert (found["label"], found["score"], found["left_px"]) == ("two\\nlines", None, None)
    assert found["latitude_deg"] == pytest.approx(39.0)
    assert found["place_is"] == "the place that the mission named"


def test_a_clock_that_was_set_and_a_flight_that_was_resumed_keep_times_and_uids_apart() -> None:
    late = "2026-05-02T12:00:00+00:00"
    (_, second, third) = facts(
        *flight(),
        event("clock_set", 20.0, before=OPENED.isoformat(), after=late),
        event("notified", 21.0, message="b", at=HERE),
        event("log_resumed", 100.0, time="2026-05-02T12:30:00+00:00"),
        event("notified", 101.0, message="c", at=HERE),
    )
    assert (second["time"], third["time"]) == ("2026-05-02T12:00:01.000Z", "2026-05-02T12:30:01.000Z")
    assert [found["uid"] for found in (second, third)] == [
        "upwash-heron-20260501T120000.000000-2",
        "upwash-heron-20260501T120000.000000-3",
    ]
