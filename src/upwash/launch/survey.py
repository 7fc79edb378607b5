"""Whether the vehicle and the servers' networks are ready for a flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from upwash.config import DroneConfig
from upwash.errors import AutopilotRefused
from upwash.eventlog.schema import VehicleSetting
from upwash.launch.drone import vehicle_link
from upwash.ports import VehicleNews
from upwash.real.mavlink import MavlinkAutopilot
from upwash.real.network import SurveyFinding
from upwash.support.loading import extra

_START_S = 120.0


@dataclass(frozen=True, slots=True)
class VehicleSurvey:
    """The vehicle that answered, and what its dead man lacks; empty for a dead man that is ready.

    `version` is its firmware's, or empty. `unfit` is why the vehicle cannot be flown, or empty. `settings` are the
    parameters that a person should know before a flight.
    """

    vehicle: str
    version: str
    unfit: str
    settings: Sequence[VehicleSetting]
    dead_man_lacks: str


async def survey_vehicle(config: DroneConfig, *, install_dead_man: bool) -> VehicleSurvey:
    """What the configured vehicle says of itself; with `install_dead_man` it is given its dead man first."""
    autopilot = await vehicle_link(config).connect()
    try:
        left_to_do = ""
        if install_dead_man:
            await autopilot.claim(resumes=False)
            left_to_do = await autopilot.dead_man.install()
        unfit, settings = await _inspected(autopilot)
        return VehicleSurvey(
            vehicle=str(autopilot.vehicle.found_vehicle),
            version=str(autopilot.vehicle.version or ""),
            unfit=unfit,
            settings=settings,
            dead_man_lacks=left_to_do or await autopilot.dead_man.missing(),
        )
    finally:
        await autopilot.close()


async def _inspected(autopilot: MavlinkAutopilot) -> tuple[str, list[VehicleSetting]]:
    """Why the vehicle cannot be flown, if so, and the parameters that a person should know of."""
    settings: list[VehicleSetting] = []

    def hear(news: VehicleNews) -> None:
        if isinstance(news, VehicleSetting):
            settings.append(news)

    autopilot.listen(hear)
    try:
        await autopilot.inspect()
        await autopilot.learn()
    except AutopilotRefused as error:
        return error.problem, settings
    return "", settings


async def survey_networks(config: DroneConfig) -> list[SurveyFinding]:
    """What NetworkManager has ready for the drone; raises NetworkError without one."""
    with extra("network"):
        from upwash.real.network.profiles import survey_networks
    return await survey_networks(
        config.network.interfaces,
        {server.name: server.network for server in config.servers},
        radios=config.network.radios,
    )
