"""Asks what is needed for a flight whether it is ready: the vehicle, the servers' networks, and the servers."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass

from upwash.config import DroneConfig, ServerConfig
from upwash.drone.networks import NoNetwork
from upwash.drone.preparation import endpoints, make_estimates
from upwash.drone.server_session import ServerEndpoint, ServerSession
from upwash.errors import AutopilotRefused, LinkError, UpwashError
from upwash.launch.drone import (
    drone_credentials,
    require_address,
    require_certificates,
    server_dialer,
    server_finder,
    vehicle_link,
)
from upwash.missions.bundled import load_specs
from upwash.ports import Dialer, VehicleNews, VehicleSetting
from upwash.real.finding import Finding
from upwash.real.mavlink import MavlinkAutopilot
from upwash.support.loading import extra

_START_S = 120.0


@dataclass(frozen=True, slots=True)
class VehicleSurvey:
    """The vehicle that answered, and what its dead man lacks; empty for a dead man that is ready.

    `version` is its firmware's, empty if the vehicle does not tell it. `unfit` says why it cannot be flown, empty if
    it can. `settings` are the parameters that a person should know of before a flight.
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
            vehicle=str(autopilot.identity),
            version=str(autopilot.version or ""),
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


async def survey_networks(config: DroneConfig) -> list[Finding]:
    """What NetworkManager has ready for the drone; raises NetworkError without one."""
    with extra("network"):
        from upwash.real.survey import survey_networks
    return await survey_networks(
        config.network.interfaces,
        {server.name: server.network for server in config.servers},
        radios=config.network.radios,
    )


async def survey_servers(config: DroneConfig) -> list[Finding]:
    """Whether each server, over the networks that this computer is in, starts the drone's services for it.

    Raises CredentialsError where the drone's certificate cannot be shown.
    """
    dialer = server_dialer(config, drone_credentials(config))
    specs = load_specs(config.services)
    wanted = endpoints(config, make_estimates(config, specs), server_finder(config))
    return await asyncio.gather(
        *(_survey_server(server, wanted[server.name], config, dialer) for server in config.servers)
    )


async def _survey_server(
    server: ServerConfig, endpoint: ServerEndpoint, config: DroneConfig, dialer: Dialer
) -> Finding:
    subject = f"{server.name} at {server.address or '?'}"
    try:
        require_address(server)
        require_certificates(server, config)
    except UpwashError as error:
        return Finding(subject, "not asked", str(error))
    session = ServerSession(endpoint, network=NoNetwork(), dialer=dialer)
    now_s = asyncio.get_running_loop().time
    began_s, answered = now_s(), False
    try:
        running = (await session.ask()).running
        answered = True
        if not running:
            await session.start(timeout_s=_START_S)
    except LinkError as error:
        return Finding(
            subject,
            "answers" if answered else "does not answer as needed",
            str(error).removeprefix(f"{subject}: "),
        )
    finally:
        await session.end(in_range=True)
    believed_s = server.check_running_s if running else server.check_s
    services = ", ".join(endpoint.services) or "nothing that the drone wants"
    did, key = ("runs", "check_running_s") if running else ("started", "check_s")
    return Finding(subject, f"{did} {services} in {now_s() - began_s:.1f} s ({key} = {believed_s:g})")
