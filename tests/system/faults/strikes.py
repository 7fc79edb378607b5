"""Makes things go wrong, at the moments that a plan says, and writes down when they did."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from tests.system.faults.crew import Daemon, DroneProgram
from tests.system.faults.plan import Fault, Moment

from upwash.emulation.field import EmulatedLink
from upwash.emulation.namespaces import LinkEnd, command, inside

_LOOK_S = 0.005
_MOMENT_WITHIN_S = 8.0  # or it happens between two moments
BACK_WITHIN_S = 3.0  # calls, at the server, when a link is there again
_SEEN_S = 3.0  # the drone's calls are watched for so long beyond that


class Strike(msgspec.Struct, frozen=True, kw_only=True):
    """One fault as it was made, by the time of day."""

    what: str
    target: str
    server: str
    said: str
    from_s: float
    to_s: float

    @property
    def is_black_out(self) -> bool:
        return self.what in ("dark", "down")

    @property
    def back_s(self) -> float:
        """From when on calls must be answered by the server again, after a black-out."""
        return self.to_s + BACK_WITHIN_S


class Log:
    """A drone's event log as it grows."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._read_bytes = 0

    def new(self) -> list[Mapping[str, Any]]:
        """The whole lines that were written since."""
        if not self._file.exists():
            return []
        with self._file.open("rb") as file:
            file.seek(self._read_bytes)
            *lines, _ = file.read().split(b"\n")
        self._read_bytes += sum(len(line) + 1 for line in lines)
        return [msgspec.json.decode(line) for line in lines]

    async def wait_for(self, true: Callable[[Mapping[str, Any]], bool]) -> None:
        while not any(map(true, self.new())):  # noqa: ASYNC110 - a file tells nobody that it grows
            await asyncio.sleep(_LOOK_S)


_MOMENTS: Mapping[Moment, Callable[[Mapping[str, Any]], bool]] = {
    "call": lambda event: event.get("decision") == "remote",
    "onboard call": lambda event: event.get("decision") == "local",
    "check": lambda event: event["event"] == "selected",
    "between": lambda event: event["event"] == "leg",
}


class Striker:
    """Carries a plan out against one drone and the daemons."""

    def __init__(
        self, drone: DroneProgram, daemons: Mapping[str, Daemon], links: Mapping[str, EmulatedLink]
    ) -> None:
        self.strikes: list[Strike] = []
        self._drone = drone
        self._daemons = daemons
        self._links = links
        self._log = Log(drone.log)

    async def carry_out(self, plan: Sequence[Fault]) -> None:
        for fault in plan:
            await self._wait_for_moment(fault)
            from_s = time.time()
            await self._make(fault)
            strike = Strike(
                what=fault.what,
                target=fault.target,
                server=fault.server,
                said=str(fault),
                from_s=from_s,
                to_s=time.time(),
            )
            self.strikes.append(strike)
            if strike.is_black_out:
                await asyncio.sleep(strike.back_s + _SEEN_S - strike.to_s)

    async def _wait_for_moment(self, fault: Fault) -> None:
        waypoint = -1

        def is_there(event: Mapping[str, Any]) -> bool:
            nonlocal waypoint
            waypoint = event["waypoint"] if event["event"] == "arrived" else waypoint
            return waypoint >= fault.after_waypoint

        await self._log.wait_for(is_there)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_MOMENT_WITHIN_S):
                if fault.moment == "check" and fault.server == "s1":  # which the drone uses already
                    await self._log.wait_for(_MOMENTS["call"])
                    _signal(self._daemons["s1"].instances(), signal.SIGKILL)
                await self._log.wait_for(_MOMENTS[fault.moment])
        await asyncio.sleep(fault.delay_s)

    async def _make(self, fault: Fault) -> None:
        """Returns when it is over."""
        daemon = self._daemons[fault.server]
        match fault.what, fault.target:
            case "dark" | "loss", _:
                with _losing(self._links[fault.server], fault.percent):
                    await asyncio.sleep(fault.lasts_s)
            case "down", _:
                with _switched_off(self._links[fault.server].drone_end):
                    await asyncio.sleep(fault.lasts_s)
            case "garbage" | "nothing", _:
                await daemon.restart(signal.SIGKILL, impostor=fault.what, after_s=fault.lasts_s)
            case "kill", "daemon":
                await daemon.restart(signal.SIGKILL)
            case "restart", "daemon":
                await daemon.restart(signal.SIGTERM)
            case "kill", "drone":
                self._drone.killed = True
                _signal([self._drone.pid], signal.SIGKILL)
            case "kill", _:
                _signal(self._processes(fault), signal.SIGKILL)
            case "freeze", _:
                frozen = self._processes(fault)
                _signal(frozen, signal.SIGSTOP)
                await asyncio.sleep(fault.lasts_s)
                _signal(frozen, signal.SIGCONT)

    def _processes(self, fault: Fault) -> list[int]:
        daemon = self._daemons[fault.server]
        match fault.target:
            case "daemon":
                return [daemon.pid]
            case "instance":
                return daemon.instances()
            case "onboard":
                return self._drone.instances()
            case _:
                return [self._drone.pid]


def _signal(processes: Sequence[int], number: signal.Signals) -> None:
    for process in processes:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, number)


@contextlib.contextmanager
def _losing(link: EmulatedLink, percent: int) -> Iterator[None]:
    """Loses that share of the frames, both ways; no program is told."""
    chance = "" if percent == 100 else f"numgen random mod 100 < {percent}"
    for end in (link.drone_end, link.server_end):
        chain = f"""
            type filter hook input priority 0
            iifname "{end.device}" {chance} drop
        """
        rules = f"table inet fault {{ chain in {{ {chain} }}\n}}"
        subprocess.run([*inside(end.namespace), "nft", "-f", "-"], input=rules, text=True, check=True)
    try:
        yield
    finally:
        for end in (link.drone_end, link.server_end):
            command(*inside(end.namespace), "nft", "delete", "table", "inet", "fault")


@contextlib.contextmanager
def _switched_off(end: LinkEnd) -> Iterator[None]:
    """Takes a device down, as when a radio is switched off."""
    command("ip", "-n", end.namespace, "link", "set", end.device, "down")
    try:
        yield
    finally:
        command("ip", "-n", end.namespace, "link", "set", end.device, "up")
