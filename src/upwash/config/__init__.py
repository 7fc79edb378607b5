"""Configuration: TOML files become frozen values, or a ConfigError that names file, key and remedy."""

from __future__ import annotations

from upwash.config.daemon import (
    DaemonConfig,
    DaemonKeysConfig,
    IdentityConfig,
    ImageConfig,
    PeerConfig,
    read_daemon_config,
)
from upwash.config.drone import (
    AutopilotConfig,
    CameraConfig,
    DroneConfig,
    EnergyConfig,
    EventConfig,
    FaultConfig,
    FleetDroneConfig,
    GridConfig,
    HeatConfig,
    HedgeConfig,
    HomeConfig,
    Lie,
    MissionConfig,
    NetworkConfig,
    NoiseConfig,
    PolicyConfig,
    ProbeConfig,
    SafeEnd,
    ServerConfig,
    ServiceConfig,
    TruthConfig,
    VehicleConfig,
    unsigned_port,
)
from upwash.config.drone_file import drone_config, read_drone_config
from upwash.config.fleet import Presence, fleet_of, presences
from upwash.config.fleet_checks import refuse_several
from upwash.config.places import ending, geofence, server_areas, server_position, waypoints
from upwash.config.problems import Document
from upwash.config.reading import convert, impossible_values, read_document
from upwash.config.runtime import RuntimeConfig
from upwash.config.truth import ServerTruth, server_truth
from upwash.config.values import KeysConfig, SettingsTable, is_address, is_on_this_machine

__all__ = [
    "AutopilotConfig",
    "CameraConfig",
    "DaemonConfig",
    "DaemonKeysConfig",
    "Document",
    "DroneConfig",
    "EnergyConfig",
    "EventConfig",
    "FaultConfig",
    "FleetDroneConfig",
    "GridConfig",
    "HeatConfig",
    "HedgeConfig",
    "HomeConfig",
    "IdentityConfig",
    "ImageConfig",
    "KeysConfig",
    "Lie",
    "MissionConfig",
    "NetworkConfig",
    "NoiseConfig",
    "PeerConfig",
    "PolicyConfig",
    "Presence",
    "ProbeConfig",
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
    "fleet_of",
    "geofence",
    "impossible_values",
    "is_address",
    "is_on_this_machine",
    "presences",
    "read_daemon_config",
    "read_document",
    "read_drone_config",
    "refuse_several",
    "server_areas",
    "server_position",
    "server_truth",
    "unsigned_port",
    "waypoints",
]
