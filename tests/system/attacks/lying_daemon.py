"""An edge daemon with a valid certificate that lies to a real `upwash fly`, in every way that a drone can notice.

    python -m tests.system.attacks.lying_daemon                   each lie against a flight of its own; prints a table
    python -m tests.system.attacks.lying_daemon --lie "a lease of 1e-9 s"

The flight is the command itself, past the stand-in vehicle, with a service that it calls at each waypoint. It must
end as if there were no server: completed, with every answer right.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import socket
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import grpc
import msgspec
from tests.events import read
from tests.programs import running, stand_in, write_drone
from tests.system.daemons import memory_bytes

from upwash.real.trust.authority import keys_in, make_keys
from upwash.rpc.protocol import AVAILABILITY, START, service_path

SERVER, SERVICE = "s1", "adder"
ELSEWHERE = f"upwash-elsewhere-{os.getpid()}"
_ADD = service_path(SERVICE, "add")
CALLS = 12
MANY = 150_000
FLIGHT_S = 100.0
ESCAPES = "\x1b]0;owned\x07\x1b[2J\x1b[31m\x9b1m\u202edetsurt\u2066\r\nupwash: all is well"
_LONGEST_LINE = 20_000  # of a log, or of what is printed
_UNPRINTABLE = re.compile("[^\n\\x20-\\x7e\\xa0-\u1fff\u2010-\u2027\u2030-\u205e\u2070-\ud7ff]")
_MEGABYTES = 2**20

MISSION = """
import time
from upwash import service

@service
class Adder:
    def add(self, first: int, second: int) -> int:
        time.sleep(0.2)
        return first + second

def fly(drone):
    adder = drone.service(Adder)
    drone.autopilot.arm()
    drone.autopilot.takeoff(drone.altitude_m)
    for number, waypoint in enumerate(drone.plan):
        drone.autopilot.goto(waypoint)
        answers = [adder.add(number, each) for each in range(4)]
        drone.user.notify(answers, at=waypoint)
    drone.autopilot.land()
"""
PLAN = {"altitude_m": 2.0, "ground_speed_m_s": 5.0, "waypoints_m": [[0, 0], [10, 0], [20, 0]]}
KEYS = {"authority": "keys/authority.pem", "certificate": "keys/heron.pem", "key": "keys/heron.key"}
NEAR = {
    "name": SERVER, "network": SERVER, "east_m": 0.0, "north_m": 0.0, "range_m": 1000.0,
    "check_s": 3.0, "check_running_s": 1.0, "remote_call_s": 0.05,
}  # fmt: skip

Reply = bytes | dict[str, Any]


# --- the lies -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Lie:
    """What the daemon answers to each path; `{port}` in an endpoint is its own, `{elsewhere}` another machine's."""

    availability: Reply | None = None
    start: Reply | None = None
    result: Reply | None = None
    refusal: str | None = None  # of every request, as gRPC carries it


def _ready(**other: Any) -> dict[str, Any]:
    return {"available": True, "endpoints": {SERVICE: ":{port}"}, "lease_s": 30.0, **other}


def _many(count: int) -> dict[str, str]:
    return {SERVICE: ":{port}", **{f"s{number}": ":1" for number in range(count)}}


def _at(endpoint: str) -> Lie:
    return Lie({"available": True, "endpoints": {SERVICE: endpoint}, "lease_s": 30.0})


LIES: Mapping[str, Lie] = {
    "none: no server": Lie({"available": False, "reason": "full"}),
    "150,000 endpoints": Lie(_ready(endpoints=_many(MANY))),
    "200 endpoints nobody asked for": Lie(_ready(endpoints=_many(200))),
    "an endpoint of 10 MB": _at(":" + "1" * 10_000_000),
    "a started endpoint of 10 MB": Lie(
        {"available": True, "endpoints": {}, "lease_s": 30.0}, start={"endpoint": "x" * 10_000_000}
    ),
    "a reason of 15 MB": Lie({"available": False, "reason": "x" * 15_000_000}),
    "150,000 peers": Lie(_ready(peers=[f"s{number}" for number in range(MANY)])),
    "a lease of 1e-9 s": Lie(_ready(lease_s=1e-9)),
    "a lease that is no number": Lie(_ready(lease_s=float("nan"))),
    "a lease of -1 s": Lie(_ready(lease_s=-1.0)),
    "an endpoint on another machine": _at("{elsewhere}"),
    "an endpoint dns:///": _at("dns:///{elsewhere}"),
    "an endpoint ipv4:": _at("ipv4:{elsewhere}"),
    "an endpoint xds:///": _at("xds:///{elsewhere}"),
    "an endpoint unix-abstract:": _at(f"unix-abstract:{ELSEWHERE}"),
    "control characters in a reason": Lie({"available": False, "reason": ESCAPES}),
    "control characters in an endpoint": _at(":7070" + ESCAPES),
    "control characters in a refusal": Lie(refusal=ESCAPES),
    "results of a wrong type": Lie(_ready(), result={"value": ["not a number"]}),
    "results that are no reply": Lie(_ready(), result={"neither": 1}),
}


class LyingDaemon:
    """A daemon that holds s1's certificate and tells that lie; and a place elsewhere that nobody should call."""

    def __init__(self, lie: Lie, keys: Path) -> None:
        self._lie = lie
        self._elsewhere = [
            _listening("127.0.0.2", socket.AF_INET), _listening(f"\0{ELSEWHERE}", socket.AF_UNIX),
        ]  # fmt: skip
        self.called_elsewhere = 0
        self.asked: Counter[str] = Counter()
        files = keys_in(keys, SERVER)
        self._server = grpc.server(
            ThreadPoolExecutor(), options=[("grpc.max_send_message_length", -1), ("grpc.so_reuseport", 0)]
        )
        self._server.add_generic_rpc_handlers((_Handler(self._answer),))
        shown = grpc.ssl_server_credentials(
            [(files.key.read_bytes(), files.certificate.read_bytes())],
            files.authority.read_bytes(),
            require_client_auth=True,
        )
        self.address = f"127.0.0.1:{self._server.add_secure_port('127.0.0.1:0', shown)}"
        self._replies = {
            AVAILABILITY: self._packed(lie.availability),
            START: self._packed(lie.start),
            _ADD: self._packed(lie.result),
        }

    def __enter__(self) -> LyingDaemon:
        for each in self._elsewhere:
            threading.Thread(target=self._count, args=(each,), daemon=True).start()
        self._server.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop(None).wait()
        for each in self._elsewhere:
            each.shutdown(socket.SHUT_RDWR)  # which ends the thread that waits on it
            each.close()

    def _packed(self, reply: Reply | None) -> bytes:
        if isinstance(reply, bytes):
            return reply
        if reply and "endpoints" in reply:
            host, port = self._elsewhere[0].getsockname()
            places = {"{port}": self.address.rpartition(":")[2], "{elsewhere}": f"{host}:{port}"}
            filled = {name: _filled(each, places) for name, each in reply["endpoints"].items()}
            reply = {**reply, "endpoints": filled}
        return msgspec.msgpack.encode(reply or {})

    def _answer(self, path: str, body: bytes, context: grpc.ServicerContext) -> bytes:
        self.asked[path] += 1
        if self._lie.refusal is not None:
            context.abort(grpc.StatusCode.FAILED_PRECONDITION, self._lie.refusal)
        if path == _ADD and self._lie.result is None:
            return msgspec.msgpack.encode({"value": sum(msgspec.msgpack.decode(body).values())})
        return self._replies.get(path, b"\x80")

    def _count(self, listening: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listening.accept()
                self.called_elsewhere += 1
                connection.close()


class _Handler(grpc.GenericRpcHandler):  # type: ignore[misc]
    """Has every request answered, whatever its path."""

    def __init__(self, answer: Callable[[str, bytes, grpc.ServicerContext], bytes]) -> None:
        self._answer = answer

    def service(self, handler_call_details: Any) -> Any:
        path: str = handler_call_details.method
        return grpc.unary_unary_rpc_method_handler(lambda body, context: self._answer(path, body, context))


def _filled(endpoint: str, places: Mapping[str, str]) -> str:
    for name, place in places.items():
        endpoint = endpoint.replace(name, place)
    return endpoint


def _listening(where: str, family: socket.AddressFamily) -> socket.socket:
    listening = socket.socket(family)
    listening.bind((where, 0) if family is socket.AF_INET else where)
    listening.listen()
    return listening


# --- the flight ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What came of a flight past a liar."""

    completed: bool
    right_answers: int
    took_s: float
    memory_bytes: int  # at most
    asked: int  # requests to the daemon
    called_elsewhere: int
    unprintable: int  # characters in the log's texts and in what was printed
    longest_line: int
    said: str = field(repr=False)

    @property
    def is_well(self) -> bool:
        """Whether the liar cost no more than waits."""
        return (
            self.completed
            and self.right_answers == CALLS
            and not (self.called_elsewhere or self.unprintable)
            and self.longest_line <= _LONGEST_LINE
        )


def flown_past(lie: Lie, folder: Path) -> Outcome:
    """Flies the mission past a daemon that tells the lie, in that folder."""
    make_keys(folder / "keys", servers=[[SERVER]], drones=["heron"])
    adder = {"name": SERVICE, "program": "mission.py:Adder", "local_call_s": 1.0}
    with stand_in(folder, "--acceleration", "50") as vehicle, LyingDaemon(lie, folder / "keys") as daemon:
        server = NEAR | {"address": daemon.address}
        pilot = {"connection": vehicle}
        write_drone(
            folder, MISSION, mission=PLAN, autopilot=pilot, keys=KEYS, service=[adder], server=[server]
        )
        code, took_s, most_bytes = _fly(folder)
        asked, elsewhere = sum(daemon.asked.values()), daemon.called_elsewhere
    said = (folder / "said").read_bytes().decode(errors="backslashreplace")
    events = read(folder / "log.jsonl")
    texts = [*_texts(events), said]
    answers = [each for event in events if event["event"] == "notified" for each in event["message"]]
    wanted = [number + each for number in range(3) for each in range(4)]
    return Outcome(
        completed=code == 0 and any(event["event"] == "mission_completed" for event in events),
        right_answers=sum(one == other for one, other in zip(answers, wanted, strict=False)),
        took_s=took_s,
        memory_bytes=most_bytes,
        asked=asked,
        called_elsewhere=elsewhere,
        unprintable=sum(len(_UNPRINTABLE.findall(text)) for text in texts),
        longest_line=max(len(line) for text in texts for line in text.split("\n")),
        said=said,
    )


def _texts(value: object) -> Iterator[str]:
    match value:
        case str():
            yield value
        case list():
            for each in value:
                yield from _texts(each)
        case dict():
            for each in value.values():
                yield from _texts(each)


def _fly(folder: Path) -> tuple[int, float, int]:
    """The flight's exit code, how long it took, and the most memory that it held; it is killed after a while."""
    fly = ("fly", "--config", "drone.toml", "--log", "log.jsonl")
    began_s, most_bytes = time.monotonic(), 0
    with (folder / "said").open("wb") as said, running(*fly, folder=folder, stdout=said) as flight:
        while flight.poll() is None:
            with contextlib.suppress(FileNotFoundError, ProcessLookupError, StopIteration):
                most_bytes = max(most_bytes, memory_bytes(flight.pid, "VmHWM"))
            if time.monotonic() - began_s > FLIGHT_S:
                flight.kill()
            time.sleep(0.05)
    return flight.returncode, time.monotonic() - began_s, most_bytes


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the table; returns 0 if no lie cost more than waits."""
    parser = argparse.ArgumentParser(prog="python -m tests.system.attacks.lying_daemon", description=__doc__)
    parser.add_argument("--lie", action="append", choices=LIES, help="this one alone")
    options = parser.parse_args(arguments)
    print("| lie | flight | answers | s | MB | requests | called elsewhere | unprintable | longest line |")
    print("|---|---|---|---|---|---|---|---|---|")
    well = True
    for name in options.lie or LIES:
        with tempfile.TemporaryDirectory() as folder:
            outcome = flown_past(LIES[name], Path(folder))
        well &= outcome.is_well
        print(
            f"| {name} | {'completed' if outcome.completed else 'LOST'} | {outcome.right_answers} of {CALLS} "
            f"| {outcome.took_s:.1f} | {outcome.memory_bytes / _MEGABYTES:.0f} | {outcome.asked} "
            f"| {outcome.called_elsewhere} | {outcome.unprintable} | {outcome.longest_line:,} |",
            flush=True,
        )
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
