"""Flies the demonstration: starts a stand-in vehicle and two daemons as processes of their own, and flies."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import msgspec
from rich.console import Console

from upwash.config import DroneConfig, KeysConfig, read_drone_config
from upwash.errors import UpwashError
from upwash.flying import fly_with_progress
from upwash.real.credentials import make_keys
from upwash.services import Detection
from upwash.services.solar_park import TrueBox

_STOP_S = 5.0


@dataclass(frozen=True, slots=True)
class Score:
    """Faults in the photos of a flight: how many there truly are, were found, and were imagined."""

    photos: int
    true: int
    found: int
    false: int


def fly_demonstration(folder: Path) -> None:
    """Flies it with everything below `folder`; whatever it started is gone when it returns or raises."""
    console = Console(markup=False)
    config = read_demonstration()
    names = [server.name for server in config.servers]
    make_keys(folder / "keys", servers=[[name] for name in names], drones=[config.name])
    with contextlib.ExitStack() as processes:
        vehicle = processes.enter_context(_vehicle(config, folder))
        daemons = {name: processes.enter_context(_daemon(name, folder)) for name in names}
        here = _fill_in(config, folder, vehicle=vehicle, daemons=daemons)
        console.print(
            f"the vehicle is at {vehicle}, the servers at {', '.join(daemons.values())}", soft_wrap=True
        )
        fly_with_progress(here, log=folder / "events.jsonl", console=console)
    score = score_photos(folder / "events.jsonl")
    console.print(
        f"faulty modules: {score.found} of {score.true} found, {score.false} false alarms, in {score.photos} photos",
        soft_wrap=True,
    )


def score_photos(log: Path) -> Score:
    """What the flight of that event log told its user, held against what its photos truly show."""
    truths: list[list[TrueBox]] = []
    told: list[list[Detection]] = []
    with log.open("rb") as lines:
        for event in map(msgspec.json.decode, lines):
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
    kind, host, port = vehicle.split(":")
    return replace(
        config,
        autopilot=replace(config.autopilot, connection=f"{kind}out:{host}:{port}"),
        keys=_keys(folder / "keys", config.name),
        servers=tuple(replace(server, address=daemons[server.name]) for server in config.servers),
    )


def _keys(folder: Path, name: str) -> KeysConfig:
    return KeysConfig(
        authority=(folder / "authority.pem").absolute(),
        certificate=(folder / f"{name}.pem").absolute(),
        key=(folder / f"{name}.key").absolute(),
    )


@contextlib.contextmanager
def _vehicle(config: DroneConfig, folder: Path) -> Iterator[str]:
    home = config.mission.home
    assert home is not None  # noqa: S101 - the demonstration's own file says it
    with _program(
        "vehicle",
        folder,
        *("vehicle", "--listen", "udp:127.0.0.1:0"),
        *("--home", f"{home.latitude_deg},{home.longitude_deg}"),
        *("--acceleration", str(config.vehicle.acceleration_m_s2)),
        *("--armable-after", "1"),
    ) as address:
        yield address


@contextlib.contextmanager
def _daemon(name: str, folder: Path) -> Iterator[str]:
    config = folder / f"{name}.toml"
    config.write_text(
        f'listen = "127.0.0.1:0"\n\n'
        f"[keys]\n"
        f'authority = "keys/authority.pem"\ncertificate = "keys/{name}.pem"\nkey = "keys/{name}.key"\n\n'
        f'[[service]]\nname = "detector"\n\n'
        f'[[server]]\nname = "{name}"\n'
    )
    with _program(name, folder, "serve", "--config", str(config)) as address:
        yield address


@contextlib.contextmanager
def _program(name: str, folder: Path, *arguments: str) -> Iterator[str]:
    """Runs an upwash command until the end of the block, its log in the folder; yields its address once ready.

    A session of its own keeps a Ctrl-C at the terminal from it: the drone lands first.
    """
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(  # noqa: S603 - this very program
            [sys.executable, "-m", "upwash", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            start_new_session=True,
            text=True,
        )
    assert process.stdout is not None  # noqa: S101
    try:
        said = process.stdout.readline()
        _, ready, address = said.strip().partition(" ready at ")
        if not ready:
            raise UpwashError(f"{name} did not start; {folder / f'{name}.log'} says why")
        yield address
    finally:
        _end(process)
        process.stdout.close()


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(timeout=_STOP_S)
    except subprocess.TimeoutExpired:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
