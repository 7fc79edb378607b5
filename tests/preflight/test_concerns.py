"""What is warned of: decided on values alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from upwash.config.drone import DroneConfig
from upwash.config.drone_file import drone_config
from upwash.config.flight_times import usable_s
from upwash.preflight.prediction import ALONE, AS_CONFIGURED, LOCAL_ONLY, Prediction, without
from upwash.preflight.warnings import Belief, warnings
from upwash.preflight.waypoints import ServerCoverage, farthest

OPERATION = "detector.process_photo[heavy]"


def configured(*, servers: tuple[str, ...] = ("s1",), **tables: Any) -> DroneConfig:
    """A configuration in which nothing hurts, but for what the tables change."""
    document = {
        "mission": {"waypoints_m": [[0, 0]], **tables.pop("mission", {})},
        "service": [{"name": "detector", "local_call_s": {"heavy": 10.0}}],
        "server": [
            {"name": name, "east_m": 0, "north_m": 0, "range_m": 50, "remote_call_s": {"heavy": 1.0}}
            for name in servers
        ],
        **tables,
    }
    return drone_config(document, Path("drone.toml"))


def covered(**changes: Any) -> ServerCoverage:
    return msgspec.structs.replace(
        ServerCoverage(server="s1", range_m=50.0, nearest_m=0.0, waypoints=(0,), longest_stay_s=60.0),
        **changes,
    )


def believed(local_s: float = 10.0, **remote_s: float) -> Belief:
    return Belief(operation=OPERATION, local_s=local_s, remote_s=remote_s or {"s1": 1.0})


def predicted(**times_s: float | None) -> list[Prediction]:
    names = {"local": LOCAL_ONLY, "configured": AS_CONFIGURED, "s1": without("s1"), "alone": ALONE}
    return [
        Prediction(case=names[case], missions=1, mission_time_s=time_s, margin_s=None)
        for case, time_s in times_s.items()
    ]


GOOD = predicted(local=100.0, configured=50.0, s1=100.0)


def kinds(
    config: DroneConfig,
    cover: ServerCoverage | None = None,
    belief: Belief | None = None,
    predictions: list[Prediction] | None = None,
) -> list[str]:
    found = warnings(config, [cover or covered()], [belief or believed()], predictions or GOOD)
    return [each.kind for each in found]


def test_nothing_is_said_where_nothing_hurts() -> None:
    assert kinds(configured()) == []


@pytest.mark.parametrize(
    ("cover", "kind", "said"),
    [
        (covered(waypoints=(), nearest_m=80.0, longest_stay_s=0.0), "covers-nothing", "80 m away"),
        (covered(longest_stay_s=3.0), "too-short", "never ready in time"),
        (covered(longest_stay_s=11.0), "too-short", "only if they run already"),
    ],
)
def test_a_server_that_is_too_far_or_too_short_in_range_is_named(
    cover: ServerCoverage, kind: str, said: str
) -> None:
    (warning,) = warnings(configured(), [cover], [believed()], GOOD)
    assert warning.kind == kind
    assert said in warning.text


def test_an_operation_that_no_server_is_faster_for_is_named() -> None:
    assert kinds(configured(), belief=believed(local_s=1.0)) == ["not-faster"]
    assert kinds(configured(servers=("s1", "s2")), belief=believed(local_s=1.0, s1=2.0, s2=0.5)) == []


def test_a_service_that_no_server_offers_is_named_with_the_line_to_add() -> None:
    counter = {"name": "counter", "program": "upwash.services:Detector", "local_call_s": 2.0}
    keyed = counter | {"local_call_s": {"fast": 1.0, "slow": 3.0}}
    detector = {"name": "detector", "local_call_s": {"heavy": 10.0}}
    for service, line in (
        (counter, "{ counter = 0.5 }"),
        (keyed, "{ counter = { fast = 0.5, slow = 0.5 } }"),
    ):
        (warning,) = warnings(configured(service=[detector, service]), [covered()], [believed()], GOOD)
        assert warning.kind == "not-offered"
        assert "counter always runs on the drone" in warning.text
        assert f"remote_call_s = {line}" in warning.text
    alone = configured(servers=(), service=[detector, counter])
    assert warnings(alone, [], [believed()], predicted(local=9.0, configured=9.0)) == []


@pytest.mark.parametrize(
    ("part", "bandwidth_bit_s", "said"),
    [
        ({}, 4e6, "no [[service]] has a before_sending"),
        ({"loss": 0.3}, 4e6, "each before_sending loses more"),
        ({"loss": 0.1}, None, "no [[server]] has a bandwidth_bit_s"),
        ({"loss": 0.1}, 4e6, ""),
    ],
)
def test_a_loss_that_is_allowed_in_vain_is_named(
    part: dict[str, Any], bandwidth_bit_s: float | None, said: str
) -> None:
    detector: dict[str, Any] = {"name": "detector", "local_call_s": {"heavy": 10.0}}
    server: dict[str, Any] = {"name": "s1", "east_m": 0, "north_m": 0, "range_m": 50}
    server["remote_call_s"] = {"heavy": 1.0}
    if part:
        detector["before_sending"] = {"takes_s": 0.1, "request_bytes": 1000, **part}
    if bandwidth_bit_s is not None:
        server["bandwidth_bit_s"] = bandwidth_bit_s
    config = configured(policy={"most_loss": 0.2}, service=[detector], server=[server])
    found = warnings(config, [covered()], [believed()], GOOD)
    assert [(each.kind, said in each.text) for each in found] == ([("sent-whole", True)] if said else [])


def test_a_wait_that_can_never_pay_off_is_named() -> None:
    greedy = {"gain_wait": 0.9}
    assert kinds(configured(policy=greedy)) == ["never-waits"]
    assert kinds(configured(policy=greedy), belief=believed(s1=0.9)) == []
    assert kinds(configured(policy={"gain_wait": 0.89})) == []


def test_servers_that_gain_nothing_or_hurt_are_named() -> None:
    assert kinds(configured(), predictions=predicted(local=100.0, configured=99.5, s1=100.0)) == ["no-gain"]
    assert kinds(configured(), predictions=predicted(local=100.0, configured=60.0, s1=55.0)) == ["hurts"]


def test_what_the_margins_leave_open_is_no_difference() -> None:
    unsure = [
        msgspec.structs.replace(each, margin_s=3.0)
        for each in predicted(local=100.0, configured=60.0, s1=55.0)
    ]
    assert kinds(configured(), predictions=unsure) == []


def test_the_battery_has_to_last_above_the_reserve_margin_included() -> None:
    config = configured(vehicle={"endurance_s": 100.0}, mission={"reserve_percent": 20.0})
    assert usable_s(config) == 80.0
    (warning,) = warnings(config, [covered()], [believed()], GOOD)
    assert warning.kind == "battery"
    assert "1:20 above the reserve of 20 %" in warning.text
    assert "local-only (1:40), without s1 (1:40)" in warning.text
    lasting = predicted(local=79.0, configured=40.0)
    assert kinds(config, predictions=lasting) == []
    assert kinds(config, predictions=[msgspec.structs.replace(lasting[0], margin_s=2.0)]) == ["battery"]


def test_without_an_endurance_nothing_is_said_of_the_battery() -> None:
    assert usable_s(configured(mission={"reserve_percent": 20.0})) is None


def test_of_two_reserves_the_higher_counts_before_the_flight_too() -> None:
    seconds = configured(vehicle={"endurance_s": 200.0}, mission={"reserve_percent": 20.0, "reserve_s": 60.0})
    assert usable_s(seconds) == pytest.approx(140.0)
    percent = configured(vehicle={"endurance_s": 200.0}, mission={"reserve_percent": 40.0, "reserve_s": 60.0})
    assert usable_s(percent) == pytest.approx(120.0)
    (warning,) = warnings(seconds, [covered()], [believed()], predicted(local=150.0, configured=50.0))
    assert "2:20 above the reserve of 60 s" in warning.text


def far_away(away_m: float, **mission: Any) -> DroneConfig:
    return configured(
        vehicle={"endurance_s": 300.0, "profile": "arducopter"},
        mission={"waypoints_m": [[0, 0], [away_m, 0], [10, 0]], "reserve_s": 60.0, **mission},
    )


def test_a_waypoint_from_which_the_drone_could_not_return_is_named() -> None:
    assert kinds(far_away(400.0)) == []
    (warning,) = warnings(far_away(700.0), [covered()], [believed()], GOOD)
    assert warning.kind == "too-far"
    assert "waypoint 1 is 700 m from home: 3:03 there and 1:58 back" in warning.text
    assert kinds(far_away(690.0, reserve_s=0.0)) == []
    assert kinds(far_away(700.0, ground_speed_m_s=8.0)) == []


def test_a_drone_that_lands_where_it_is_needs_the_way_down_only() -> None:
    config = far_away(700.0)
    landing = msgspec.structs.replace(
        config, autopilot=msgspec.structs.replace(config.autopilot, on_failure="land")
    )
    assert kinds(landing) == []
    assert farthest(landing).home_s < 40.0 < farthest(config).home_s


def test_a_reserve_in_seconds_asks_for_the_endurance() -> None:
    (warning,) = warnings(configured(mission={"reserve_s": 60.0}), [covered()], [believed()], GOOD)
    assert warning.kind == "endurance"


def test_a_reserve_below_the_autopilots_own_stage_is_named_before_a_flight() -> None:
    def kinds_for(**mission: Any) -> list[str]:
        return kinds(
            with_addresses(
                "127.0.0.1:1",
                camera=FLIGHT["camera"],
                mission={**FLIGHT["mission"], "reserve_s": 60.0, **mission},
                vehicle={"endurance_s": 1200.0},
            )
        )

    assert kinds_for() == ["low-battery-stage"]
    assert kinds_for(reserve_percent=15.0) == []
    assert kinds_for(reserve_s=180.0) == []
    assert "low-battery-stage" not in kinds(far_away(100.0)), "a scenario has no autopilot"


def test_missions_that_fail_alike_are_said_once() -> None:
    failed = [
        Prediction(case=case, missions=2, mission_time_s=None, margin_s=None, failures=("lost",))
        for case in (LOCAL_ONLY, AS_CONFIGURED)
    ]
    (warning,) = warnings(configured(), [covered()], [believed()], failed)
    assert warning.text.endswith("local-only (1 of 2), as configured (1 of 2): lost")


def with_addresses(*addresses: str, **tables: Any) -> DroneConfig:
    config = configured(servers=tuple(f"s{number}" for number in range(1, len(addresses) + 1)), **tables)
    servers = tuple(
        msgspec.structs.replace(server, address=address or None)
        for server, address in zip(config.servers, addresses, strict=True)
    )
    return msgspec.structs.replace(config, servers=servers)


FLIGHT: dict[str, Any] = {
    "mission": {"home": {"latitude_deg": 39.0, "longitude_deg": 22.0}},
    "camera": {"folder": "photos"},
}


def test_two_servers_with_one_address_are_named() -> None:
    assert kinds(with_addresses("127.0.0.1:1", "127.0.0.1:1", **FLIGHT)) == ["same-address"]
    assert kinds(with_addresses("127.0.0.1:1", "127.0.0.1:2", **FLIGHT)) == []


def test_a_drone_that_never_offloads_is_not_told_of_servers() -> None:
    assert (
        kinds(configured(policy={"name": "local-only"}), covered(waypoints=()), believed(local_s=0.5)) == []
    )


@pytest.mark.parametrize(
    ("connection", "signing_key", "warned"),
    [
        ("udpin:0.0.0.0:14550", None, True),
        ("udpin:192.168.1.7:14550", None, True),
        ("udpin:drone.local:14550", None, True),
        ("udpin:0.0.0.0:14550", "signing.key", False),
        ("udpin:127.0.0.1:14550", None, False),
        ("udpin:localhost:14550", None, False),
        ("udpout:192.168.1.7:14550", None, False),
        ("serial:/dev/ttyAMA0:921600", None, False),
    ],
)
def test_a_port_that_networks_reach_is_named_unless_messages_are_signed(
    connection: str, signing_key: str | None, warned: bool
) -> None:
    autopilot = {"connection": connection} | ({"signing_key": signing_key} if signing_key else {})
    assert ("unsigned-port" in kinds(configured(autopilot=autopilot))) is warned
