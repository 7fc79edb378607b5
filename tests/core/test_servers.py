"""The transition table of the specification, row by row, and nothing but it."""

from __future__ import annotations

import itertools
import math

import pytest

from upwash.core.geo import Circle, Position
from upwash.core.knowledge.servers import (
    CHECKING,
    SELECTED,
    TRANSITIONS,
    Server,
    ServerTable,
    State,
    Trigger,
)
from upwash.errors import TransitionError

AVL, AVL_R, CHECK, CHECK_R, READY, BLACKLISTED = (
    State("AVL"),
    State("AVL-R"),
    State("CHECK"),
    State("CHECK-R"),
    State("READY"),
    State("BLACKLISTED"),
)

# Written down from the specification, not from the code.
TABLE = {
    (AVL, "selected"): CHECK,
    (AVL_R, "selected"): CHECK_R,
    (CHECK_R, "found_stopped"): CHECK,  # daemon answers: available, not running
    (CHECK, "found_running"): READY,  # daemon answers: already running
    (CHECK_R, "found_running"): READY,
    (CHECK, "started"): READY,  # endpoint received
    (CHECK, "check_failed"): BLACKLISTED,  # cannot join, no answer in time, unavailable, start failed
    (CHECK_R, "check_failed"): BLACKLISTED,
    (CHECK, "deselected"): AVL,  # before the start was requested
    (CHECK, "deselected_after_start"): AVL_R,
    (CHECK_R, "deselected"): AVL_R,
    (READY, "deselected"): AVL_R,  # out of range, slower than local, better one
    (READY, "call_failed_in_range"): BLACKLISTED,
    (READY, "call_failed_out_of_range"): AVL_R,
    (READY, "turn_over"): CHECK_R,  # its slot is another drone's: asked for one again
    (CHECK, "network_lost"): BLACKLISTED,
    (CHECK_R, "network_lost"): BLACKLISTED,
    (READY, "network_lost"): BLACKLISTED,
    (BLACKLISTED, "blacklist_expired"): AVL,
    (BLACKLISTED, "probed"): AVL,  # a sign of life: not all services run
    (BLACKLISTED, "probed_running"): AVL_R,
    (AVL_R, "idle_expired"): AVL,
    (AVL, "prepared"): AVL_R,  # a peer's word: its services are being started
    (AVL_R, "prepared"): AVL_R,
}

WAY_TO = {
    AVL: [],
    CHECK: ["selected"],
    READY: ["selected", "started"],
    BLACKLISTED: ["selected", "check_failed"],
    AVL_R: ["selected", "started", "deselected"],
    CHECK_R: ["selected", "started", "deselected", "selected"],
}

IMPOSSIBLE = [
    (state, str(event))
    for state, event in itertools.product(State, Trigger)
    if (state, str(event)) not in TABLE
]


def server_in(state: State) -> Server:
    """A server that went to the state by the table, one second a step."""
    server = Server("s1", Circle(Position(0.0, 0.0), 100.0))
    for step, event in enumerate(WAY_TO[state], start=1):
        server.apply(Trigger(event), now_s=float(step))
    assert server.state is state
    return server


@pytest.mark.parametrize(("state", "event"), TABLE)
def test_every_row_of_the_table(state: State, event: str) -> None:
    server = server_in(state)
    after = TABLE[state, event]
    server.apply(Trigger(event), now_s=42.0)
    assert (server.state, server.since_s) == (after, 42.0)
    assert server.history[-1] == f"42.000 {state} {event} {after}"


@pytest.mark.parametrize(("state", "event"), IMPOSSIBLE)
def test_any_other_step_raises_with_the_servers_history(state: State, event: str) -> None:
    server = server_in(state)
    with pytest.raises(TransitionError) as caught:
        server.apply(Trigger(event), now_s=42.0)
    said = str(caught.value)
    assert f"server s1: {event} is impossible in {state}" in said
    history = said.partition("before that: ")[2].split("; ")
    if not WAY_TO[state]:
        assert history == ["nothing"]
    else:
        before = AVL
        for step, (entry, passed) in enumerate(zip(history, WAY_TO[state], strict=True), start=1):
            after = TABLE[before, passed]
            assert entry == f"{step}.000 {before} {passed} {after}"
            before = after
    assert (server.state, len(server.history)) == (state, len(WAY_TO[state]))  # nothing was changed


def test_the_law_is_the_table_and_knows_no_more() -> None:
    assert {(state, str(event)): after for (state, event), after in TRANSITIONS.items()} == TABLE


def test_the_three_states_of_a_selected_server() -> None:
    assert {CHECK, CHECK_R, READY} == SELECTED
    assert {CHECK, CHECK_R} == CHECKING


@pytest.mark.parametrize("state", [AVL, AVL_R])
def test_selection_starts_the_clock_of_the_check(state: State) -> None:
    server = server_in(state)
    server.start_requested = True  # left over from an earlier check
    server.apply(Trigger.SELECTED, now_s=42.0)
    assert server.checked_since_s == 42.0
    assert not server.start_requested


def test_a_check_that_finds_the_service_stopped_keeps_its_clock() -> None:
    server = server_in(CHECK_R)
    selected_s = server.checked_since_s
    server.apply(Trigger.FOUND_STOPPED, now_s=42.0)
    assert server.checked_since_s == selected_s == 4.0


@pytest.mark.parametrize(
    ("state", "start_requested", "after"),
    [
        (CHECK, False, AVL),
        (CHECK, True, AVL_R),
        (CHECK_R, False, AVL_R),
        (READY, False, AVL_R),
        (READY, True, AVL_R),
    ],
)
def test_where_a_deselected_server_goes(state: State, after: State, *, start_requested: bool) -> None:
    server = server_in(state)
    server.start_requested = start_requested
    server.apply(server.deselection, now_s=42.0)
    assert server.state is after


@pytest.mark.parametrize("state", [AVL, AVL_R, BLACKLISTED])
def test_only_a_selected_server_can_be_deselected(state: State) -> None:
    server = server_in(state)
    with pytest.raises(TransitionError):
        server.apply(server.deselection, now_s=42.0)


def test_the_history_keeps_the_latest_steps_only() -> None:
    server = server_in(AVL)
    for step in range(1000):
        server.apply(Trigger.SELECTED if step % 2 == 0 else Trigger.DESELECTED, now_s=float(step))
    assert len(server.history) == 20
    assert server.history[-1].startswith("999.000 ")


def test_nothing_expires_but_a_blacklisting_that_no_probe_ends_and_the_belief_in_services() -> None:
    table = ServerTable({"s1": Circle(Position(0.0, 0.0), 100.0)}, idle_s=60.0)
    server = table.servers["s1"]
    for state in State:
        server.state, server.since_s, server.left_alone_s = state, 10.0, 25.0
        table.meet()
        due_s = {AVL_R: 70.0, BLACKLISTED: 35.0}.get(state, math.inf)
        assert table.next_expiry_s(probed=()) == due_s
        assert table.next_expiry_s(probed=[server]) == (math.inf if state is BLACKLISTED else due_s)
        assert table.expired(due_s - 0.001, probed=()) == []
        if due_s < math.inf:
            [(expired, trigger)] = table.expired(due_s, probed=())
            expired.apply(trigger, now_s=due_s)
            assert server.state is AVL


def test_a_blacklisting_of_a_probed_server_does_not_expire() -> None:
    table = ServerTable({"s1": Circle(Position(0.0, 0.0), 100.0)}, idle_s=60.0)
    server = table.servers["s1"]
    server.state, server.left_alone_s = BLACKLISTED, 25.0
    table.meet()
    assert table.blacklisted == [server]
    assert table.expired(99.0, probed=[server]) == []
