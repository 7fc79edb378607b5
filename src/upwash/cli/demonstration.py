"""The demonstration: a stand-in vehicle and two daemons as processes of their own, and a flight past them.

`demonstration.toml`, beside this file, is the drone's configuration.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from msgspec import convert
from msgspec.structs import replace
from rich.console import Console

from upwash.cli.arguments import Live
from upwash.cli.fly import fly_with_progress
from upwash.config.drone import DroneConfig, MissionConfig, PhotosConfig
from upwash.config.drone_file import read_drone_config
from upwash.config.flight_times import told_in_numbers
from upwash.core.geo import Position, ground_distance_m
from upwash.eventlog import schema
from upwash.eventlog.log import EventLog
from upwash.launch.processes import ready_program, ready_vehicle
from upwash.real.trust.authority import keys_in, make_keys
from upwash.services import Detection
from upwash.services.solar_park import TrueBox
from upwash.support.output_files import write_file
from upwash.support.sentences import say
from upwash.support.text import counted

_CONFIGURATION = Path(__file__).with_suffix(".toml")
_SPACING_M = 20.0  # of its waypoints
_RUNTIME = "[runtime]\nsandbox_as_root = true\n"  # people may try the demonstration as root


def read_demonstration(
    *, policy: str | None = None, stay_or_go: str | None = None, moving: bool = False
) -> DroneConfig:
    """The demonstration's configuration, perhaps with another policy or `stay_or_go`, or `moving` along rows.

    `filled_in` adds what exists only while a flight runs.
    """
    config = read_drone_config(_CONFIGURATION)
    others = {"name": policy, "stay_or_go": stay_or_go}
    changes = {key: value for key, value in others.items() if value is not None}
    if moving:
        config = replace(config, mission=_in_rows(config.mission))
    return replace(config, policy=replace(config.policy, **changes))


def _in_rows(mission: MissionConfig) -> MissionConfig:
    """The same photos, from two rows."""
    places = mission.waypoints_m or ()
    half = len(places) // 2
    ends = (places[0], places[half - 1], places[half], places[-1])
    return replace(mission, waypoints_m=ends, photos=PhotosConfig(every_m=_SPACING_M))


def filled_in(config: DroneConfig, folder: Path, *, vehicle: str, servers: Mapping[str, str]) -> DroneConfig:
    """The configuration with the addresses of the vehicle and the servers, and the drone's keys in the folder."""
    return replace(
        config,
        autopilot=replace(config.autopilot, connection=vehicle),
        keys=keys_in(folder / "keys", config.name),
        vehicle=told_in_numbers(config.vehicle),
        servers=tuple(replace(server, address=servers[server.name]) for server in config.servers),
    )


def fly_demonstration(
    folder: Path, config: DroneConfig, *, runtime: str, live: Live | None, calls: bool = False
) -> None:
    """Fly with all files below `folder`; every process has ended when it returns or raises.

    `runtime` is a table [runtime] of the daemons' configuration, in TOML. With `live` a page shows the flight.
    With `calls` the result has a row for each call.
    """
    console = Console(markup=False)
    names = [server.name for server in config.servers]
    make_keys(folder / "keys", servers=[[name] for name in names], drones=[config.name])
    with (
        ready_vehicle("vehicle", folder, config) as vehicle,
        ready_daemons(names, folder, runtime=runtime) as servers,
    ):
        here = filled_in(config, folder, vehicle=vehicle, servers=servers)
        say(f"the vehicle is at {vehicle}, the servers at {', '.join(servers.values())}", console)
        fly_with_progress(here, log=folder / "events.jsonl", live=live, calls=calls)
    say(score_photos([folder / "events.jsonl"]).in_words(), console)


@contextlib.contextmanager
def ready_daemons(names: Sequence[str], folder: Path, *, runtime: str) -> Iterator[Mapping[str, str]]:
    """Run a daemon for each of the servers until the end of the block; yields their addresses by name.

    Their keys are in the folder.
    """
    addresses = dict(zip(names, _free_addresses(len(names)), strict=True))
    with contextlib.ExitStack() as processes:
        for name in names:
            file = folder / f"{name}.toml"
            write_file(file, _daemon(name, addresses, runtime or _RUNTIME).encode())
            processes.enter_context(ready_program(name, folder, "serve", "--config", str(file)))
        yield addresses


def _free_addresses(count: int) -> list[str]:
    """Addresses of this machine that are free now: peers must know each other's before they start."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(count)]
        return [f"127.0.0.1:{listening.getsockname()[1]}" for listening in sockets]


def _daemon(name: str, addresses: Mapping[str, str], runtime: str) -> str:
    peers = "".join(
        f'[[peer]]\nname = "{peer}"\naddress = "{address}"\n\n'
        for peer, address in addresses.items()
        if peer != name
    )
    return (
        f'listen = "{addresses[name]}"\n\n'
        f"[keys]\n"
        f'authority = "keys/authority.pem"\ncertificate = "keys/{name}.pem"\nkey = "keys/{name}.key"\n\n'
        f'[[service]]\nname = "detector"\n\n'
        f'[[server]]\nname = "{name}"\n\n{peers}{runtime}'
    )


@dataclass(slots=True)
class Score:
    """Faults in photos: how many there truly are, were found, and were imagined."""

    photos: int = 0
    true: int = 0
    found: int = 0
    false: int = 0

    def in_words(self) -> str:
        """One line about the faults."""
        return (
            f"faulty modules: {self.found} of {self.true} found, "
            f"{counted(self.false, 'false alarm')}, in {self.photos} photos"
        )


@dataclass(slots=True)
class _Photo:
    """A photo: where it was taken, its true faults, and the faults that the user was notified of."""

    position: Position
    truth: list[TrueBox]
    notified: list[Detection] = field(default_factory=list)


def score_photos(logs: Sequence[Path]) -> Score:
    """Compare what the flights of those event logs notified their users of with the true faults."""
    score = Score()
    for log in logs:
        for photo in _photos(log):
            score.photos += 1
            score.true += len(photo.truth)
            score.found += sum(any(_is_hit(fault, box) for box in photo.notified) for fault in photo.truth)
            score.false += sum(
                not any(_is_hit(fault, box) for fault in photo.truth) for box in photo.notified
            )
    return score


def _photos(log: Path) -> list[_Photo]:
    photos: list[_Photo] = []
    for event in EventLog(log):
        match event:
            case schema.PhotoTaken(truth=truth, position=position) if truth is not None:
                photos.append(_Photo(position, convert(truth, list[TrueBox])))
            case schema.Notified(message=message, at=at):  # perhaps after a photo of the next waypoint
                its_own = min(photos, key=lambda photo: ground_distance_m(photo.position, at))
                its_own.notified = convert(message, list[Detection])
    return photos


def _is_hit(fault: TrueBox, detection: Detection) -> bool:
    """Whether the detection names the fault and has its middle on it."""
    x = detection.left_px + detection.width_px / 2 - fault.left_px
    y = detection.top_px + detection.height_px / 2 - fault.top_px
    return detection.label == fault.label and 0 <= x <= fault.width_px and 0 <= y <= fault.height_px
