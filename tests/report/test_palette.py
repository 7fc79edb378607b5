"""The colours can be told apart, by most people, on both grounds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import pytest

from upwash.report.palette import DARK, LIGHT, Theme, stylesheet

Triple = tuple[float, float, float]

_EYES: dict[str, tuple[Triple, Triple, Triple]] = {  # Machado, Oliveira and Fernandes 2009, on linear RGB
    "normal": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "protanope": (
        (0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)
    ),
    "deuteranope": (
        (0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881)
    ),
    "tritanope": (
        (1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602), (0.004733, 0.691367, 0.303900)
    ),
}  # fmt: skip
_XYZ = (
    (0.4124564, 0.3575761, 0.1804375), (0.2126729, 0.7151522, 0.0721750), (0.0193339, 0.1191920, 0.9503041)
)  # fmt: skip
_WHITE = (0.95047, 1.0, 1.08883)
_APART = 12.0


def through(matrix: tuple[Triple, Triple, Triple], value: Triple) -> Triple:
    first, second, third = (sum(a * b for a, b in zip(row, value, strict=True)) for row in matrix)
    return first, second, third


def linear(colour: str) -> Triple:
    """Of #rrggbb."""
    red, green, blue = (int(colour[start : start + 2], 16) / 255 for start in (1, 3, 5))
    return _linear(red), _linear(green), _linear(blue)


def _linear(value: float) -> float:
    return float(value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4)


def lab(light: Triple) -> Triple:
    """CIELAB of linear sRGB."""
    seen = through(_XYZ, (min(1, max(0, light[0])), min(1, max(0, light[1])), min(1, max(0, light[2]))))
    x, y, z = (_root(value / white) for value, white in zip(seen, _WHITE, strict=True))
    return 116 * y - 16, 500 * (x - y), 200 * (y - z)


def _root(value: float) -> float:
    return math.cbrt(value) if value > 216 / 24389 else (24389 / 27 * value + 16) / 116


def difference(one: Triple, other: Triple) -> float:
    """CIEDE2000, after Sharma, Wu and Dalal 2005."""
    mean = (math.hypot(*one[1:]) + math.hypot(*other[1:])) / 2
    stretch = 1.5 - 0.5 * math.sqrt(mean**7 / (mean**7 + 25**7))
    (c1, h1), (c2, h2) = (
        (math.hypot(stretch * a, b), math.degrees(math.atan2(b, stretch * a)) % 360)
        for _, a, b in (one, other)
    )
    turn = (h2 - h1 + 180) % 360 - 180 if c1 * c2 else 0.0
    lightness, chroma = (one[0] + other[0]) / 2, (c1 + c2) / 2
    hue = (h1 + turn / 2) % 360 if c1 * c2 else h1 + h2
    t = (
        1
        - 0.17 * _cos(hue - 30)
        + 0.24 * _cos(2 * hue)
        + 0.32 * _cos(3 * hue + 6)
        - 0.20 * _cos(4 * hue - 63)
    )
    d_l = (other[0] - one[0]) / (1 + 0.015 * (lightness - 50) ** 2 / math.sqrt(20 + (lightness - 50) ** 2))
    d_c = (c2 - c1) / (1 + 0.045 * chroma)
    d_h = 2 * math.sqrt(c1 * c2) * math.sin(math.radians(turn / 2)) / (1 + 0.015 * chroma * t)
    bend = -2 * math.sqrt(chroma**7 / (chroma**7 + 25**7))
    bend *= math.sin(math.radians(60 * math.exp(-(((hue - 275) / 25) ** 2))))
    return math.sqrt(d_l**2 + d_c**2 + d_h**2 + bend * d_c * d_h)


def _cos(degrees: float) -> float:
    return math.cos(math.radians(degrees))


def contrast(one: str, other: str) -> float:
    """WCAG 2.2's, from 1 to 21."""
    dark, light = sorted(through(_XYZ, linear(colour))[1] for colour in (one, other))
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((50.0, 2.5, 0.0), (61.0, -5.0, 29.0), 22.8977),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_differences_are_those_of_the_published_pairs(one: Triple, other: Triple, expected: float) -> None:
    assert difference(one, other) == pytest.approx(expected, abs=1e-4)


def sets() -> Iterator[tuple[str, Theme, list[str]]]:
    for name, theme in (("light", LIGHT), ("dark", DARK)):
        yield f"{name} places", theme, list(theme.places)
        yield f"{name} drones", theme, list(theme.drones)


@pytest.mark.parametrize("eye", list(_EYES))
@pytest.mark.parametrize(
    ("theme", "colours"), [each[1:] for each in sets()], ids=[each[0] for each in sets()]
)
def test_any_two_of_a_set_can_be_told_apart(theme: Theme, colours: list[str], eye: str) -> None:
    seen = {colour: lab(through(_EYES[eye], linear(colour))) for colour in colours}
    close = {
        (one, other): round(difference(seen[one], seen[other]), 1)
        for one, other in itertools.combinations(colours, 2)
        if difference(seen[one], seen[other]) < _APART
    }
    assert close == {}


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_what_is_drawn_and_written_stands_out_from_its_ground(theme: Theme) -> None:
    for ground in (theme.paper, theme.band):
        assert {place for place in theme.places if contrast(place, ground) < 3} == set(), "marks: WCAG 1.4.11"
        assert contrast(theme.ink, ground) > 7
        assert contrast(theme.soft, ground) > 4.5
    for ground in (theme.ready, theme.check, theme.caution):
        assert contrast(theme.ink, ground) > 4.5
    assert contrast(theme.on_alarm, theme.alarm) > 4.5
    assert {drone for drone in theme.drones if contrast(drone, theme.paper) < 4.5} == set(), "their numbers"


def test_the_style_sheet_has_every_colour_of_both_themes() -> None:
    css = stylesheet()
    for theme in (LIGHT, DARK):
        for colour in (*theme.places, *theme.drones, theme.alarm, theme.paper):
            assert f"{colour};" in css
    assert ".place-8 {" in css
    assert ".drone-8 {" in css


def test_after_the_last_server_the_colours_come_again_but_not_the_drones() -> None:
    colours = [LIGHT.of_server(index) for index in range(9)]
    assert len(set(colours[:8])) == 8
    assert colours[8] == colours[0]
    assert LIGHT.places[0] not in colours
