"""Own policies that place the calls in line, and decide where a resting drone waits, on virtual time."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.drone.test_backlog import RANGE_M, field
from tests.drone.test_lanes import backlog
from tests.drone.test_pending import of
from tests.scenarios import server

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.core.geo import Position, ground_distance_m
from upwash.drone import own_policy
from upwash.drone.site import Site
from upwash.eventlog import schema
from upwash.lab.run import Run, simulate

MINE = """
import math, time
from upwash.policies import LookAhead, Take

class Same(LookAhead): pass

class NewestFirst(LookAhead):
    def place_in_line(self, line):
        return Take(len(line.calls) - 1, "drone") if line.drone.is_free else None

class ServersOnly(LookAhead):
    def place_in_line(self, line):
        if line.server is not None and line.server.is_free and not math.isinf(line.calls[0].remote_s):
            return Take(0, "server")

class Patient(LookAhead):
    def place_in_line(self, line):
        if line.drone.is_free and line.calls[0].waited_s >= 8.0:
            return Take(0, "drone")

class Stays(LookAhead):
    def where_to_wait(self, stay): return None
class Farthest(LookAhead):
    def where_to_wait(self, stay): return max(stay.places, key=lambda place: place.extra_s).server

class Near(LookAhead):
    def where_to_wait(self, stay): return "s1"

class AtOnce(LookAhead):
    def when_to_act(self, act): return None
class AtTheEnd(LookAhead):
    def when_to_act(self, act): return len(act.gaps) - 1
class NoGap(LookAhead):
    def when_to_act(self, act): return len(act.gaps)

class Beyond(LookAhead):
    def place_in_line(self, line): return Take(len(line.calls), "drone")
class Before(LookAhead):
    def place_in_line(self, line): return Take(-1, "drone")
class Word(LookAhead):
    def place_in_line(self, line): return "drone"
class Held(LookAhead):
    def place_in_line(self, line): return Take(0, "drone")
class NotThere(LookAhead):
    def place_in_line(self, line): return Take(0, "server")
class TooSoon(LookAhead):
    def place_in_line(self, line): return Take(0, "server") if line.server and line.server.is_free else None
class Never(LookAhead):
    def place_in_line(self, line): return None
class Silent(LookAhead):
    def place_in_line(self, line): time.sleep(9.0)
class Nowhere(LookAhead):
    def where_to_wait(self, stay): return "s9"
class Lost(LookAhead):
    def where_to_wait(self, stay): return stay.places[7]
"""
CALLS = {"check_s": 11.5, "check_running_s": 3.5, "remote_call_s": {"light": 0.3, "heavy": 0.7}}
NEAR = server("s1", 37.5, 105.0, range_m=RANGE_M, **CALLS)
FAR = server("s2", 200.0, -20.0, range_m=RANGE_M, **CALLS)


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(MINE)
    return file


def own(file: Path, policy: str) -> dict[str, Any]:
    return {"policy": {"name": f"{file}:{policy}"}}


def flown(config: DroneConfig) -> Run:
    run = simulate(config)
    assert run.failure == "" and run.result.completed
    return run


def line(remote_s: float | None = 4.0, *, order: str = "oldest", **tables: Any) -> DroneConfig:
    return backlog(10.0, remote_s, order=order, spacing_m=6.0, **tables)


def test_a_policy_without_these_methods_flies_by_the_built_in_rules(mine: Path) -> None:
    for config, others in ((line(), line(**own(mine, "Same"))), (field(), field(**own(mine, "Same")))):
        assert flown(others).result.calls == flown(config).result.calls


def test_the_drone_takes_the_call_that_the_policy_says(mine: Path) -> None:
    as_told, newest = flown(line(None, **own(mine, "NewestFirst"))), flown(line(None, order="newest"))
    assert [call.waypoint for call in as_told.result.calls] == [call.waypoint for call in newest.result.calls]
    assert as_told.result.mission_time_s == newest.result.mission_time_s
    assert as_told.result.calls != flown(line(None)).result.calls


def test_a_call_waits_for_the_lane_that_the_policy_wants(mine: Path) -> None:
    run = flown(line(**own(mine, "ServersOnly")))
    assert run.result.offloading_failed == "" and {call.server for call in run.result.calls} == {"s1"}
    assert any(call.server is None for call in flown(line()).result.calls)


def test_a_call_may_be_kept_in_line_though_a_lane_is_free(mine: Path) -> None:
    """Nothing happens when its time has come, so it goes at the next event: the next photo, or the end of a call."""
    run = flown(line(None, **own(mine, "Patient")))
    assert run.result.offloading_failed == ""
    begun = {event.waypoint: event.t for event in of(list(run.events), schema.Decided)}
    made = {event.waypoint: event.t for event in of(list(run.events), schema.CallStarted)}
    assert min(begun[waypoint] - made[waypoint] for waypoint in begun) >= 8.0


def test_a_resting_drone_waits_where_the_policy_says(mine: Path) -> None:
    built_in, stays = flown(field()), flown(field(**own(mine, "Stays")))
    assert len(of(list(built_in.events), schema.SoughtAnswers)) == 1
    assert of(list(stays.events), schema.SoughtAnswers) == []
    two = {"server": [NEAR, FAR]}
    for tables, place in (
        (two, Position(37.5, 105.0)),
        (two | own(mine, "Farthest"), Position(200.0, -20.0)),
    ):
        sought, *_ = of(list(flown(field(**tables)).events), schema.SoughtAnswers)
        assert ground_distance_m(sought.position, place) <= RANGE_M


def test_a_place_that_a_fence_forbids_is_not_among_the_places(
    mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def allows(_: Site, limits: object, start: Position, target: Position) -> bool:
        return not 30.0 < target.north_m < 60.0  # where the drone would wait

    config = field(server=[NEAR, FAR], **own(mine, "Near"))
    sought, *_ = of(list(flown(config).events), schema.SoughtAnswers)
    assert sought.position.north_m > 30.0
    monkeypatch.setattr(Site, "allows_leg", allows)
    run = flown(config)
    assert of(list(run.events), schema.SoughtAnswers) == []
    assert "named 's1', which is not among the places [None, 's2']" in run.result.offloading_failed


def acting(**tables: Any) -> DroneConfig:
    """Three rows of 100 m; a call of 3 s, and the answer to each fifth photo has a demand."""
    ends = [[0.0, 0.0], [100.0, 0.0], [100.0, 15.0], [0.0, 15.0], [0.0, 30.0], [100.0, 30.0]]
    mission = {"waypoints_m": ends, "photos": {"every_m": 20.0}, "ground_speed_m_s": 5.0, "action_s": 2.0}
    service = {"name": "detector", "local_call_s": {"light": 1.0, "heavy": 3.0}}
    document = {"mission": mission, "service": [service], "event": {"every": 5, "offset": 2}, **tables}
    return drone_config(document, Path("scenario.toml"))


def test_an_act_is_done_when_the_policy_says(mine: Path) -> None:
    at_once, as_told = flown(acting(policy={"act_within_s": 0.0})), flown(acting(**own(mine, "AtOnce")))
    assert [each.t for each in of(list(as_told.events), schema.Acted)] == [
        each.t for each in of(list(at_once.events), schema.Acted)
    ]
    late = list(flown(acting(**own(mine, "AtTheEnd"))).events)
    last_s = of(late, schema.PhotoTaken)[-1].t
    assert len(acted := of(late, schema.Acted)) == 4 and all(each.t > last_s for each in acted)
    assert flown(acting()).result.mission_time_s < at_once.result.mission_time_s


@pytest.mark.parametrize(
    ("policy", "why"),
    [
        (
            "Beyond",
            "place_in_line returned Take(call=1, lane='drone'), and None or the Take of one of 1 call",
        ),
        ("Before", "place_in_line returned Take(call=-1"),
        ("Word", "place_in_line returned 'drone'"),
        ("Held", "place_in_line took call 0, and the drone's lane is not free"),
        ("NotThere", "place_in_line took call 0, and the server's lane is not free"),
        ("TooSoon", "place_in_line took call 0, and the server cannot compute it now"),
        ("Never", "place_in_line used no lane for 60 s"),
        ("Silent", "place_in_line did not answer within 0.5 s"),
        ("Nowhere", "where_to_wait named 's9', which is not among the places [None, 's1']"),
        ("Lost", "where_to_wait raised IndexError"),
        ("NoGap", "when_to_act returned"),
    ],
)
def test_a_defect_ends_offloading_and_not_the_mission(
    mine: Path, policy: str, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if policy == "Silent":
        monkeypatch.setattr(own_policy, "ANSWERS_WITHIN_S", 0.5)
        # The answers before take no time, so that all of it is left also on a busy machine.
        monkeypatch.setattr(own_policy, "time", SimpleNamespace(monotonic=lambda: 0.0))
    told, leaves_ranges = own(mine, policy), policy in ("TooSoon", "Nowhere", "Lost")
    config = field(**told) if leaves_ranges else line(None if policy == "NotThere" else 4.0, **told)
    if policy == "NoGap":
        config = acting(**told)
    run = flown(config)
    (failed,) = of(list(run.events), schema.OffloadingFailed)
    assert f"policy mine.py:{policy}: {why}" in failed.why
    later = [call for call in run.result.calls if call.at_s + call.delay_s > failed.t + 10.0]
    assert later and all(call.server is None for call in later)
    assert len(run.result.calls) == len(of(list(run.events), schema.PhotoTaken))
