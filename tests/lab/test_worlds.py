"""Worlds drawn at random are scenarios, and stay the same."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from upwash.cli.main import main
from upwash.lab.scenario import read_scenario
from upwash.lab.worlds import HELD_OUT, draw_world


def test_held_out_worlds_are_those_of_the_first_version() -> None:
    worlds = [draw_world(seed) for seed in (*range(1, 1001), *HELD_OUT)]
    assert (
        hashlib.sha256(msgspec.json.encode(worlds)).hexdigest()
        == "b4af7c9a79372390d9d4e02670b32dbafee7a8f436d58f6d35f93e7b4ad1cb83"
    )


def test_every_held_out_world_can_be_flown() -> None:
    for seed in HELD_OUT:
        read_scenario(draw_world(seed))


def test_a_written_world_is_the_one_that_was_drawn(tmp_path: Path) -> None:
    assert main(["worlds", "--seeds", "5..40", "--out", str(tmp_path)]) == 0
    assert len(list(tmp_path.iterdir())) == 36
    for seed in range(5, 41):
        assert read_scenario(tmp_path / f"world-{seed}.toml") == read_scenario(draw_world(seed))


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
