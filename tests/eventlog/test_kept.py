"""Events of long runs, of which few are in memory."""

from __future__ import annotations

import pickle

import pytest
from tests.scenarios import scenario

from upwash.eventlog import kept, schema
from upwash.eventlog.kept import KeptEvents
from upwash.eventlog.schema import Event
from upwash.lab.run import simulate


def events(count: int) -> list[Event]:
    return [schema.LocalReady(t=float(number), service=f"service {number}") for number in range(count)]


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "_BLOCK", 4)
    monkeypatch.setattr(kept, "_IN_MEMORY", 8)


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("count", [0, 1, 8, 9, 30, 33])
def test_they_are_the_same_sequence_wherever_they_lie(count: int) -> None:
    given, found = events(count), KeptEvents()
    for event in given:
        found.append(event)
    assert len(found) == count
    assert list(found) == given
    assert found == given
    assert list(reversed(found)) == given[::-1]
    assert [found[number] for number in range(-count, count)] == given + given
    assert found[2:-3] == given[2:-3]
    assert b"".join(found.lines()) == b"".join(KeptEvents(given).lines())
    assert pickle.loads(pickle.dumps(found)) == given
    assert len(found._latest) <= 8
    with pytest.raises(IndexError):
        found[count]


@pytest.mark.usefixtures("small_blocks")
def test_a_mission_is_logged_and_counted_the_same_with_few_events_in_memory() -> None:
    long = simulate(scenario())
    assert len(long.events._blocks) > 0
    log = long.log()
    assert b"".join(long.events.as_read().lines()) == log
    assert long.result.completed
