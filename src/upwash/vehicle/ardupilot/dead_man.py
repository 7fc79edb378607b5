"""The one script that the stand-in runs: upwash's dead man, once it is uploaded. Its deeds are modelled here.

`real/mavlink/dead_man.lua` is the script itself. The stand-in reads nothing but its version from it.
"""

from __future__ import annotations

import re
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from upwash.mavlink.packets import sender_of
from upwash.vehicle.ardupilot.boot import INFORMATION, WARNING, Text
from upwash.vehicle.ardupilot.copter import Copter
from upwash.vehicle.ardupilot.settings import CopterMode
from upwash.vehicle.body.copter import Result
from upwash.vehicle.body.ftp import Files

_FILE = "scripts/upwash_dead_man.lua"
_VERSION = re.compile(rb"^local VERSION = (\d+)$", re.MULTILINE)
_MAGIC = 0x5550
_COMPANION = 1, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
_MODES = {1: CopterMode.RTL, 2: CopterMode.LAND}
_EARLY_S = 1.0
_STOP_AND_RESTART = 3
MAV_CMD_SCRIPTING = 42701


class Scripting:
    """Scripts start by command, if SCR_ENABLE was 1 at boot; the dead man is the only script."""

    def __init__(self, copter: Copter) -> None:
        self._copter = copter
        self._enabled = bool(copter.parameters["SCR_ENABLE"])
        self._runs = False
        self._promised_s = 0.0  # 0: no promise
        self._mode = CopterMode.RTL
        self._heard_s = 0.0
        self._was_armed = False

    def obey(self, command: float, files: Files) -> Result:
        """Starts the scripts, or refuses, as the answer to MAV_CMD_SCRIPTING."""
        if command != _STOP_AND_RESTART:
            return Result.UNSUPPORTED
        found = _VERSION.search(bytes(files.content.get(_FILE, b"")))
        self._runs, self._was_armed = bool(found and self._enabled), False
        if found and self._enabled:
            self._copter.parameters.add("UPW_VERSION", int(found[1]))
            self._copter.parameters.add("UPW_SILENCE_S", 0.0)
            self._promise(0.0)
            self._copter.say(Text(f"upwash: dead man {int(found[1])} is ready", INFORMATION))
        return Result.ACCEPTED

    def hear(self, heartbeat: Any, now_s: float) -> None:
        """Takes a heartbeat. The companion's holds its order: after how many silent seconds to take which mode."""
        promises = heartbeat.custom_mode >> 16 == _MAGIC and sender_of(heartbeat) == _COMPANION
        if not self._runs or not promises:
            return
        self._notice_arming(now_s)
        mode, silence_s = _MODES.get(heartbeat.custom_mode >> 13 & 7), (heartbeat.custom_mode & 8191) / 10
        if heartbeat.custom_mode & 0xFFFF == 0:
            self._promise(0.0)
        elif mode is not None and silence_s and self._may_be_watched(now_s):
            self._mode, self._heard_s = mode, now_s
            self._promise(silence_s)

    def tick(self, now_s: float) -> None:
        """Changes to the ordered mode if the companion has been silent for the ordered time."""
        if not self._runs:
            return
        self._notice_arming(now_s)
        if not self._promised_s:
            return
        if not self._may_be_watched(now_s):
            self._promise(0.0)
        elif now_s - self._heard_s >= self._promised_s - _EARLY_S:
            if self._was_armed and self._copter.flying(now_s):
                self._act(now_s)
            else:
                self._promise(0.0)

    def _notice_arming(self, now_s: float) -> None:
        """Drops the order at arming: only orders after it count."""
        armed = self._copter.armed(now_s)
        if armed and not self._was_armed:
            self._promise(0.0)
        self._was_armed = armed

    def _act(self, now_s: float) -> None:
        self._copter.say(Text(f"upwash: companion silent, {self._mode.name}", WARNING))
        if self._copter.change_mode(now_s, self._mode) is not Result.ACCEPTED:
            self._copter.change_mode(now_s, CopterMode.LAND)

    def _may_be_watched(self, now_s: float) -> bool:
        flies = self._copter.armed(now_s) and self._copter.flying(now_s)
        return not flies or self._copter.mode is CopterMode.GUIDED

    def _promise(self, silence_s: float) -> None:
        self._promised_s = silence_s
        self._copter.parameters.change("UPW_SILENCE_S", silence_s)
