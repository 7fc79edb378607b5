"""Whole flights of the drone program, on virtual time."""

from __future__ import annotations

import asyncio
import itertools
from pathlib import Path
from typing import Any

import pytest
from tests.events import written

from upwash import Drone
from upwash.config.drone_file import read_drone_config
from upwash.core.selection.selection import Selection
from upwash.drone.server_session import ServerSession
from upwash.errors import MissionFailed
from upwash.lab.run import Run, simulate
from upwash.services import Detector

# One server whose range holds the waypoints at 40 and 60 m; legs of 20 m take 9 s.
SCENARIO = """
[mission]
program = "{program}"
mode = "heavy"
waypoints_m = [[0, 0], [20, 0], [40, 0], [60, 0], [80, 0], [100, 0]]
[[service]]
name = "detector"
local_call_s = {{ light = 3.0, heavy = 10.0 }}
[[server]]
name = "s1"
east_m = 50.0
north_m = 0.0
range_m = 20.0
check_s = {check_s}
check_running_s = 3.5
remote_call_s = {{ light = 0.3, heavy = 0.7 }}
[server.truth]
{truth}
"""

THESIS = '[policy]\nname = "location-aware"\n'


def fly(
    tmp_path: Path,
    program: str = "survey",
    *,
    truth: str = "",
    check_s: float = 11.5,
    more: str = "",
    scenario: str = SCENARIO,
) -> Run:
    file = tmp_path / "scenario.toml"
    file.write_text(scenario.format(program=program, truth=truth, check_s=check_s) + more)
    return simulate(read_drone_config(file))


def events(run: Run, name: str) -> list[dict[str, Any]]:
    return [event for event in written(run.events) if event["event"] == name]


def places(run: Run) -> list[str]:
    return [call.place for call in run.result.calls]


def test_calls_run_on_the_server_within_its_range_and_on_the_drone_elsewhere(tmp_path: Path) -> None:
    run = fly(tmp_path, truth="join_s = 1.0\nstart_s = 1.0")
    assert run.failure == ""
    assert places(run) == ["local", "local", "s1", "s1", "local", "local"]
    assert [round(call.delay_s, 3) for call in run.result.calls] == [10, 10, 0.7, 0.7, 10, 10]


def test_a_call_waits_for_a_check_that_is_nearly_over(tmp_path: Path) -> None:
    # The range begins 10 m before waypoint 2: 4.5 s of flight and 1 s of photo later the check has 6 s to go.
    run = fly(tmp_path)
    call = run.result.calls[2]
    assert call.place == "s1"
    assert call.waited_s == pytest.approx(6.0, abs=0.01)
    assert call.delay_s == pytest.approx(call.waited_s + 0.7)
    assert (run.result.totals.waits, run.result.totals.waits_failed) == (1, 0)


def test_a_wait_in_vain_is_bounded_and_ends_on_the_drone(tmp_path: Path) -> None:
    run = fly(tmp_path, truth="start_s = 25.0")
    call = run.result.calls[2]
    assert call.place == "local"
    assert call.waited_s == pytest.approx(10 * 0.75 - 0.7)
    assert call.delay_s == pytest.approx(call.waited_s + 10)
    assert run.result.totals.waits_failed == 1


def test_a_wait_that_cannot_pay_off_is_not_begun(tmp_path: Path) -> None:
    run = fly(tmp_path, check_s=40.0, truth="join_s = 1.0\nstart_s = 30.0")
    assert run.result.totals.waits == 0
    assert run.result.calls[2].place == "local"


@pytest.mark.parametrize(
    ("table", "took_s"),
    [("{{ heavy = 0.25 }}", 10.5), ("{{ light = 0.25 }}", 10.0), ("{{ heavy = 0 }}", 10.0)],
)
def test_calls_on_the_drone_are_slower_while_it_joins_where_the_scenario_says_so(
    tmp_path: Path, table: str, took_s: float
) -> None:
    # The call at waypoint 2 begins 5.5 s after the join, 2.5 s before its end: 2 s of its work are done by then.
    slowed = SCENARIO.replace("[[server]]", f"local_joining_slowdown = {table}\n[[server]]")
    run = fly(tmp_path, check_s=40.0, truth="join_s = 8.0\nstart_s = 30.0", more=THESIS, scenario=slowed)
    assert run.result.calls[2].place == "local"
    assert run.result.calls[2].delay_s == pytest.approx(took_s, abs=0.01)
    assert run.result.calls[1].delay_s == pytest.approx(10.0)


TWO = SCENARIO.replace(
    "[[server]]",
    """[[server]]
name = "s2"
east_m = 90.0
north_m = 0.0
range_m = 20.0
check_running_s = 3.5
remote_call_s = {{ light = 0.3, heavy = 0.7 }}
[[server]]""",
)


@pytest.mark.parametrize("leave_s", [0.0, 3.0])
def test_the_next_server_is_joined_once_the_one_before_is_left(tmp_path: Path, leave_s: float) -> None:
    truth = f"join_s = 1.0\nstart_s = 1.0\nleave_s = {leave_s}"
    run = fly(tmp_path, truth=truth, more=THESIS, scenario=TWO)
    assert run.failure == "" and run.result.completed
    selected, joined = (
        next(event["t"] for event in events(run, name) if event["server"] == "s2")
        for name in ("selected", "joined")
    )
    assert joined - selected == pytest.approx(leave_s + 3.5)


def test_remote_calls_that_fail_are_answered_on_the_drone_and_blacklist_the_server(tmp_path: Path) -> None:
    run = fly(
        tmp_path,
        truth="join_s = 1.0\nstart_s = 1.0",
        more=THESIS + '[[fault]]\ntarget = "link:s1"\nkind = "stuck"\nfrom_s = 50.0\n',
    )
    call = run.result.calls[2]
    assert call.place == "local"
    assert run.result.totals.fallbacks == 1
    assert call.delay_s == pytest.approx(4 * 0.7 + 10), "the deadline, and one local call"
    (blacklisted,) = events(run, "call_failed_in_range")
    assert blacklisted["after"] == "BLACKLISTED"
    assert run.result.completed


def test_offloading_goes_on_after_the_vehicle_was_silent_for_a_while(tmp_path: Path) -> None:
    # The drone enters the range at about 44 s, while nothing is heard of the vehicle, and arrives at 49 s.
    silent = '[[fault]]\ntarget = "autopilot"\nkind = "off"\nfrom_s = 41.5\nto_s = 47.0\n'
    run = fly(tmp_path, truth="join_s = 1.0\nstart_s = 1.0", more=silent)
    assert run.failure == "" and run.result.completed
    assert not events(run, "offloading_failed")
    assert len(events(run, "border_watch_failed")) == 1
    there, back = run.range_intervals
    assert there.from_s < 47.0 and there.to_s < back.from_s, "the borders were crossed all the same"
    assert places(run) == ["local", "local", "s1", "s1", "local", "local"]


LOADED = "join_s = 1.0\nstart_s = 1.0\nremote_call_s = { light = 0.3, heavy = 7.7 }"


def remote_estimates(run: Run) -> list[float]:
    return [event["remote_s"] for event in events(run, "decided") if event["remote_s"] is not None]


def test_a_call_cut_short_by_a_server_that_is_alive_makes_it_look_slower(tmp_path: Path) -> None:
    run = fly(tmp_path, truth=LOADED, more=THESIS)
    assert run.result.totals.fallbacks == 1
    (cut,) = events(run, "remote_failed")
    assert "no answer within 2.8 s" in cut["why"]
    longer = fly(tmp_path, truth=LOADED, more=THESIS + "blacklist_s = 1.0\n")
    assert remote_estimates(longer)[1] == pytest.approx((0.7 + 0.7 + 2.8) / 3)


def test_a_call_cut_short_by_a_dead_link_says_nothing_of_the_server(tmp_path: Path) -> None:
    run = fly(
        tmp_path,
        truth="join_s = 1.0\nstart_s = 1.0",
        more=THESIS
        + 'blacklist_s = 1.0\n[[fault]]\ntarget = "link:s1"\nkind = "stuck"\nfrom_s = 50\nto_s = 60\n',
    )
    assert run.result.totals.fallbacks == 1
    assert set(remote_estimates(run)) == {0.7}


def test_a_server_without_the_image_is_left_alone(tmp_path: Path) -> None:
    run = fly(tmp_path, truth="images = []")
    assert set(places(run)) == {"local"}
    assert "no image of detector" in events(run, "check_failed")[0]["why"]


def test_every_decision_is_logged_with_its_inputs(tmp_path: Path) -> None:
    run = fly(tmp_path)
    made = [event["decision"] for event in events(run, "decided")]
    assert made == ["local", "local", "wait", "remote", "remote", "local", "local"]
    decided = [event for event in events(run, "decided") if event["decision"] == "wait"]
    for name in ("local_s", "remote_s", "check_s", "check_elapsed_s", "state", "position", "at_most_s"):
        assert decided[0][name] is not None, name


def fail_in_the_air(drone: Drone) -> None:
    drone.autopilot.arm()
    drone.autopilot.takeoff(10)
    drone.autopilot.goto(drone.plan[3])
    raise ValueError("the mission has a bug")


class Wordless(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no words")


def fail_without_words(drone: Drone) -> None:
    drone.autopilot.arm()
    drone.autopilot.takeoff(10)
    raise Wordless


def fail_on_the_ground(drone: Drone) -> None:
    raise ValueError("the mission has a bug")


def forget_to_land(drone: Drone) -> None:
    drone.autopilot.arm()
    drone.autopilot.takeoff(10)


def look_at_a_broken_photo(drone: Drone) -> None:
    detector = drone.service(Detector)
    with pytest.raises(TypeError, match="process_photo"):
        detector.process_photo("no bytes", mode="heavy")  # type: ignore[arg-type]


def here(mission: Any) -> str:
    return f"{__file__}:{mission.__name__}"


def test_a_mission_that_raises_in_the_air_is_brought_home(tmp_path: Path) -> None:
    with pytest.raises(MissionFailed, match="raised ValueError: the mission has a bug"):
        fly(tmp_path, here(fail_in_the_air))


def test_a_mission_whose_exception_has_no_words_is_brought_home(tmp_path: Path) -> None:
    with pytest.raises(MissionFailed, match=r"the mission program raised Wordless$"):
        fly(tmp_path, here(fail_without_words))


def test_a_mission_that_raises_on_the_ground_moves_nothing(tmp_path: Path) -> None:
    with pytest.raises(MissionFailed, match="raised ValueError: the mission has a bug"):
        fly(tmp_path, here(fail_on_the_ground))


def test_a_mission_that_ends_in_the_air_is_landed(tmp_path: Path) -> None:
    run = fly(tmp_path, here(forget_to_land))
    names = [event["event"] for event in written(run.events)]
    assert names.index("safe_end") < names.index("landed")


def test_a_wrong_argument_is_the_missions_own_error(tmp_path: Path) -> None:
    assert fly(tmp_path, here(look_at_a_broken_photo)).failure == ""


@pytest.mark.parametrize(
    ("defective", "after"), [("decide", 0), ("decide", 3), ("handle", 0), ("handle", 5), ("handle", 9)]
)
def test_a_defect_in_deciding_ends_offloading_and_not_the_mission(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, defective: str, after: int
) -> None:
    sound, asked = getattr(Selection, defective), itertools.count()

    def fail_after_a_while(*about: Any, **known: Any) -> Any:
        if next(asked) >= after:
            raise ZeroDivisionError("a defect")
        return sound(*about, **known)

    monkeypatch.setattr(Selection, defective, fail_after_a_while)
    run = fly(tmp_path, truth="join_s = 1.0\nstart_s = 1.0")
    assert run.failure == "" and run.result.completed
    assert len(run.result.calls) == 6, "each is answered"
    (failure,) = events(run, "offloading_failed")
    assert failure["why"] == "ZeroDivisionError: a defect"
    later = [call for call in run.result.calls if call.at_s > failure["t"]]
    assert {call.place for call in later} <= {"local"}
    assert {call.decision for call in later} <= {"offloading has failed: ZeroDivisionError: a defect"}


@pytest.mark.parametrize("defective", ["keep_lease", "lost", "end"])
def test_a_defect_in_the_background_of_offloading_ends_offloading_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, defective: str
) -> None:
    failed_s: list[float] = []

    async def fail_soon(*_: Any, **__: Any) -> None:
        await asyncio.sleep(1.0)
        failed_s.append(asyncio.get_running_loop().time())
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(ServerSession, defective, fail_soon)
    run = fly(tmp_path, truth="join_s = 1.0\nstart_s = 1.0")
    assert run.failure == "" and run.result.completed
    (failure,) = events(run, "offloading_failed")
    assert failure["why"] == "ZeroDivisionError: a defect"
    assert failure["t"] == failed_s[0], "not only when something else is asked of the session"
