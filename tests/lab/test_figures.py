"""Figures say what they show as text, in every format alike, and are the same bytes when they are drawn again."""

from __future__ import annotations

import itertools
import re
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from upwash.cli.main import main
from upwash.lab.figures import FigureFiles
from upwash.support.confidence import Mean, mean_of

pytest.importorskip("matplotlib")

from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

from upwash.lab.figures.means import DrawnMean, draw_means, draw_sweep
from upwash.report.palette import LIGHT

SCENARIOS = Path(__file__).parents[2] / "scenarios"
STARTS = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}
SVG = "{http://www.w3.org/2000/svg}"
LONG = "edge-server-on-the-roof-of-building"


def texts(svg: Path) -> list[str]:
    """What is written in the picture, as text."""
    return ["".join(each.itertext()) for each in ET.parse(svg).iter(f"{SVG}text")]


class Written(NamedTuple):
    """A line of text, and the box that it fills."""

    text: str
    left: float
    top: float
    right: float
    bottom: float


def lines(svg: Path) -> Iterator[Written]:
    for element in ET.parse(svg).iter(f"{SVG}text"):
        style, text = element.attrib["style"], "".join(element.itertext())
        weight = "bold" if "bold" in style or "700" in style else "normal"
        (size,) = re.findall(r"([\d.]+)px", style)
        font = FontProperties(family="DejaVu Sans", size=float(size), weight=weight)
        width, height, descent = text_to_path.get_text_width_height_descent(text, font, ismath=False)
        x, y = map(float, re.findall(r"[\d.]+", element.attrib["transform"])[-2:])
        turned = "rotate(-90" in element.attrib["transform"]
        before = {"middle": width / 2, "end": width}.get("".join(re.findall(r"anchor: (\w+)", style)), 0.0)
        above, below = height - descent, descent
        if turned:
            yield Written(text, x - above, y - width + before, x + below, y + before)
        else:
            yield Written(text, x - before, y - above, x - before + width, y + below)


def assert_whole(svg: Path) -> None:
    """Every text lies in the picture, and none over another."""
    _, _, width, height = map(float, ET.parse(svg).getroot().attrib["viewBox"].split())
    written = list(lines(svg))
    for line in written:
        assert line.left >= 0 and line.top >= 0 and line.right <= width and line.bottom <= height, line
    for one, other in itertools.combinations(written, 2):
        apart = (
            one.right <= other.left
            or other.right <= one.left
            or one.bottom <= other.top
            or other.bottom <= one.top
        )
        assert apart, (one, other)


def bounds(svg: Path) -> int:
    """How many bounds are drawn in a figure of means."""
    dashed = [path for path in ET.parse(svg).iter(f"{SVG}path") if "dasharray: 2" in path.get("style", "")]
    return len(dashed) - 1  # the legend has one


def field_of(folder: Path, names: list[str]) -> Path:
    """A scenario with a server of each name."""
    servers = "".join(
        f"""
[[server]]
name = "{name}"
east_m = {35 + 70 * (number % 5)}.0
north_m = {50 + 120 * (number // 5)}.0
range_m = 70.0
check_s = 6.0
check_running_s = 2.0
remote_call_s = {{ heavy = 0.8 }}
"""
        for number, name in enumerate(names)
    )
    file = folder / "field.toml"
    file.write_text(
        """seed = 1
[mission]
program = "survey"
mode = "heavy"
altitude_m = 40.0
ground_speed_m_s = 5.0
grid = { columns = 15, rows = 10, spacing_m = 25.0 }
[[service]]
name = "detector"
local_call_s = { heavy = 10.0 }
"""
        + servers
    )
    return file


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
    counts = [int(text.rpartition("(")[2][:-1]) for text in said if re.search(r"\(\d+\)$", text)]
    assert sum(counts) == 121
    assert {"s1 alone (27)", "several (49)"} <= set(said)


@pytest.mark.parametrize(
    "names",
    [[], ["s1"], [f"s{number}" for number in range(1, 11)], [f"{LONG}-{number}" for number in range(1, 11)]],
    ids=["none", "one", "ten", "long"],
)
def test_no_text_of_a_flight_is_cut_or_covers_another(tmp_path: Path, names: list[str]) -> None:
    command = ["simulate", str(field_of(tmp_path, names)), "--figures", str(tmp_path), "--format", "svg"]
    assert main(command) == 0
    for figure in "map", "call_delay":
        assert_whole(tmp_path / f"{figure}.svg")
    joined = "".join(texts(tmp_path / "map.svg")) + "".join(texts(tmp_path / "call_delay.svg"))
    assert all(f"{name} alone (" in joined and f"on {name}" in joined for name in names)


@pytest.mark.parametrize("scenario", ["power-line", "dense-city"])
def test_a_long_field_and_a_dense_one_have_names_on_the_map(tmp_path: Path, scenario: str) -> None:
    file = SCENARIOS / f"{scenario}.toml"
    assert main(["simulate", str(file), "--figures", str(tmp_path), "--format", "svg"]) == 0
    assert_whole(tmp_path / "map.svg")
    assert set(re.findall(r'name = "(\w+)"', file.read_text())) - {"detector"} <= set(
        texts(tmp_path / "map.svg")
    )


def test_a_server_has_the_colour_that_it_has_on_the_flight_page(tmp_path: Path) -> None:
    """Which is by the order of the names, whatever the order in the file."""
    scenario = field_of(tmp_path, ["pole10", "pole2", "pole1"])
    assert main(["simulate", str(scenario), "--figures", str(tmp_path), "--format", "svg"]) == 0
    fills = {
        "".join(each.itertext()): each.attrib["style"].rpartition("fill: ")[2]
        for each in ET.parse(tmp_path / "map.svg").iter(f"{SVG}text")
    }
    assert [fills[name] for name in ("pole1", "pole2", "pole10")] == [
        LIGHT.of_server(index) for index in range(3)
    ]
    assert texts(tmp_path / "call_delay.svg").index("pole2") < texts(tmp_path / "call_delay.svg").index(
        "pole10"
    )


def test_a_server_without_a_range_has_its_calls_drawn(tmp_path: Path) -> None:
    scenario = shutil.copy(SCENARIOS.parent / "examples" / "lte.toml", tmp_path)
    command = ["simulate", str(scenario), "--keep-coverage", "--figures", str(tmp_path), "--format", "svg"]
    assert main(command) == 0
    assert {"on s1", "s1"} <= set(texts(tmp_path / "call_delay.svg"))
    assert_whole(tmp_path / "call_delay.svg")


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
    assert {"field", "town", "look-ahead", "less than local-only,", "paired (min)"} <= set(said)
    assert said.count("local-only") == 2
    assert_whole(tmp_path / "means.svg")


@pytest.mark.parametrize("cases", [1, 2, 12])
@pytest.mark.parametrize("name", ["local", ", ".join(["service.detector.local_call_s={ light = 0.3 }"] * 2)])
def test_each_setting_has_its_bound_and_no_name_is_cut(tmp_path: Path, cases: int, name: str) -> None:
    times = [mean_of([60.0 * (30 + case), 60.0 * (31 + case)]) for case in range(cases)]
    saved = mean_of([60.0, 65.0])
    rows = [
        DrawnMean(
            group,
            f"{name}, seeds={case}",
            time,
            saved if case else None,
            None if case % 3 == 1 else 900.0 + case,
        )
        for group in ("field", f"{LONG}-{LONG}")
        for case, time in enumerate(times)
    ]
    draw_means(rows, FigureFiles(tmp_path, ("svg",)).files("means"))
    assert_whole(tmp_path / "means.svg")
    assert bounds(tmp_path / "means.svg") == sum(row.bound_s is not None for row in rows)
    assert ("paired (min)" in texts(tmp_path / "means.svg")) is (cases > 1)


@pytest.mark.parametrize("values", [(1.0, 2.0), (0.0001, 0.0029), (1e6, 54e6), (3.5, 123456.0)])
def test_the_numbers_on_the_axes_of_a_setting_have_room(tmp_path: Path, values: tuple[float, float]) -> None:
    rows = [
        DrawnMean("field", str(value), mean_of([100_000.0, 100_003.0]), None, 99_999.0) for value in values
    ]
    key = f"server.{LONG}-1.bandwidth_bit_s"
    draw_sweep(values, rows, FigureFiles(tmp_path, ("svg",)).files("sweep"), key=key)
    assert_whole(tmp_path / "sweep.svg")


def test_a_setting_has_its_bound_where_another_has_none(tmp_path: Path) -> None:
    rows = [
        DrawnMean("field", "", Mean(1, 600.0, float("inf")), None, bound_s)
        for bound_s in (500.0, None, 400.0)
    ]
    draw_sweep([1.0, 2.0, 3.0], rows, FigureFiles(tmp_path, ("svg",)).files("sweep"), key="drones")
    assert {"theoretical minimum", "mean", "1", "2", "3"} <= set(texts(tmp_path / "sweep.svg"))
    assert "1.5" not in texts(tmp_path / "sweep.svg")


def test_one_numeric_setting_is_a_line_with_its_confidence(tmp_path: Path) -> None:
    rows = [
        DrawnMean("field", str(value), mean_of([60.0 * value, 66.0 * value]), None, 50.0)
        for value in (10, 20)
    ]
    draw_sweep([10.0, 20.0], rows, FigureFiles(tmp_path, ("svg",)).files("sweep"), key="server.s1.range_m")
    assert {"server.s1.range_m", "theoretical minimum", "mean and 95 % confidence"} <= set(
        texts(tmp_path / "sweep.svg")
    )


def test_policies_and_campaigns_are_drawn(tmp_path: Path) -> None:
    figures = ["--figures", str(tmp_path), "--format", "svg"]
    scenario = str(SCENARIOS / "demonstration.toml")
    assert main(["compare", scenario, "--seeds", "2", "--workers", "1", *figures]) == 0
    assert {"demonstration", "look-ahead", "less than local-only,"} <= set(texts(tmp_path / "compare.svg"))
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
