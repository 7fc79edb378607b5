"""Figures say what they show as text, in every format alike, and are the same bytes when they are drawn again."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from upwash.cli.main import main
from upwash.lab.figures import FigureFiles
from upwash.support.confidence import Mean, mean_of

pytest.importorskip("matplotlib")

from upwash.lab.figures.means import DrawnMean, draw_means, draw_sweep

SCENARIOS = Path(__file__).parents[2] / "scenarios"
STARTS = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}


def texts(svg: Path) -> list[str]:
    """What is written in the picture, as text."""
    return ["".join(each.itertext()) for each in ET.parse(svg).iter("{http://www.w3.org/2000/svg}text")]


def simulate(folder: Path) -> None:
    command = [
        "simulate",
        str(SCENARIOS / "thesis.toml"),
        "--policy",
        "location-aware",
        "--figures",
        str(folder),
    ]
    assert main([*command, "--format", "pdf,png,svg"]) == 0


def test_a_figure_is_written_in_each_format_and_again_as_the_same_bytes(tmp_path: Path) -> None:
    for name in ("first", "again"):
        simulate(tmp_path / name)
    files = sorted((tmp_path / "first").iterdir())
    assert [file.name for file in files] == [
        f"{each}{end}" for each in ("call_delay", "map") for end in (".pdf", ".png", ".svg")
    ]
    for file in files:
        assert file.read_bytes().startswith(STARTS[file.suffix])
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes(), file.name


def test_delays_have_a_strip_for_each_server_and_seconds_alone_on_their_axis(tmp_path: Path) -> None:
    simulate(tmp_path)
    said = texts(tmp_path / "call_delay.svg")
    assert {"s1", "s2", "call delay (s)", "on s1", "on s2", "on the drone", "every call on the drone"} <= set(
        said
    )
    assert "waited for a server" in said
    assert said.count("s1") == 1, "the name of its strip"
    on_axis = [float(text) for text in said if text.replace(".", "").isdigit()]
    assert max(on_axis) <= 120.0


def test_the_map_says_how_many_waypoints_each_server_covers(tmp_path: Path) -> None:
    simulate(tmp_path)
    said = texts(tmp_path / "map.svg")
    counts = [int(text.rpartition("(")[2][:-1]) for text in said if "range" in text]
    assert sum(counts) == 121
    assert "in range of several (49)" in said


def test_means_stand_beside_the_minimum_and_their_paired_differences(tmp_path: Path) -> None:
    alone, better = mean_of([600.0, 620.0]), mean_of([400.0, 410.0])
    rows = [
        DrawnMean("field", "local-only", alone, None, 380.0),
        DrawnMean("field", "look-ahead", better, mean_of([200.0, 210.0]), 380.0),
        DrawnMean("town", "local-only", Mean(1, 500.0, float("inf")), None, 300.0),
    ]
    draw_means(rows, FigureFiles(tmp_path, ("svg",)).files("means"))
    said = texts(tmp_path / "means.svg")
    assert said.count("theoretical minimum") == 1
    assert {"field", "town", "look-ahead", "less than local-only, paired (min)"} <= set(said)
    assert said.count("local-only") == 2


def test_one_numeric_setting_is_a_line_with_its_band(tmp_path: Path) -> None:
    rows = [
        DrawnMean("field", str(value), mean_of([60.0 * value, 66.0 * value]), None, 50.0)
        for value in (10, 20)
    ]
    draw_sweep([10.0, 20.0], rows, FigureFiles(tmp_path, ("svg",)).files("sweep"), key="server.s1.range_m")
    assert {"server.s1.range_m", "95 % confidence", "theoretical minimum", "mean"} <= set(
        texts(tmp_path / "sweep.svg")
    )


def test_policies_and_campaigns_are_drawn(tmp_path: Path) -> None:
    figures = ["--figures", str(tmp_path), "--format", "svg"]
    scenario = str(SCENARIOS / "demonstration.toml")
    assert main(["compare", scenario, "--seeds", "2", "--workers", "1", *figures]) == 0
    assert {"demonstration", "look-ahead", "less than local-only, paired (min)"} <= set(
        texts(tmp_path / "compare.svg")
    )
    campaign = ["campaign", scenario, "--seeds", "1", "--workers", "1", "--out", str(tmp_path / "runs.csv")]
    assert main([*campaign, "--set", "server.s1.range_m=20,30", *figures]) == 0
    assert "server.s1.range_m" in texts(tmp_path / "campaign.svg")
    assert (
        main(
            [*campaign[:-1], str(tmp_path / "by.csv"), "--set", "policy.name=local-only,look-ahead", *figures]
        )
        == 0
    )
    assert "policy.name=look-ahead" in texts(tmp_path / "campaign.svg")


def test_a_format_that_there_is_not_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["simulate", "any.toml", "--figures", "there", "--format", "gif"])
    assert "'gif' is no format of figures: choose of png, pdf, svg" in capsys.readouterr().err
