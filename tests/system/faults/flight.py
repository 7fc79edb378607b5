"""A flight of two drones under the faults of one seed, enclosed: `python -m tests.system.faults.flight SEED FOLDER`.

It leaves the drones' event logs and configurations, and `record.json`: what was done to them.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import msgspec
from tests.system.faults.crew import Daemon, DroneProgram
from tests.system.faults.lateness import noting_lateness
from tests.system.faults.plan import draw
from tests.system.faults.strikes import Strike, Striker

from upwash.config.drone import DroneConfig
from upwash.core.geo import GeoPosition, LocalFrame, Position
from upwash.emulation.emulate import Mover
from upwash.emulation.enclosure import settle_in
from upwash.emulation.field import Field, drone_namespace, server_namespace
from upwash.emulation.namespaces import inside
from upwash.emulation.programs import Computers, daemon_file, drone_file
from upwash.emulation.radios import ShapedRadio
from upwash.emulation.request import EmulationRequest
from upwash.emulation.vehicles import tracked
from upwash.launch.processes import ready_vehicle
from upwash.real.trust.authority import make_keys

SCENARIO = Path(__file__).parent / "field.toml"
_LONGEST_S = 240.0
_LOOK_S = 0.5
RECORD, LATENESS = "record.json", "lateness"


class Record(msgspec.Struct, frozen=True, kw_only=True):
    """What was done to a flight, and what its logs do not tell."""

    seed: int
    strikes: list[Strike]
    exit_codes: dict[str, int | None]
    daemons_ended: list[str]  # of themselves
    most_instances: dict[str, int]  # of one daemon's one service, for longer than it takes to replace one
    position_lag_s: float
    took_s: float


async def main(seed: int, folder: Path) -> None:
    settle_in(asyncio.get_running_loop().stop)
    ordered = EmulationRequest(scenarios=(SCENARIO,), drones=2, folder=folder).read()
    field = Field([each.config for each in ordered])
    computers = Computers()
    for name in field.namespaces():
        computers.make(name)
    names = [drone.name for drone in field.drones]
    make_keys(folder / "keys", servers=[[server.name] for server in field.servers], drones=names)
    radio = ShapedRadio(field.links())
    daemons = {
        server.name: Daemon(
            daemon_file(server, field, computers, folder),
            namespace=server_namespace(server.name),
            address=field.daemon_address(server),
            keys=folder / "keys",
        )
        for server in field.servers
    }
    for daemon in daemons.values():
        await daemon.start()
    with contextlib.ExitStack() as stack:
        drones, positions = [], {}
        for drone in field.drones:
            connection, positions[drone.name] = _vehicle(drone, folder, stack)
            file = drone_file(drone, field, folder, vehicle=connection)
            drones.append(DroneProgram(file, namespace=drone_namespace(drone.name)))
        stack.enter_context(noting_lateness(folder / LATENESS))
        links = {link.server.name: link for link in field.links() if link.drone == names[0]}
        record = await _fly(
            seed, drones, Striker(drones[0], daemons, links), daemons, Mover(radio, positions)
        )
        (folder / RECORD).write_bytes(msgspec.json.encode(record))


def _vehicle(
    drone: DroneConfig, folder: Path, stack: contextlib.ExitStack
) -> tuple[str, Callable[[], Position]]:
    namespace, home = drone_namespace(drone.name), drone.mission.home
    assert home is not None
    connection = stack.enter_context(
        ready_vehicle(f"{drone.name}-vehicle", folder, drone, through=inside(namespace))
    )
    frame = LocalFrame(GeoPosition(home.latitude_deg, home.longitude_deg))
    return connection, stack.enter_context(tracked(connection, namespace=namespace, frame=frame))


async def _fly(
    seed: int, drones: Iterable[DroneProgram], striker: Striker, daemons: Mapping[str, Daemon], mover: Mover
) -> Record:
    began_s = time.monotonic()
    census = Census(daemons.values())
    async with asyncio.TaskGroup() as beside:
        tasks = [
            beside.create_task(each) for each in (mover.run(), striker.carry_out(draw(seed)), census.run())
        ]
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_LONGEST_S):
                await asyncio.gather(*(drone.fly() for drone in drones))
        for task in tasks:
            task.cancel()
    return Record(
        seed=seed,
        strikes=striker.strikes,
        exit_codes={drone.name: drone.exit_code for drone in drones},
        daemons_ended=[daemon.name for daemon in daemons.values() if daemon.ended],
        most_instances=census.most,
        position_lag_s=mover.lag_s,
        took_s=time.monotonic() - began_s,
    )


class Census:
    """Counts each daemon's instances, now and then; those that are there for seven looks in a row."""

    def __init__(self, daemons: Iterable[Daemon]) -> None:
        self.most = {daemon.name: 0 for daemon in daemons}
        self._daemons = list(daemons)

    async def run(self) -> None:
        seen: dict[str, list[set[int]]] = {name: [] for name in self.most}
        while True:
            for daemon in self._daemons:
                looks = seen[daemon.name]
                looks[:] = [*looks[-6:], set(daemon.instances())]
                self.most[daemon.name] = max(self.most[daemon.name], len(set.intersection(*looks)))
            await asyncio.sleep(_LOOK_S)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), Path(sys.argv[2])))
