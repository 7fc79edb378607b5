"""The demonstration, flown for real: real processes, real calls, real images, and real kills."""

from __future__ import annotations

import math
import os
import re
import signal
import subprocess
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from tests.children import Process, descendants, is_alive, processes
from tests.events import read
from tests.programs import UPWASH
from tests.system.browser import Browser
from tests.system.browser import why_not as why_no_browser
from tests.system.faults.lateness import noting_lateness, noting_waits, read_lateness
from tests.system.thresholds import waits_at_their_threshold
from tests.waiting import wait_for

from upwash.cli.demonstration import read_demonstration, score_photos
from upwash.eventlog.log import EventLog
from upwash.eventlog.results import RunResult, read_result
from upwash.lab.run import simulate
from upwash.report.record import read_records, reviewed_of
from upwash.services.solar_park.geometry import Area, Breakage, HotSpot, Park
from upwash.support.text import clock

pytestmark = [pytest.mark.system, pytest.mark.flight, pytest.mark.long, pytest.mark.timeout(240)]

WAYPOINTS = 12
MARK = "UPWASH_TEST_MARK"


@dataclass
class Demonstration:
    """`upwash demo` as a process, and everything that descends from it."""

    folder: Path
    mark: str
    process: subprocess.Popen[bytes]
    seen: set[int] = field(default_factory=set)  # instances

    def events(self, log: str = "events.jsonl") -> list[dict[str, Any]]:
        return read(self.folder / log)

    def wait_for(
        self, wanted: Callable[[dict[str, Any]], bool], *, since: int = 0, log: str = "events.jsonl"
    ) -> None:
        """Waits for such an event, after the first `since` of them."""
        wait_for(lambda: any(map(wanted, self.events(log)[since:])), within_s=240.0, process=self.process)

    def processes(self) -> list[Process]:
        """What runs of the demonstration, known by a mark in its environment, but for what is in a sandbox."""
        return list(processes(mark=f"{MARK}={self.mark}"))

    def daemons(self) -> list[Process]:
        return [process for process in self.processes() if " serve " in process.command]

    def instances(self, *of: int) -> list[Process]:
        """Their children that are instances; one in a sandbox has nothing of the environment."""
        found = [each for each in processes() if each.is_instance and each.parent in of]
        self.seen.update(process.pid for process in found)
        return found

    def finish(self) -> RunResult:
        """Waits for the end; checks that the mission was whole and that nothing is left."""
        self.end(0)
        return self.flown()

    def end(self, code: int) -> str:
        """Waits for the end with that exit code; checks that nothing is left, and returns what was printed."""
        output = self.process.communicate()[0].decode()
        assert self.process.returncode == code, output
        assert "Traceback" not in output
        assert self.processes() == []
        assert not any(map(is_alive, self.seen))
        return output

    def flown(self, log: str = "events.jsonl") -> RunResult:
        """What the flight of that log came to; checks that the mission was whole."""
        result = read_result(EventLog(self.folder / log))
        assert result.completed
        assert [call.waypoint for call in result.calls] == list(range(WAYPOINTS)), (
            "one result for every photo"
        )
        assert result.undone == []
        score = score_photos([self.folder / log])
        assert score.photos == WAYPOINTS
        assert score.found >= 0.9 * score.true, "each photo's own faults were found"
        return result


@pytest.fixture
def demonstration(tmp_path: Path) -> Iterator[Demonstration]:
    with started(tmp_path) as running:
        yield running


@contextmanager
def started(folder: Path, *options: str) -> Iterator[Demonstration]:
    mark = uuid.uuid4().hex
    process = subprocess.Popen(
        [*UPWASH, "demo", "--folder", str(folder / "run"), *options], env={**os.environ, MARK: mark},
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
    )  # fmt: skip
    running = Demonstration(folder / "run", mark, process)
    with process:
        try:
            yield running
        finally:
            for each in running.processes():
                os.kill(each.pid, signal.SIGKILL)


@pytest.mark.root
@pytest.mark.xdist_group("browser")
@pytest.mark.skipif(bool(why_no_browser()), reason=why_no_browser())
@pytest.mark.timeout(300)
def test_calls_run_on_the_drone_and_on_both_servers_and_a_page_shows_them(
    page: Browser, tmp_path: Path
) -> None:
    lateness, waits = tmp_path / "lateness", tmp_path / "waits"
    with started(tmp_path, "--live", "0") as demonstration:
        process = demonstration.process
        with noting_lateness(lateness), noting_waits(waits, lambda: descendants(process.pid)):
            assert process.stdout is not None
            lines = map(bytes.decode, iter(process.stdout.readline, b""))
            address = next(line.split()[-1] for line in lines if line.startswith("live view: "))
            check_is_shown(page, address)
            result = demonstration.finish()
    check_was_shown(page, address, result)
    totals = result.totals
    assert totals.local >= 1
    assert set(totals.remote) == {"s1", "s2"}
    assert totals.fallbacks == 0
    local_only_s = result.local_only_time_s()
    assert local_only_s is not None and result.mission_time_s < local_only_s
    late_s = sum(to_s - from_s for file in (lateness, waits) for from_s, to_s in read_lateness(file))
    check_against_simulation(result, late_s)
    check_places(demonstration.folder / "events.jsonl")


def check_is_shown(page: Browser, address: str) -> None:
    """The page shows the flight until its end."""
    page.open(address)
    page.wait_until(lambda: page.text("#mode") == "live")
    first = page.wait_until(lambda: page.text(".where"))
    page.wait_until(lambda: page.text(".where") != first)
    page.wait_until(lambda: any(not row[1].startswith("not joined") for row in page.rows(".servers")))
    page.wait_until(lambda: page.run("return document.querySelector('.photo img').naturalWidth") == 1440)
    page.wait_until(lambda: page.all(".boxes .found"), within_s=100)
    assert page.all(".boxes .truth")
    assert page.violations() == []
    page.wait_until(lambda: shown_calls(page) > 1)  # the only call has none before it
    page.click("#previous")  # what was may be looked at while it goes on
    page.wait_until(
        lambda: page.find("#latest").get_attribute("aria-pressed") == "false"
    )  # at the next frame
    page.click("#latest")
    page.wait_until(lambda: "mission completed" in page.text(".doing"), within_s=200)


def check_was_shown(page: Browser, address: str, result: RunResult) -> None:
    """The page that is left open has what came of the flight."""
    page.wait_until(lambda: "has ended" in page.text("#connection"))
    page.open_tab("why")
    page.wait_until(lambda: page.rows(".calls-table"))
    assert [row[4] for row in page.rows(".calls-table")] == [f"{call.delay_s:.2f} s" for call in result.calls]
    assert f"the mission took {clock(result.mission_time_s)}" in page.text(".summary")
    assert page.errors() == []
    assert page.elsewhere(address) == []


def shown_calls(page: Browser) -> int:
    """How many calls the lanes show."""
    label = page.find(".lanes canvas").get_attribute("aria-label") or ""
    counted = re.search(r"(\d+) calls", label)
    return int(counted[1]) if counted else 0


def check_places(log: Path) -> None:
    """Each sure finding lies within 1 m of a fault of its kind in the park, and within its stated error."""
    tables = Park(2).tables(Area(west_m=-50.0, north_m=70.0, width_m=220.0, height_m=140.0))
    faults = [
        (type(module.fault), middle(module.fault.outline(module.area)))
        for table in tables
        for module in table.modules
        if module.fault is not None
    ]
    found = [
        each.finding for each in reviewed_of(read_records([log])).objects if (each.finding.score or 0) > 0.9
    ]
    assert len(found) >= 10
    for finding in found:
        own = finding.own
        assert own is not None
        kind = {"hot-spot": HotSpot, "broken-module": Breakage}[finding.what]
        place = own.position.east_m, own.position.north_m
        away_m = min(math.dist(place, at) for its_kind, at in faults if its_kind is kind)
        assert away_m < min(1.0, own.error_m), finding


def middle(outline: Sequence[tuple[float, float]]) -> tuple[float, float]:
    east, north = zip(*outline, strict=True)
    return (min(east) + max(east)) / 2, (min(north) + max(north)) / 2


def check_against_simulation(flown: RunResult, late_s: float) -> None:
    """The same configuration on virtual time gives the same places, but for waits within 10 % of their threshold.

    It gives the same time within 10 %, and for as long as the machine was late.

    Two cases of a busy machine are left out. A wait in vain: the machine started a service later than configured.
    What comes after a server's answer that took twice as long as configured: the drone has other estimates then.
    """
    run = simulate(read_demonstration())
    simulated = {call.waypoint: call for call in run.result.calls}
    for call in flown.calls:
        expected = simulated[call.waypoint]
        waited_in_vain = call.waited_s > 0 and call.place == "local"
        if not waited_in_vain and call.waypoint not in waits_at_their_threshold(run, within=0.1):
            assert call.place == expected.place, f"at waypoint {call.waypoint}"
        if call.place != "local" and call.delay_s - call.waited_s > 2 * (
            expected.delay_s - expected.waited_s
        ):
            break
    expected_s = run.result.mission_time_s
    assert 0.9 * expected_s < flown.mission_time_s < 1.1 * expected_s + late_s


def test_of_two_drones_one_whose_program_is_killed_does_not_end_the_other_which_goes_on_and_tells_all(
    tmp_path: Path,
) -> None:
    with started(
        tmp_path, "--drones", "2", "--policy", "look-ahead", "--stay-or-go", "learn"
    ) as demonstration:
        demonstration.wait_for(lambda event: event["event"] == "arrived", log="drone-2.jsonl")
        (killed,) = (
            process
            for process in demonstration.processes()
            if process.parent == demonstration.process.pid and "drone-2.toml" in process.command
        )
        os.kill(killed.pid, signal.SIGKILL)
        output = demonstration.end(1)
    whole, cut = (demonstration.events(f"drone-{number}.jsonl") for number in (1, 2))
    assert "landed" not in [event["event"] for event in cut]
    assert len({*plan_of(whole), *plan_of(cut)}) == 2 * WAYPOINTS, "each on its own lane"
    assert "1 of 2 flights completed; mission time: mean" in output
    assert any(
        line.startswith("drone-1  ") and line.endswith("  landed at home") for line in output.splitlines()
    )
    assert (tmp_path / "run" / "keys" / "drone-2.key").exists(), "each has its own"
    assert set(demonstration.flown("drone-1.jsonl").totals.remote) == {"s1", "s2"}
    check_is_prepared(whole)
    check_goes_on(whole)


def check_goes_on(events: list[dict[str, Any]]) -> None:
    """It went on before answers were there, and came back for those that demanded something."""
    decided = [event for event in events if event["event"] == "stay_or_go"]
    assert [event["waypoint"] for event in decided] == list(range(WAYPOINTS))
    assert decided[0]["goes"], "3 s on the drone, and nothing known of what answers demand"
    assert not decided[-1]["goes"], "the last waypoint waits"
    demanding = [
        event["waypoint"] for event in events if event["event"] == "answer_taken" and event.get("demanded")
    ]
    assert demanding
    assert [event["waypoint"] for event in events if event["event"] == "acted"] == demanding
    went = {event["waypoint"] for event in decided if event["goes"]}
    turned_back = {event["waypoint"] for event in events if event["event"] == "turned_back"}
    assert turned_back == went & set(demanding)


def check_is_prepared(events: list[dict[str, Any]]) -> None:
    """The second server was warm on arrival."""
    steps = [event for event in events if event.get("server") == "s2" and "before" in event]
    first = [(event["event"], event["after"]) for event in steps[:3]]
    assert first == [("prepared", "AVL-R"), ("selected", "CHECK-R"), ("found_running", "READY")]
    assert steps[0]["why"] == "by s1"
    assert "started" not in {event["event"] for event in steps}


def test_the_mission_survives_the_kill_of_instances_and_then_of_both_daemons(
    demonstration: Demonstration,
) -> None:
    demonstration.wait_for(lambda event: event["event"] == "arrived" and event["waypoint"] == 2)
    servers_instances = demonstration.instances(*(daemon.pid for daemon in demonstration.daemons()))
    assert servers_instances, "s1 runs its detector by now"
    for instance in servers_instances:
        os.kill(instance.pid, signal.SIGKILL)
    demonstration.wait_for(lambda event: event["event"] == "leg" and event["waypoint"] == 5)
    (onboard,) = demonstration.instances(demonstration.process.pid)
    os.kill(onboard.pid, signal.SIGKILL)
    demonstration.wait_for(lambda event: event["event"] == "arrived" and event["waypoint"] == 8)
    before = demonstration.events()
    daemons = demonstration.daemons()
    assert len(daemons) == 2
    for daemon in daemons:
        os.kill(daemon.pid, signal.SIGKILL)
    result = demonstration.finish()
    failures = [event["why"] for event in before if event["event"] == "remote_failed"]
    cut = [why for why in failures if "no answer within" not in why]  # a busy machine answers late
    assert len(cut) == 1, "the call to the killed instance"
    kinds = [event["event"] for event in demonstration.events()]
    assert "local_ended" in kinds
    assert kinds.count("local_ready") == 2
    after = [call for call in result.calls if call.waypoint is not None and call.waypoint >= 9]
    assert {call.place for call in after} == {"local"}
    assert any(call.place != "local" for call in result.calls[:8])


def test_ctrl_c_lands_the_drone_and_leaves_nothing_behind(demonstration: Demonstration) -> None:
    demonstration.wait_for(lambda event: event["event"] == "took_off")
    demonstration.process.send_signal(signal.SIGINT)
    demonstration.end(130)
    assert_landed(demonstration.events())


def assert_landed(events: list[dict[str, Any]]) -> None:
    """The mission was stopped, and the drone came down."""
    # Of a vehicle that says why it disarmed, the words may come before or after the report that it did.
    kinds = [event["event"] for event in events if event["event"] != "vehicle_said"]
    assert kinds[-1] == "mission_ended"
    assert kinds.index("stopping") < kinds.index("safe_end") < kinds.index("landed")


def plan_of(events: list[dict[str, Any]]) -> list[tuple[float, float]]:
    (planned,) = (event for event in events if event["event"] == "planned")
    return [(east_m, north_m) for east_m, north_m in planned["waypoints_m"]]
