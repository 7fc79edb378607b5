"""The drone's end of every contender, timed call by call, in one mission.

`python -m bench.client FOLDER ROUNDS RAW GRPC DAEMON`, with the addresses of the three servers, prints the delays as
JSON: seconds by contender, round by round.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import grpc
import msgspec
from bench.echo import REPLY_BYTES, Echo, OnboardEcho
from bench.servers import GRPC_PATH, LENGTH_BYTES

from upwash.config.drone import (
    DroneConfig,
    MissionConfig,
    NetworkConfig,
    PolicyConfig,
    ServerConfig,
    ServiceConfig,
)
from upwash.core.geo import Position
from upwash.core.knowledge.servers import State
from upwash.drone.api import Drone
from upwash.drone.flight import Flight, Ports
from upwash.drone.networks import NoNetwork
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.ports import Program
from upwash.real.camera.camera import FolderCamera
from upwash.real.host.journal import FileJournal
from upwash.real.instances.runtime import OwnProcesses
from upwash.real.link.link import CHANNEL_OPTIONS, GrpcDialer
from upwash.real.trust.credentials import Credentials, read_credentials
from upwash.sim.autopilot import ModelAutopilot
from upwash.vehicle.ardupilot import airframe as arducopter

MAX_MESSAGE_BYTES = 16 * 2**20
READY_S = 20.0
MOST_WARM_UP_ROUNDS = 20
SERVICES: dict[str, type] = {"echo": Echo, "onboardecho": OnboardEcho}

Call = Callable[[bytes], bytes]


@dataclass(frozen=True)
class Addresses:
    """Where the three servers are."""

    raw: str
    grpc: str
    daemon: str


@contextlib.contextmanager
def raw_call(address: str) -> Iterator[Call]:
    """A length-prefixed request over TCP."""
    host, _, port = address.rpartition(":")
    with socket.create_connection((host, int(port))) as connection, connection.makefile("rb") as replies:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        def call(body: bytes) -> bytes:
            connection.sendall(len(body).to_bytes(LENGTH_BYTES))
            connection.sendall(body)
            return replies.read(REPLY_BYTES)

        yield call


@contextlib.contextmanager
def grpc_call(address: str, credentials: Credentials) -> Iterator[Call]:
    """A unary call with a blocking stub, with the certificates and options that upwash uses."""
    channel_credentials = grpc.ssl_channel_credentials(
        credentials.authority, credentials.key, credentials.certificate
    )
    options = [*CHANNEL_OPTIONS, ("grpc.ssl_target_name_override", "s1")]
    with grpc.secure_channel(address, channel_credentials, options) as channel:
        stub = channel.unary_unary(GRPC_PATH)
        yield lambda body: cast(bytes, stub(body, timeout=10.0))


async def fly(folder: Path, rounds: int, addresses: Addresses) -> dict[str, list[float]]:
    """The delays of every contender, measured by a mission of a drone that stays on the ground."""
    credentials = read_credentials(folder / "authority.pem", folder / "drone.pem", folder / "drone.key")
    delays_s: dict[str, list[float]] = {}
    ready = threading.Event()
    warm_up_rounds = min(rounds, MOST_WARM_UP_ROUNDS)

    def watch(event: Event) -> None:
        if isinstance(event, schema.ServerStep) and event.after is State.READY:
            ready.set()

    def mission(drone: Drone) -> None:
        photo = drone.camera.take_photo()
        if not ready.wait(READY_S):
            raise RuntimeError(f"the edge server was not ready within {READY_S:.0f} s")
        with raw_call(addresses.raw) as raw, grpc_call(addresses.grpc, credentials) as bare:
            contenders: dict[str, Call] = {
                "raw": raw,
                "grpc": bare,
                "remote": drone.service(Echo).measure,
                "local": drone.service(OnboardEcho).measure,
            }
            _interleaved(contenders, photo, rounds=warm_up_rounds)
            delays_s.update(_interleaved(contenders, photo, rounds=rounds))

    own = OwnProcesses("drone", max_message_bytes=MAX_MESSAGE_BYTES)
    with contextlib.closing(FileJournal(folder / "events.jsonl", watchers=(watch,))) as journal:
        ports = Ports(
            autopilot=ModelAutopilot(Position(0.0, 0.0), ground_speed_m_s=1.0, manner=arducopter),
            networks=[NoNetwork()],
            dialer=GrpcDialer("drone", credentials, max_message_bytes=MAX_MESSAGE_BYTES),
            onboard_dialer=own,
            onboard_runtime=own,
            camera=FolderCamera(folder, photo_s=0.0),
            notifier=journal,
            journal=journal,
        )
        programs = {name: Program(f"{cls.__module__}:{cls.__name__}") for name, cls in SERVICES.items()}
        await Flight(
            mission, _config(addresses.daemon), services=SERVICES, programs=programs, ports=ports
        ).run()
    _check_places(journal.path, rounds + warm_up_rounds)
    return delays_s


def _config(daemon: str) -> DroneConfig:
    """One server that is always in range, and expected to be far faster than the drone."""
    server = ServerConfig(
        name="s1",
        east_m=0.0,
        north_m=0.0,
        range_m=1000.0,
        network="wired",
        address=daemon,
        remote_call_s={"echo": {"": 1.0}},
    )
    return DroneConfig(
        mission=MissionConfig(),
        network=NetworkConfig(kind="wired"),
        policy=PolicyConfig(name="opportunistic"),
        services=tuple(ServiceConfig(name=name, local_call_s={"": 10.0}) for name in SERVICES),
        servers=(server,),
    )


def _interleaved(contenders: Mapping[str, Call], photo: bytes, *, rounds: int) -> dict[str, list[float]]:
    delays_s: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, call in contenders.items():
            began_s = time.perf_counter()
            reply = call(photo)
            delays_s[name].append(time.perf_counter() - began_s)
            if len(reply) != REPLY_BYTES or int(reply) != len(photo):
                raise RuntimeError(f"{name} answered {reply!r} to {len(photo)} bytes")
    return delays_s


def _check_places(journal: Path, calls: int) -> None:
    """Ends with an error if a call ran at another place than the measured one."""
    with journal.open("rb") as lines:
        events = [msgspec.json.decode(line) for line in lines]
    places = Counter((event["operation"], event["place"]) for event in events if event["event"] == "call")
    if places != {("echo.measure", "s1"): calls, ("onboardecho.measure", "local"): calls}:
        raise RuntimeError(f"the calls ran elsewhere: {dict(places)}")


if __name__ == "__main__":
    measured = asyncio.run(fly(Path(sys.argv[1]), int(sys.argv[2]), Addresses(*sys.argv[3:])))
    print(msgspec.json.encode(measured).decode())
