"""The configuration files of the emulated programs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from upwash.config import (
    DaemonConfig,
    DaemonKeysConfig,
    DroneConfig,
    IdentityConfig,
    ImageConfig,
    KeysConfig,
    PeerConfig,
    ServerConfig,
    server_truth,
)
from upwash.config.coverage import CoverageFile
from upwash.config.values import PlanFile
from upwash.emulation.request import server_paces
from upwash.support.output_files import write_file


def write_drone_file(file: Path, config: DroneConfig) -> None:
    """Writes the configuration so that reading the file gives it back."""
    _write(file, config)


def write_daemon_file(file: Path, config: DaemonConfig) -> None:
    """Writes the configuration so that reading the file gives it back."""
    _write(file, config)


def daemon_config(
    server: ServerConfig, config: DroneConfig, *, listen: str, peers: Mapping[str, str], keys: KeysConfig
) -> DaemonConfig:
    """The configuration of the daemon that acts as one of the drone's servers."""
    truth = server_truth(server, config.services)
    paces = server_paces(server, config)
    return DaemonConfig(
        listen=listen,
        keys=DaemonKeysConfig(authority=keys.authority, certificate=keys.certificate, key=keys.key),
        images=tuple(
            ImageConfig(
                name=service.name,
                program=service.program,
                pace_s=paces[service.name].call_s,
                start_pace_s=paces[service.name].start_s,
            )
            for service in config.services
            if service.name in paces
        ),
        identities=(
            IdentityConfig(name=server.name, slots=truth.slots, turn_s=truth.turn_s, images=tuple(paces)),
        ),
        peers=tuple(PeerConfig(name=name, address=address) for name, address in peers.items()),
    )


def _write(file: Path, config: DroneConfig | DaemonConfig) -> None:
    tables = _without_nothing(msgspec.to_builtins(config, enc_hook=_as_text))
    write_file(file, tomli_w.dumps(tables).encode())


def _as_text(value: object) -> str:
    if isinstance(value, CoverageFile | PlanFile):
        return str(value.file.absolute())
    if isinstance(value, Path):
        return str(value)
    raise NotImplementedError(f"no text for {value!r}")


def _without_nothing(value: Any) -> Any:
    """The value without the Nones in it, which TOML cannot write."""
    if isinstance(value, dict):
        return {key: _without_nothing(item) for key, item in value.items() if item is not None}
    return [_without_nothing(item) for item in value] if isinstance(value, list | tuple) else value
