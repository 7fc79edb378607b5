"""What the page on the science says of baselines, on missions whose figures can be worked out by hand."""

from __future__ import annotations

import pytest
from bench.baselines.clients import replicated
from bench.baselines.manners import flown, stopping
from bench.baselines.reserving import Reserved
from bench.baselines.tables import by_manner, by_share, lost_most, worlds_of
from bench.baselines.worlds import scenario
from bench.gains.kept import Missions
from msgspec.structs import replace

from upwash.config.world import FaultConfig
from upwash.lab.run import simulate
from upwash.policies import Option, Situation

pytestmark = pytest.mark.virtual


def missions(world: str, **times_s: float) -> Missions:
    named = {name.replace("_", ", "): time_s for name, time_s in times_s.items()}
    return Missions("none", world, 1, 0.0, named)


DRAWN = worlds_of(
    [
        missions(
            "7, 10 s", alone_waits=600.0, served_waits=300.0, minimum_waits=300.0,
            alone_learns=240.0, served_learns=228.0, minimum_learns=220.0,
        ),
        missions(
            "8, 0.5 s", alone_waits=100.0, served_waits=105.0, minimum_waits=100.0,
            alone_learns=100.0, served_learns=103.0, minimum_learns=100.0,
        ),
    ]
)  # fmt: skip


def test_each_side_is_flown_in_its_quickest_manner() -> None:
    (first, _) = by_manner(DRAWN)
    assert first == ("7, 10 s", "50", "5", "-", "4.0, 3.8", "5.0", "60")


def test_losses_are_counted_as_gains_are() -> None:
    rows = {row[0]: row[1:] for row in by_share(DRAWN)}
    assert rows["waits"][1:3] == ("22.5 ± 349.4 %", "22.5 %")
    assert rows["flown well"][-3:] == ("50 %", "50 %", "-3.0 %")
    assert rows["flown well, calls of 0 to 1 s"][0] == "1"
    assert lost_most(DRAWN) == "8 (3.0 %)"


def test_a_drone_on_the_move_is_no_faster_than_its_camera() -> None:
    config = scenario("thesis")
    slow = replace(config, camera=replace(config.camera, photo_s=10.0))
    assert (moving := flown(slow, "moves")) is not None
    assert simulate(moving).result.completed
    assert moving.mission.ground_speed_m_s == pytest.approx(2.0, rel=0.01)
    assert flown(stopping(scenario("power-line")), "goes") is not None


def test_every_server_in_range_answers_unless_it_is_faulty() -> None:
    config = replace(scenario("demonstration"), noise=scenario("demonstration").noise.__class__())
    run = simulate(config)
    every = replicated(run, config)
    assert every.mission_s < run.result.mission_time_s
    silent = tuple(FaultConfig(target=server.name, kind="stuck") for server in config.servers)
    none = replicated(run, replace(config, faults=silent))
    assert none.copies == 0
    assert none.mission_s > every.mission_s
    late = tuple(FaultConfig(target=server.name, kind="slow", extra_s=0.5) for server in config.servers)
    assert every.mission_s < replicated(run, replace(config, faults=late)).mission_s <= none.mission_s


def test_a_server_is_used_only_at_the_reserved_times() -> None:
    policy = Reserved(times={"s1": [[10.0, 20.0]]})
    options = [Option("s1", 1.0, 0.0), Option("s2", 0.5, 0.0)]

    def chosen(now_s: float) -> str | None:
        return policy.choose(Situation(options, "s1", 10.0, now_s=now_s)).server

    assert [chosen(now_s) for now_s in (9.0, 10.0, 19.0, 20.0)] == [None, "s1", "s1", None]
