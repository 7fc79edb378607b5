"""Reading a log: of this version, of another one, and of releases that wrote none."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

import msgspec
import pytest
from tests.conftest import SCENARIOS
from tests.events import event, line

from upwash.core.knowledge.servers import Trigger
from upwash.errors import UsageError
from upwash.eventlog import log as event_log
from upwash.eventlog import schema
from upwash.eventlog.log import EventLog, LineReader
from upwash.eventlog.schema import Event
from upwash.lab.run import simulate
from upwash.lab.scenario import read_scenario

OPENED = line("log_opened", 0.0, version=schema.VERSION)
OPENED_BY_AN_EARLIER_RELEASE = b'{"t": 0.0, "event": "log_opened", "time": "2026-01-01T00:00:00+00:00"}\n'


ARMED = b'{"event":"armed","t":2.0}\n'


def read(folder: Path, *lines: bytes) -> list[Event]:
    file = folder / "flown.jsonl"
    file.write_bytes(b"".join(lines))
    return event_log.read(file)


def kinds(folder: Path, *lines: bytes) -> list[str]:
    return [each.kind for each in read(folder, *lines)]


def left_out(folder: Path, *lines: bytes) -> str:
    """What the log says of the lines that are no events."""
    read(folder, *lines)
    log = EventLog(folder / "flown.jsonl")
    assert log.left_out == ""
    for _ in log:
        pass
    return log.left_out


@pytest.mark.parametrize("kind", [schema.kind_of(each) for each in schema.EVENTS])
def test_each_event_is_read_as_it_was_written(tmp_path: Path, kind: str) -> None:
    written = event(kind, 1.5)
    assert read(tmp_path, msgspec.json.encode(written) + b"\n") == [written]
    assert written.kind == kind and (type(written).__doc__ or "").strip()


def test_each_step_of_the_table_is_an_event() -> None:
    assert set(schema.STEPS) == set(Trigger)


def test_an_event_that_no_journal_has_stamped_is_none_of_a_log(tmp_path: Path) -> None:
    lines = OPENED, msgspec.json.encode(schema.Armed()) + b"\n"
    assert kinds(tmp_path, *lines) == ["log_opened"]
    assert left_out(tmp_path, *lines) == (
        "1 line of the log is left out, line 2: each line of one has an event and its time"
    )


@pytest.mark.parametrize("kind", ["log_opened", "log_resumed", "simulated"])
def test_a_log_of_a_later_version_is_refused(tmp_path: Path, kind: str) -> None:
    later = line(kind, 1.0, version=schema.VERSION + 1)
    told = rf"flown\.jsonl: line 2: this log is of version {schema.VERSION + 1}, and this upwash reads"
    with pytest.raises(UsageError, match=told):
        read(tmp_path, OPENED, later)
    unlike = line("log_opened", 0.0, version=schema.VERSION + 1, opened="today")
    with pytest.raises(UsageError, match=f"line 1: this log is of version {schema.VERSION + 1}"):
        read(tmp_path, unlike)


@pytest.mark.parametrize(
    "odd",
    [
        b'{"event":"teleported","t":1.0}\n',
        b'{"event":"call","t":1.0,"place":"local"}\n',
        b'{"event":"selected","t":1.0,"server":"s1","before":"AVL","after":"ASLEEP"}\n',
        b'{"event":"mission_started","t":1.0,"policy":"p","waypoints":9223372036854775808}\n',
        b'{"event":"leg","t":1e300,"waypoint":1,"east_m":0.0,"north_m":0.0}\n',
        b'{"event":"leg","t":1.0,"waypoint":1,"east_m":NaN,"north_m":0.0}\n',
        b'{"event":"mission_ended","t":1.0,"why":"' + b"x" * 20_000 + b'"}\n',
        b'{"event":"notified","t":1.0,"message":[[[[[]]]]],"at":{"east_m":0.0,"north_m":0.0}}\n',
        b'{"event":"mission_ended","t":1.0,"why":"' + b"x" * 2**24 + b'"}\n',
        b"[" * 100_000 + b"\n",
    ],
    ids=range(10),
)
def test_a_line_that_is_no_event_costs_itself_alone(tmp_path: Path, odd: bytes) -> None:
    lines = OPENED, odd, ARMED, odd
    assert kinds(tmp_path, *lines) == ["log_opened", "armed"]
    said = left_out(tmp_path, *lines)
    assert said.startswith("2 lines of the log are left out, the first is line 2: ")
    assert len(said) < 300 and said.isprintable()


@pytest.mark.parametrize(
    "content", [b"latitude,longitude\n39.36,22.95\n", b"\n" * 10**6, bytes(10**6) + b"\n"]
)
def test_a_file_without_events_is_no_log(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(UsageError, match=r"flown\.jsonl is not an event log: line 1: "):
        read(tmp_path, content)


def test_no_more_events_are_read_than_there_is_memory_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_log, "MOST_EVENTS", 5_000)
    lines = OPENED, ARMED * 10_000
    assert 2_000 < len(read(tmp_path, *lines)) <= 5_000
    assert "no more than 5000 events of a log are read" in left_out(tmp_path, *lines)


def test_a_log_of_an_earlier_release_is_read_as_far_as_its_events_are_known(tmp_path: Path) -> None:
    gone, known = b'{"t": 1.0, "event": "teleported"}\n', b'{"t": 2.0, "event": "armed", "by": "hand"}\n'
    assert [each.kind for each in read(tmp_path, OPENED_BY_AN_EARLIER_RELEASE, gone, known)] == [
        "log_opened",
        "armed",
    ]
    lines = OPENED_BY_AN_EARLIER_RELEASE, gone, b'{"t": 1.0, "event": "leg"}\n'
    assert left_out(tmp_path, *lines).startswith(
        "1 line of the log is left out, line 3: Object missing required field"
    )


def test_each_part_of_a_log_is_read_by_the_version_that_wrote_it(tmp_path: Path) -> None:
    gone = b'{"t": 1.0, "event": "teleported"}\n'
    resumed = line("log_resumed", 2.0, version=schema.VERSION)
    lines = OPENED_BY_AN_EARLIER_RELEASE, gone, resumed, gone
    assert kinds(tmp_path, *lines) == ["log_opened", "log_resumed"]
    assert "line 4: " in left_out(tmp_path, *lines)


def test_a_torn_line_of_this_version_costs_itself(tmp_path: Path) -> None:
    torn = b'{"event":"leg","t":1.0,"wayp{"event":"armed","t":2.0}\n'
    assert kinds(tmp_path, OPENED, torn, b'{"eve\n') == ["log_opened", "armed"]
    assert (
        left_out(tmp_path, OPENED, torn, b'{"eve\n')
        == "2 lines of the log are left out, the first is line 2: it is torn"
    )


LEG = line("leg", 3.0, waypoint=1)


@pytest.mark.parametrize(
    "odd",
    [
        b"", b"\n", b" \n", b'{"event":"armed","t":2.0} \r\n', b'{"event":"armed","t":2.0,"by":"hand"}\n',
        b'{"event":"armed"}\n', b'{"event":"teleported","t":1.0}\n', b'{"event":"leg","t":1.0}\n', b"[]\n", b"7\n",
        ARMED[:-1] + ARMED, b'{"event":"armed",\n"t":2.0}\n', b"\xff\n", b"[" * 100_000 + b"\n",
        b'{"event":"leg","t":1.0,"wayp{"event":"armed","t":2.0}\n', b'{"eve\n', b"\0\0\n",
        line("log_opened", 0.0, version=schema.VERSION + 1), line("log_resumed", 2.0, version=schema.VERSION),
    ],
    ids=range(19),
)  # fmt: skip
@pytest.mark.parametrize("opened", [OPENED, OPENED_BY_AN_EARLIER_RELEASE, b""])
@pytest.mark.parametrize("piece_bytes", [1, 7, 50])
def test_the_pieces_in_which_a_log_is_read_change_nothing(
    opened: bytes, odd: bytes, piece_bytes: int
) -> None:
    parts = [
        opened,
        ARMED + LEG,
        ARMED + odd[:1000],
        odd[-1000:] + LEG,
        LEG,
        b'{"event":"teleported","t":9.0}\n',
    ]
    content = b"".join(parts)
    pieces = [content[start : start + piece_bytes] for start in range(0, len(content), piece_bytes)]
    assert made_of(pieces) == made_of(parts) == made_of([content])


def made_of(pieces: Iterable[bytes]) -> tuple[list[Event], str]:
    """The events of a log that comes in pieces, and what of it is left out or why it is read no further."""
    events, lines = list[Event](), LineReader(Path("log"))
    try:
        for piece in pieces:
            events.extend(lines.take_all(piece))
    except UsageError as error:
        return events, str(error)
    return events, lines.left_out


def test_a_place_is_a_server_or_the_drone() -> None:
    on_drone, at_server = event("call", 1.0, place="local"), event("call", 1.0, place="s1")
    assert isinstance(on_drone, schema.Call) and isinstance(at_server, schema.Call)
    assert (on_drone.server, at_server.server) == (None, "s1")


@pytest.mark.parametrize("policy", ["location-aware", "look-ahead"])
def test_each_call_leads_back_to_the_selection_of_its_server(policy: str) -> None:
    run = simulate(read_scenario(SCENARIOS / "dense-city.toml", policy=policy))
    selected = {each.check: each for each in run.events if isinstance(each, schema.Selected)}
    remote = [each for each in run.events if isinstance(each, schema.Call) and each.server is not None]
    assert len({each.check for each in remote}) > 3
    for call in remote:
        assert call.check is not None
        cause = selected[call.check]
        assert cause.server == call.server and cause.t <= call.t
    for decided in (each for each in run.events if isinstance(each, schema.Decided) and each.server):
        assert decided.check is not None
        assert selected[decided.check].server == decided.server == decided.selected


def test_a_log_is_data_frames_of_its_calls_and_of_each_kind(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    run = simulate(read_scenario(SCENARIOS / "demonstration.toml"))
    (tmp_path / "flown.jsonl").write_bytes(run.log())
    log = event_log.read(tmp_path / "flown.jsonl")
    calls = log.to_pandas()
    assert isinstance(calls, pandas.DataFrame)
    assert list(calls["place"]) == [call.place for call in run.result.calls]
    assert calls["delay_s"].sum() == pytest.approx(run.result.totals.service_delay_s)
    decided = log.to_pandas("decided")
    assert len(decided) == sum(event.kind == "decided" for event in log)
    assert {"t", "why", "position.east_m"} <= set(decided.columns)
    assert list(log.to_pandas("hedged").columns[:2]) == ["t", "waypoint"]
    with pytest.raises(UsageError, match="'photograph' is no kind of event"):
        log.to_pandas("photograph")


def test_data_frames_without_pandas_are_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    (tmp_path / "flown.jsonl").write_bytes(OPENED)
    with pytest.raises(
        UsageError, match=r"pandas is not installed: `pip install 'upwash\[pandas\]'` installs it"
    ):
        event_log.read(tmp_path / "flown.jsonl").to_pandas()
