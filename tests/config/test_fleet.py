"""Several drones in one file: a configuration for each, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from upwash.cli.main import main
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import Presence, fleet_of, presences, read_drone_config
from upwash.config.places import waypoints
from upwash.errors import ConfigError

FLEET = (Path(__file__).parent / "fleet.toml").read_text()
PLAN = Path(__file__).parents[1] / "plans" / "field.plan"
GRID = "grid = { columns = 2, rows = 2, spacing_m = 20.0 }\n"


def read(tmp_path: Path, text: str) -> DroneConfig:
    file = tmp_path / "fleet.toml"
    file.write_text(text)
    return read_drone_config(file)


def ways(config: DroneConfig) -> list[list[tuple[float, float]]]:
    return [
        [(waypoint.position.east_m, waypoint.position.north_m) for waypoint in waypoints(drone.mission)]
        for drone in fleet_of(config)
    ]


def test_what_a_drone_leaves_out_is_as_the_file_says(tmp_path: Path) -> None:
    config = read(tmp_path, FLEET)
    first, second = fleet_of(config)
    assert (first.name, second.name) == ("d1", "d2")
    assert (first.mission, first.policy, first.services) == (config.mission, config.policy, config.services)
    assert second.mission.ground_speed_m_s == 5.0 and second.mission.grid is None
    assert second.policy.name == "opportunistic" and second.policy.gain_wait == 0.5
    assert [service.local_call_s for service in second.services] == [{"light": 3.0, "heavy": 20.0}, {"": 3.0}]
    assert ways(config) == [[(0, 20), (20, 20), (20, 0), (0, 0)], [(0, 0), (20, 0)]]
    assert presences(config) == (Presence(), Presence(60.0, 600.0))
    assert first.drones == second.drones == ()
    assert first.servers == second.servers == config.servers


def test_a_file_without_drones_is_one_drone(tmp_path: Path) -> None:
    config = read(tmp_path, FLEET.partition("[[drone]]")[0])
    assert fleet_of(config) == (config,)
    assert presences(config) == (Presence(),)


def test_the_first_has_the_files_seed_and_a_drone_more_changes_no_others(tmp_path: Path) -> None:
    seeds = [drone.seed for drone in fleet_of(read(tmp_path, FLEET))]
    more = FLEET.replace('[[drone]]\nname = "d2"', '[[drone]]\nname = "d0"\n\n[[drone]]\nname = "d2"')
    first, between, last = fleet_of(read(tmp_path, more))
    assert seeds == [first.seed, last.seed] and first.seed == 3
    assert len({first.seed, between.seed, last.seed}) == 3
    assert fleet_of(read(tmp_path, FLEET.replace("seed = 3", "seed = 4")))[1].seed != seeds[1]


def test_where_all_have_their_own_way_the_mission_needs_none(tmp_path: Path) -> None:
    text = FLEET.replace(GRID, "").replace('name = "d1"', f'name = "d1"\n{GRID}')
    assert ways(read(tmp_path, text)) == ways(read(tmp_path, FLEET))


def test_a_drones_own_plan_says_how_high_and_how_fast_and_counts_from_home(tmp_path: Path) -> None:
    (tmp_path / PLAN.name).write_bytes(PLAN.read_bytes())
    planned = FLEET.replace("waypoints_m = [[0, 0], [20, 0]]", f'plan = "{PLAN.name}"')
    config = read(tmp_path, planned)
    own, of_file = fleet_of(config)[1].mission, config.mission
    assert own.home == of_file.home
    assert own.plan is not None
    assert own.altitude_m == (own.plan.plan.takeoff_altitude_m or own.plan.plan.waypoints[0].place.altitude_m)
    assert len(waypoints(own)) == len(own.plan.plan.waypoints)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"d2"', '"d1"', 'drone[1].name: a second drone named "d1": give each its own name'),
        (
            '"d2"',
            '"local"',
            'drone[1].name: "local" stands for the drone itself in results: rename the drone',
        ),
        ('"d2"', '"s1"', 'drone[1].name: "s1" is a server too: rename one of them'),
        ('"d2"', '"d 2"', "drone[1].name: expected a name of letters"),
        ("600.0", "60.0", "drone[1].vanishes_s: 60 is not after departs_s = 60: let it vanish later"),
        ("60.0", "1e6", "drone[1].departs_s: expected a number from 0 to 86400, in seconds, found 1000000.0"),
        (
            GRID,
            "",
            "drone[0]: nowhere to fly: give it a grid, waypoints_m or a plan, or [mission] one for all drones",
        ),
        ("[[0, 0], [20, 0]]", f"[[0, 0]]\n{GRID}", "drone[1]: no single list of waypoints"),
        (GRID, f"{GRID}waypoints_m = [[0, 0]]\n", "drone[0]: no single list of waypoints"),
        ('policy = "opp', 'policy = "op', "drone[1].policy: expected one of"),
        (
            "counter = 3.0 }",
            "counters = 3.0 }",
            'drone[1].local_call_s: unknown profile key of detector "counters"',
        ),
        ("heavy = 20.0", "heavy = -1", "drone[1].local_call_s: expected seconds of at least 0"),
        ("departs_s", "depart_s", 'drone[1].depart_s: unknown key "depart_s"; did you mean "departs_s"?'),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in FLEET
    with pytest.raises(ConfigError) as raised:
        read(tmp_path, FLEET.replace(old, new))
    assert str(raised.value).startswith(f"{tmp_path / 'fleet.toml'}: {said}")


def test_a_plan_without_a_home_that_all_share_is_refused(tmp_path: Path) -> None:
    (tmp_path / PLAN.name).write_bytes(PLAN.read_bytes())
    home = next(line for line in FLEET.splitlines(keepends=True) if line.startswith("home"))
    text = FLEET.replace(home, "").replace("waypoints_m = [[0, 0], [20, 0]]", f'plan = "{PLAN.name}"')
    with pytest.raises(ConfigError, match=r"drone\[1\].plan: its places count from mission.home"):
        read(tmp_path, text)


def test_more_drones_than_one_simulation_takes_are_refused(tmp_path: Path) -> None:
    drones = "".join(f'[[drone]]\nname = "d{number}"\n' for number in range(1001))
    with pytest.raises(ConfigError, match="drone: 1001 drones: one simulation has at most 1000"):
        read(tmp_path, FLEET.partition("[[drone]]")[0] + drones)


@pytest.mark.parametrize("command", ["fly --config {}", "check --networks {}", "check --vehicle {}"])
def test_what_is_of_a_real_drone_is_of_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    read(tmp_path, FLEET)
    assert main(command.format(tmp_path / "fleet.toml").split()) == 2
    said = capsys.readouterr().err
    assert "is of one drone, and this file has [[drone]] tables" in said
    assert "give each drone a file of its own" in said
