"""The drone's configuration: what a file means, and what is refused."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import msgspec
import pytest

from upwash.config.drone import AutopilotConfig, DroneConfig, GridConfig, MissionConfig
from upwash.config.drone_file import read_drone_config
from upwash.config.flight_times import told_in_numbers
from upwash.config.places import server_position, waypoints
from upwash.config.truth import server_truth
from upwash.core.geo import Position
from upwash.errors import ConfigError

FULL = (Path(__file__).parent / "full.toml").read_text()
_RESERVE = "reserve_percent = 25.0"
_HURRIED = 'finish_by_s = 900\nlighter = {{ {} = "{}" }}'
_USER = "[user]"
_WEB, _TAK = "user.webhook", "user.cursor_on_target"
REFUSED_OF_USER = [
    ('webhook = "ftp://h/x"', _WEB, '"https://HOST/PATH"'),
    ('webhook = "https:///x"', _WEB, '"https://HOST/PATH"'),
    ('webhook = "https://h:port/x"', _WEB, '"https://HOST/PATH"'),
    ('webhook = "https://h/a b"', _WEB, "ASCII"),
    ('webhook = "https://h/\\u0007"', _WEB, "ASCII"),
    (f'webhook = "https://{"h" * 64}.org/x"', _WEB, '"https://HOST/PATH"'),
    ('webhook = "https://me:secret@h/x"', _WEB, "token_file"),
    ('webhook = "http://h/x"\ntoken_file = "token"', _WEB, "use https"),
    ('token_file = "token"', "user.token_file", "give webhook"),
    ('cursor_on_target = "239.2.3.1:6969"', _TAK, '"udp://HOST:PORT"'),
    ('cursor_on_target = "udp://239.2.3.1"', _TAK, '"udp://HOST:PORT"'),
    ('cursor_on_target = "tcp://h:8087"', _TAK, '"udp://HOST:PORT"'),
]
SHORT = (Path(__file__).parent / "several.toml").read_text()


def written(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "drone.toml"
    file.write_text(text)
    return file


def read(tmp_path: Path, text: str) -> DroneConfig:
    return read_drone_config(written(tmp_path, text))


def test_every_printed_value_is_read(tmp_path: Path) -> None:
    config = read(tmp_path, FULL)
    server = config.servers[0]
    assert (config.name, config.seed) == ("heron", 7)
    assert config.mission.grid == GridConfig(columns=11, rows=11, spacing_m=20.0)
    assert config.mission.home is not None
    assert config.mission.home.longitude_deg == 22.9507
    assert config.autopilot == AutopilotConfig(
        connection="udpout:127.0.0.1:14550",
        signing_key=tmp_path / "keys" / "signing.key",
        on_failure="land",
        dead_man_s=20.0,
    )
    assert config.mission.reserve_percent == 25.0
    assert config.network.kind == "wired"
    assert config.services[0].local_call_s == {"light": 3.0, "heavy": 10.0}
    assert config.services[0].local_pace_s == {"light": 3.0}
    assert config.services[0].local_joining_slowdown == {"light": 0.1}
    assert (server.network, server.address, server.bandwidth_bit_s) == ("s1-net", "10.10.1.1:7070", 54e6)
    assert server.remote_call_s == {"detector": {"light": 0.3, "heavy": 0.7}}
    assert server.processing_s == {"detector": {"light": 0.2, "heavy": 0.6}}
    assert server.truth.remote_call_s == {"detector": {"light": 0.3, "heavy": 7.7}}
    assert server.truth.leave_s == 1.5
    assert config.heat is not None
    assert config.faults[0].to_s == 420.0


def test_a_reserve_of_seconds_leaves_something_to_fly(tmp_path: Path) -> None:
    vehicle = "\n[vehicle]\nendurance_s = 1200.0\n"
    text = SHORT.replace("[mission]", "[mission]\nreserve_s = 60.0") + vehicle
    assert read(tmp_path, text).mission.reserve_s == 60.0
    with pytest.raises(
        ConfigError, match=r"mission.reserve_s: 1200 is no less than vehicle.endurance_s = 1200"
    ):
        read(tmp_path, text.replace("60.0", "1200.0"))


def test_what_a_file_leaves_out_has_the_printed_defaults(tmp_path: Path) -> None:
    full, short = read(tmp_path, FULL), read(tmp_path, SHORT)
    assert (short.name, short.seed) == ("drone", 1)
    thesis = {"name": "location-aware", "blacklist_s": 60.0}
    assert msgspec.structs.replace(short.policy, **thesis) == full.policy
    assert told_in_numbers(short.vehicle) == full.vehicle
    assert short.noise == full.noise
    assert (short.mission.program, short.mission.mode) == ("survey", "heavy")
    assert (short.mission.altitude_m, short.mission.ground_speed_m_s) == (20.0, 4.0)
    assert short.services[0].request_bytes == 425_000
    assert (short.servers[0].check_s, short.servers[0].check_running_s) == (11.5, 3.5)
    assert short.network.kind == "wired"
    assert short.servers[0].network == "s1"
    assert (short.heat, short.keys, short.faults) == (None, None, ())
    assert short.autopilot == AutopilotConfig(connection=None, on_failure="return")
    assert (short.mission.plan, short.mission.reserve_percent) == (None, None)


def test_paths_count_from_the_files_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path, FULL.replace('program = "survey"', 'program = "missions/mine.py:fly"'))
    monkeypatch.chdir(tmp_path)
    config = read_drone_config(Path("drone.toml"))
    assert config.keys is not None
    assert config.keys.authority == tmp_path / "keys/authority.pem"
    assert config.keys.key == Path("/etc/upwash/heron.key")
    assert config.camera.folder == tmp_path / "photos"
    assert config.mission.program == f"{tmp_path}/missions/mine.py:fly"


def test_a_radio_table_counts_from_the_files_folder(tmp_path: Path) -> None:
    (tmp_path / "goodput.csv").write_text("distance_m,goodput_bit_s\n")
    config = read(tmp_path, FULL.replace('radio = "fixed"', 'radio = "goodput.csv"'))
    assert config.servers[0].truth.radio == str(tmp_path / "goodput.csv")


def test_times_are_written_by_service_and_key_in_any_shorthand(tmp_path: Path) -> None:
    config = read(tmp_path, SHORT)
    assert config.services[1].local_call_s == {"": 1.5}
    assert config.servers[0].remote_call_s == {"detector": {"light": 0.3, "heavy": 0.7}, "counter": {"": 0.2}}
    assert config.servers[1].processing_s == {"detector": {"light": 0.2, "heavy": 0.6}}


def test_one_number_is_the_time_of_everything_beneath(tmp_path: Path) -> None:
    nested = "{ detector = { light = 0.3, heavy = 0.7 }, counter = 0.2 }"
    for written, detector_s in (("0.4", 0.4), ("{ detector = 0.6, counter = 0.4 }", 0.6)):
        server = read(tmp_path, SHORT.replace(nested, written)).servers[0]
        detector = {"light": detector_s, "heavy": detector_s}
        assert server.remote_call_s == {"detector": detector, "counter": {"": 0.4}}
    text = SHORT.replace("{ light = 3.0, heavy = 10.0 }", "3").replace("{ light = 0.2, heavy = 0.6 }", "0.2")
    times_s = read(tmp_path, text.replace(nested, "0.4")).servers[1].processing_s
    assert times_s == {"detector": {"": 0.2}, "counter": {"": 0.2}}


def test_a_keys_time_is_that_of_each_service_which_has_the_key(tmp_path: Path) -> None:
    text = SHORT.replace("local_call_s = 1.5", "local_call_s = { light = 1.5, dark = 2.0 }")
    nested = "{ detector = { light = 0.3, heavy = 0.7 }, counter = 0.2 }"
    written = "{ light = 0.3, heavy = 0.7, dark = 0.5, counter = { light = 0.1 } }"
    text = text.replace("processing_s = {", "processing_s = { dark = 0.4,")
    server = read(tmp_path, text.replace(nested, written)).servers[0]
    assert server.remote_call_s == {
        "detector": {"light": 0.3, "heavy": 0.7},
        "counter": {"light": 0.1, "dark": 0.5},
    }


def test_a_flat_time_stands_beside_a_nested_one_in_either_order(tmp_path: Path) -> None:
    nested = "{ detector = { light = 0.3, heavy = 0.7 }, counter = 0.2 }"
    for mixed in (
        "{ light = 0.3, detector = { heavy = 0.7 } }",
        "{ detector = { heavy = 0.7 }, light = 0.3 }",
    ):
        config = read(tmp_path, SHORT.replace(nested, mixed))
        assert config.servers[0].remote_call_s == {"detector": {"light": 0.3, "heavy": 0.7}}


def test_what_is_true_is_what_is_believed_unless_told(tmp_path: Path) -> None:
    config = read(tmp_path, SHORT)
    truth = server_truth(config.servers[0], config.services)
    assert (truth.join_s, truth.start_s, truth.slots, truth.radio) == (3.5, 8.0, "auto", "fixed")
    assert truth.images == ("detector", "counter")
    assert truth.remote_call_s == config.servers[0].remote_call_s


@pytest.mark.parametrize(("written", "turn_s"), [("turn_s = 5", 5.0), ("turn_s = inf", math.inf), ("", 30.0)])
def test_a_turn_lasts_30_s_or_as_told_and_may_have_no_end(
    tmp_path: Path, written: str, turn_s: float
) -> None:
    """By itself a default of 30 s is not too short for a network that takes longer to join."""
    join_s = 3.5 if written else 40.0
    config = read(tmp_path, SHORT + f"[server.truth]\njoin_s = {join_s}\n{written}\n")
    assert server_truth(config.servers[1], config.services).turn_s == turn_s


def test_a_true_time_replaces_only_the_believed_one_of_its_operation(tmp_path: Path) -> None:
    config = read(tmp_path, SHORT + "[server.truth]\nremote_call_s = { heavy = 7.7 }\njoin_s = 0\n")
    truth = server_truth(config.servers[1], config.services)
    assert truth.remote_call_s == {"detector": {"heavy": 7.7}}
    assert truth.processing_s == {"detector": {"light": 0.2, "heavy": 0.6}}
    assert truth.join_s == 0.0


def test_a_radio_or_a_true_processing_time_replaces_the_believed_delay(tmp_path: Path) -> None:
    truth = 'remote_call_s = { light = 0.3, heavy = 7.7 }\nradio = "fixed"'
    by_radio = read(tmp_path, FULL.replace(truth, 'radio = "disc54"'))
    assert server_truth(by_radio.servers[0], by_radio.services).remote_call_s == {}
    by_processing = read(tmp_path, FULL.replace(truth, "processing_s = { heavy = 7.6 }"))
    told = server_truth(by_processing.servers[0], by_processing.services)
    transfer_s = 8 * 425_500 / 54e6
    assert told.remote_call_s == {"detector": {"light": 0.3, "heavy": pytest.approx(7.6 + transfer_s)}}
    assert told.processing_s == {"detector": {"light": 0.2, "heavy": 7.6}}


def test_a_server_stands_where_metres_or_degrees_say(tmp_path: Path) -> None:
    in_metres = read(tmp_path, FULL)
    assert server_position(in_metres.servers[0], in_metres.mission.home) == Position(80.0, 80.0)
    in_degrees = read(
        tmp_path,
        FULL.replace("east_m = 80.0\nnorth_m = 80.0", "latitude_deg = 39.3676\nlongitude_deg = 22.9507"),
    )
    place = server_position(in_degrees.servers[0], in_degrees.mission.home)
    assert place.east_m == pytest.approx(0.0)
    assert place.north_m == pytest.approx(111.02, abs=0.01)


@pytest.mark.parametrize(
    ("start", "alternate", "expected"),
    [
        ("top-left", True, [(0, 10), (10, 10), (20, 10), (20, 0), (10, 0), (0, 0)]),
        ("top-left", False, [(0, 10), (10, 10), (20, 10), (0, 0), (10, 0), (20, 0)]),
        ("top-right", True, [(20, 10), (10, 10), (0, 10), (0, 0), (10, 0), (20, 0)]),
        ("bottom-left", True, [(0, 0), (10, 0), (20, 0), (20, 10), (10, 10), (0, 10)]),
        ("bottom-right", False, [(20, 0), (10, 0), (0, 0), (20, 10), (10, 10), (0, 10)]),
    ],
)
def test_a_grid_is_flown_row_by_row_away_from_its_start(
    start: Any, alternate: bool, expected: list[tuple[float, float]]
) -> None:
    grid = GridConfig(columns=3, rows=2, spacing_m=10, start=start, rows_alternate=alternate)
    flown = waypoints(MissionConfig(grid=grid, altitude_m=30))
    assert [(place.position.east_m, place.position.north_m) for place in flown] == expected
    assert [place.index for place in flown] == list(range(6))
    assert {place.position.altitude_m for place in flown} == {30}


def test_the_thesis_grid_has_legs_of_20_m_only(tmp_path: Path) -> None:
    flown = [place.position for place in waypoints(read(tmp_path, FULL).mission)]
    legs = [math.dist((a.east_m, a.north_m), (b.east_m, b.north_m)) for a, b in itertools.pairwise(flown)]
    assert len(flown) == 121
    assert set(legs) == {20.0}


def test_listed_waypoints_are_flown_as_listed(tmp_path: Path) -> None:
    first, second = waypoints(read(tmp_path, SHORT).mission)
    assert (first.position, second.position) == (Position(0, 0, 20), Position(20, 0, 20))


REFUSED = [
    ('metrics = "127.0.0.1:9100"', 'metrics = "127.0.0.1"', "metrics", "host:port"),
    *((_USER, f"{_USER}\n{line}", key, named) for line, key, named in REFUSED_OF_USER),
    # old text, new text, key, what the message has to name
    ("range_m = 100.0", "range_m = 0", "server[0].range_m", 'above 0, in metres, or "measured", found 0'),
    (
        "range_m = 100.0",
        "range_m = -5.5",
        "server[0].range_m",
        'above 0, in metres, or "measured", found -5.5',
    ),
    ("range_m = 100.0", "range_m = inf", "server[0].range_m", "a finite number"),
    ("range_m = 100.0", "range_m = nan", "server[0].range_m", "a finite number"),
    (
        "range_m = 100.0",
        'range_m = "far"',
        "server[0].range_m",
        'above 0, in metres, or "measured", found "far"',
    ),
    ("range_m = 100.0", "", "server[0].range_m", "missing: add a number above 0"),
    ("range_m = 100.0", "rangem = 100.0", "server[0].rangem", 'did you mean "range_m"?'),
    ("range_m = 100.0", "quux = 1", "server[0].quux", "allowed: name, east_m, north_m"),
    ("seed = 7", "seed = 1e3", "seed", "an integer, found 1000.0"),
    ("seed = 7", f"seed = {2**64}", "seed", "fits 64 bits"),
    ("seed = 7", "sede = 7", "sede", 'did you mean "seed"?'),
    ('name = "heron"', 'name = ""', "name", "letters, digits"),
    ('name = "heron"', 'name = "grey heron"', "name", "letters, digits"),
    ('name = "heron"', 'name = "heron\\n"', "name", "letters, digits"),
    ('name = "s1"', 'name = "s/1"', "server[0].name", "letters, digits"),
    ('name = "detector"', "name = 3", "service[0].name", "letters, digits"),
    ("ground_speed_m_s = 4.0", "ground_speed_m_s = 0", "mission.ground_speed_m_s", "above 0"),
    ("altitude_m = 20.0", "altitude_m = -1", "mission.altitude_m", "above 0"),
    ("columns = 11", "columns = 0", "mission.grid.columns", "from 1 to 1000"),
    (
        'start = "top-left"',
        'start = "middle"',
        "mission.grid.start",
        '"top-left", "top-right", found "middle"',
    ),
    ("rows_alternate = true", "rows_alternate = 1", "mission.grid.rows_alternate", "true or false, found 1"),
    ("latitude_deg = 39.3666", "latitude_deg = 93", "mission.home.latitude_deg", "from -90 to 90"),
    ("grid = {", "plan = 3\ngrid = {", "mission.plan", "a plan's path"),
    ("grid = {", "waypoints_m = [[0, 0]]\ngrid = {", "mission", "found grid, waypoints_m"),
    ("grid = {", "#", "mission", "give one of grid, waypoints_m, plan, found none"),
    ("reserve_percent = 25.0", "reserve_percent = 100", "mission.reserve_percent", "above 0 and below 100"),
    ("reserve_percent = 25.0", "reserve_s = -1", "mission.reserve_s", "at least 0"),
    ("reserve_percent = 25.0", "reserve_percent = 0", "mission.reserve_percent", "above 0 and below 100"),
    ('on_failure = "land"', 'on_failure = "dance"', "autopilot.on_failure", '"return"'),
    ('on_failure = "land"', 'on_failure = "hold"', "autopilot.dead_man_s", "hover for ever"),
    ("dead_man_s = 20.0", "dead_man_s = 2.0", "autopilot.dead_man_s", "from 5 to 600"),
    ("grid = {", "waypoints_m = [] #", "mission.waypoints_m", "at least one"),
    ("grid = {", "waypoints_m = [[0, 0], [1]] #", "mission.waypoints_m[1]", "[east, north] in metres"),
    ('mode = "heavy"', 'mode = "hevy"', "mission.mode", 'did you mean "heavy"? allowed: light, heavy'),
    ("acceleration_m_s2 = 1.0", "acceleration_m_s2 = 0", "vehicle.acceleration_m_s2", "above 0"),
    ("takeoff_s = 10.0", "takeoff_s = -1", "vehicle.takeoff_s", "at least 0"),
    ("takeoff_s = 10.0", 'profile = "plane"', "vehicle.profile", '"arducopter"'),
    ('connection = "udpout:127.0.0.1:14550"', 'connection = ""', "autopilot.connection", "not empty"),
    ('kind = "wired"', 'kind = "wifi"', "network.kind", '"stand-in", "wired"'),
    ('kind = "wired"', 'kind = "networkmanager"', "network.interfaces", 'such as interfaces = ["wlan1"]'),
    ('kind = "wired"', 'kind = "wired"\ninterfaces = ["wlan1"]', "network.interfaces", "leave them out"),
    (
        'kind = "wired"',
        'kind = "networkmanager"\ninterfaces = ["wlan1", "wlan1"]',
        "network.interfaces[1]",
        "a second time",
    ),
    (
        'kind = "wired"',
        'kind = "networkmanager"\ninterfaces = ["wlan 1"]',
        "network.interfaces[0]",
        "the name of a network interface",
    ),
    ('kind = "wired"', 'kind = "wired"\nradios = 3', "network.radios", "1 or 2"),
    (
        'kind = "wired"',
        'kind = "networkmanager"\ninterfaces = ["wlan1"]\nradios = 2',
        "network.radios",
        "2 radios on 1 interfaces",
    ),
    ('authority = "keys/authority.pem"', "authority = 3", "keys.authority", "a file's path"),
    ('authority = "keys/authority.pem"', 'authority = ""', "keys.authority", "a file's path"),
    ("photo_s = 1.0", "photo_s = -1.0", "camera.photo_s", "at least 0"),
    ("photo_s = 1.0", "device = -1", "camera.device", "a video device's number, such as 0, or its path"),
    ("photo_s = 1.0", "device = true", "camera.device", "a video device's number, such as 0, or its path"),
    ("photo_s = 1.0", "fov_deg = 200", "camera.fov_deg", "a number from 1 to 170, in degrees"),
    ("photo_s = 1.0", "photo_px = [4000, 0]", "camera.photo_px[1]", "an integer from 1 to 100,000"),
    (
        "altitude_m = 20.0",
        'speed = "auto"',
        "mission.speed",
        "without mission.photos the drone stops at each waypoint",
    ),
    ("photo_s = 1.0", "park_seed = 1.5", "camera.park_seed", "an integer of at least 0"),
    (
        "photo_s = 1.0",
        "park_seed = 1",
        "camera",
        "give one of folder, device, topic, bag, park_seed, plug_in, found folder, park_seed",
    ),
    (
        'name = "location-aware"',
        'name = "greedy"',
        "policy.name",
        '"opportunistic", or a class of your own, such as "mine.py:Class", found "greedy"',
    ),
    ("gain_switch = 0.25", "gain_switch = 1.1", "policy.gain_switch", "from 0 to 1, found 1.1"),
    ("gain_wait = 0.25", "gain_wait = -0.1", "policy.gain_wait", "from 0 to 1"),
    ("period_s = 1.0", "period_s = 0", "policy.period_s", "above 0"),
    ("blacklist_s = 60.0", "blacklist_s = -60", "policy.blacklist_s", "at least 1"),
    ("services:Detector", "services:", "service[0].program", "package.module:Class"),
    ("request_bytes = 425_000", "request_bytes = -1", "service[0].request_bytes", "at least 0"),
    ("local_call_s = { light = 3.0, heavy = 10.0 }", "", "service[0].local_call_s", "missing: add seconds"),
    ("{ light = 3.0, heavy = 10.0 }", "{}", "service[0].local_call_s", "one for each profile key"),
    (_RESERVE, "finish_by_s = 900", "mission.lighter", "finish_by_s needs it"),
    (_RESERVE, "finish_by_s = 0", "mission.finish_by_s", "a number above 0"),
    (_RESERVE, 'lighter = { heavy = "light" }', "mission.finish_by_s", "say by when"),
    (
        _RESERVE,
        'lighter = { heavy = "light" }',
        "mission.finish_by_s",
        "vehicle.endurance_s and mission.reserve_s",
    ),
    (_RESERVE, 'finish_by_s = 900\nlighter = "light"', "mission.lighter", "each with its lighter one"),
    (_RESERVE, _HURRIED.format("hevy", "light"), "mission.lighter.hevy", 'did you mean "heavy"?'),
    (_RESERVE, _HURRIED.format("heavy", "tiny"), "mission.lighter.heavy", "allowed: light"),
    (_RESERVE, _HURRIED.format("light", "heavy"), "mission.lighter.light", "name one that is faster"),
    (_RESERVE, _HURRIED.format("heavy", "heavy"), "mission.lighter.heavy", "has a lighter key itself"),
    ("{ light = 3.0, heavy = 10.0 }", "true", "service[0].local_call_s", "seconds of at least 0"),
    ("light = 3.0, heavy", "light = -3.0, heavy", "service[0].local_call_s", '"light": -3.0'),
    ("local_pace_s = { light", "local_pace_s = { lihgt", "service[0].local_pace_s", 'did you mean "light"?'),
    (
        "local_joining_slowdown = { light",
        "local_joining_slowdown = { lihgt",
        "service[0].local_joining_slowdown",
        'did you mean "light"?',
    ),
    ("{ light = 0.1 }", "{ light = -0.1 }", "service[0].local_joining_slowdown", "at least 0"),
    ("[[server]]", "[[service]]\nname='detector'\nlocal_call_s=1\n[[server]]", "service[1].name", "its own"),
    (
        "[server.truth]",
        '[[server]]\nname="s1"\neast_m=0\nnorth_m=0\nrange_m=1\nremote_call_s={light=1,heavy=1}\n[server.truth]',
        "server[1].name",
        'a second server named "s1"',
    ),
    (
        'name = "s1"',
        'name = "local"',
        "server[0].name",
        "stands for the drone itself in results: rename the server",
    ),
    ("[[server]]", "[[server]]\nlatitude_deg = 39.0", "server[0].east_m", "either east_m and north_m, or"),
    ("north_m = 80.0", "", "server[0].east_m", "either east_m and north_m, or"),
    ("10.10.1.1:7070", "10.10.1.1", "server[0].address", "host:port"),
    ("10.10.1.1:7070", "10.10.1.1:70707", "server[0].address", "host:port"),
    ("check_s = 11.5", "check_s = 1", "server[0].check_s", "check_running_s = 3.5"),
    ("bandwidth_bit_s = 54e6", "bandwidth_bit_s = 0", "server[0].bandwidth_bit_s", "above 0"),
    ("{ light = 0.2, heavy = 0.6 }", "{ detectr = { light = 1 } }", "server[0].processing_s", '"detector"?'),
    ("{ light = 0.2, heavy = 0.6 }", "{ lihgt = 0.2 }", "server[0].processing_s", 'did you mean "light"?'),
    ("{ light = 0.3, heavy = 0.7 }", "{ night = 0.3 }", "server[0].remote_call_s", "allowed: light, heavy"),
    ("{ light = 0.3, heavy = 0.7 }", "{ light = 'x' }", "server[0].remote_call_s", "seconds of at least 0"),
    ("{ light = 0.3, heavy = 0.7 }", "'x'", "server[0].remote_call_s", 'found "x"'),
    ("{ light = 0.3, heavy = 7.7 }", "{ detector = { light = -1 } }", "server[0].truth.remote_call_s", "-1"),
    ("{ light = 0.3, heavy = 7.7 }", "{ night = 1 }", "server[0].truth.remote_call_s", "light, heavy"),
    ('radio = "fixed"', 'radio = "disk54"', "server[0].truth.radio", "fixed, disc54, disc12 or a csv file"),
    ("slots = 1", "slots = 0", "server[0].truth.slots", 'at least 1, or "auto", found 0'),
    ("slots = 1", 'slots = "many"', "server[0].truth.slots", 'at least 1, or "auto", found "many"'),
    ("slots = 1", "turn_s = 4.9", "server[0].truth.turn_s", "at least 5, in seconds, or inf"),
    ("slots = 1", "turn_s = -inf", "server[0].truth.turn_s", "a finite number"),
    (
        "join_s = 3.5",
        "join_s = 5.1\nturn_s = 5",
        "server[0].truth.turn_s",
        "truth.join_s = 5.1: let a turn last",
    ),
    ("leave_s = 1.5", "leave_s = inf", "server[0].truth.leave_s", "a finite number"),
    ('images = ["detector"]', 'images = ["dtector"]', "server[0].truth.images", 'did you mean "detector"?'),
    ("join_s = 3.5", "join_s = -1", "server[0].truth.join_s", "at least 0"),
    ("leave_s = 1.5", "leave_s = -1", "server[0].truth.leave_s", "at least 0"),
    ("load_w = 4.0", "load_w = -4.0", "heat.load_w", "at least 0"),
    ("leg = 0.0", "leg = -0.1", "noise.leg", "at least 0"),
    ("join = 0.0", "join = -0.1", "noise.join", "at least 0"),
    ('target = "s1"', 'target = "link:s2"', "fault[0].target", "allowed: s1, link:s1, autopilot"),
    ('kind = "stuck"', 'kind = "broken"', "fault[0].kind", '"flapping"'),
    ("to_s = 420.0", "to_s = 200.0", "fault[0].to_s", "before from_s = 300"),
    ("[[server]]", "[server]", "server", "[[server]]"),
]


@pytest.mark.parametrize(("old", "new", "key", "named"), REFUSED)
def test_a_refusal_names_the_key_and_the_remedy(
    tmp_path: Path, old: str, new: str, key: str, named: str
) -> None:
    assert old in FULL
    text = FULL.replace(old, new, 1)
    if new == "[server]":
        text = text.replace("[server.truth]", "[other]")
    file = written(tmp_path, text)
    with pytest.raises(ConfigError) as refusal:
        read_drone_config(file)
    assert refusal.value.key == key
    assert named in refusal.value.problem
    assert refusal.value.file == str(file)


REFUSED_SHORT = [
    (
        "{ light = 3.0, heavy = 10.0 }",
        "3\nlocal_pace_s = { x = 1 }",
        "service[0].local_pace_s",
        "give one number",
    ),
    ("heavy = 10.0 }", "heavy = 10.0 }\nlocal_pace_s = 3", "service[0].local_pace_s", "each of light, heavy"),
    ("bandwidth_bit_s = 54e6", "", "server[1].bandwidth_bit_s", "detector[light] has no remote_call_s"),
    (
        "processing_s = { light = 0.2, heavy = 0.6 }",
        "",
        "server[1].remote_call_s",
        "processing_s and bandwidth",
    ),
    ("light = 0.2, heavy = 0.6", "light = 0.2", "server[1].remote_call_s", "nothing for detector[heavy]"),
    ("counter = 0.2", "counter = { x = 1 }", "server[0].remote_call_s", "counter has no profile keys"),
    (
        "east_m = 80\nnorth_m = 80",
        "latitude_deg = 1\nlongitude_deg = 2",
        "server[0].latitude_deg",
        "mission.home",
    ),
    ("[[server]]", "[server]\n[[server]]", "", "not valid TOML"),
    ("[[service]]", "x = 2021-01-01\n[[service]]", "mission.x", "unknown key"),
    ("range_m = 100", "range_m = 2021-01-01", "server[0].range_m", "2021-01-01"),
    (
        "remote_call_s",
        'truth = { radio = "disc54" }\nremote_call_s',
        "server[0].truth.processing_s",
        'detector[light], as radio = "disc54" needs it',
    ),
    (
        "remote_call_s",
        "truth = { processing_s = { heavy = 3 } }\nremote_call_s",
        "server[0].bandwidth_bit_s",
        "detector[heavy] has no truth.remote_call_s",
    ),
]


@pytest.mark.parametrize(("old", "new", "key", "named"), REFUSED_SHORT)
def test_a_refusal_among_several_services_or_servers(
    tmp_path: Path, old: str, new: str, key: str, named: str
) -> None:
    assert old in SHORT
    with pytest.raises(ConfigError) as refusal:
        read(tmp_path, SHORT.replace(old, new, 1))
    assert refusal.value.key == key
    assert named in refusal.value.problem


def test_a_missing_file_a_folder_and_foreign_bytes_are_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"seed = 1 # \xff")
    for file, problem in [
        (tmp_path / "none.toml", "no such file"),
        (tmp_path, "cannot be read"),
        (binary, "not UTF-8 text (byte 11): save it as UTF-8"),
    ]:
        with pytest.raises(ConfigError, match=r".") as refusal:
            read_drone_config(file)
        assert problem in refusal.value.problem
        assert refusal.value.key == ""


def test_a_syntax_error_names_the_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="line 3"):
        read(tmp_path, "\nseed = 1\nname = \n")


@pytest.mark.parametrize(
    "text",
    ["x = " + "[" * 5000, ".".join(["a"] * 5000) + " = 1", "seed = " + "9" * 5000, f"seed = 0x{'f' * 9000}"],
)
def test_a_monstrous_file_is_refused_like_any_other(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError):
        read(tmp_path, text)
