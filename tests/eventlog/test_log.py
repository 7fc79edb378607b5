"""Reading a log: of this version, of another one, and of releases that wrote none."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec
import pytest
from tests.conftest import SCENARIOS
from tests.events import event, line

from upwash.core.servers import Trigger
from upwash.errors import UsageError
from upwash.eventlog import log as event_log
from upwash.eventlog import schema
from upwash.eventlog.log import LineReader
from upwash.eventlog.schema import Event
from upwash.lab.run import simulate
from upwash.lab.simulation import read_scenario

OPENED = line("log_opened", 0.0, version=schema.VERSION)
OPENED_BY_AN_EARLIER_RELEASE = b'{"t": 0.0, "event": "log_opened", "time": "2026-01-01T00:00:00+00:00"}\n'


def read(folder: Path, *lines: bytes) -> list[Event]:
    file = folder / "flown.jsonl"
    file.write_bytes(b"".join(lines))
    return event_log.read(file)


@pytest.mark.parametrize("kind", [schema.kind_of(each) for each in schema.EVENTS])
def test_each_event_is_read_as_it_was_written(tmp_path: Path, kind: str) -> None:
    written = event(kind, 1.5)
    assert read(tmp_path, msgspec.json.encode(written) + b"\n") == [written]
    assert written.kind == kind and (type(written).__doc__ or "").strip()


def test_each_step_of_the_table_is_an_event() -> None:
    assert set(schema.STEPS) == set(Trigger)


def test_an_event_that_no_journal_has_stamped_is_none_of_a_log(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="each line of one has an event and its time"):
        read(tmp_path, OPENED, msgspec.json.encode(schema.Armed()) + b"\n")


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
    ],
)
def test_what_this_version_cannot_have_written_is_refused_with_its_line(tmp_path: Path, odd: bytes) -> None:
    with pytest.raises(
        UsageError, match=r"flown\.jsonl is not an event log that this version reads: line 2: "
    ):
        read(tmp_path, OPENED, odd)


def test_a_log_of_an_earlier_release_is_read_as_far_as_its_events_are_known(tmp_path: Path) -> None:
    gone, known = b'{"t": 1.0, "event": "teleported"}\n', b'{"t": 2.0, "event": "armed", "by": "hand"}\n'
    assert [each.kind for each in read(tmp_path, OPENED_BY_AN_EARLIER_RELEASE, gone, known)] == [
        "log_opened",
        "armed",
    ]
    with pytest.raises(UsageError, match="that this version reads: line 2: Object missing required field"):
        read(tmp_path, OPENED_BY_AN_EARLIER_RELEASE, b'{"t": 1.0, "event": "leg"}\n')


def test_each_part_of_a_log_is_read_by_the_version_that_wrote_it(tmp_path: Path) -> None:
    gone = b'{"t": 1.0, "event": "teleported"}\n'
    resumed = line("log_resumed", 2.0, version=schema.VERSION)
    assert len(read(tmp_path, OPENED_BY_AN_EARLIER_RELEASE, gone, resumed)) == 2
    with pytest.raises(UsageError, match="line 4"):
        read(tmp_path, OPENED_BY_AN_EARLIER_RELEASE, gone, resumed, gone)


def test_a_torn_line_of_this_version_costs_itself(tmp_path: Path) -> None:
    torn = b'{"event":"leg","t":1.0,"wayp{"event":"armed","t":2.0}\n'
    assert [each.kind for each in read(tmp_path, OPENED, torn, b'{"eve\n')] == ["log_opened", "armed"]


ARMED = b'{"event":"armed","t":2.0}\n'
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
)  # fmt: skip
@pytest.mark.parametrize("opened", [OPENED, OPENED_BY_AN_EARLIER_RELEASE, b""])
def test_lines_that_are_read_at_once_are_what_they_are_one_by_one(opened: bytes, odd: bytes) -> None:
    parts = [opened, ARMED + LEG, ARMED + odd, odd + LEG, LEG, b'{"event":"teleported","t":9.0}\n']
    by_itself, at_once = LineReader(Path("log")), LineReader(Path("log"))
    assert made_of(map(at_once.take_all, parts)) == made_of(
        [by_itself.take(line)] for line in b"".join(parts).split(b"\n")[:-1]
    )


def made_of(parts: Iterable[Iterable[Event | None]]) -> tuple[list[Event], str]:
    """The events of a log's parts, and why it is read no further."""
    events = list[Event]()
    try:
        for part in parts:
            events.extend(event for event in part if event is not None)
    except UsageError as error:
        return events, str(error)
    return events, ""


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
