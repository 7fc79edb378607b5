"""What a daemon's start or reload would refuse, found without a daemon."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from upwash.config.daemon import DaemonConfig, DaemonKeysConfig, read_daemon_config
from upwash.errors import UpwashError
from upwash.launch.confinement import Confinement
from upwash.launch.daemon_keys import DaemonKeys
from upwash.launch.daemon_reload import needs_restart
from upwash.launch.daemon_services import DaemonServices
from upwash.launch.in_force import CONFIGURATION, KEYS


async def check(file: Path, running: Path | None) -> Mapping[str, str]:
    """By its part what is refused of a daemon's configuration, and why; against the file of a running one, if given.

    Keys are left out where none of their files are, such as on a computer that only keeps configurations.
    """
    refused: dict[str, str] = {}
    try:
        config = read_daemon_config(file)
        if running is not None:
            refused |= _restarts(read_daemon_config(running), config)
        await DaemonServices.found(config, Confinement())
    except UpwashError as error:
        return refused | {CONFIGURATION: str(error)}
    try:
        if config.keys is None or any(each.exists() for each in _files(config.keys)):
            DaemonKeys(config)
    except UpwashError as error:
        refused[KEYS] = str(error)
    return refused


def _restarts(old: DaemonConfig, new: DaemonConfig) -> dict[str, str]:
    why = "; ".join(needs_restart(old, new))
    return {"without a restart": why} if why else {}


def _files(keys: DaemonKeysConfig) -> tuple[Path, ...]:
    return keys.authority, keys.certificate, keys.key
