"""ports.DeadMan for ArduPilot: a script in the autopilot (dead_man.lua) that listens to this program's heartbeats.

Each heartbeat contains the longest silence that the script must tolerate, so nothing must be undone in the autopilot
when this program dies. docs/decisions/dead-man.md has the reasons.
"""

from __future__ import annotations

import asyncio
import math
import zlib
from functools import cache
from importlib.resources import files

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.core.geo import GeoPosition
from upwash.errors import AutopilotRefused, AutopilotTimeout
from upwash.ports import DeadManAction
from upwash.real.mavlink.ftp import FileClient
from upwash.real.mavlink.parameters import read_parameters, set_parameter
from upwash.real.mavlink.vehicle import MavlinkVehicle

VERSION, SILENCE_S = "UPW_VERSION", "UPW_SILENCE_S"  # the script's parameters
_SCRIPTING_ON = "SCR_ENABLE"
FILE = "upwash_dead_man.lua"
_MAGIC = 0x5550 << 16
_ACTIONS: dict[DeadManAction, int] = {"return": 1, "land": 2}
GOODBYE = _MAGIC
_MOST_TENTHS = 2**13 - 1
_SCRIPTING = 42701  # MAV_CMD_SCRIPTING; older dialects have no name for it
_STOP_AND_RESTART = 3.0
_SCRIPTS_START_WITHIN_S = 15.0
_EARLY_S = 2.0  # the script's last message may be a second older than ours, and it acts a little early
_CONFIRMATIONS, _GOODBYES = 8, 3
_LOOK_S = 0.3
_STEP = "dead man"
_RESTART = "switch the autopilot off and on, then look again with: upwash check CONFIG --vehicle"


@cache
def script() -> tuple[int, bytes]:
    """The script's version, a checksum of its text, and the text with the version in it."""
    template = (files("upwash.real.mavlink") / "dead_man.lua").read_bytes()
    version = zlib.crc32(template) % 2**24  # as much as a parameter holds exactly
    return version, template.replace(b"@VERSION@", str(version).encode())


def promise(silence_s: float, action: DeadManAction) -> int:
    """The custom_mode of heartbeats: it promises no longer silence, and names the action after a longer one."""
    tenths = math.floor(silence_s * 10)
    if not 0 < tenths <= _MOST_TENTHS:
        raise ValueError(f"{silence_s} s of silence cannot be promised")
    return _MAGIC | _ACTIONS[action] << 13 | tenths


class LuaDeadMan:
    """The dead man's switch of one ArduPilot: a script in its autopilot."""

    def __init__(self, vehicle: MavlinkVehicle) -> None:
        self._vehicle = vehicle
        self._promise = 0
        self._is_set = False  # whether the script has said that it watches
        vehicle.heartbeat_word = self._word

    async def missing(self) -> str:
        """Why the switch cannot be used, from the parameters that a running script has; "" if it can."""
        version, _ = script()
        parameters = await read_parameters(self._vehicle, (VERSION, _SCRIPTING_ON))
        running, scripting = parameters.get(VERSION), parameters.get(_SCRIPTING_ON)
        if running == version:
            return ""
        install = "install it with: upwash check CONFIG --install-dead-man"
        if scripting is None:
            if _SCRIPTING_ON in parameters.absent:
                return "the autopilot has no parameter SCR_ENABLE: its firmware has no scripting, and so no dead man"
            return parameters.why_unknown(_SCRIPTING_ON)
        if not scripting:
            return f"scripting is off in the autopilot (SCR_ENABLE is 0), and so the dead man; {install}"
        if running is None and VERSION not in parameters.absent:
            return parameters.why_unknown(VERSION)
        if running is None:
            return f"the dead man is not in the autopilot, or was not started; {install}"
        return f"the dead man in the autopilot is of another version of upwash; {install}"

    async def install(self) -> str:
        """Uploads the script if it differs, restarts the autopilot's scripts, and returns what was done."""
        vehicle, (version, text) = self._vehicle, script()
        vehicle.require_control(_STEP)
        if vehicle.telemetry.armed:
            raise AutopilotRefused(_STEP, "the vehicle is armed; disarm it to install its dead man")
        parameters = await read_parameters(vehicle, (_SCRIPTING_ON,))
        if _SCRIPTING_ON not in parameters:
            raise AutopilotRefused(_STEP, await self.missing())
        await self._upload(text)
        if not parameters[_SCRIPTING_ON]:
            await set_parameter(vehicle, _SCRIPTING_ON, 1)
            return f"scripting was switched on (SCR_ENABLE is 1) and starts with the autopilot: {_RESTART}"
        if await self._running_version() != version:
            await self._restart_scripts(version)
        return ""

    async def watch(self, *, silence_s: float, action: DeadManAction) -> None:
        """Arms the switch, by each heartbeat from now on; raises AutopilotRefused if the script does not confirm."""
        self._promise = promise(silence_s, action)
        self._vehicle.missed_after_s = max(self._vehicle.patience.quiet_after_s, silence_s - _EARLY_S)
        if missing := await self.missing():
            raise AutopilotRefused(_STEP, missing)
        self._is_set = await self._confirmed(math.floor(silence_s * 10) / 10, _CONFIRMATIONS)
        if not self._is_set:
            problem = (
                f"it did not take {silence_s:g} s; does another script in the autopilot receive MAVLink too?"
            )
            raise AutopilotTimeout(_STEP, problem, self._vehicle.said_lately)

    async def release(self) -> None:
        """Releases the switch, by each heartbeat from now on and some extra ones."""
        if not self._promise:
            return
        self._promise = GOODBYE
        self._vehicle.missed_after_s = math.inf
        self._vehicle.beat()
        if self._is_set:
            await self._confirmed(0.0, _GOODBYES)

    def _word(self) -> int:
        """The custom_mode of the next heartbeat: 0 before `watch`, the promise, or a goodbye for a lost vehicle."""
        return self._promise if self._vehicle.is_ours or not self._promise else GOODBYE

    async def _running_version(self) -> float | None:
        return (await read_parameters(self._vehicle, (VERSION,))).get(VERSION)

    async def _confirmed(self, silence_s: float, attempts: int) -> bool:
        for _ in range(attempts):
            self._vehicle.beat()
            await asyncio.sleep(_LOOK_S)
            said_s = (await read_parameters(self._vehicle, (SILENCE_S,))).get(SILENCE_S)
            if said_s is not None and abs(said_s - silence_s) < 0.05:
                return True
        return False

    async def _upload(self, text: bytes) -> None:
        client = FileClient(self._vehicle)
        folder = "scripts"  # of a simulated autopilot; one of hardware keeps everything in APM
        if await client.has_directory("APM"):
            folder = "APM/scripts"
        await client.make_directory(folder)
        path = f"{folder}/{FILE}"
        if await client.read(path) != text:
            await client.write(path, text)

    async def _restart_scripts(self, version: int) -> None:
        vehicle, nowhere, frame = self._vehicle, GeoPosition(0.0, 0.0), mavlink.MAV_FRAME_GLOBAL
        await vehicle.accept(_STEP, vehicle.command_int(_SCRIPTING, nowhere, frame, _STOP_AND_RESTART))
        deadline_s = vehicle.now_s + _SCRIPTS_START_WITHIN_S
        while await self._running_version() != version:
            if vehicle.now_s > deadline_s:
                problem = f"the script was uploaded and did not start; {_RESTART}"
                raise AutopilotTimeout(_STEP, problem, vehicle.telemetry.said_since(deadline_s - 60.0))
            await asyncio.sleep(_LOOK_S)


class NoDeadMan:
    """The dead man's switch of a firmware that has none: it refuses everything."""

    def __init__(self, firmware: str) -> None:
        self._why = f"upwash has no dead man for {firmware}: leave autopilot.dead_man_s out"

    async def missing(self) -> str:
        """Why the switch cannot be used: the firmware has none."""
        return self._why

    async def install(self) -> str:
        """Refused."""
        raise AutopilotRefused(_STEP, self._why)

    async def watch(self, *, silence_s: float, action: DeadManAction) -> None:
        """Refused."""
        raise AutopilotRefused(_STEP, self._why)

    async def release(self) -> None:
        """Does nothing, as nothing was armed."""
