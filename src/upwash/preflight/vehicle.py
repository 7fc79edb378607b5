"""What the vehicle should have before take-off, for a person to read."""

from __future__ import annotations

import asyncio

from rich.console import Console
from rich.text import Text

from upwash.config import DroneConfig


def check_vehicle(config: DroneConfig, console: Console, *, install_dead_man: bool = False) -> bool:
    """Connects to the vehicle and prints whether its dead man is ready; whether a flight would begin.

    Where it is to be installed, that is done first.
    """
    from upwash.launch.survey import survey_vehicle

    found = asyncio.run(survey_vehicle(config, install_dead_man=install_dead_man))
    wanted = config.autopilot.dead_man_s is not None
    console.print(f"{found.vehicle} was heard on {config.autopilot.connection}", soft_wrap=True)
    if found.dead_man_lacks:
        lacks = Text("dead man: ", style="red" if wanted or install_dead_man else "yellow")
        console.print(lacks + Text(found.dead_man_lacks), soft_wrap=True)
    else:
        console.print(Text("dead man: ready in the autopilot", style="green"))
    if wanted:
        console.print(_told(config), soft_wrap=True)
    else:
        console.print("autopilot.dead_man_s is not given: flights do without it", soft_wrap=True)
    return not (found.dead_man_lacks and (wanted or install_dead_man))


def _told(config: DroneConfig) -> str:
    settings = config.autopilot
    does = "return" if settings.on_failure == "return" else "land"
    return f"it will have the vehicle {does} once it has not heard upwash for {settings.dead_man_s:g} s in flight"
