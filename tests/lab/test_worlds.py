"""Worlds drawn at random are scenarios, and stay the same."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from bench.deployments import DEPLOYMENTS

from upwash.cli.main import main
from upwash.config.plan_photos import photo_legs
from upwash.lab.scenario import read_scenario
from upwash.lab.worlds import HELD_OUT, TODAYS, draw_world


def test_held_out_worlds_are_those_of_the_first_version() -> None:
    worlds = [draw_world(seed) for seed in (*range(1, 1001), *HELD_OUT)]
    assert (
        hashlib.sha256(msgspec.json.encode(worlds)).hexdigest()
        == "b4af7c9a79372390d9d4e02670b32dbafee7a8f436d58f6d35f93e7b4ad1cb83"
    )


def test_surveys_are_those_of_the_first_version() -> None:
    surveys = [draw_world(seed, survey=True) for seed in (*range(1, 1001), *HELD_OUT)]
    assert (
        hashlib.sha256(msgspec.json.encode(surveys)).hexdigest()
        == "b67d1fcb299c459706096d26a4161f6f00123865228e1f26feee5149a0beccd0"
    )


@pytest.mark.parametrize("survey", [False, True])
def test_every_held_out_world_can_be_flown(survey: bool) -> None:
    for seed in HELD_OUT:
        read_scenario(draw_world(seed, survey=survey))


@pytest.mark.parametrize(("kind", "given"), [("world", []), ("survey", ["--surveys"])])
def test_a_written_world_is_the_one_that_was_drawn(tmp_path: Path, kind: str, given: list[str]) -> None:
    assert main(["worlds", "--seeds", "5..40", *given, "--out", str(tmp_path)]) == 0
    assert len(list(tmp_path.iterdir())) == 36
    for seed in range(5, 41):
        written = read_scenario(tmp_path / f"{kind}-{seed}.toml")
        assert written == read_scenario(draw_world(seed, survey=kind == "survey"))


def test_surveys_overlap_and_are_computed_by_todays_computers() -> None:
    outrun = 0
    for seed in range(1, 201):
        document = draw_world(seed, survey=True)
        config = read_scenario(document)
        (leg,) = photo_legs(config.mission)
        local_s = config.services[0].local_call_s["heavy"]
        remote_s = config.servers[0].remote_call_s["detector"]["heavy"]
        assert 0.59 < 1 - leg.step_m / (0.9 * leg.altitude_m) < 0.81
        assert leg.step_m / leg.ground_speed_m_s >= config.camera.photo_s
        assert any(
            0.79 < local_s / times.local_s < 1.26 and 0.79 < remote_s / times.remote_s < 1.26
            for times in TODAYS
        )
        assert all(100 <= server["range_m"] <= 200 for server in document["server"])
        outrun += local_s * leg.ground_speed_m_s > leg.step_m
    assert 0.4 < outrun / 200 < 0.7


def test_the_table_of_deployments_has_the_same_computers() -> None:
    assert [(each.local_s, each.remote_s) for each in DEPLOYMENTS] == list(TODAYS)


def test_worlds_have_all_that_the_page_states() -> None:
    worlds = [draw_world(seed) for seed in range(1, 301)]
    shares = {
        name: sum(name in world for world in worlds) / len(worlds) for name in ("drone", "heat", "event")
    }
    assert shares == {
        name: pytest.approx(share, abs=0.08)
        for name, share in (("drone", 0.15), ("heat", 0.25), ("event", 0.3))
    }
    assert {len(world["server"]) for world in worlds} == {1, 2, 3, 4, 6, 10}
    assert {fault["kind"] for world in worlds for fault in world["fault"]} == {
        "off", "stuck", "slow", "garbage", "wrong", "flapping", "full", "crash",
    }  # fmt: skip


def test_comparisons_in_drawn_worlds_render_no_photos() -> None:
    flown = "import sys, upwash; upwash.compare(worlds=range(1, 3), policies=['look-ahead'], workers=1)"
    nothing = "assert not {'cv2', 'numpy', 'upwash.services.solar_park'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", f"{flown}; {nothing}"], timeout=120, check=True)
