"""The event log as a file."""

from __future__ import annotations

import errno
import math
import os
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.events import event, written

from upwash.core.geo import Position
from upwash.errors import UsageError
from upwash.eventlog import schema
from upwash.eventlog.log import EventLog
from upwash.eventlog.schema import Event, SetOff
from upwash.real.host import journal as journal_module
from upwash.real.host.journal import FileJournal, Unwritten, read_events


class Found(msgspec.Struct):
    label: str


def events(log: Path) -> list[dict[str, Any]]:
    return [msgspec.json.decode(line) for line in log.read_bytes().splitlines()]


def journalled(log: Path, **settings: Any) -> closing[FileJournal]:
    """A journal until the end of the block, which is on an event loop."""
    return closing(FileJournal(log, **settings))


def recorded(log: Path, *of_one_run: Event, **settings: Any) -> None:
    """Has a journal of its own take these events."""
    with journalled(log, **settings) as journal:
        for each in of_one_run:
            journal.record(each)


async def test_an_event_is_in_the_file_as_soon_as_it_is_recorded(tmp_path: Path) -> None:
    log = tmp_path / "new/folder/events.jsonl"
    with journalled(log) as journal:
        journal.record(event("arrived", waypoint=3))
        assert [each["event"] for each in events(log)] == ["log_opened", "arrived"]
        assert events(log)[1]["waypoint"] == 3


async def test_each_event_is_one_line_in_one_write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[bytes] = []
    write = os.write

    def watched(file: int, data: bytes) -> int:
        written.append(data)
        return write(file, data)

    monkeypatch.setattr(os, "write", watched)
    recorded(tmp_path / "log", event("vehicle_said", text="two\nlines\r\u2028"))
    assert len(written) == 2
    assert all(data.count(b"\n") == 1 and data.endswith(b"\n") for data in written)


async def test_time_counts_from_the_opening_which_tells_the_time_of_day(tmp_path: Path) -> None:
    with journalled(tmp_path / "log") as journal:
        journal.record(event("armed"))
        journal.record(event("landed"))
    opened, first, second = events(tmp_path / "log")
    assert 0.0 <= opened["t"] <= first["t"] <= second["t"] < 5.0
    assert abs(datetime.fromisoformat(opened["time"]) - datetime.now(UTC)) < timedelta(minutes=1)


async def test_a_log_that_is_there_is_added_to(tmp_path: Path) -> None:
    for name in ("armed", "landed"):
        recorded(tmp_path / "log", event(name))
    assert [each["event"] for each in events(tmp_path / "log")] == [
        "log_opened",
        "armed",
        "log_opened",
        "landed",
    ]


async def test_nothing_is_added_to_a_file_that_is_no_log(tmp_path: Path) -> None:
    other = tmp_path / "drone.toml"
    other.write_text("name = 1\n")
    with pytest.raises(UsageError, match="is no event log, and stays as it is"):
        FileJournal(other)
    assert other.read_text() == "name = 1\n"


async def test_a_watcher_that_fails_costs_no_event_and_no_other_watcher(tmp_path: Path) -> None:
    seen: list[Event] = []

    def print_to_a_closed_terminal(_: Event) -> None:
        raise OSError(errno.EIO, "Input/output error")

    recorded(tmp_path / "log", event("landed"), watchers=(print_to_a_closed_terminal, seen.append))
    assert [each.kind for each in seen] == ["log_opened", "landed"]
    assert written(seen) == events(tmp_path / "log")


@pytest.mark.parametrize("place", ["file/events.jsonl", "."])
async def test_a_log_that_cannot_be_written_is_named(tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=r"cannot write the event log .*: \w+"):
        recorded(tmp_path / place)


async def test_a_log_without_room_for_its_first_line_is_named() -> None:
    with pytest.raises(UsageError, match="cannot write the event log /dev/full: No space left"):
        recorded(Path("/dev/full"))


def cut_at(most_bytes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on a write has room for that many bytes, and the next for none, as on a disk that is nearly full."""
    write, room = os.write, [most_bytes]

    def cut(file: int, data: bytes) -> int:
        if not room[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = write(file, data[: room[0]])
        room[0] -= written
        return written

    monkeypatch.setattr(os, "write", cut)


@pytest.mark.parametrize("room_bytes", [0, 1, 12, 40])
async def test_a_write_that_was_cut_is_taken_back_and_its_events_come_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room_bytes: int
) -> None:
    log, unwritten = tmp_path / "log", Unwritten()
    with journalled(log, unwritten=unwritten) as journal:
        journal.record(event("armed"))
        before = log.read_bytes()
        cut_at(room_bytes, monkeypatch)
        for waypoint in range(3):
            journal.record(event("arrived", waypoint=waypoint))
        assert log.read_bytes() == before
        assert (len(unwritten), unwritten.why) == (3, "No space left on device")
        monkeypatch.undo()
        monkeypatch.setattr(journal_module, "_TRY_AGAIN_S", 0.0)
        journal.record(event("landed"))
    names = [each["event"] for each in events(log)]
    assert names == ["log_opened", "armed", "arrived", "arrived", "arrived", "landed"]
    assert (len(unwritten), unwritten.why) == (0, "")


async def test_what_never_found_room_is_in_memory_in_its_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, unwritten = tmp_path / "log", Unwritten()
    seen: list[Event] = []
    with journalled(log, unwritten=unwritten, watchers=(seen.append,)) as journal:
        cut_at(10, monkeypatch)
        journal.record(event("armed"))
        journal.record(event("landed"))
    assert [each.kind for each in seen] == ["log_opened", "armed", "landed"]
    assert [each["event"] for each in events(log)] == ["log_opened"]
    assert [msgspec.json.decode(line)["event"] for line in unwritten.lines] == ["armed", "landed"]
    assert unwritten.why == "No space left on device"


async def test_a_full_disk_is_not_tried_at_every_event(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries: list[int] = []

    def full(file: int, _: bytes) -> int:
        tries.append(file)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with journalled(tmp_path / "log") as journal:
        monkeypatch.setattr(os, "write", full)
        for _ in range(1000):
            journal.record(event("position"))
    assert len(tries) < 10


async def test_what_is_too_much_for_memory_is_counted_and_told_in_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(journal_module, "_MOST_UNWRITTEN_BYTES", 200)
    log, unwritten = tmp_path / "log", Unwritten()
    with journalled(log, unwritten=unwritten) as journal:
        cut_at(0, monkeypatch)
        for waypoint in range(50):
            journal.record(event("arrived", waypoint=waypoint))
        assert len(unwritten) == 50 and unwritten.lost > 40
        monkeypatch.undo()
    *_, last = events(log)
    assert (last["event"], last["count"]) == ("events_lost", 50 - (len(events(log)) - 2))


async def test_a_cut_line_that_cannot_be_taken_back_is_closed_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    log = tmp_path / "log"

    def refuse(_file: int, _length: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with journalled(log) as journal:
        cut_at(12, monkeypatch)
        monkeypatch.setattr(os, "ftruncate", refuse)
        journal.record(event("armed"))
        monkeypatch.undo()
    assert [each.kind for each in read_events(log)] == ["log_opened", "armed"]
    assert f"{log}: 1 line of the log is left out, line 2: it is torn" in caplog.text
    recorded(log, event("landed"), resumes=True)
    names = [each.kind for each in read_events(log)]
    assert names == ["log_opened", "armed", "log_resumed", "landed"]


async def test_a_log_that_ends_with_a_torn_line_is_added_to_on_a_line_of_its_own(tmp_path: Path) -> None:
    log = tmp_path / "log"
    recorded(log, event("armed"))
    log.write_bytes(log.read_bytes() + b'{"t":7.0,"eve')
    recorded(log, event("landed"))
    assert [each.kind for each in read_events(log)] == ["log_opened", "armed", "log_opened", "landed"]


@pytest.mark.parametrize(
    ("torn", "left"),
    [
        (b'{"t":7.0,"eve', []),
        (b'{"t":7.0,"eve{"t":8.0,"event":"armed"}', ["armed"]),  # as releases before this one left it
        (b'{"t"', []),
        (b"", []),
        (bytes(4096), []),
        (b'{"t":7.0,"event":"arr' + bytes(100) + b"}", []),
    ],
)
async def test_a_torn_line_costs_itself_and_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, torn: bytes, left: list[str]
) -> None:
    log = tmp_path / "log"
    recorded(log, event("armed"))
    log.write_bytes(log.read_bytes() + torn + b'\n{"t":9.0,"event":"landed"}\n')
    assert [each.kind for each in read_events(log)] == ["log_opened", "armed", *left, "landed"]
    assert caplog.text.count(f"{log}: 1 line of the log is left out, line 3: it is torn") == 1


@pytest.mark.parametrize("line", [b"photo", b'{"t":7.0}', b'{"t":"7","event":"arrived"}', b'[{"t":7.0}]'])
async def test_a_line_that_no_log_could_have_is_not_taken_for_a_torn_one(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, line: bytes
) -> None:
    log = tmp_path / "log"
    recorded(log, event("armed"))
    log.write_bytes(log.read_bytes() + line + b"\n")
    assert [each.kind for each in read_events(log)] == ["log_opened", "armed"]
    assert f"{log}: 1 line of the log is left out, line 3: each line of one has an event" in caplog.text


@pytest.mark.parametrize(
    ("too_much", "kept"),
    [
        ([{"label": "\x01" * 15_000_000, "score": 0.9}], {"score": 0.9}),
        ("x" * 15_000_000, "xxx"),
    ],
    ids=["label", "words"],
)
async def test_what_no_reader_takes_is_shortened_as_it_is_written(
    tmp_path: Path, too_much: Any, kept: object
) -> None:
    log = tmp_path / "log"
    seen: list[Event] = []
    with journalled(log, watchers=(seen.append,)) as journal:
        journal.record(schema.Notified(message=too_much, at=Position(0.0, 0.0)))
        journal.record(event("armed"))
    assert read_events(log) == seen
    assert [each.kind for each in seen] == ["log_opened", "notified", "shortened", "armed"]
    assert log.stat().st_size < 100_000
    _, notified, shortened, _ = events(log)
    assert (shortened["of"], shortened["t"]) == ("notified", notified["t"])
    assert "length <= 10000" in shortened["why"]
    message = notified["message"]
    found = {"score": message[0]["score"]} if isinstance(message, list) else message[:3]
    assert found == kept


def nested(depth: int) -> Any:
    return [nested(depth - 1)] if depth else "end"


ODD = [
    SetOff(waypoint=1, east_m=math.nan, north_m=0.0),
    SetOff(waypoint=1, east_m=math.inf, north_m=0.0),
    SetOff(waypoint=-1, east_m=0.0, north_m=0.0),
    schema.PhotoTaken(
        source="\udcff", bytes=2**70, age_s=1e300, position=Position(1e20, 0.0), truth=[nested(9)]
    ),
    schema.Notified(message=nested(50), at=Position(0.0, 0.0)),
    schema.Notified(message={str(number): [1.0] * 50 for number in range(10_000)}, at=Position(0.0, 0.0)),
    schema.VehicleSetting(name="RTL_ALT", value=math.nan, advice="fly higher"),
    schema.Planned(waypoints_m=[(0.0, 0.0)] * 150_000),
    schema.MissionEnded(why="\ud800" * 20_000),
]


@pytest.mark.parametrize("odd", ODD, ids=range(len(ODD)))
async def test_every_line_that_is_written_is_read(tmp_path: Path, odd: Event) -> None:
    log = tmp_path / "log"
    recorded(log, odd)
    read = EventLog(log)
    kinds = [each.kind for each in read]
    assert not read.left_out
    assert kinds[1:] in ([odd.kind, "shortened"], ["shortened"], [odd.kind])  # an unknown value may be null


async def test_no_flight_is_taken_up_after_years(tmp_path: Path) -> None:
    log = tmp_path / "log"
    recorded(log, event("armed"))
    log.write_bytes(log.read_bytes() + b'{"t":9e8,"event":"landed"}\n')
    with pytest.raises(UsageError, match="no flight is taken up after 900000000 s"):
        recorded(log, resumes=True)


async def test_a_disk_that_fails_as_the_log_is_closed_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unwritten, close = Unwritten(), os.close

    def fail(file: int) -> None:
        close(file)
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    journal = FileJournal(tmp_path / "log", unwritten=unwritten)
    monkeypatch.setattr(os, "close", fail)
    journal.close()
    monkeypatch.undo()
    assert (len(unwritten), unwritten.why) == (0, "Input/output error")


async def test_a_text_that_is_not_unicode_does_not_end_the_flight(tmp_path: Path) -> None:
    name = os.fsdecode(b"photo\xff.jpg")
    lost = [schema.RemoteFailed(server="s1", why=f"{name} is missing"), schema.ArmingDelayed(reasons=[name])]
    with journalled(tmp_path / "log") as journal:
        for each in lost:
            journal.record(each)
    failed, delayed = events(tmp_path / "log")[1:]
    assert (failed["event"], failed["why"]) == ("remote_failed", r"photo\udcff.jpg is missing")
    assert delayed["reasons"] == [r"photo\udcff.jpg"]


async def test_no_control_character_is_in_the_file_and_each_comes_back(tmp_path: Path) -> None:
    raw = "\x1b[2J\x9b31m\u202e\u2028\r\n\U000e0041"
    recorded(tmp_path / "log", event("notified", message=[raw]))
    assert all(line.isprintable() for line in (tmp_path / "log").read_text().split("\n"))
    assert events(tmp_path / "log")[-1]["message"] == [raw]


async def test_the_user_is_told_through_the_log(tmp_path: Path) -> None:
    found = [Found("hot-spot")]

    with journalled(tmp_path / "log") as journal:
        await journal.notify(found, Position(1.0, 2.0, 3.0))
    told = events(tmp_path / "log")[-1]
    assert (told["event"], told["at"]) == ("notified", {"east_m": 1.0, "north_m": 2.0, "altitude_m": 3.0})
    assert told["message"] == [{"label": "hot-spot"}]


async def test_a_log_that_is_resumed_goes_on_in_time(tmp_path: Path) -> None:
    log = tmp_path / "log"
    recorded(log, event("arrived"))
    recorded(log, event("landed"), resumes=True)
    assert [each["event"] for each in events(log)] == ["log_opened", "arrived", "log_resumed", "landed"]
    times_s = [each["t"] for each in events(log)]
    assert times_s == sorted(times_s)


async def test_a_log_of_several_flights_goes_on_in_the_time_of_the_last(tmp_path: Path) -> None:
    log = tmp_path / "log"
    yesterday = (datetime.now(UTC) - timedelta(days=1)).isoformat()
    log.write_bytes(msgspec.json.encode({"t": 0.0, "event": "log_opened", "time": yesterday}) + b"\n")
    recorded(log, event("arrived"))
    recorded(log, event("landed"), resumes=True)
    assert all(each["t"] < 60.0 for each in events(log))


async def test_a_clock_that_has_gone_back_does_not_take_the_log_back(tmp_path: Path) -> None:
    log = tmp_path / "log"
    tomorrow = (datetime.now(UTC) + timedelta(days=1)).isoformat()
    opened = {"t": 0.0, "event": "log_opened", "time": tomorrow}
    log.write_bytes(
        b"".join(
            msgspec.json.encode(each) + b"\n" for each in (opened, {"t": 70.0, "event": "left_hovering"})
        )
    )
    recorded(log, event("landed"), resumes=True)
    assert [70.0 <= each["t"] < 80.0 for each in events(log)] == [False, True, True, True]


async def test_a_line_that_a_failing_computer_left_unfinished_is_dropped(tmp_path: Path) -> None:
    log = tmp_path / "log"
    recorded(log, event("arrived"))
    log.write_bytes(log.read_bytes() + b'{"t":7.0,"eve')
    assert [each.kind for each in read_events(log)] == ["log_opened", "arrived"]
    recorded(log, event("landed"), resumes=True)
    assert [each["event"] for each in events(log)] == ["log_opened", "arrived", "log_resumed", "landed"]


async def test_a_log_that_another_flight_writes_is_not_resumed(tmp_path: Path) -> None:
    log = tmp_path / "log"
    with journalled(log) as journal:
        with pytest.raises(UsageError, match="is the flight still under way"):
            FileJournal(journal.path, resumes=True)
        journal.record(event("landed"))
    assert [each["event"] for each in events(log)] == ["log_opened", "landed"]


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "is not an event log"),
        (b"photo\n", "is not an event log"),
        (b'{"t":1}\n', "is not an event log"),
        (b'{"t":1,"event":"armed"}\n', "not the event log of a flight"),
        (b"[1]\n", "is not an event log"),
    ],
)
def test_what_is_no_log_is_not_resumed(tmp_path: Path, content: bytes, why: str) -> None:
    log = tmp_path / "log"
    log.write_bytes(content)
    with pytest.raises(UsageError, match=why):
        read_events(log)
    assert log.read_bytes() == content
