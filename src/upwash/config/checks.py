"""What cannot stand in a drone's configuration, beyond what the types say of each value by itself."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from msgspec import Struct

from upwash.config.drone import (
    AutopilotConfig,
    CameraConfig,
    DroneConfig,
    FleetDroneConfig,
    MissionConfig,
    NetworkConfig,
    ServerConfig,
    ServiceConfig,
)
from upwash.config.flight_times import finish_by_s
from upwash.config.places import (
    corners,
    geofence,
    is_planned_home,
    measured_servers,
    row_ends,
    sweeps_of,
    track_of,
    waypoints,
)
from upwash.config.plan_photos import MOST_SPOTS, speed_set_at
from upwash.config.problems import Problem, below, listed, metrics_problems, name_problems, repeated, unknown
from upwash.config.shorthand import is_file
from upwash.config.traces import read_battery, read_goodput_trace, read_service_times, read_wind
from upwash.config.truth import ServerTruth, keys_of, server_truth
from upwash.config.user import user_problems
from upwash.config.values import MDNS, is_address
from upwash.config.world import RADIOS, FaultConfig, TruthConfig
from upwash.core.geo import Position, ground_distance_m
from upwash.core.vehicle.geofence import breached_by_leg, breached_by_position, breached_by_way
from upwash.core.vehicle.track import NEAR_M, Track
from upwash.mavlink.connection import parse_connection
from upwash.plans import FlightPlan

_FARTHEST_M = 100_000.0  # from home: a plan for another field, or one with its coordinates swapped
_HOME = Position(0.0, 0.0)
_WAYS = ("grid", "waypoints_m", "plan")
_SOURCES = ("folder", "device", "topic", "bag", "park_seed", "plug_in")
_LENSES = ("fov_deg", "focal_px", "calibration")
_MOST_DRONES = 1000  # the largest simulation that was tried


def problems(config: DroneConfig) -> Iterator[Problem]:
    """Everything about the configuration that cannot be, though each value by itself could."""
    yield from metrics_problems(config.metrics, config.metrics_hosts)
    if not config.drones:
        yield from _way_problems("mission", config.mission)
    yield from _mission_problems(config.mission, config.services)
    yield from _speed_problems(config)
    yield from _photos_problems(config)
    yield from _autopilot_problems(config.autopilot)
    yield from _lighter_problems(config)
    look, altitude_m = config.mission.second_look, config.mission.altitude_m
    if look is not None and config.mission.plan is None and look.altitude_m >= altitude_m:
        yield (
            "mission.second_look.altitude_m",
            f"{look.altitude_m:g} m, and photos are taken at mission.altitude_m = {altitude_m:g} m: give a lower one",
        )
    yield from _two_answers_problems(config)
    yield from _deadline_problems(config)
    yield from _battery_problems(config)
    yield from _flight_problems(config)
    yield from _camera_problems(config.camera)
    yield from user_problems(config.user)
    if config.event is not None and config.camera.park_seed is not None:
        yield "event", "the photos of camera.park_seed show what is there: leave one of the two out"
    yield from name_problems("service", [service.name for service in config.services])
    yield from name_problems("server", [server.name for server in config.servers])
    yield from _network_problems(config.network)
    if config.network.coverage_map is not None and not measured_servers(config):
        yield (
            "network.coverage_map",
            'no server has range_m = "measured", so there is nothing to keep: leave it out',
        )
    for index, service in enumerate(config.services):
        key = f"service[{index}]"
        yield from _key_problems(f"{key}.local_pace_s", service, service.local_pace_s)
        yield from _key_problems(f"{key}.local_joining_slowdown", service, service.local_joining_slowdown)
        if (part := service.before_sending) is not None:
            named = {name: loss for name, loss in part.loss.items() if name}
            yield from _key_problems(f"{key}.before_sending.loss", service, named)
    for index, server in enumerate(config.servers):
        yield from below(f"server[{index}]", _server_problems(server, config))
    for index, fault in enumerate(config.faults):
        yield from below(f"fault[{index}]", _fault_problems(fault, config.servers))
    if len(config.drones) > _MOST_DRONES:
        count = len(config.drones)
        yield "drone", f"{count} drones: one simulation has at most {_MOST_DRONES}, divide them among files"
    yield from name_problems("drone", [drone.name for drone in config.drones])
    for index, drone in enumerate(config.drones):
        yield from below(f"drone[{index}]", _drone_problems(drone, config))


def never_made_smaller(config: DroneConfig) -> str:
    """Why no request is made smaller before it is sent, though `most_loss` allows it; "" if some may be."""
    most_loss = config.policy.most_loss
    parts = {service.name: service.before_sending for service in config.services if service.before_sending}
    if not most_loss or not config.servers:
        return ""
    if not parts:
        why = "no [[service]] has a before_sending: measure it with `upwash profile detector --photos photos`"
    elif all(min(part.loss.values()) > most_loss for part in parts.values()):
        why = "each before_sending loses more: allow more, or let its part keep more"
    elif all(server.bandwidth_bit_s is None for server in config.servers):
        why = "no [[server]] has a bandwidth_bit_s, which tells what the transfer of a request takes: add it"
    else:
        return ""
    return f"policy.most_loss is {most_loss:g}, and all requests are sent whole: {why}"


def never_offloaded(config: DroneConfig) -> Iterator[str]:
    """A warning for each service that always runs on the drone, as no server is believed to offer it."""
    offered = {name for server in config.servers for name in (*server.processing_s, *server.remote_call_s)}
    for service in config.services if config.servers else ():
        if service.name not in offered and not only_on_servers(service):
            keys = [f"{key} = 0.5" for key in service.local_call_s if key]
            example = f"{{ {', '.join(keys)} }}" if keys else "0.5"
            yield (
                f"{service.name} always runs on the drone, as no [[server]] has a time for it: add what a call takes "
                f"to the servers that offer it, as in remote_call_s = {{ {service.name} = {example} }}"
            )


def only_on_servers(service: ServiceConfig) -> bool:
    """Whether the file gives the service no delay on the drone."""
    return all(call_s == math.inf for call_s in service.local_call_s.values())


def _drone_problems(drone: FleetDroneConfig, config: DroneConfig) -> Iterator[Problem]:
    if drone.name in [server.name for server in config.servers]:
        yield "name", f'"{drone.name}" is a server too: rename one of them'
    if drone.vanishes_s is not None and drone.vanishes_s <= drone.departs_s:
        problem = f"{drone.vanishes_s:g} is not after departs_s = {drone.departs_s:g}: let it vanish later"
        yield "vanishes_s", problem
    if _given(drone, _WAYS):
        yield from _way_problems("", drone)
        if drone.plan is not None and config.mission.home is None:
            yield "plan", "its places count from mission.home, which all drones share: add it"
    elif _given(config.mission, _WAYS):
        yield from _way_problems("", config.mission)
    else:
        yield "", "nowhere to fly: give it a grid, waypoints_m or a plan, or [mission] one for all drones"
    yield from _times_problems("local_call_s", drone.local_call_s, config.services)


def _given(table: Struct, keys: Iterable[str]) -> list[str]:
    return [key for key in keys if getattr(table, key) is not None]


def _way_problems(key: str, table: MissionConfig | FleetDroneConfig) -> Iterator[Problem]:
    found = _given(table, _WAYS)
    if len(found) != 1:
        yield key, f"no single list of waypoints: give one of {listed(_WAYS)}, found {listed(found)}"


def _mission_problems(mission: MissionConfig, services: Sequence[ServiceConfig]) -> Iterator[Problem]:
    if mission.plan is not None and mission.home is None:
        yield "mission.home", f"missing, and {mission.plan.file} names none: add it"
    keys = list(dict.fromkeys(key for service in services for key in service.local_call_s if key))
    if mission.program == "survey" and keys and mission.mode not in keys:
        yield "mission.mode", unknown("profile key", mission.mode, keys)


def _speed_problems(config: DroneConfig) -> Iterator[Problem]:
    mission, key = config.mission, "mission.speed"
    if mission.speed == "given":
        return
    if mission.photos is None:
        yield (
            key,
            '"auto" is for rows, and without mission.photos the drone stops at each waypoint, where the highest '
            "speed is the quickest: leave it out, and give ground_speed_m_s",
        )
    elif any(drone.plan is not None for drone in config.drones):
        yield key, "plans of several drones have speeds of their own: leave it out"
    elif mission.plan is not None and (fixed := speed_set_at(mission.plan.plan, mission.photos)) is not None:
        yield (
            key,
            f"{mission.plan.file}: item {fixed} sets a speed, or photos by time, whose distance is up to the speed: "
            "leave speed out",
        )
    elif mission.photos.every_s is not None:
        yield (
            key,
            "with photos.every_s the speed decides how far photos lie apart: give photos.every_m, or a speed",
        )


def _photos_problems(config: DroneConfig) -> Iterator[Problem]:
    mission, photos = config.mission, config.mission.photos
    if photos is None:
        return
    if mission.waypoints_m is not None and len(mission.waypoints_m) % 2:
        count = len(mission.waypoints_m)
        yield "mission.waypoints_m", f"{count} places: with photos, give the start and the end of each row"
    if mission.order != "given":
        yield "mission.order", 'rows are flown in the order of the file: leave it out, or set "given"'
    if not any(_given(table, ("grid", "waypoints_m")) for table in (mission, *config.drones)):
        return
    step_m, key = photos.step_m(mission.ground_speed_m_s), "mission.photos.every_m"
    if step_m is None:
        yield key, "missing: add a number above 0; only a plan has triggers of its own"
        return
    rows_m = sum(ground_distance_m(*row) for row in row_ends(mission))
    if rows_m / step_m > MOST_SPOTS:
        key = key if photos.every_s is None else "mission.photos.every_s"
        yield key, f"more than {MOST_SPOTS:,} photos of {rows_m:g} m of rows: make it larger"
    if photos.every_s is not None and photos.every_s < config.camera.photo_s:
        yield (
            "mission.photos.every_s",
            f"{photos.every_s:g} s, and a photo takes camera.photo_s = {config.camera.photo_s:g} s: make it larger",
        )
        return
    fastest_m_s = step_m / config.camera.photo_s if config.camera.photo_s else math.inf
    if mission.speed == "given" and photos.every_m is not None and mission.ground_speed_m_s > fastest_m_s:
        yield (
            "mission.ground_speed_m_s",
            f"a photo takes camera.photo_s = {config.camera.photo_s:g} s, so that one every {photos.every_m:g} m "
            f"allows at most {fastest_m_s:.3g} m/s: fly slower, or make photos.every_m larger",
        )


def _lighter_problems(config: DroneConfig) -> Iterator[Problem]:
    mission, services = config.mission, config.services
    if mission.finish_by_s is not None and not mission.lighter:
        yield "mission.lighter", 'missing: finish_by_s needs it, such as lighter = { heavy = "light" }'
    if mission.lighter and finish_by_s(config) is None:
        yield (
            "mission.finish_by_s",
            "missing: say by when, in seconds from arming; or what the battery allows, with vehicle.endurance_s and "
            "mission.reserve_s or reserve_percent; or leave lighter out",
        )
    for asked, lighter in mission.lighter.items():
        key = f"mission.lighter.{asked}"
        if lighter in mission.lighter:
            yield key, f'"{lighter}" has a lighter key itself: name the one at the end for each'
        delays = [
            service.local_call_s
            for service in services
            if asked in service.local_call_s and not only_on_servers(service)
        ]
        if not delays:
            names = dict.fromkeys(name for service in services for name in service.local_call_s if name)
            yield key, unknown("profile key", asked, names)
        for local_call_s in delays:
            if lighter not in local_call_s:
                yield key, unknown("profile key", lighter, [name for name in local_call_s if name != asked])
            elif local_call_s[lighter] >= local_call_s[asked]:
                yield (
                    key,
                    f'"{lighter}" takes {local_call_s[lighter]:g} s on the drone, no less than "{asked}" '
                    f"({local_call_s[asked]:g} s): name one that is faster",
                )


def _two_answers_problems(config: DroneConfig) -> Iterator[Problem]:
    for service in config.services:
        if service.two_answers is None:
            continue
        if only_on_servers(service):
            problem = "the drone cannot give the first answer, as only servers run it: leave this out"
            yield f"service.{service.name}.two_answers", problem
            continue
        first, local_call_s = service.two_answers.first, service.local_call_s
        key, others = f"service.{service.name}.two_answers", [name for name in local_call_s if name != first]
        if first not in local_call_s or not others:
            yield f"{key}.first", unknown("profile key", first, others)
        elif local_call_s[first] >= min(local_call_s[name] for name in others):
            yield (
                f"{key}.first",
                f'"{first}" takes {local_call_s[first]:g} s on the drone, no less than another: name the fastest',
            )
        elif service.two_answers.within_s < local_call_s[first]:
            yield (
                f"{key}.within_s",
                f'{service.two_answers.within_s:g} s are over before "{first}" is computed on the drone '
                f"({local_call_s[first]:g} s): give more",
            )


def _deadline_problems(config: DroneConfig) -> Iterator[Problem]:
    for service in config.services:
        key = f"service.{service.name}.deadline"
        if service.deadline is None:
            continue
        if service.two_answers is not None:
            yield key, "two_answers has a deadline of its own: leave one of the two out"
        if only_on_servers(service):
            yield (
                key,
                "calls that only servers run wait for a server: leave it out, and give within_s to drone.service",
            )
        if config.mission.photos is not None:
            yield key, "photos in flight wait for earlier ones: a deadline goes with calls made one at a time"


def _battery_problems(config: DroneConfig) -> Iterator[Problem]:
    reserve_s, endurance_s = config.mission.reserve_s, config.vehicle.endurance_s
    if reserve_s is not None and endurance_s is not None and reserve_s >= endurance_s:
        problem = (
            f"{reserve_s:g} is no less than vehicle.endurance_s = {endurance_s:g}: nothing is left to fly"
        )
        yield "mission.reserve_s", problem
    if config.heat and config.energy and config.energy.computer_load_w is not None:
        problem = f"heat.load_w = {config.heat.load_w:g} says already what a call adds: leave it out"
        yield "energy.computer_load_w", problem


def _flight_problems(config: DroneConfig) -> Iterator[Problem]:
    vehicle = config.vehicle
    if vehicle.wind_csv is not None:
        read_wind(vehicle.wind_csv)
    if vehicle.battery_csv is not None:
        read_battery(vehicle.battery_csv)
        if vehicle.endurance_s is not None or (config.energy and config.energy.battery_wh is not None):
            beside = "vehicle.endurance_s" if vehicle.endurance_s is not None else "energy.battery_wh"
            yield (
                "vehicle.battery_csv",
                f"{beside} says too how long the battery lasts: leave one of the two out",
            )
    if (track := track_of(vehicle, config.mission)) is not None:
        yield from _track_problems(track, config)


def _track_problems(track: Track, config: DroneConfig) -> Iterator[Problem]:
    key = "vehicle.track_csv"
    if config.drones:
        yield (
            key,
            "a track is one vehicle's, and the file has [[drone]] tables: leave them, or the track, out",
        )
        return
    if any(fault.target == "autopilot" for fault in config.faults):
        yield key, "a fault of the autopilot would take the vehicle off its track: leave one of the two out"
    if config.event is not None:
        yield key, "an answer with a demand would turn the vehicle back: leave [event], or the track, out"
    if track.risen_s(config.mission.altitude_m) is None:
        highest_m = max(place.altitude_m for place in track.places)
        yield (
            key,
            f"it rises to {highest_m:.1f} m, and mission.altitude_m is {config.mission.altitude_m:g}: set that lower,"
            " or give altitudes above home",
        )
    passed_s = 0.0
    for waypoint in waypoints(config.mission):
        at_s = track.passing_s(waypoint.position, after_s=passed_s)
        if at_s is None:
            near_m = track.nearest_m(waypoint.position)
            where, remedy = f"is {near_m:.0f} m from the track", f"give waypoints within {NEAR_M:g} m of it"
            if near_m <= NEAR_M:
                where, remedy = "is not passed after the one before", "give waypoints in the track's order"
            yield key, f"waypoint {waypoint.index} {where}: {remedy}"
            return
        passed_s = at_s


def _camera_problems(camera: CameraConfig) -> Iterator[Problem]:
    found = _given(camera, _SOURCES)
    if camera.bag is not None and camera.topic is not None:
        found.remove("topic")  # it chooses one of the bag's
    if len(found) > 1:
        yield "camera", f"photos from several places: give one of {listed(_SOURCES)}, found {listed(found)}"
    if camera.settings and camera.plug_in is None:
        yield "camera.settings", "only the camera of a plug-in takes some: name it in camera.plug_in"
    given = _given(camera, _LENSES)
    if len(given) > 1:
        yield "camera", f"several lenses: give one of {listed(_LENSES)}, found {listed(given)}"
    if camera.park_seed is not None and given:
        yield f"camera.{given[0]}", "photos of a solar park have a lens of their own: leave the key out"


def _autopilot_problems(autopilot: AutopilotConfig) -> Iterator[Problem]:
    if autopilot.connection is not None:
        try:
            parse_connection(autopilot.connection)
        except ValueError as error:
            yield "autopilot.connection", str(error)
    if autopilot.dead_man_s is not None and autopilot.on_failure == "hold":
        problem = (
            'a vehicle must not hover for ever: set on_failure to "return" or "land", or leave dead_man_s out'
        )
        yield "autopilot.dead_man_s", problem


def _network_problems(network: NetworkConfig) -> Iterator[Problem]:
    key, interfaces = "network.interfaces", network.interfaces
    if network.kind != "networkmanager":
        if interfaces:
            yield key, f'kind = "{network.kind}" uses none: leave them out, or set "networkmanager"'
    elif not interfaces:
        yield key, 'missing: name those that upwash may use, such as interfaces = ["wlan1"]'
    elif network.radios > 1 and len(interfaces) != network.radios:
        count = len(interfaces)
        problem = f"{network.radios} radios on {count} interfaces: name one interface for each"
        yield "network.radios", problem
    for index, name in repeated(list(interfaces)):
        yield f"{key}[{index}]", f'"{name}" a second time: name each interface once'


def plan_problems(mission: MissionConfig, plan: FlightPlan) -> Iterator[Problem]:
    """Everything that keeps the mission's plan from being flown from the mission's home."""
    if plan.above_sea_level is not None and plan.home is not None and not is_planned_home(mission, plan):
        yield (
            f"item {plan.above_sea_level}",
            "its altitude is above sea level, and mission.home is not the plan's home: give it above home",
        )
    places = corners(mission, plan)
    names = ["home", *(f"waypoint {waypoint.index}" for waypoint in places)]
    items = ["plannedHomePosition", *(f"item {waypoint.item}" for waypoint in plan.waypoints)]
    fences = geofence(mission)
    ends = [_HOME, *(waypoint.position for waypoint in places)]
    for name, item, position in zip(names, items, ends, strict=True):
        if ground_distance_m(position, _HOME) > _FARTHEST_M:
            yield item, f"{name} is {ground_distance_m(position, _HOME) / 1000:.0f} km from home: check both"
        if (fence := breached_by_position(fences, position)) is not None:
            yield item, f"{name} is {'outside' if fence.inclusion else 'within'} {fence.name} of the geofence"
    for (start, end), (before, name), item in zip(
        itertools.pairwise(ends), itertools.pairwise(names), items[1:], strict=True
    ):
        if (fence := breached_by_leg(fences, start, end)) is not None:
            verb = "leaves" if fence.inclusion else "crosses"
            yield item, f"the straight way from {before} to {name} {verb} {fence.name} of the geofence"


def order_problems(config: DroneConfig) -> Iterator[Problem]:
    """What keeps one drone's waypoints from being flown in the configured order, as far as the file says."""
    mission = config.mission
    if mission.order in ("given", "by-index"):  # which is given too, of a drone that is none of several
        return
    sweeps = sweeps_of(mission)
    if not sweeps:
        yield (
            "mission.order",
            f"the waypoints of {config.name} form no full grid of rows and columns, so there is nothing to sweep: "
            'leave it out, or set "given"',
        )
    elif isinstance(mission.order, int):
        sweep = sweeps[mission.order]
        places = [_HOME, *(waypoint.position for waypoint in sweep.waypoints)]
        if (fence := breached_by_way(geofence(mission), places)) is not None:
            yield (
                "mission.order",
                f"{sweep}, does not keep {config.name} to {fence.name} of the geofence: "
                'choose another number, or "best-sweep", which leaves out such sweeps',
            )


def _server_problems(server: ServerConfig, config: DroneConfig) -> Iterator[Problem]:
    yield from _place_problems(server, config.mission)
    if server.address == MDNS:
        if config.keys is None:
            problem = 'without [keys] any computer could announce this server: give them, or its "host:port"'
            yield "address", problem
    elif server.address is not None and not is_address(server.address):
        yield "address", f'expected "host:port", "unix:path" or "mdns", found "{server.address}"'
    if server.check_s < server.check_running_s:
        problem = f"{server.check_s:g} is less than check_running_s = {server.check_running_s:g}"
        yield "check_s", f"{problem}: a check that starts the service takes at least as long"
    yield from _times_problems("processing_s", server.processing_s, config.services)
    yield from _times_problems("remote_call_s", server.remote_call_s, config.services)
    if server.times_csv is not None:
        yield from _measured_problems("times_csv", server.times_csv, config.services)
    yield from below("truth", _truth_problems(server.truth, config.services))
    truth, turn_s = server_truth(server, config.services), server.truth.turn_s
    if turn_s is not None and turn_s < truth.join_s:
        problem = f"{turn_s:g} is shorter than truth.join_s = {truth.join_s:g}"
        yield "truth.turn_s", f"{problem}: let a turn last longer than it takes to join"
    if server.truth.peers:
        others = [other.name for other in config.servers if other.name != server.name]
        for name in server.truth.peers:
            if name not in others:
                yield "truth.peers", unknown("other server", name, others)
    if config.services:
        yield from _belief_problems(server, truth, config.services)


def _truth_problems(truth: TruthConfig, services: Sequence[ServiceConfig]) -> Iterator[Problem]:
    yield from _times_problems("processing_s", truth.processing_s, services)
    yield from _times_problems("remote_call_s", truth.remote_call_s, services)
    names = [service.name for service in services]
    for image in truth.images or ():
        if image not in names:
            yield "images", unknown("service", image, names)
    if truth.service_csv is not None:
        yield from _measured_problems("service_csv", truth.service_csv, services)
    if truth.goodput_csv is not None:
        read_goodput_trace(truth.goodput_csv)
        if truth.radio != "fixed":
            yield "radio", "goodput_csv says how fast the link is: leave one of the two out"
    if truth.radio not in RADIOS and not is_file(Path(truth.radio)):
        yield "radio", f"no file {truth.radio}: give {listed(RADIOS)} or a csv file of goodput by distance"


def _measured_problems(key: str, file: Path, services: Sequence[ServiceConfig]) -> Iterator[Problem]:
    for operation in read_service_times(file):
        if not any(keys_of(operation, services)):
            known = listed(
                sorted({key or service.name for service in services for key in service.local_call_s})
            )
            yield key, f"{operation} is no operation with a local_call_s: name one of {known}"


def _place_problems(server: ServerConfig, mission: MissionConfig) -> Iterator[Problem]:
    metres = [server.east_m, server.north_m]
    degrees = [server.latitude_deg, server.longitude_deg]
    given = [value is not None for value in metres + degrees]
    needed = _why_placed(server)
    if not any(given) and not needed:
        return
    if not any(given) and server.believed_range_m is None:
        yield "east_m", f"missing, with north_m: {needed} counts from where the server stands"
    elif given not in ([True, True, False, False], [False, False, True, True]):
        yield "east_m", "no single place: give either east_m and north_m, or latitude_deg and longitude_deg"
    elif mission.home is None and server.east_m is None:
        yield "latitude_deg", "degrees need mission.home: add it, or give east_m and north_m"


def _why_placed(server: ServerConfig) -> str:
    """The key that needs the server's place; "" if none does."""
    if server.believed_range_m is not None:
        return "range_m"
    if server.truth.range_m is not None:
        return "truth.range_m"
    if server.truth.goodput_csv is not None:
        return "truth.goodput_csv"
    return "" if server.truth.radio == "fixed" else "truth.radio"


def _times_problems(
    key: str, times: Mapping[str, Mapping[str, float]], services: Sequence[ServiceConfig]
) -> Iterator[Problem]:
    by_name = {service.name: service for service in services}
    for name, by_key in times.items():
        if name in by_name:
            yield from _key_problems(key, by_name[name], by_key)
        else:
            yield key, unknown("service", name, by_name)


def _key_problems(key: str, service: ServiceConfig, by_key: Mapping[str, float]) -> Iterator[Problem]:
    known = list(service.local_call_s)
    for name in by_key:
        if name in known:
            continue
        if name == "":
            problem = f"one number, but {service.name} has profile keys: give one for each of {listed(known)}"
            yield key, problem
        elif known == [""]:
            yield key, f'"{name}" has no local_call_s: {service.name} has no profile keys, give one number'
        else:
            yield key, unknown(f"profile key of {service.name}", name, known)


def _belief_problems(
    server: ServerConfig, truth: ServerTruth, services: Sequence[ServiceConfig]
) -> Iterator[Problem]:
    """Whether every call that may go to the server has a believed delay and, in simulation, a true one."""
    named = {*server.processing_s, *server.remote_call_s}
    offered = [service for service in services if service.name in named]
    if not offered:
        yield "remote_call_s", "missing: give remote_call_s, or processing_s and bandwidth_bit_s (eq. 3.1)"
    images = set(truth.images)
    for service in offered:
        for key in service.local_call_s:
            operation = f"{service.name}[{key}]" if key else service.name
            if key not in server.remote_call_s.get(service.name, {}):
                if key not in server.processing_s.get(service.name, {}):
                    yield "remote_call_s", f"nothing for {operation}: add it, or its processing_s"
                elif server.bandwidth_bit_s is None:
                    yield "bandwidth_bit_s", f"missing, and {operation} has no remote_call_s: add one of them"
            if service.name in images:
                yield from _true_call_problems(server, truth, service, key, operation)


def _true_call_problems(
    server: ServerConfig, truth: ServerTruth, service: ServiceConfig, key: str, operation: str
) -> Iterator[Problem]:
    if key in truth.remote_call_s.get(service.name, {}):
        return
    if key not in truth.processing_s.get(service.name, {}):
        needs = f'radio = "{truth.radio}"' if truth.goodput_csv is None else "goodput_csv"
        yield "truth.processing_s", f"nothing for {operation}, as {needs} needs it: add it"
    elif truth.service_times:  # which without a way's goodput have the way in them
        return
    elif truth.radio == "fixed" and truth.goodput_csv is None and server.bandwidth_bit_s is None:
        yield "bandwidth_bit_s", f"missing, and {operation} has no truth.remote_call_s: add one of them"


def _fault_problems(fault: FaultConfig, servers: Sequence[ServerConfig]) -> Iterator[Problem]:
    names = [server.name for server in servers]
    targets = [*names, *(f"link:{name}" for name in names), "autopilot", "computer"]
    if fault.target not in targets:
        yield "target", unknown("target", fault.target, targets)
    if fault.to_s < fault.from_s:
        yield "to_s", f"{fault.to_s:g} lies before from_s = {fault.from_s:g}: let it end later"
