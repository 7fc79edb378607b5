"""Flies the demonstration: starts a stand-in vehicle and two daemons as processes of their own, and flies."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import msgspec
from rich.console import Console

from upwash import event_log
from upwash.config import DroneConfig, read_drone_config
from upwash.flying import fly_with_progress
from upwash.narration import counted
from upwash.output import write_file
from upwash.real.credentials import keys_in, make_keys
from upwash.running import ready_program, ready_vehicle
from upwash.services import Detection
from upwash.services.solar_park import TrueBox

_RUNTIME = "[runtime]\nsandbox_as_root = true\n"  # whoever tries it out may be root


@dataclass(frozen=True, slots=True)
class Score:
    """Faults in the photos of a flight: how many there truly are, were found, and were imagined."""

    photos: int
    true: int
    found: int
    false: int


def fly_demonstration(
    folder: Path, *, runtime: str = "", policy: str | None = None, live_port: int | None = None
) -> None:
    """Flies it with everything below `folder`; whatever it started is gone when it returns or raises.

    `runtime` is what the daemons' configuration is to say besides, in TOML: a table [runtime]. `policy` is another
    than the configured one. With `live_port` it is shown on a page meanwhile.
    """
    console = Console(markup=False)
    config = read_demonstration()
    if policy:
        config = msgspec.structs.replace(config, policy=msgspec.structs.replace(config.policy, name=policy))
    names = [server.name for server in config.servers]
    make_keys(folder / "keys", servers=[[name] for name in names], drones=[config.name])
    with contextlib.ExitStack() as processes:
        vehicle = processes.enter_context(ready_vehicle("vehicle", folder, config))
        daemons = dict(zip(names, _free_addresses(len(names)), strict=True))
        for name in names:
            processes.enter_context(_daemon(name, folder, runtime, daemons))
        here = _fill_in(config, folder, vehicle=vehicle, daemons=daemons)
        console.print(
            f"the vehicle is at {vehicle}, the servers at {', '.join(daemons.values())}", soft_wrap=True
        )
        fly_with_progress(here, log=folder / "events.jsonl", live_port=live_port)
    score = score_photos(folder / "events.jsonl")
    console.print(
        f"faulty modules: {score.found} of {score.true} found, "
        f"{counted(score.false, 'false alarm')}, in {score.photos} photos",
        soft_wrap=True,
    )


def score_photos(log: Path) -> Score:
    """What the flight of that event log told its user, held against what its photos truly show."""
    truths: list[list[TrueBox]] = []
    told: list[list[Detection]] = []
    for event in event_log.read(log):
        match event:
            case {"event": "photo", "truth": truth}:
                truths.append(msgspec.convert(truth, list[TrueBox]))
                told.append([])
            case {"event": "notified", "message": message}:
                told[-1] = msgspec.convert(message, list[Detection])
    found = false = 0
    for truth, detections in zip(truths, told, strict=True):
        found += sum(any(_is_hit(fault, each) for each in detections) for fault in truth)
        false += sum(not any(_is_hit(fault, each) for fault in truth) for each in detections)
    return Score(photos=len(truths), true=sum(map(len, truths)), found=found, false=false)


def _is_hit(fault: TrueBox, detection: Detection) -> bool:
    """Whether the detection names the fault and has its middle on it."""
    x = detection.left_px + detection.width_px / 2 - fault.left_px
    y = detection.top_px + detection.height_px / 2 - fault.top_px
    return detection.label == fault.label and 0 <= x <= fault.width_px and 0 <= y <= fault.height_px


def read_demonstration() -> DroneConfig:
    """The demonstration's configuration, as it is simulated; a flight fills in what only exists while it runs."""
    with as_file(files("upwash.demonstration") / "drone.toml") as file:
        return read_drone_config(file)


def _fill_in(config: DroneConfig, folder: Path, *, vehicle: str, daemons: Mapping[str, str]) -> DroneConfig:
    replace = msgspec.structs.replace
    return replace(
        config,
        autopilot=replace(config.autopilot, connection=vehicle),
        keys=keys_in(folder / "keys", config.name),
        servers=tuple(replace(server, address=daemons[server.name]) for server in config.servers),
    )


def _free_addresses(count: int) -> list[str]:
    """Addresses of this machine that nobody listens at now; peers have to know each other's before they start."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(count)]
        return [f"127.0.0.1:{each.getsockname()[1]}" for each in sockets]


@contextlib.contextmanager
def _daemon(name: str, folder: Path, runtime: str, daemons: Mapping[str, str]) -> Iterator[None]:
    config = folder / f"{name}.toml"
    peers = "".join(
        f'[[peer]]\nname = "{peer}"\naddress = "{address}"\n\n'
        for peer, address in daemons.items()
        if peer != name
    )
    text = (
        f'listen = "{daemons[name]}"\n\n'
        f"[keys]\n"
        f'authority = "keys/authority.pem"\ncertificate = "keys/{name}.pem"\nkey = "keys/{name}.key"\n\n'
        f'[[service]]\nname = "detector"\n\n'
        f'[[server]]\nname = "{name}"\n\n{peers}{runtime or _RUNTIME}'
    )
    write_file(config, text.encode())
    with ready_program(name, folder, "serve", "--config", str(config)):
        yield
