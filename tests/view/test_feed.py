"""What pages are sent while a log grows: everything once, in order, and nothing twice."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from upwash.errors import UsageError
from upwash.view import recording
from upwash.view.feed import Feed
from upwash.view.recording import reading

OPENED = {"t": 0.0, "event": "log_opened", "time": "2026-01-01T00:00:00+00:00"}
STARTED = {"t": 1.0, "event": "mission_started", "policy": "location-aware", "waypoints": 3}


def arrival(waypoint: int) -> dict[str, Any]:
    return {"t": 2.0 + waypoint, "event": "arrived", "waypoint": waypoint, "east_m": 0.0, "north_m": 0.0}


def append(log: Path, *events: object) -> None:
    with log.open("ab") as file:
        file.writelines(msgspec.json.encode(event) + b"\n" for event in events)


def said(page: Page) -> list[tuple[str, list[int]]]:
    """What was found on each log: the words, and the numbers."""
    return [(found["words"], found["numbers"]) for found in page.found]


class Page:
    """A browser's page, as far as it is told."""

    def __init__(self, feed: Feed, after: str = "") -> None:
        self.id = after
        self.facts: dict[int, list[dict[str, Any]]] = {}
        self.trouble = ""
        self.together: bool | None = None
        self.received = 0
        self.more: list[bool] = []
        self.runs: dict[int, int] = {}
        self.found: list[dict[str, Any]] = []
        self.messages: AsyncIterator[str] = feed.messages(after)

    async def hear(self, until: Callable[[Page], bool]) -> None:
        """Takes in messages until that is so."""
        async with asyncio.timeout(20):
            while not until(self):
                self._take(await anext(self.messages))

    def _take(self, message: str) -> None:
        fields = dict(line.split(": ", 1) for line in message.strip().splitlines())
        self.id = fields.get("id", self.id)
        if fields["event"] == "page":
            self.together = json.loads(fields["data"])["together"]
        if fields["event"] == "findings":
            self.found = json.loads(fields["data"])
        if fields["event"] == "facts":
            batch = json.loads(fields["data"])
            facts = self.facts.setdefault(batch["log"], [])
            if self.runs.get(batch["log"]) not in {None, batch["run"]}:
                facts.clear()
            self.runs[batch["log"]] = batch["run"]
            self.received += len(batch["facts"])
            self.trouble = batch["trouble"]
            self.more.append(batch["more"])
            facts += batch["facts"]

    def reached(self, log: int = 0) -> int:
        counts = [fact["reached"] for fact in self.facts.get(log, ()) if fact["fact"] == "doing"]
        return counts[-1] if counts else 0


@contextlib.asynccontextmanager
async def following(*logs: Path) -> AsyncIterator[Feed]:
    with reading(logs, lambda _: False) as recordings:
        feed = Feed(recordings)
        task = asyncio.create_task(feed.follow())
        try:
            yield feed
        finally:
            feed.close()
            await task


@pytest.fixture
def log(tmp_path: Path) -> Path:
    file = tmp_path / "flight.jsonl"
    append(file, OPENED, STARTED, arrival(0))
    return file


@pytest.mark.parametrize(
    ("drones", "together"),
    [(["heron", "stork"], True), (["heron", "heron"], False), (["heron"], False), ([None, None], True),
     (["heron", None, "heron"], True), ([None], False)],
)  # fmt: skip
def test_logs_of_several_drones_are_shown_together(
    tmp_path: Path, drones: list[str | None], together: bool
) -> None:
    logs = [tmp_path / f"{number}.jsonl" for number in range(len(drones))]
    for log, drone in zip(logs, drones, strict=True):
        append(log, OPENED, *([] if drone is None else [{**STARTED, "drone": drone}]))

    async def run() -> None:
        async with following(*logs) as feed:
            page = Page(feed)
            await page.hear(lambda page: page.together is not None)
            assert page.together == together

    asyncio.run(run())


def found(at_s: float, *labels: str) -> dict[str, Any]:
    box = {"left_px": 1.0, "top_px": 2.0, "width_px": 3.0, "height_px": 4.0, "score": 0.9}
    message = [{**box, "label": label} for label in labels]
    return {"t": at_s, "event": "notified", "message": message, "at": {"east_m": 0.0, "north_m": 0.0}}


async def test_the_findings_of_a_fleet_have_one_number_each_which_stays(tmp_path: Path) -> None:
    logs = [tmp_path / "1.jsonl", tmp_path / "2.jsonl"]
    for log, drone in zip(logs, ("heron", "stork"), strict=True):
        append(log, OPENED, {**STARTED, "drone": drone})
    append(logs[0], found(2.0, "hot-spot", "hot-spot"), found(4.0, "broken-module"))
    append(logs[1], found(3.0, "hot-spot"))
    words = "4 faults: 3 hot-spots, 1 broken module"
    async with following(*logs) as feed:
        page = Page(feed)
        await page.hear(lambda page: bool(page.found))
        assert said(page) == [(words, [1, 2, 4]), (words, [3])]
        append(logs[1], found(5.0, "hot-spot"))
        await page.hear(lambda page: len(page.found[1]["numbers"]) > 1)
        assert [each["numbers"] for each in page.found] == [[1, 2, 4], [3, 5]]
        assert len([fact for fact in page.facts[1] if fact["fact"] == "told"]) == 2


async def test_the_findings_of_flights_of_one_drone_are_said_of_each(log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.jsonl"
    append(other, OPENED, STARTED, found(2.0, "hot-spot"), found(3.0))
    async with following(log, other) as feed:
        page = Page(feed)
        await page.hear(lambda page: bool(page.found))
        assert said(page) == [("", []), ("1 hot-spot", [1])]


async def test_a_page_is_sent_what_is_new_and_only_that(log: Path) -> None:
    async with following(log) as feed:
        page = Page(feed)
        await page.hear(lambda page: page.reached() == 1)
        before = page.received
        append(log, arrival(1))
        await page.hear(lambda page: page.reached() == 2)
        assert page.received - before == len(page.facts[0]) - before <= 3


def test_what_a_long_log_has_told_is_sent_in_pieces_of_which_the_last_is_known(log: Path) -> None:
    append(log, *(arrival(waypoint) for waypoint in range(1, 9_000)))

    async def run() -> None:
        async with following(log) as feed:
            at_once, later = Page(feed), Page(feed)
            for page in at_once, later:
                await page.hear(lambda page: page.more[-1:] == [False])
                assert all(page.more[:-1]) and len(page.more) > 1
                assert page.received == len(page.facts[0]) == feed.recordings[0].count
            assert at_once.facts == later.facts
            append(log, arrival(9_000))
            await later.hear(lambda page: page.reached() == 9_001)
            assert not later.more[-1]

    asyncio.run(run())


def test_half_a_line_waits_for_its_other_half(log: Path) -> None:
    line = msgspec.json.encode(arrival(1)) + b"\n"

    async def run() -> None:
        async with following(log) as feed:
            page = Page(feed)
            with log.open("ab", buffering=0) as file:
                file.write(line[:20])
                await page.hear(lambda page: page.reached() == 1)
                file.write(line[20:])
            await page.hear(lambda page: page.reached() == 2)
            assert not page.trouble

    asyncio.run(run())


async def test_a_page_that_was_away_is_sent_what_it_missed(log: Path) -> None:
    async with following(log) as feed:
        page = Page(feed)
        await page.hear(lambda page: page.reached() == 1)
        append(log, arrival(1))
        again = Page(feed, after=page.id)
        await again.hear(lambda page: page.reached() == 2)
        assert again.received <= 3
        whole = Page(feed)
        await whole.hear(lambda page: page.reached() == 2)
        assert whole.facts[0] == page.facts[0] + again.facts[0]


@pytest.mark.parametrize("identity", ["", "another.1-3", "x.y.z", "\N{SNOWMAN}"])
async def test_a_page_of_another_program_begins_anew(log: Path, identity: str) -> None:
    async with following(log) as feed:
        page = Page(feed, after=identity)
        await page.hear(lambda page: page.reached() == 1)
        assert page.facts[0][0]["fact"] == "opened"


@pytest.mark.parametrize("numbers", ["1-x", "1", "7-0", "1-99999"])
async def test_an_id_that_was_never_given_does_no_harm(log: Path, numbers: str) -> None:
    async with following(log) as feed:
        page = Page(feed)
        await page.hear(lambda page: page.reached() == 1)
        odd = Page(feed, after=f"{page.id.partition('.')[0]}.{numbers}")
        append(log, arrival(1))
        await odd.hear(lambda page: bool(page.facts))


async def test_another_run_in_the_same_log_begins_anew(log: Path) -> None:
    async with following(log) as feed:
        page = Page(feed)
        await page.hear(lambda page: page.reached() == 1)
        append(log, OPENED, STARTED, arrival(0), arrival(1))
        await page.hear(lambda page: page.reached() == 2)
        assert [fact["fact"] for fact in page.facts[0]].count("began") == 1


def test_a_log_that_was_put_in_the_place_of_another_begins_anew(log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.jsonl"
    append(other, OPENED, STARTED, arrival(0), arrival(1), arrival(2))

    async def run() -> None:
        async with following(log) as feed:
            page = Page(feed)
            await page.hear(lambda page: page.reached() == 1)
            other.rename(log)
            await page.hear(lambda page: page.reached() == 3)

    asyncio.run(run())


def test_two_logs_are_told_apart(log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.jsonl"
    append(other, OPENED, STARTED, arrival(0), arrival(1))

    async def run() -> None:
        async with following(log, other) as feed:
            page = Page(feed)
            await page.hear(lambda page: (page.reached(0), page.reached(1)) == (1, 2))

    asyncio.run(run())


def test_what_is_no_event_is_left_out_and_said(log: Path) -> None:
    async def run() -> None:
        async with following(log) as feed:
            page = Page(feed)
            await page.hear(lambda page: page.reached() == 1)
            append(log, {"t": 4.0, "event": "call", "place": "local"}, arrival(1))
            await page.hear(lambda page: page.reached() == 2)
            assert not page.trouble
            said = [fact["cause"] for fact in page.facts[0] if fact["fact"] == "notice"]
            assert [each[:43] for each in said] == ["1 line of the log is left out, line 4: Obje"]


def test_what_is_more_than_a_page_can_show_ends_the_reading(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "_MOST_BYTES", 200_000)
    append(log, *(arrival(waypoint) for waypoint in range(1, 9_000)))

    async def run() -> None:
        async with following(log) as feed:
            page = Page(feed)
            await page.hear(lambda page: bool(page.trouble))
            assert "flight.jsonl tells more than a page can show" in page.trouble
            assert page.facts[0]

    asyncio.run(run())


def test_the_last_that_is_said_is_what_the_mission_came_to_and_the_end(log: Path) -> None:
    async def run() -> list[str]:
        async with following(log) as feed:
            page = Page(feed)
            await page.hear(lambda page: page.reached() == 1)
            append(log, {"t": 8.0, "event": "mission_completed"})
            feed.close()
            return [message async for message in page.messages]

    *_, summaries, elsewhere, end = asyncio.run(run())
    assert "the mission took 7.0 s" in summaries
    assert elsewhere.startswith("event: elsewhere")
    assert end.startswith("event: end")


def test_what_a_mission_came_to_is_told_beside_a_flight_that_had_none(log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.jsonl"
    append(other, OPENED, {"t": 1.0, "event": "mission_ended", "why": "no camera"})
    append(log, {"t": 8.0, "event": "mission_completed"})

    async def run() -> list[str]:
        async with following(log, other) as feed:
            feed.close()
            return [message async for message in feed.messages()]

    (summaries,) = (
        each for each in asyncio.run(run()) if each.startswith("event: summaries") and "took" in each
    )
    assert "flight: the mission took 7.0 s" in summaries


@pytest.mark.parametrize("content", [b"\xff\n", b"photo\n", b"[1]\n", b'{"t": 1}\n', b"[" * 100_000 + b"\n"])
def test_other_files_are_refused_at_once(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "photo.jpeg"
    file.write_bytes(content)
    with pytest.raises(UsageError, match=r"photo\.jpeg is not an event log"):
        open_and_close(file)


def test_a_log_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot read the event log"):
        open_and_close(tmp_path / "nowhere.jsonl")


def open_and_close(log: Path) -> None:
    with reading([log], lambda _: False):
        pass
