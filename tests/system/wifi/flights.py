"""The flights, inside the machine: four simulated radios, two access points with a server each, one drone.

`python -m tests.system.wifi.flights [CASE ...]` flies the cases, and writes a line of JSON into `/found/flights`
for each.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import tomli_w
from tests.events import read
from tests.programs import UPWASH, write_drone
from tests.waiting import wait_for

from upwash.real.trust.authority import make_keys

WORK = Path("/root/flights")
FOUND = Path("/found/flights")
PATIENCE_S = 240.0  # the machine is emulated in software

MISSION = """
from services_for_tests import Workbench

def fly(drone):
    bench = drone.service(Workbench)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for waypoint in drone.plan:
        drone.autopilot.goto(waypoint)
        bench.work("heavy")
    drone.end_flight()
    drone.autopilot.disarm()
"""
WORKBENCH = {"name": "workbench", "program": "services_for_tests.py:Workbench"}


def keys_of(holder: str) -> dict[str, str]:
    """The files of the holder of a certificate."""
    return {
        "authority": "keys/authority.pem",
        "certificate": f"keys/{holder}.pem",
        "key": f"keys/{holder}.key",
    }


def server_of(number: int, east_m: float, range_m: float) -> dict[str, Any]:
    """A server for the drone, so far east and with that range in metres."""
    place = {"east_m": east_m, "north_m": 0.0, "range_m": range_m, "address": f"10.10.{number}.1:7070"}
    delays_s = {"check_s": 12.0, "check_running_s": 8.0, "remote_call_s": {"light": 0.5, "heavy": 0.5}}
    return {"name": f"s{number}", "network": f"s{number}-net", **place, **delays_s}


ACCESS_POINT = """
interface=wlan{number}
driver=nl80211
ssid=s{number}-net
hw_mode=g
channel={channel}
wpa=2
wpa_key_mgmt=WPA-PSK
rsn_pairwise=CCMP
wpa_passphrase=secret-of-s{number}
ignore_broadcast_ssid={hidden}
"""
SLOW_LEAVE = "#!/bin/sh\nsleep 6\n"


class Air:
    """The radios, the access points and what gives addresses there; servers s1 and s2 run for all flights."""

    def __init__(self) -> None:
        self._points: dict[int, subprocess.Popen[bytes]] = {}
        self._addresses: dict[int, subprocess.Popen[bytes]] = {}

    def begin(self) -> None:
        """Brings up the radios, and NetworkManager on the drone's two, wlan0 and wlan3."""
        run("modprobe", "mac80211_hwsim", "radios=4")
        for number in (1, 2):
            run("ip", "netns", "add", f"s{number}")
            run("iw", "phy", f"phy{number}", "set", "netns", "name", f"s{number}")
            run(*self.at(number), "ip", "link", "set", "lo", "up")
            run(*self.at(number), "ip", "address", "add", f"10.10.{number}.1/24", "dev", f"wlan{number}")
        run("ip", "link", "set", "lo", "up")
        run("systemctl", "start", "NetworkManager")

    @staticmethod
    def at(number: int) -> tuple[str, ...]:
        """The beginning of a command that runs at the server."""
        return ("ip", "netns", "exec", f"s{number}")

    def access_point(self, number: int, *, hidden: bool = False) -> None:
        """The access point sends, from now on."""
        self.no_access_point(number)
        file = WORK / f"hostapd{number}.conf"
        file.write_text(ACCESS_POINT.format(number=number, channel=5 * number, hidden=int(hidden)))
        with (WORK / f"hostapd{number}.log").open("wb") as log:
            self._points[number] = subprocess.Popen(
                [*self.at(number), "hostapd", str(file)], stdout=log, stderr=log
            )

    def no_access_point(self, number: int) -> None:
        """The access point has lost its power."""
        end(self._points.pop(number, None))

    def addresses(self, number: int) -> None:
        """DHCP answers there, from now on."""
        self.no_addresses(number)
        options = ["--keep-in-foreground", "--conf-file=/dev/null", "--port=0", "--bind-interfaces"]
        options += [f"--interface=wlan{number}", f"--dhcp-leasefile={WORK}/leases{number}"]
        options += [f"--dhcp-range=10.10.{number}.50,10.10.{number}.99,10m"]
        self._addresses[number] = subprocess.Popen([*self.at(number), "dnsmasq", *options])

    def no_addresses(self, number: int) -> None:
        """Nothing answers by DHCP there."""
        end(self._addresses.pop(number, None))

    @staticmethod
    def profile(number: int, *, secret: str = "", hidden: bool = False, interface: str = "wlan0") -> None:
        """The drone's profile of that network, made anew."""
        subprocess.run(["nmcli", "connection", "delete", f"s{number}-net"], capture_output=True, check=False)
        settings = f"""con-name s{number}-net ifname {interface} ssid s{number}-net autoconnect no
            wifi-sec.key-mgmt wpa-psk wifi-sec.psk {secret or f"secret-of-s{number}"}
            wifi.hidden {"yes" if hidden else "no"}
            ipv4.method auto ipv4.dhcp-timeout 6 ipv4.never-default yes ipv6.method disabled"""
        run("nmcli", "connection", "add", "type", "wifi", *settings.split())

    def ready(self) -> None:
        """Everything is well, as each flight finds it."""
        for number in (1, 2):
            self.access_point(number)
            self.addresses(number)
            self.profile(number)


@dataclass
class Flight:
    """One flight under way, or over."""

    process: subprocess.Popen[bytes]
    log: Path

    def events(self, *names: str) -> list[dict[str, Any]]:
        """What is in the log by now."""
        return read(self.log, *names)

    def after(self, seen: Callable[[Sequence[dict[str, Any]]], bool]) -> None:
        """Returns once the log shows it."""
        wait_for(
            lambda: seen(self.events()),
            within_s=PATIENCE_S,
            process=self.process,
            seen=lambda: self.events()[-5:],
        )


@dataclass(frozen=True)
class Case:
    """A flight: how the air is before it, what happens during it, and what its log has to show."""

    name: str
    before: Callable[[Air], None] = lambda air: None
    during: Callable[[Air, Flight], None] = lambda air, flight: None
    shows: Callable[[Found], bool] = lambda found: True
    servers: Sequence[tuple[float, float]] = (
        (0.0, 1000.0),
    )  # how far east s1 and s2 are, and their range, in m
    radios: int = 1
    waypoints: int = 4


@dataclass
class Found:
    """What one flight showed: all waypoints reached, times (s), calls on servers of all calls, and what was told."""

    case: str
    reached: int
    joins_s: list[float]
    hand_over_s: float | None
    remote: int
    calls: int
    told: list[str]
    after_descent: list[str] = field(default_factory=list)  # networks joined while the drone came down
    ended: int = 0
    wrong: str = ""


def slow_to_leave(_: Air) -> None:
    """NetworkManager runs a script of 6 s before it leaves a network."""
    script = Path("/etc/NetworkManager/dispatcher.d/pre-down.d/slow")
    script.write_text(SLOW_LEAVE)
    script.chmod(0o755)


def quick_to_leave() -> None:
    Path("/etc/NetworkManager/dispatcher.d/pre-down.d/slow").unlink(missing_ok=True)


def hidden(air: Air) -> None:
    """s1's access point does not tell its name, as the profile says."""
    air.access_point(1, hidden=True)
    air.profile(1, hidden=True)


def lose_and_bring_back(air: Air, flight: Flight) -> None:
    """The access point goes while its server is in use, and is back once the drone has noticed."""
    flight.after(lambda events: any(event["event"] == "call" and event["place"] == "s1" for event in events))
    air.no_access_point(1)
    flight.after(lambda events: any(event["event"] in ("network_lost", "remote_failed") for event in events))
    air.access_point(1)


def lose_for_good(air: Air, flight: Flight) -> None:
    """The access point goes while its server is in use."""
    flight.after(lambda events: any(event["event"] == "call" and event["place"] == "s1" for event in events))
    air.no_access_point(1)


def one_or_other(air: Air) -> None:
    """Both profiles fit either radio."""
    for number in (1, 2):
        air.profile(number, interface="*")


BOTH = ((0.0, 28.0), (50.0, 28.0))
CASES = [
    Case("join", shows=lambda found: found.remote >= found.calls - 1 and not found.told),
    Case(
        "hand-over",
        servers=BOTH,
        waypoints=6,
        shows=lambda found: (
            found.remote >= found.calls - 1 and found.hand_over_s is not None and not found.told
        ),
    ),
    Case(
        "two radios",
        before=one_or_other,
        servers=BOTH,
        radios=2,
        waypoints=6,
        shows=lambda found: found.remote >= found.calls - 1 and len(found.joins_s) == 2,
    ),
    Case(
        "access point gone and back",
        during=lose_and_bring_back,
        waypoints=8,
        shows=lambda found: len(found.joins_s) >= 2 and 2 <= found.remote < found.calls,
    ),
    Case(
        "access point gone",
        during=lose_for_good,
        waypoints=5,
        shows=lambda found: 1 <= found.remote < found.calls,
    ),
    Case(
        "wrong secret",
        before=lambda air: air.profile(1, secret="mistaken"),
        shows=lambda found: found.remote == 0 and any("secret" in each for each in found.told),
    ),
    Case(
        "no DHCP",
        before=lambda air: air.no_addresses(1),
        shows=lambda found: found.remote == 0 and any("DHCP" in each for each in found.told),
    ),
    Case(
        "hidden network",
        before=hidden,
        shows=lambda found: found.remote >= found.calls - 1,
    ),
    Case(
        "slow to leave",
        before=slow_to_leave,
        servers=BOTH,
        waypoints=6,
        shows=lambda found: (
            len(found.joins_s) >= 2 and not any("still active" in each for each in found.told)
        ),
    ),
]


def main() -> None:
    """Flies the cases of the command line, or all."""
    wanted = [case for case in CASES if case.name in (sys.argv[1:] or [case.name])]
    WORK.mkdir(exist_ok=True)
    make_keys(WORK / "keys", servers=[["s1"], ["s2"]], drones=["heron"])
    (WORK / "services_for_tests.py").write_text(Path("/checkout/tests/services_for_tests.py").read_text())
    air = Air()
    air.begin()
    air.ready()
    with contextlib.ExitStack() as stack:
        for number in (1, 2):
            stack.enter_context(server(air, number))
        for case in wanted:
            found = flown(air, case)
            with FOUND.open("a") as lines:
                print(json.dumps(asdict(found)), file=lines)
            print(found, flush=True)


@contextlib.contextmanager
def server(air: Air, number: int) -> Iterator[None]:
    """An edge daemon at its access point, until the end of the block."""
    document = {
        "listen": f"10.10.{number}.1:7070",
        "runtime": {"sandbox": "off"},
        "keys": keys_of(f"s{number}"),
        "service": [WORKBENCH],
        "server": [{"name": f"s{number}"}],
    }
    (WORK / f"s{number}.toml").write_text(tomli_w.dumps(document))
    with ready([*air.at(number), *UPWASH, "serve", "--config", f"s{number}.toml"], f"s{number}"):
        yield


def flown(air: Air, case: Case) -> Found:
    """Flies the case from a state where everything is well."""
    air.ready()
    case.before(air)
    folder = WORK / case.name.replace(" ", "-").replace(",", "")
    folder.mkdir()
    with ready(
        [*UPWASH, "vehicle", "--listen", "tcp:127.0.0.1:0", "--armable-after", "0"], "vehicle"
    ) as connection:
        own = {
            "local_call_s": {"light": 6.0, "heavy": 6.0},
            "local_pace_s": {"light": 6.0, "heavy": 6.0},
        }
        interfaces = ["wlan0", "wlan3"][: case.radios]
        plan: dict[str, Any] = {"altitude_m": 5.0, "ground_speed_m_s": 3.0}
        plan["waypoints_m"] = [[10 * number, 0] for number in range(case.waypoints)]
        write_drone(
            WORK,
            MISSION,
            mission=plan,
            policy={"blacklist_s": 5.0},
            autopilot={"connection": connection},
            network={"kind": "networkmanager", "interfaces": interfaces, "radios": case.radios},
            keys=keys_of("heron"),
            service=[WORKBENCH | own],
            server=[server_of(number, *place) for number, place in enumerate(case.servers, start=1)],
        )
        log = folder / "events.jsonl"
        with (folder / "terminal").open("wb") as terminal:
            process = subprocess.Popen(
                [*UPWASH, "fly", "--config", "drone.toml", "--log", str(log)],
                cwd=WORK,
                stdout=terminal,
                stderr=terminal,
            )
        flight = Flight(process, log)
        wrong = ""
        try:
            case.during(air, flight)
            process.wait(timeout=PATIENCE_S)
        except (AssertionError, subprocess.TimeoutExpired) as error:
            wrong = str(error)
        finally:
            end(process)
        quick_to_leave()
    run("cp", "-r", str(folder), "/found/")
    found = found_by(case, flight)
    found.wrong = wrong or (
        "" if found.ended == 0 and found.reached == case.waypoints else "it did not end well"
    )
    if not found.wrong and found.after_descent:
        found.wrong = "a network was joined on the way down"
    if not found.wrong and not case.shows(found):
        found.wrong = "not as expected"
    return found


def found_by(case: Case, flight: Flight) -> Found:
    """What the log says."""
    events = flight.events()
    calls = flight.events("call")
    down_s = min((event["t"] for event in flight.events("returning", "landing")), default=float("inf"))
    changes = [event for event in events if "after" in event and "server" in event]
    joins_s, begun_s, left_s, hand_over_s = [], 0.0, None, None
    for event in sorted([*changes, *flight.events("joined")], key=lambda event: float(event["t"])):
        if event["event"] == "joined":
            joins_s.append(round(event["t"] - begun_s, 2))
        elif event["after"] in ("CHECK", "CHECK-R") and event["before"] not in ("CHECK", "CHECK-R"):
            begun_s = event["t"]
        elif event["before"] == "READY" and event["server"] == "s1":
            left_s = event["t"]
        elif event["after"] == "READY" and event["server"] == "s2" and left_s is not None:
            hand_over_s = round(event["t"] - left_s, 2)
    trouble = flight.events("check_failed", "network_lost", "leave_failed")
    return Found(
        case=case.name,
        reached=len(flight.events("arrived")),
        joins_s=joins_s,
        hand_over_s=hand_over_s,
        remote=sum(call["place"] != "local" for call in calls),
        calls=len(calls),
        told=list(dict.fromkeys(event["why"] for event in trouble)),
        after_descent=[event["network"] for event in flight.events("joined") if event["t"] > down_s],
        ended=flight.process.returncode,
    )


@contextlib.contextmanager
def ready(command: Sequence[str], name: str) -> Iterator[str]:
    """Runs an upwash command until the end of the block; yields its address."""
    with (Path("/found") / f"{name}.log").open("ab") as log:
        process = subprocess.Popen(command, cwd=WORK, stdout=subprocess.PIPE, stderr=log, text=True)
    assert process.stdout is not None
    try:
        said = process.stdout.readline()
        assert " ready at " in said, said
        yield said.strip().partition(" ready at ")[2]
    finally:
        end(process)
        process.stdout.close()


def run(*command: str) -> None:
    """Runs a command that has to succeed."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stdout}{done.stderr}"


def end(process: subprocess.Popen[Any] | None) -> None:
    """Ends the program, by force if it does not within 20 s."""
    if process is None:
        return
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(timeout=20.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


if __name__ == "__main__":
    main()
