"""The loop of virtual time: it jumps, refuses the outside world, and never hangs."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import threading
import time
import warnings
from pathlib import Path

import pytest
from tests.scenarios import scenario

from upwash.config.drone import DroneConfig
from upwash.lab.run import simulate, simulate_drones
from upwash.sim import turns
from upwash.sim.loop import DeadlockError, LivelockError, OutsideWorldError, VirtualLoop, run_virtually
from upwash.sim.turns import sleeps_reported


def flying(tmp_path: Path, body: str) -> DroneConfig:
    """A scenario whose mission takes off and then does this."""
    program = tmp_path / "mine.py"
    program.write_text(
        "import time\nfrom time import sleep\n\ndef mission(drone):\n    drone.autopilot.arm()\n"
        f"    drone.autopilot.takeoff(20.0)\n    {body}\n"
    )
    return scenario(mission={"program": f"{program}:mission"})


def test_it_jumps_to_the_next_timer() -> None:
    async def nap() -> float:
        await asyncio.sleep(3 * 24 * 3600.0)
        return asyncio.get_running_loop().time()

    assert run_virtually(nap()) == 3 * 24 * 3600.0  # no test may take as long


def test_timers_come_in_the_order_of_their_time_and_then_of_their_making() -> None:
    async def race() -> list[str]:
        seen: list[str] = []

        async def note(name: str, after_s: float) -> None:
            await asyncio.sleep(after_s)
            seen.append(name)

        async with asyncio.TaskGroup() as tasks:
            for name, after_s in [("c", 2.0), ("a", 1.0), ("d", 2.0), ("b", 1.5)]:
                tasks.create_task(note(name, after_s))
        return seen

    assert run_virtually(race()) == ["a", "b", "c", "d"]


def test_waiting_for_nothing_is_a_deadlock_that_names_who_waits() -> None:
    async def wait() -> None:
        await asyncio.Event().wait()

    with pytest.raises(DeadlockError, match=r"nothing is scheduled: .*wait"):
        run_virtually(wait())


def test_going_on_for_ever_without_time_is_a_livelock() -> None:
    async def spin() -> None:
        await asyncio.sleep(1.5)
        while True:  # noqa: ASYNC110 - this is the fault
            await asyncio.sleep(0)

    with pytest.raises(LivelockError, match=r"after \d+ turns it is still 1\.500 s: .*spin"):
        run_virtually(spin())


def test_the_outside_world_is_refused() -> None:
    async def connect() -> None:
        await asyncio.open_connection("127.0.0.1", 1)

    async def think() -> None:
        await asyncio.to_thread(sum, [1, 2])

    async def run() -> None:
        await asyncio.create_subprocess_exec("true")

    for attempt in (connect, think, run):
        with pytest.raises(OutsideWorldError):
            run_virtually(attempt())


# --- missions that cannot end -------------------------------------------------------------------------------


def test_a_mission_that_loops_over_hold_ends_with_an_error(tmp_path: Path) -> None:
    run = simulate(flying(tmp_path, "while True: drone.autopilot.hold()"))
    assert "a mission that loops over verbs which take no time" in run.failure


def test_a_mission_that_loops_over_photos_ends_after_two_days(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("upwash.lab.run._LONGEST_S", 3600.0)
    monkeypatch.setattr("upwash.lab.run._LONGEST_STOP_S", 0.0)
    run = simulate(flying(tmp_path, "while True: drone.camera.take_photo()"))
    assert "the mission did not end within 1 h of virtual time" in run.failure
    assert run.events[-1].kind == "mission_ended"


def test_a_mission_that_keeps_its_turn_ends_with_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    let_go = threading.Event()
    monkeypatch.setattr(turns, "_LONGEST_TURN_S", 0.1)
    monkeypatch.setattr(threading, "let_go", let_go, raising=False)
    before = set(threading.enumerate())
    run = simulate(flying(tmp_path, "import threading; threading.let_go.wait(); drone.autopilot.hold()"))
    (left,) = [each for each in set(threading.enumerate()) - before if each.name == "mission"]
    let_go.set()
    left.join(5.0)
    assert not left.is_alive(), "what it does after that is refused, and ends it"
    assert "the mission's own code has run for 0 s without calling a verb, and at 10.000 s" in run.failure


@pytest.mark.parametrize("goes_on_s", [0.0, 3600.0])
def test_ctrl_c_ends_a_simulation_though_what_runs_swallows_cancellations(goes_on_s: float) -> None:
    ended = []

    async def stubborn() -> None:
        signal.raise_signal(signal.SIGINT)
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(goes_on_s)
        ended.append(asyncio.get_running_loop().time())

    with pytest.raises(KeyboardInterrupt):
        run_virtually(stubborn())
    assert ended == [0.0]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# --- missions that sleep ------------------------------------------------------------------------------------


@pytest.mark.parametrize("call", ["time.sleep(700)", "sleep(700)"])  # longer than a test may take
def test_a_mission_that_sleeps_is_warned_by_name(tmp_path: Path, call: str) -> None:
    genuine = time.sleep
    with pytest.warns(
        RuntimeWarning, match=r"time\.sleep\(700\) in mission\(\), line 7 of .*mine\.py, is skipped"
    ) as caught:
        run = simulate(flying(tmp_path, f"{call}; drone.autopilot.return_home_and_land()"))
    assert (caught[0].filename, caught[0].lineno) == (str(tmp_path / "mine.py"), 7)
    assert run.failure == ""
    assert run.result.mission_time_s == 26.0
    assert time.sleep is genuine


def test_a_closed_loop_leaves_no_thread_of_a_mission_that_is_over() -> None:
    loop = VirtualLoop()
    turn, over = loop.mission_turn(), []

    def mission() -> None:
        turn.begin()
        turn.end()
        over.append(sum(range(10_000_000)))  # what a busy computer takes to end a thread

    threading.Thread(target=mission).start()
    loop.call_soon(turn.give)
    loop.call_soon(loop.call_soon, loop.stop)
    loop.run_forever()
    loop.close()
    assert over


def test_other_threads_and_other_times_sleep_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    slept_s: list[float] = []

    def nap() -> None:
        began_s = time.monotonic()
        time.sleep(0.05)
        slept_s.append(time.monotonic() - began_s)

    async def beside() -> None:
        thread = threading.Thread(target=nap)
        thread.start()
        thread.join()

    with warnings.catch_warnings(), sleeps_reported():
        warnings.simplefilter("error")
        run_virtually(beside())
        kept = time.sleep
    monkeypatch.setattr(time, "sleep", kept)  # as a mission that imported the name has it
    later = threading.Thread(target=nap, name="mission")
    later.start()
    later.join()
    assert len(slept_s) == 2 and all(each_s >= 0.05 for each_s in slept_s)


def test_a_mission_flies_in_asyncios_debug_mode_too(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = simulate(scenario()).log()
    monkeypatch.setenv("PYTHONASYNCIODEBUG", "1")
    assert simulate(scenario()).log() == plain


def test_missions_of_several_drones_take_turns_in_one_order(tmp_path: Path) -> None:
    program, seen = tmp_path / "two.py", tmp_path / "seen"
    program.write_text(
        "def mission(drone):\n    for _ in range(3):\n"
        f"        with open({str(seen)!r}, 'a') as log:\n"
        "            print(drone.plan[0].position.east_m, file=log)\n"
        "        drone.camera.take_photo()\n"
    )
    config = scenario(
        mission={"program": f"{program}:mission"},
        drone=[{"name": f"d{east}", "waypoints_m": [[east, 0]]} for east in (0, 60, 120)],
    )
    assert [run.failure for run in simulate_drones(config).values()] == ["", "", ""]
    assert seen.read_text().split() == ["0.0", "60.0", "120.0"] * 3
