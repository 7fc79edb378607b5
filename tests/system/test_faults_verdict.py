"""The judge of flights under faults finds what it is there to find, in logs written for it."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest
from tests.events import line
from tests.system.faults.flight import RECORD, SCENARIO, Record
from tests.system.faults.mission import Spotter, heard
from tests.system.faults.strikes import Strike
from tests.system.faults.verdict import judge

from upwash.config.drone_file import read_drone_config
from upwash.config.places import waypoints
from upwash.emulation.programs import write_config

BEGAN_S = 1_800_000_000.0
CALL_S = 0.5
Event = dict[str, Any]


def _facts(event: Event) -> Event:
    return {name: fact for name, fact in event.items() if name not in ("event", "t")}


class Log:
    """The log of one drone's flight, in which all goes well."""

    def __init__(self, began_s: float = 0.0, place: str = "s1") -> None:
        opened = datetime.fromtimestamp(BEGAN_S + began_s, UTC).isoformat()
        self.events: list[Event] = [
            {"t": 0.0, "event": "log_opened", "time": opened},
            {"t": 0.0, "event": "mission_started", "policy": "location-aware", "waypoints": 17},
        ]
        self._t_s = 1.0
        self._add("selected", server=place, before="AVL", after="CHECK", why="fastest in range")
        self._add("found_running", server=place, before="CHECK", after="READY", why="")
        spotter = Spotter()
        for waypoint in waypoints(read_drone_config(SCENARIO).mission):
            self._add("arrived", waypoint=waypoint.index)
            for number in (2 * waypoint.index, 2 * waypoint.index + 1):
                self._call(number, place, msgspec.to_builtins(heard(spotter, number)))
        self._add("mission_completed")

    def _call(self, number: int, place: str, message: Any) -> None:
        at = {"east_m": 20.0, "north_m": 0.0, "altitude_m": 5.0}
        facts = {"server": place, "deadline_s": 1.2, "state": "READY", "local_s": 1.2, "remote_s": 0.4}
        self._add("decided", operation="spotter.look", decision="remote", position=at, **facts)
        self._t_s += CALL_S
        self._add("call", operation="spotter.look", place=place, delay_s=CALL_S)
        self._add("notified", message=message)

    def _add(self, event: str, **facts: Any) -> None:
        self.events.append({"t": round(self._t_s, 3), "event": event, **facts})

    def write(self, folder: Path, name: str) -> None:
        config = msgspec.structs.replace(read_drone_config(SCENARIO), name=name)
        write_config(folder / f"{name}.toml", config)
        (folder / f"{name}.jsonl").write_bytes(
            b"".join(line(event["event"], event["t"], **_facts(event)) for event in self.events)
        )


def broken(folder: Path, log: Log, *strikes: Strike, other: Log | None = None, **facts: Any) -> list[str]:
    log.write(folder, "drone-1")
    if other is not None:
        other.write(folder, "drone-2")
    names = ["drone-1"] if other is None else ["drone-1", "drone-2"]
    record = Record(
        seed=0, strikes=list(strikes), exit_codes=dict.fromkeys(names, 0), position_lag_s=0.0, took_s=100.0,
        daemons_ended=facts.get("daemons_ended", []), most_instances=facts.get("most_instances", {"s1": 1}),
    )  # fmt: skip
    (folder / RECORD).write_bytes(msgspec.json.encode(record))
    return judge(folder).broken


def strike(what: str, target: str, from_s: float, to_s: float, server: str = "s1") -> Strike:
    return Strike(
        what=what, target=target, server=server, said=what, from_s=BEGAN_S + from_s, to_s=BEGAN_S + to_s
    )


def of_kind(log: Log, name: str, number: int) -> Event:
    return [event for event in log.events if event["event"] == name][number]


def test_a_flight_in_which_all_went_well_breaks_nothing(tmp_path: Path) -> None:
    assert broken(tmp_path, Log(), strike("dark", "link", 0.5, 1.5)) == []


AFAR = {"east_m": 60.0, "north_m": 0.0, "altitude_m": 5.0}


def answer_with_another(log: Log) -> None:
    one, other = (of_kind(log, "notified", number)["message"] for number in (4, 5))
    one["answer"] = other["answer"]


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda log: log.events.remove(of_kind(log, "notified", 4)), "promise 1: no answer to [4]"),
        (answer_with_another, "promises 3 and 4: heard"),
        (lambda log: of_kind(log, "decided", 3).update(position=AFAR), "promise 6 (range)"),
        (lambda log: of_kind(log, "call", 3).update(delay_s=1.4), "promise 2 (bounded calls)"),
        (lambda log: log.events.remove(of_kind(log, "arrived", 7)), "promise 1: never arrived at [7]"),
        (lambda log: log.events[9].update(t=0.5), "promise 10: the log of drone-1"),
    ],
)
def test_what_is_wrong_with_a_log_is_found(spoil: Callable[[Log], None], why: str, tmp_path: Path) -> None:
    log = Log()
    spoil(log)
    assert any(why in each for each in broken(tmp_path, log))


def test_a_torn_line_is_found(tmp_path: Path) -> None:
    broken(tmp_path, Log())
    with (tmp_path / "drone-1.jsonl").open("ab") as log:
        log.write(b'{"t": 100.0, "ev')
    assert any("its last line is torn" in each for each in judge(tmp_path).broken)


def test_calls_that_do_not_return_after_a_black_out_are_found(tmp_path: Path) -> None:
    log = Log()
    for event in log.events:
        if event["event"] == "call" and 3.0 < event["t"] < 9.0:
            event["place"], event["onboard_s"] = "local", CALL_S
    assert broken(tmp_path, log, strike("dark", "link", 3.0, 7.0)) == []
    assert any(
        "after the end of a black-out of 3 s" in each
        for each in broken(tmp_path, log, strike("dark", "link", 2.0, 5.0))
    )


def test_time_stands_still_for_a_drone_that_is_stopped(tmp_path: Path) -> None:
    log = Log()
    slow = of_kind(log, "call", 3)
    for event in log.events[log.events.index(slow) :]:
        event["t"] += 2.0
    slow["delay_s"] += 2.0
    stop = strike("freeze", "drone", slow["t"] - 2.1, slow["t"] - 0.1)
    assert broken(tmp_path, log, stop) == []
    assert broken(tmp_path, log) != []


def test_two_drones_in_one_slot_are_found(tmp_path: Path) -> None:
    one, other = Log(place="s2"), Log(began_s=10.25, place="s2")
    assert any("promise 11: s2 answered drone-2" in each for each in broken(tmp_path, one, other=other))


def test_a_drone_that_hears_an_answer_while_it_leaves_holds_no_slot(tmp_path: Path) -> None:
    def found() -> list[str]:
        return [each for each in broken(tmp_path, one, other=other) if each.startswith("promise 11")]

    one, other = Log(place="s2"), Log(began_s=20.0, place="s2")
    assert found()
    last = of_kind(one, "call", -1)
    left = {"t": last["t"] - 0.2, "event": "deselected", "server": "s2", "before": "READY", "after": "AVL-R"}
    one.events.insert(one.events.index(last), {**left, "why": "no server in range"})
    assert not found()


def test_a_daemon_that_ended_of_itself_and_a_second_instance_are_found(tmp_path: Path) -> None:
    found = broken(tmp_path, Log(), daemons_ended=["s1"], most_instances={"s1": 2})
    assert found == ["promise 11: the daemon of s1 ended", "promise 11: s1 ran 2 instances of one service"]
