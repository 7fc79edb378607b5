"""Configuration: TOML files become frozen values, or a ConfigError that names file, key and remedy."""

from __future__ import annotations

from upwash.config.daemon import (
    DaemonConfig,
    DaemonKeysConfig,
    IdentityConfig,
    ImageConfig,
    read_daemon_config,
)
from upwash.config.drone import (
    AutopilotConfig,
    CameraConfig,
    DroneConfig,
    FaultConfig,
    GridConfig,
    HeatConfig,
    HomeConfig,
    MissionConfig,
    NetworkConfig,
    NoiseConfig,
    PolicyConfig,
    SafeEnd,
    ServerConfig,
    ServerTruth,
    ServiceConfig,
    TruthConfig,
    VehicleConfig,
    ending,
    geofence,
    server_area,
    server_position,
    server_truth,
    waypoints,
)
from upwash.config.drone_file import drone_config, read_drone_config
from upwash.config.problems import Document
from upwash.config.reading import convert, impossible_values, read_document
from upwash.config.runtime import RuntimeConfig
from upwash.config.values import KeysConfig, SettingsTable, is_address, is_on_this_machine

__all__ = [
    "AutopilotConfig",
    "CameraConfig",
    "DaemonConfig",
    "DaemonKeysConfig",
    "Document",
    "DroneConfig",
    "FaultConfig",
    "GridConfig",
    "HeatConfig",
    "HomeConfig",
    "IdentityConfig",
    "ImageConfig",
    "KeysConfig",
    "MissionConfig",
    "NetworkConfig",
    "NoiseConfig",
    "PolicyConfig",
    "RuntimeConfig",
    "SafeEnd",
    "ServerConfig",
    "ServerTruth",
    "ServiceConfig",
    "SettingsTable",
    "TruthConfig",
    "VehicleConfig",
    "convert",
    "drone_config",
    "ending",
    "geofence",
    "impossible_values",
    "is_address",
    "is_on_this_machine",
    "read_daemon_config",
    "read_document",
    "read_drone_config",
    "server_area",
    "server_position",
    "server_truth",
    "waypoints",
]
