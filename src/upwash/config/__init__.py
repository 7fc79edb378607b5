"""Configuration: TOML files become frozen values, or a ConfigError that names file, key and remedy.

A file is read in this order: `reading` (TOML to plain values), `shorthand` (short forms written out), `convert` (the
types of `values`, `drone`, `world`, `daemon` and `runtime`), `checks` (what no type says). The first problem is
raised. After that every value is possible, and `places`, `flight_times` and `truth` answer what follows from several
keys.

A docstring below a key is its line in docs/configuration-reference.md, and the description of a kind of value is what
an error says was expected: both are for people who write files. Ugly is that msgspec names a wrong value by a path in
its message, which `explanation` has to take apart.
"""

from __future__ import annotations

from upwash.config.checks import never_made_smaller, never_offloaded, only_on_servers
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
    FleetDroneConfig,
    GridConfig,
    MissionConfig,
    NetworkConfig,
    PhotosConfig,
    PolicyConfig,
    SafeEnd,
    SecondLook,
    ServerConfig,
    ServiceConfig,
    VehicleConfig,
    unsigned_port,
)
from upwash.config.drone_file import (
    FASTEST_M_S,
    Presence,
    drone_config,
    fleet_of,
    presences,
    read_drone_config,
    refuse_several,
)
from upwash.config.flight_times import (
    finish_by_s,
    pace_in_numbers,
    reserve_percent,
    told_in_numbers,
    told_pace,
    usable_s,
)
from upwash.config.inventory import ListedServer, read_inventory
from upwash.config.photo_ground import photo_ground
from upwash.config.places import (
    altitudes_above_sea,
    coverage_kept,
    coverage_of,
    demand_map_of,
    demands_kept,
    ending,
    file_notices,
    frame_of,
    geofence,
    is_planned_home,
    leaving,
    movable_waypoints,
    planned_way,
    server_areas,
    server_places,
    server_position,
    stands,
    sweeps_of,
    track_of,
    true_areas,
    true_range_m,
    waypoints,
)
from upwash.config.plan_photos import PhotoLeg, photo_legs
from upwash.config.problems import impossible_values
from upwash.config.reading import Document, convert, read_document
from upwash.config.runtime import RuntimeConfig
from upwash.config.traces import read_battery, read_wind
from upwash.config.truth import ServerTruth, server_truth
from upwash.config.user import UserConfig
from upwash.config.values import (
    HomeConfig,
    KeysConfig,
    PlanFile,
    SettingsTable,
    is_address,
    is_on_this_machine,
)
from upwash.config.world import (
    EnergyConfig,
    EventConfig,
    FaultConfig,
    Lie,
    NoiseConfig,
    ObjectConfig,
    TruthConfig,
)
