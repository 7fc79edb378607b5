"""Flies the demonstration: starts a stand-in vehicle and two daemons as processes of their own, and flies."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from upwash.cli.demonstration.configuration import filled_in
from upwash.cli.demonstration.daemons import ready_daemons
from upwash.cli.demonstration.score import score_photos
from upwash.cli.flying import fly_with_progress
from upwash.config import DroneConfig
from upwash.launch.processes import ready_vehicle
from upwash.real.trust.authority import make_keys
from upwash.support.sentences import say


def fly_demonstration(
    folder: Path, config: DroneConfig, *, runtime: str = "", live_port: int | None = None
) -> None:
    """Flies it with everything below `folder`; whatever it started is gone when it returns or raises.

    `runtime` is what the daemons' configuration is to say besides, in TOML: a table [runtime]. With `live_port` it is
    shown on a page meanwhile.
    """
    console = Console(markup=False)
    names = [server.name for server in config.servers]
    make_keys(folder / "keys", servers=[[name] for name in names], drones=[config.name])
    with (
        ready_vehicle("vehicle", folder, config) as vehicle,
        ready_daemons(names, folder, runtime=runtime) as servers,
    ):
        here = filled_in(config, folder, vehicle=vehicle, servers=servers)
        say(
            f"the vehicle is at {vehicle}, the servers at {', '.join(servers.values())}",
            console,
        )
        fly_with_progress(here, log=folder / "events.jsonl", live_port=live_port)
    say(score_photos(folder / "events.jsonl").in_words(), console)
