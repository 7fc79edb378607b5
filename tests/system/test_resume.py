"""`upwash fly` is killed and started again with --resume, while a stand-in vehicle flies on by itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.events import read
from tests.programs import COUNTER, COUNTING, running, stand_in, upwash, write_drone
from tests.system.daemons import config, daemon
from tests.waiting import wait_for

pytestmark = pytest.mark.system


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    plan = {
        "ground_speed_m_s": 15.0,
        "altitude_m": 3.0,
        "waypoints_m": [[0, 0], [20, 0], [40, 0], [40, 20]],
    }
    service = COUNTER | {"local_call_s": 0.5, "local_pace_s": 0.5}
    write_drone(tmp_path, COUNTING, mission=plan, camera={"photo_s": 0.2}, service=[service])
    return tmp_path


@pytest.fixture
def fly(folder: Path) -> Iterator[tuple[str, ...]]:
    """The command, past a stand-in; it stays armed on the ground for as long as a busy machine starts a program."""
    options = ("--acceleration", "50", "--param", "DISARM_DELAY=127")
    with stand_in(folder, *options) as vehicle:
        yield ("fly", "--config", "drone.toml", "--autopilot", vehicle)


def wait_for_events(log: Path, name: str, number: int) -> None:
    """Returns when the log has that many events of the name."""
    wait_for(lambda: len(read(log, name)) >= number, within_s=60.0, seen=lambda: f"no {name} in the log")


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("call", 2),
        *(
            pytest.param(*when, marks=pytest.mark.long)
            for when in [("armed", 1), ("took_off", 1), ("arrived", 2), ("leg", 4)]
        ),
    ],
)
def test_a_flight_that_is_killed_is_taken_up_where_it_broke_off(
    folder: Path, fly: tuple[str, ...], name: str, number: int
) -> None:
    log = folder / "events.jsonl"
    with running(*fly, "--log", log, folder=folder):
        wait_for_events(log, name, number)
    broken_off = read(log)
    assert log.read_bytes().endswith(b"\n")
    second = upwash(*fly, "--resume", log, folder=folder)
    assert second.returncode == 0, second.stderr
    both = read(log)
    assert both[: len(broken_off)] == broken_off
    assert both[len(broken_off)]["event"] == "log_resumed"
    assert [event["t"] for event in both] == sorted(event["t"] for event in both)
    here, answered = -1, []
    for event in both:
        here = event["waypoint"] if event["event"] == "arrived" else here
        answered += [here] if event["event"] == "call" else []
    assert answered == [0, 1, 2, 3]
    assert "4 of 4 waypoints reached" in second.stdout and "4 calls: 4 on the drone" in second.stdout
    assert both[-1]["event"] == "mission_completed"


ASKING = (
    COUNTING.replace("@service\n", '@service(where="servers")\n')
    .replace("drone.service(Counter)", "drone.service(Counter, unanswered=None)")
    .replace(
        "drone.user.notify(counter.count(drone.camera.take_photo()), at=waypoint)",
        "pending = drone.start(counter.count, drone.camera.take_photo())\n"
        "        drone.stay_or_go(pending, lambda count, at=waypoint: drone.user.notify(count, at=at))",
    )
)


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("", 0),
        pytest.param("call_started", 3, marks=pytest.mark.long),
        pytest.param("call", 1, marks=pytest.mark.long),
    ],
)
def test_photos_that_only_a_server_answers_are_all_answered_by_it(
    tmp_path: Path, name: str, number: int
) -> None:
    (tmp_path / "mission.py").write_text(ASKING)
    served = [{"name": "counter", "program": f"{tmp_path}/mission.py:Counter"}]
    with (
        daemon(tmp_path, config(None, service=served, server=[{"name": "s1"}]), names="s1") as edge,
        stand_in(tmp_path, "--acceleration", "50", "--param", "DISARM_DELAY=127") as vehicle,
    ):
        server = {"name": "s1", "east_m": 40.0, "north_m": 20.0, "range_m": 12.0, "address": edge.address}
        server |= {"remote_call_s": 0.2, "check_s": 3.0, "check_running_s": 0.5}
        plan = {"ground_speed_m_s": 15.0, "altitude_m": 3.0}
        plan["waypoints_m"] = [[0, 0], [20, 0], [40, 0], [40, 20], [20, 20]]  # type: ignore[assignment]
        write_drone(
            tmp_path,
            ASKING,
            mission=plan,
            camera={"photo_s": 0.2},
            service=[COUNTER],
            server=[server],
            network={"kind": "stand-in"},
        )
        fly = ("fly", "--config", "drone.toml", "--autopilot", vehicle)
        log = tmp_path / "events.jsonl"
        if name:
            with running(*fly, "--log", log, folder=tmp_path):
                wait_for_events(log, name, number)
        done = upwash(*fly, *(("--resume",) if name else ("--log",)), log, folder=tmp_path)
        assert done.returncode == 0, done.stderr
    answered = [(event["waypoint"], event["place"]) for event in read(log, "call")]
    assert {waypoint for waypoint, _ in answered} == {0, 1, 2, 3, 4}
    assert {place for _, place in answered} == {"s1"}
    assert not read(log, "local_ready")
    told = {event["waypoint"]: event["waited_s"] for event in read(log, "answer_taken")}
    assert told.keys() == {0, 1, 2, 3, 4}


def test_a_log_that_is_not_there_cannot_be_resumed(folder: Path) -> None:
    done = upwash("fly", "--config", "drone.toml", "--resume", "nothing.jsonl", folder=folder)
    assert done.returncode == 2
    assert "cannot read the event log nothing.jsonl: No such file" in done.stderr
