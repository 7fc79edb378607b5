"""What follows from a scenario when it is emulated: configurations, paces and names."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from upwash.config.daemon import PeerConfig, read_daemon_config
from upwash.config.drone import DroneConfig
from upwash.config.drone_file import read_drone_config
from upwash.config.truth import server_truth
from upwash.config.user import UserConfig
from upwash.config.world import TruthConfig
from upwash.emulation.native import WIFI, wifi_of
from upwash.emulation.programs import daemon_config, write_config
from upwash.emulation.request import EmulationRequest, emulated, left_out, server_paces
from upwash.errors import UsageError
from upwash.real.trust.authority import keys_in

ROOT = Path(__file__).parents[2]
SCENARIOS = [
    file for file in sorted((ROOT / "scenarios").glob("*.toml")) if not file.stem.startswith("fleet-")
]
THESIS = ROOT / "scenarios" / "thesis.toml"
DEMONSTRATION = ROOT / "scenarios" / "demonstration.toml"


def order(tmp_path: Path, *scenarios: Path, drones: int = 1) -> EmulationRequest:
    return EmulationRequest(scenarios=scenarios, drones=drones, folder=tmp_path)


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda file: file.stem)
def test_a_drones_file_is_read_back_as_it_was_written(tmp_path: Path, scenario: Path) -> None:
    config = emulated(read_drone_config(scenario))
    write_config(tmp_path / "drone.toml", config)
    assert read_drone_config(tmp_path / "drone.toml") == config


@pytest.mark.parametrize("name", ["field.plan", "field.waypoints"])
def test_a_planned_mission_keeps_its_plan(tmp_path: Path, name: str) -> None:
    scenario = tmp_path / "there" / "scenario.toml"
    scenario.parent.mkdir()
    (scenario.parent / name).write_bytes((ROOT / "tests/plans" / name).read_bytes())
    home = "home = { latitude_deg = 39.3666, longitude_deg = 22.9507 }\n"
    scenario.write_text(
        f'[mission]\nplan = "{name}"\n{home}[[service]]\nname = "detector"\nlocal_call_s = {{ heavy = 1 }}\n'
    )
    config = read_drone_config(scenario)
    write_config(tmp_path / "drone.toml", config)
    again = read_drone_config(tmp_path / "drone.toml")
    assert again.mission.plan is not None and config.mission.plan is not None
    assert again.mission.plan.plan == config.mission.plan.plan
    assert again.mission.altitude_m == config.mission.altitude_m


def test_calls_take_as_long_as_the_scenario_says_with_the_transfer_left_to_the_link() -> None:
    thesis = read_drone_config(THESIS)
    transfer_s = 8 * 425_000 / 54e6
    paces = server_paces(thesis.servers[0], thesis)["detector"]
    assert paces == pytest.approx({"light": 0.3 - transfer_s, "heavy": 0.7 - transfer_s})
    over_wifi = read_drone_config(DEMONSTRATION)
    assert server_paces(over_wifi.servers[0], over_wifi) == {"detector": {"light": 0.2, "heavy": 0.3}}


def test_a_daemon_is_told_its_paces_slots_and_images(tmp_path: Path) -> None:
    config = read_drone_config(ROOT / "scenarios" / "two-services.toml")
    for server in config.servers:
        file = tmp_path / f"{server.name}.toml"
        keys, peers = keys_in(tmp_path, server.name), {"s9": "10.83.8.1:7070"}
        daemon = daemon_config(server, config, listen="10.83.0.1:7070", peers=peers, keys=keys)
        write_config(file, daemon)
        daemon = read_daemon_config(file)
        (identity,) = daemon.identities
        paces = server_paces(server, config)
        assert daemon.peers == (PeerConfig(name="s9", address="10.83.8.1:7070"),)
        assert (identity.name, identity.slots) == (server.name, server.truth.slots)
        assert {image.name: dict(image.pace_s) for image in daemon.images} == paces
        start_s = server_truth(server, config.services).start_s
        assert {image.start_pace_s for image in daemon.images} == {start_s}


def test_what_cannot_be_emulated_is_named_and_left_out() -> None:
    thesis = read_drone_config(THESIS)
    assert left_out(thesis) == ["local_first_extra_s", "local_joining_slowdown"]
    assert left_out(emulated(thesis)) == []
    assert emulated(thesis).services[0].local_pace_s == {"light": 3.0, "heavy": 10.0}
    server = msgspec.structs.replace(thesis.servers[0], truth=TruthConfig(first_extra_s=2.0))
    slow_at_first = msgspec.structs.replace(emulated(thesis), servers=(server,))
    assert left_out(slow_at_first) == ["first_extra_s"]
    assert left_out(emulated(slow_at_first)) == []
    service = msgspec.structs.replace(thesis.services[0], local_joining_slowdown={"light": 0.1})
    slow_meanwhile = msgspec.structs.replace(emulated(thesis), services=(service,))
    assert "local_joining_slowdown" in left_out(slow_meanwhile)
    told = msgspec.structs.replace(emulated(thesis), user=UserConfig(command=("told.sh",)))
    assert left_out(told) == ["user"]
    assert left_out(emulated(told)) == []
    assert left_out(emulated(slow_meanwhile)) == []


def test_several_drones_are_told_apart_and_a_single_one_keeps_its_name(tmp_path: Path) -> None:
    def names(request: EmulationRequest) -> list[str]:
        return [each.config.name for each in request.read()]

    assert names(order(tmp_path, DEMONSTRATION)) == ["drone"]
    assert names(order(tmp_path, DEMONSTRATION, drones=3)) == ["drone-1", "drone-2", "drone-3"]
    assert names(order(tmp_path, DEMONSTRATION, DEMONSTRATION)) == ["drone-1", "drone-2"]


FLEET = """
[[drone]]
name = "d1"

[[drone]]
name = "d2"
departs_s = 20.0
local_call_s = { light = 6.0 }
"""


def test_the_drones_of_a_scenario_have_their_own_times_and_departures(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(DEMONSTRATION.read_text() + FLEET)
    d1, d2 = order(tmp_path, fleet).read()
    assert (d1.config.name, d1.departs_s, d1.config.services[0].local_pace_s["light"]) == ("d1", 0.0, 1.0)
    assert (d2.config.name, d2.departs_s, d2.config.services[0].local_pace_s["light"]) == ("d2", 20.0, 6.0)


def test_a_drone_that_vanishes_is_not_emulated(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(DEMONSTRATION.read_text() + FLEET + "vanishes_s = 60.0\n")
    with pytest.raises(UsageError, match=r"fleet.toml: d2 vanishes, .*: remove its vanishes_s"):
        order(tmp_path, fleet).read()


def test_scenarios_of_different_servers_are_not_emulated_together(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="the same"):
        order(tmp_path, DEMONSTRATION, THESIS).read()


def test_an_order_survives_its_way_to_the_enclosed_program(tmp_path: Path) -> None:
    sent = order(tmp_path, DEMONSTRATION, drones=2)
    assert EmulationRequest.decoded(sent.encoded()) == sent


def radio_of(config: DroneConfig, radio: str, range_m: float = 100.0) -> DroneConfig:
    replace = msgspec.structs.replace
    server = config.servers[0]
    return replace(
        config, servers=(replace(server, range_m=range_m, truth=replace(server.truth, radio=radio)),)
    )


def test_wifi_ends_at_the_servers_range() -> None:
    config = read_drone_config(DEMONSTRATION)
    assert wifi_of(radio_of(config, "disc12").servers[0]) == WIFI["disc12"]
    near = wifi_of(radio_of(config, "disc12", range_m=10.0).servers[0])
    assert near.loss_at_1m_db == pytest.approx(WIFI["disc12"].loss_at_1m_db + 10 * 2.56)


def test_a_radio_that_is_no_wifi_is_refused_with_what_to_write() -> None:
    config = radio_of(read_drone_config(DEMONSTRATION), "fixed")
    with pytest.raises(UsageError, match="disc12, disc54"):
        wifi_of(config.servers[0])
