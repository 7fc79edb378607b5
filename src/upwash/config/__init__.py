"""Configuration: TOML files become frozen values, or a ConfigError that names file, key and remedy."""

from __future__ import annotations

from upwash.config.battery import finish_by_s, reserve_percent, usable_s
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
from upwash.config.offers import never_offloaded
from upwash.config.places import (
    ending,
    geofence,
    movable_waypoints,
    server_areas,
    server_position,
    stands,
    sweeps_of,
    waypoints,
)
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
    "finish_by_s",
    "fleet_of",
    "geofence",
    "impossible_values",
    "is_address",
    "is_on_this_machine",
    "movable_waypoints",
    "never_offloaded",
    "presences",
    "read_daemon_config",
    "read_document",
    "read_drone_config",
    "refuse_several",
    "reserve_percent",
    "server_areas",
    "server_position",
    "server_truth",
    "stands",
    "sweeps_of",
    "unsigned_port",
    "usable_s",
    "waypoints",
]
