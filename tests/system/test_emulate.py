"""Emulations for real: radios, flights, kills; as root, in namespaces and in containers of their own."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from tests.children import descendants, processes
from tests.events import read
from tests.programs import UPWASH, ended, stand_in, upwash
from tests.system.faults.lateness import noting_lateness, noting_waits, read_lateness
from tests.system.ns3 import require_ns3
from tests.system.thresholds import waits_at_their_threshold
from tests.waiting import wait_for

from upwash import read_log, read_result
from upwash.config.drone_file import read_drone_config
from upwash.emulation.containers import require_containers
from upwash.emulation.enclosure import clean, run_enclosed
from upwash.emulation.request import emulated
from upwash.errors import UsageError
from upwash.eventlog.results import CallResult
from upwash.lab.run import simulate

pytestmark = [
    pytest.mark.root,
    pytest.mark.system,
    pytest.mark.timeout(280),
    pytest.mark.skipif(os.geteuid() != 0, reason="makes network namespaces: needs root"),
    pytest.mark.skipif(not shutil.which("ip"), reason="needs iproute2"),
]

DIES_WITHIN_S = 10.0
PEERS = 'start_s = 3.0\npeers = ["{}"]'
ROOT = Path(__file__).parents[2]
EMULATED = Path(__file__).parent / "emulated"
DEMONSTRATION = ROOT / "scenarios" / "demonstration.toml"


@pytest.fixture(
    params=["table", pytest.param("ns3", marks=(pytest.mark.xdist_group("ns3"), pytest.mark.nightly))]
)
def radio(request: pytest.FixtureRequest) -> str:
    """Each kind of radio; ns-3's programs are built first, and run one at a time, as they hold each other up."""
    if request.param == "ns3":
        require_ns3()
    return str(request.param)


@pytest.fixture(params=["namespaces", "containers"])
def computers(request: pytest.FixtureRequest) -> str:
    """Each kind of computers."""
    if request.param == "containers":
        require_engine()
    return str(request.param)


def require_engine() -> None:
    try:
        require_containers()
    except UsageError as why:
        pytest.skip(str(why))


class Emulation:
    """`upwash emulate` as a process, and everything that it started."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder = folder
        self.process = subprocess.Popen(
            [*UPWASH, "emulate", "--folder", str(folder), *arguments], stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True, text=True,
        )  # fmt: skip

    def processes(self) -> dict[int, str]:
        """Commands by process, of all that belong to it but the command itself."""
        mark = f"UPWASH_EMULATION={self.process.pid}:"
        return {process.pid: process.command for process in processes(mark=mark)}

    def in_calls(self) -> set[int]:
        """The processes that a call may wait for: the drone, the servers, their instances, the radio."""
        return descendants(self.process.pid)

    def groups(self) -> list[Path]:
        """The control groups of its containers."""
        return [
            group
            for depth in ("*", "*/*")  # by the version of control groups
            for group in Path("/sys/fs/cgroup").glob(f"{depth}/lxc.*")
            if group.parent.name.startswith(f"upwash-emulation-{self.process.pid}:")
        ]

    def events(self, drone: str = "drone") -> list[dict[str, Any]]:
        return read(self.folder / f"{drone}.jsonl")

    def wait_for(self, kind: str, drone: str = "drone") -> None:
        """Waits until its log has such an event."""
        self.wait_until(lambda: bool(read(self.folder / f"{drone}.jsonl", kind)))

    def wait_until(self, is_so: Callable[[], bool]) -> None:
        wait_for(is_so, within_s=240.0, process=self.process, seen=self.printed)

    def printed(self) -> str:
        """What it printed, once it has ended."""
        return "" if self.process.poll() is None else self.process.communicate()[0]

    def finish(self) -> str:
        """Waits for its end and returns what it printed; nothing of it may be left."""
        output = self.process.communicate()[0]
        assert self.processes() == {} and self.groups() == []
        assert "Traceback" not in output
        return output

    def finish_in_time(self) -> None:
        """Waits for its end; skips the test where this machine was too busy to keep up."""
        output = self.finish()
        outcome = json.loads((self.folder / "emulation.json").read_text())
        assert outcome["exit_codes"] and not any(outcome["exit_codes"].values()), output
        if not outcome["valid"]:
            assert "NOT VALID" in output and self.process.returncode == 1
            pytest.skip(f"this machine was too busy to keep up: {outcome}")
        assert self.process.returncode == 0, output


@pytest.fixture
def emulate(tmp_path: Path) -> Iterator[Callable[..., Emulation]]:
    """Starts an emulation, which is gone after the test."""
    started: list[Emulation] = []

    def start(*arguments: str) -> Emulation:
        started.append(Emulation(tmp_path / "run", *arguments))
        return started[-1]

    yield start
    for each in started:
        with each.process:
            each.process.kill()
    clean()


def seen_outside() -> list[str]:
    """What of an emulation's namespaces, devices and addresses is the machine's own; other tests may have others."""
    commands = (["ip", "netns"], ["ip", "-brief", "address"], ["ip", "rule"], ["ip", "route"])
    ours = ("drone-", "server-", "to0@", "air")
    lines = [line for command in commands for line in ended(command).stdout.splitlines()]
    return [line for line in lines if line.startswith(ours) or "10.83." in line]


def test_links_are_as_fast_as_the_settings_say_and_end_at_their_range(radio: str, tmp_path: Path) -> None:
    assert run_enclosed(str(EMULATED / "links.py"), radio, str(tmp_path / "seen.json")) == 0
    seen = json.loads((tmp_path / "seen.json").read_text())
    assert seen["50"]["answers"] and 8 < seen["50"]["goodput_mbit_s"] < 13, seen
    assert not seen["110"]["answers"], seen
    assert seen["99"]["answers"], "the link is there again"


@pytest.mark.flight
def test_the_demonstration_goes_as_it_is_simulated(radio: str, emulate: Callable[..., Emulation]) -> None:
    expect_as_simulated(emulate(str(DEMONSTRATION), "--radio", radio))


@pytest.mark.flight
@pytest.mark.nightly
def test_it_goes_so_in_containers_too_with_services_in_containers_of_the_servers_own(
    emulate: Callable[..., Emulation],
) -> None:
    require_engine()
    emulation = emulate(str(DEMONSTRATION), "--in", "containers")
    expect_as_simulated(emulation)
    check_services_are_contained(emulation, "s1", "s2")


def check_services_are_contained(emulation: Emulation, *servers: str) -> None:
    for server in servers:
        assert 'kind = "lxd"' in (emulation.folder / f"{server}.toml").read_text()
        assert "detector@" in (emulation.folder / f"{server}.log").read_text()


def expect_as_simulated(emulation: Emulation) -> None:
    """The flight goes as its simulation, call by call; where the machine was late, so may a call be.

    The first call over a new connection takes some 22 ms more on an idle machine too, as TCP starts slowly.
    """
    lateness, waits = emulation.folder.parent / "lateness", emulation.folder.parent / "waits"
    with noting_lateness(lateness), noting_waits(waits, emulation.in_calls):  # all of ordinary priority
        emulation.finish_in_time()
    flown = read_result(read_log(emulation.folder / "drone.jsonl"))
    run = simulate(emulated(read_drone_config(DEMONSTRATION)))
    assert flown.completed and len(flown.calls) == len(run.result.calls)
    assert {call.place for call in flown.calls} == {"local", "s1", "s2"}
    late_s = late_in_calls(emulation.events(), [*read_lateness(lateness), *read_lateness(waits)])
    for ours, simulated, late in zip(flown.calls, run.result.calls, late_s, strict=True):
        if ours.waypoint not in waits_at_their_threshold(run, within=0.2):
            assert ours.place == simulated.place, f"at waypoint {ours.waypoint}"
            expected_s = computing_s(simulated)
            assert 0.9 * expected_s < computing_s(ours) < 1.1 * expected_s + late, (ours, late)


def computing_s(call: CallResult) -> float:
    return call.delay_s - call.waited_s


def late_in_calls(
    events: Sequence[Mapping[str, Any]], lateness: Sequence[tuple[float, float]]
) -> Iterator[float]:
    """For how long the machine was late in each call."""
    opened_s = datetime.fromisoformat(events[0]["time"]).timestamp()
    for event in events:
        if event["event"] == "call":
            ended_s = opened_s + event["t"]
            began_s = ended_s - event["delay_s"]
            yield sum(max(0.0, min(to_s, ended_s) - max(from_s, began_s)) for from_s, to_s in lateness)


@pytest.mark.flight
def test_a_call_is_cut_when_the_drone_leaves_the_range_and_answered_on_the_drone(
    radio: str, computers: str, emulate: Callable[..., Emulation], tmp_path: Path
) -> None:
    own: contextlib.AbstractContextManager[str] = contextlib.nullcontext("")
    if computers == "namespaces":  # there a vehicle of the machine itself is flown, from inside
        options = ("--armable-after", "1", "--acceleration", "4", "--home", "39.3666,22.9507")
        own = stand_in(tmp_path, *options, speedup=1, listen="tcp:127.0.0.1:0")
    with own as vehicle:
        given = ("--autopilot", vehicle) if vehicle else ()
        emulation = emulate(str(EMULATED / "leaving.toml"), "--radio", radio, "--in", computers, *given)
        emulation.finish_in_time()
    assert (emulation.folder / "drone-vehicle.log").exists() == (not vehicle)
    _, cut = read_result(read_log(emulation.folder / "drone.jsonl")).calls
    assert cut.place == "local" and cut.decision != "no server selected"
    out_of_range_after_s, local_s = 3.5, 5.0
    assert local_s < cut.delay_s < out_of_range_after_s + local_s + 0.5, emulation.events()
    assert any(event["event"] == "remote_failed" for event in emulation.events())
    if computers == "containers":
        check_services_are_contained(emulation, "s1")


@pytest.mark.flight
def test_several_drones_fly_at_once_and_share_the_servers(emulate: Callable[..., Emulation]) -> None:
    emulation = emulate(str(EMULATED / "leaving.toml"), "--drones", "3")
    output = emulation.finish()
    assert "late" in output
    for drone in ("drone-1", "drone-2", "drone-3"):
        assert read_result(read_log(emulation.folder / f"{drone}.jsonl")).completed


@pytest.mark.flight
def test_servers_that_are_peers_have_a_wire_between_them_and_ctrl_c_leaves_nothing(
    emulate: Callable[..., Emulation], tmp_path: Path
) -> None:
    scenario = tmp_path / "peers.toml"
    first, second = DEMONSTRATION.read_text().split('name = "s2"')
    scenario.write_text(
        f'{first.replace("start_s = 3.0", PEERS.format("s2"))}name = "s2"'
        f'{second.replace("start_s = 3.0", PEERS.format("s1"))}\n[policy]\nname = "look-ahead"\n'
    )
    emulation = emulate(str(scenario))

    def steps() -> list[str]:
        about = [event for event in emulation.events() if event.get("server") == "s2" and "before" in event]
        return [event["event"] for event in about[:3]]

    emulation.wait_until(lambda: len(steps()) == 3)
    assert steps() == ["prepared", "selected", "found_running"]
    expect_an_end_at_ctrl_c(emulation)


def test_ctrl_c_lands_the_drones_in_containers_and_leaves_nothing(emulate: Callable[..., Emulation]) -> None:
    require_engine()
    emulation = emulate(str(DEMONSTRATION), "--in", "containers")
    emulation.wait_for("took_off")
    expect_an_end_at_ctrl_c(emulation)


def expect_an_end_at_ctrl_c(emulation: Emulation) -> None:
    os.killpg(emulation.process.pid, signal.SIGINT)
    output = emulation.finish()
    assert emulation.process.returncode == 130, output
    events = [event["event"] for event in emulation.events()]
    assert events.index("stopping") < events.index("landed")
    assert seen_outside() == []


VICTIMS = {
    "the command": "",
    "its namespaces' owner": "unshare ",
    "the enclosed program": "-m upwash.emulation",
    "a daemon": "upwash serve",
    "the vehicle": "upwash vehicle",
    "the drone": "upwash fly",
    "an instance": "upwash.real.instances.instance",
}


@pytest.mark.parametrize("victim", VICTIMS)
def test_whatever_is_killed_in_flight_nothing_is_left(victim: str, emulate: Callable[..., Emulation]) -> None:
    emulation = emulate(str(DEMONSTRATION), "--drones", "2")
    emulation.wait_for("took_off", "drone-1")
    kill(emulation, VICTIMS[victim])
    if victim in ("a daemon", "the vehicle", "the drone", "an instance"):  # the others go on without it
        time.sleep(1.0)
        emulation.process.kill()
    emulation.process.wait()
    expect_clean(emulation)


@pytest.mark.parametrize("after_s", [0.3, 0.8, 1.5, 3.0, 6.0])
def test_whenever_the_command_is_killed_nothing_is_left(
    after_s: float, emulate: Callable[..., Emulation]
) -> None:
    emulation = emulate(str(DEMONSTRATION))
    time.sleep(after_s)
    emulation.process.kill()
    emulation.process.wait()
    expect_clean(emulation)


@pytest.mark.parametrize("victim", ["the command", "an engine"])
def test_whatever_of_a_field_of_containers_is_killed_nothing_is_left(
    victim: str, emulate: Callable[..., Emulation]
) -> None:
    require_engine()
    emulation = emulate(str(EMULATED / "leaving.toml"), "--in", "containers")
    if victim == "the command":
        emulation.wait_until(lambda: bool(emulation.groups()))
        emulation.process.kill()
    else:
        emulation.wait_for("took_off")
        kill(emulation, "lxd --group root")
    emulation.process.wait()
    expect_clean(emulation)


def kill(emulation: Emulation, victim: str) -> None:
    pids = [pid for pid, command in emulation.processes().items() if victim in command]
    assert pids
    os.kill(pids[0] if victim else emulation.process.pid, signal.SIGKILL)


def expect_clean(emulation: Emulation) -> None:
    """All of it dies with what was killed, so that `--clean` finds nothing of it."""
    wait_for(lambda: not emulation.processes(), within_s=DIES_WITHIN_S, seen=emulation.processes)
    assert upwash("emulate", "--clean").returncode == 0
    assert emulation.groups() == [] and seen_outside() == []


def test_what_outlives_its_command_all_the_same_is_cleaned() -> None:
    left = subprocess.Popen(["sleep", "600"], env=os.environ | {"UPWASH_EMULATION": "999999999:1"})
    alive = subprocess.Popen(["sleep", "600"], env=os.environ | {"UPWASH_EMULATION": owner_mark()})
    with left, alive:
        clean()
        assert left.wait(5.0) == -signal.SIGKILL
        assert alive.poll() is None, "it has an owner"
        alive.kill()


def owner_mark() -> str:
    started = Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19]
    return f"{os.getpid()}:{started}"
