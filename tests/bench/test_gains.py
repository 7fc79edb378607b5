"""What the page on the science says of missions, on a few whose figures can be worked out by hand."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench.gains.kept import TABLE, Kept, Missions, read, write
from bench.gains.ladder import LADDER, Part, fly, worlds
from bench.gains.shares import MeasuredWorld, measured_worlds
from bench.gains.tables import tables

from upwash.core.selection.hedging import HedgeRule
from upwash.core.selection.recovery import Probing

VARIANTS = ("local-only", "one", "same", "more")
# Of 100 s that can be gained "one" gains 60 and 80 s, and "more" 10 and 20 s on top of that.
MISSIONS = (
    Missions("group", "first", 1, 100.0, {"local-only": 200.0, "one": 140.0, "same": 140.0, "more": 130.0}),
    Missions("group", "first", 2, 100.0, {"local-only": 200.0, "one": 120.0, "same": 120.0, "more": 100.0}),
    Missions("group", "second", 1, 100.0, {"local-only": 150.0, "more": 160.0}),
    Missions("group", "second", 2, 100.0, {"local-only": 150.0, "more": 160.0}),
)


@pytest.fixture
def first() -> MeasuredWorld:
    return measured_worlds(MISSIONS)[0]


def test_a_share_is_of_what_an_all_knowing_drone_gains(first: MeasuredWorld) -> None:
    share = first.share("one")
    assert share.value == pytest.approx(0.7)
    assert share.margin == pytest.approx(
        12.706 * 0.1, rel=1e-3
    )  # t of one degree of freedom, times 0.1414 / sqrt(2)
    assert first.share("local-only").value == 0.0
    assert first.possible_s.value == pytest.approx(100.0)


def test_a_step_is_counted_from_the_variant_before_seed_by_seed(first: MeasuredWorld) -> None:
    assert first.step_s("more").value == pytest.approx(15.0)
    assert first.step_s("more").margin == pytest.approx(12.706 * 5.0, rel=1e-3)
    assert (first.step_s("same").value, first.step_s("same").margin) == (0.0, 0.0)
    assert first.changes("more")
    assert not first.changes("same")


def test_a_variant_that_did_not_fly_in_a_world_is_passed_over() -> None:
    kept = Kept(VARIANTS, MISSIONS)
    second = measured_worlds(MISSIONS)[1]
    assert second.steps == ["more"]
    assert second.step_s("more").value == pytest.approx(-10.0)
    assert second.share("more").value == pytest.approx(-0.2)
    brief, shares, steps, times = tables(kept).split("\n\n")
    assert "| more | 0 | 1 | 1 | 0 |  | -10.0 ± 0.0 s, group: second |" in brief
    assert "| same | 0 | 0 | 0 | 1 |  |  |" in brief
    assert "| group: first | 1.67 ± 0.00 | 70.0 ± 127.1 | = | 85.0 ± 190.6 |" in shares
    assert "| group: second |  |  | -10.0 ± 0.0 |" in steps
    assert "| group: second | 1.67 | 2.50 ± 0.00 |  |  | 2.67 ± 0.00 |" in times


def test_missions_are_read_as_they_were_written(tmp_path: Path) -> None:
    kept = Kept(list(VARIANTS), list(MISSIONS))
    write(tmp_path / "missions.csv", kept)
    assert read(tmp_path / "missions.csv") == kept


def test_the_last_variant_is_what_upwash_does_by_default() -> None:
    (*before, last) = (variant.enters(next(worlds()).config_of(1)).policy for variant in LADDER)
    assert (last.name, last.probing, last.hedging) == ("look-ahead", Probing(), HedgeRule())
    assert not any(policy.probing for policy in before)
    assert [policy.hedging for policy in before] == [None] * 5 + [HedgeRule()]


def test_the_kept_missions_are_of_the_worlds_and_variants_that_there_are() -> None:
    kept = read(TABLE)
    assert kept.variants == [variant.name for variant in LADDER]
    flown = [(world.group, world.name) for world in measured_worlds(kept.missions)]
    assert flown == [(world.group, world.name) for world in worlds()]


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["demonstration", "answers 3 s late"])
def test_kept_missions_take_as_long_when_they_are_flown_again(name: str) -> None:
    (world,) = (world for world in worlds() if world.name == name)
    kept = next(mission for mission in read(TABLE).missions if mission.world == name)
    again = fly(Part(world.group, world.name, world.config_of(kept.seed)))
    assert again.bound_s == pytest.approx(kept.bound_s, abs=0.01)
    assert again.times_s == pytest.approx(kept.times_s, abs=0.01), "run python -m bench.gains --keep"


def test_a_figure_is_drawn_of_the_kept_missions(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from bench.gains.figure import draw

    draw(Kept(VARIANTS, MISSIONS), tmp_path / "gains.png")
    assert (tmp_path / "gains.png").read_bytes().startswith(b"\x89PNG")
