"""What the vehicle should have before take-off, for a person to read."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from upwash.config import DroneConfig

if TYPE_CHECKING:
    from upwash.launch.survey import VehicleSurvey


def check_vehicle(config: DroneConfig, console: Console, *, install_dead_man: bool = False) -> bool:
    """Connects to the vehicle, prints whether it and its dead man are ready; whether a flight would begin.

    A dead man that is to be installed is installed first.
    """
    from upwash.launch.survey import survey_vehicle

    found = asyncio.run(survey_vehicle(config, install_dead_man=install_dead_man))
    wanted = config.autopilot.dead_man_s is not None
    console.print(f"{found.vehicle} was heard on {config.autopilot.connection}", soft_wrap=True)
    _show_firmware(found, console)
    if found.dead_man_lacks:
        lacks = Text("dead man: ", style="red" if wanted or install_dead_man else "yellow")
        console.print(lacks + Text(found.dead_man_lacks), soft_wrap=True)
    else:
        console.print(Text("dead man: ready in the autopilot", style="green"))
    if wanted:
        console.print(_told(config), soft_wrap=True)
    else:
        console.print("autopilot.dead_man_s is not given: flights do without it", soft_wrap=True)
    return not (found.unfit or (found.dead_man_lacks and (wanted or install_dead_man)))


def _show_firmware(found: VehicleSurvey, console: Console) -> None:
    version = found.version or "the vehicle does not tell it"
    console.print(Text(f"version: {version}", style="" if found.version else "yellow"), soft_wrap=True)
    for setting in found.settings:
        value = "not known" if setting.value is None else f"{setting.value:g}"
        line = Text(f"{setting.name}: ", style="yellow") + Text(f"{value}: {setting.advice}")
        console.print(line, soft_wrap=True)
    if found.unfit:
        console.print(Text("cannot be flown: ", style="red") + Text(found.unfit), soft_wrap=True)


def _told(config: DroneConfig) -> str:
    settings = config.autopilot
    does = "return" if settings.on_failure == "return" else "land"
    return f"it will have the vehicle {does} once it has not heard upwash for {settings.dead_man_s:g} s in flight"
