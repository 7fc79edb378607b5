"""Asks what is needed for a flight whether it is ready: the vehicle, and the networks of the servers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from upwash.config import DroneConfig
from upwash.launch.drone import vehicle_link
from upwash.support.loading import extra

if TYPE_CHECKING:
    from upwash.real.survey import Finding


@dataclass(frozen=True, slots=True)
class VehicleSurvey:
    """What a vehicle runs, and what its dead man lacks, empty where it is ready."""

    firmware: str
    dead_man_lacks: str


async def survey_vehicle(config: DroneConfig, *, install_dead_man: bool) -> VehicleSurvey:
    """What the configured vehicle says of itself; with `install_dead_man` it is given its dead man first."""
    autopilot = await vehicle_link(config).connect()
    try:
        left_to_do = ""
        if install_dead_man:
            await autopilot.claim(resumes=False)
            left_to_do = await autopilot.dead_man.install()
        return VehicleSurvey(autopilot.firmware, left_to_do or await autopilot.dead_man.missing())
    finally:
        await autopilot.close()


async def survey_networks(config: DroneConfig) -> list[Finding]:
    """What NetworkManager has ready for the drone; raises NetworkError without one."""
    with extra("network"):
        from upwash.real.survey import survey_networks
    return await survey_networks(
        config.network.interfaces,
        {server.name: server.network for server in config.servers},
        radios=config.network.radios,
    )
