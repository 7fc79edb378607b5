"""The map of a site: the photos on the ground, and over them the objects under their numbers, as SVG."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from upwash.core.geo import Position
from upwash.report.client.album import DocumentPictures
from upwash.report.client.labels import Spot, place_labels
from upwash.report.client.mosaic import Bounds
from upwash.report.client.survey import Inspected, Photograph, Survey
from upwash.report.client.words import Words
from upwash.report.markup import Markup, element, in_document, joined
from upwash.report.palette import components

_SAME_SITE_M = 1500.0  # between homes: flights on one map
_WIDE, _HIGH = 1000.0, 920.0  # of the whole map, at most
_LEAST_M = 10.0
_MARGIN = 0.03
_FAR = 3.0  # times the photographed ground: objects farther away are not on the map
_HUGE = 6.0  # times a usual photo's ground: photos up to the horizon do not decide how large the map is
_LARGE, _SMALL, _MANY = 20.0, 15.0, 60  # the height of numbers, and from how many objects on they are small
_BAR = 0.25  # of the map's width, at most
_FOOT = 40.0  # below the ground, for the scale


@dataclass(frozen=True, slots=True)
class SurveyedSite:
    """Flights over the same ground; Places are counted from the home of the flight `first`."""

    first: int
    flights: Sequence[int]


@dataclass(frozen=True, slots=True)
class _Point:
    """An object on the map, in its units."""

    x: float
    y: float
    radius: float | None
    object: Inspected


@dataclass(frozen=True, slots=True)
class DrawnMap:
    """A map, the names of the objects beyond it, and how many objects on it have no room for their numbers."""

    svg: Markup
    beyond: Sequence[str]
    unnumbered: int


def sites_of(survey: Survey) -> list[SurveyedSite]:
    """The flights by where they began, in their order."""
    sites: list[tuple[int, list[int]]] = []
    for flight in range(len(survey.flights)):
        for first, flights in sites:
            if math.hypot(*survey.offset_m(flight, first)) <= _SAME_SITE_M:
                flights.append(flight)
                break
        else:
            sites.append((flight, [flight]))
    return [SurveyedSite(first, flights) for first, flights in sites]


class SiteMap:
    """A site on a plane in metres; `photographed` is the ground on the photos, None if unknown.

    A metre of the ground is `scale` units of the map.
    """

    def __init__(self, survey: Survey, site: SurveyedSite) -> None:
        self._survey = survey
        self.site = site
        self.photographs = [photo for flight in site.flights for photo in survey.flights[flight].photographs]
        self.objects = [each for each in survey.objects if each.found.best[0] in site.flights]
        corners = self._usual_corners()
        self.photographed = _around(corners)
        spots = [spot for photo in self.photographs if (spot := self._taken_at_m(photo)) is not None]
        self.bounds = _bounds(_around([*corners, *spots]), [self._place_m(each) for each in self.objects])
        self.scale = min(_WIDE / self.bounds.width_m, (_HIGH - _FOOT) / self.bounds.height_m)
        self._size = self.scale * self.bounds.width_m, self.scale * self.bounds.height_m

    def _at(self, place_m: tuple[float, float]) -> tuple[float, float]:
        """Where the place is on the map, to the right and down."""
        east_m, north_m = place_m
        return self.scale * (east_m - self.bounds.west_m), self.scale * (self.bounds.north_m - north_m)

    def _corners_m(self, photo: Photograph) -> list[tuple[float, float]]:
        return self._survey.corners_m(photo, self.site.first)

    def _usual_corners(self) -> list[tuple[float, float]]:
        corners = [self._corners_m(photo) for photo in self.photographs if photo.corners_m is not None]
        if not corners:
            return []
        usual_m = statistics.median(math.dist(each[0], each[2]) for each in corners)
        return [
            corner for each in corners if math.dist(each[0], each[2]) <= _HUGE * usual_m for corner in each
        ]

    def _place_m(self, each: Inspected) -> tuple[float, float]:
        return self._from_home(each.found.best[0], each.found.finding.place)

    def _taken_at_m(self, photo: Photograph) -> tuple[float, float] | None:
        place = photo.taken.shot.position
        return None if place is None else self._from_home(photo.key[0], place)

    def _from_home(self, flight: int, place: Position) -> tuple[float, float]:
        east_m, north_m = self._survey.offset_m(flight, self.site.first)
        return place.east_m + east_m, place.north_m + north_m

    def draw(self, mosaic: bytes | None, album: DocumentPictures, words: Words) -> DrawnMap:
        """The map over the mosaic of the photos; missing photos are outlines, and photos without corners dots."""
        width, height = self._size
        points, beyond = self._points()
        size = _LARGE if len(points) <= _MANY else _SMALL
        sizes = [(0.62 * size * len(point.object.name) + 0.7 * size, 1.25 * size) for point in points]
        labels = place_labels([(point.x, point.y) for point in points], sizes, self._size)
        numbered = [
            _numbered(point, label, size, wide_high, words, linked=album.shows(point.object))
            for point, label, wide_high in zip(points, labels, sizes, strict=True)
        ]
        frame = f"site-{self.site.first}"
        svg = element(
            "svg",
            element("clipPath", element("rect", width=width, height=height), id=frame),
            element(
                "g",
                *self._ground(mosaic, album),
                *(_ring(point, words) for point in points),
                clip_path=f"url(#{frame})",
            ),
            element("rect", width=width, height=height, class_="frame"),
            *(line for lines, _ in numbered for line in lines),
            *(mark for _, mark in numbered),
            _scale(self.scale, height),
            _north(width, height),
            xmlns="http://www.w3.org/2000/svg",
            viewBox=f"-1 -1 {width + 2:.1f} {height + _FOOT + 2:.1f}",
            width=f"{100 * width / _WIDE:.4g}%",
            role="group",
            aria_label=f"Map of {len(points)} numbered objects; the table of objects has their places",
        )
        return DrawnMap(svg, beyond, sum(label is None for label in labels))

    def _points(self) -> tuple[list[_Point], list[str]]:
        """The objects on the map, and the names of those beyond it."""
        points, beyond = [], []
        for each in self.objects:
            x, y = self._at(self._place_m(each))
            error_m = each.found.finding.error_m
            if 0 <= x <= self._size[0] and 0 <= y <= self._size[1]:
                points.append(_Point(x, y, None if error_m is None else self.scale * error_m, each))
            else:
                beyond.append(each.name)
        return points, beyond

    def _ground(self, mosaic: bytes | None, album: DocumentPictures) -> Iterator[Markup]:
        width, height = self._size
        if mosaic is not None:
            size = {"width": width, "height": height}
            yield element("image", href=in_document(mosaic), **size, preserveAspectRatio="none")
        for photo in self.photographs:
            if photo.corners_m is not None and photo.key in album.missing:
                corners = " ".join("{:.1f},{:.1f}".format(*self._at(each)) for each in self._corners_m(photo))
                yield element("polygon", points=corners, class_="ground" if mosaic else "ground bare")
            elif photo.corners_m is None and (spot := self._taken_at_m(photo)) is not None:
                x, y = self._at(spot)
                yield element("circle", cx=x, cy=y, r=2.5, class_="spot")


def _bounds(ground: Bounds | None, objects: Sequence[tuple[float, float]]) -> Bounds:
    """The ground, and the objects near it, with a margin."""
    near = list(objects)
    if ground is not None:
        beyond_m = _FAR * max(ground.width_m, ground.height_m, _LEAST_M)
        near = [
            (east_m, north_m)
            for east_m, north_m in objects
            if ground.west_m - beyond_m <= east_m <= ground.east_m + beyond_m
            and ground.south_m - beyond_m <= north_m <= ground.north_m + beyond_m
        ]
        near += [(ground.west_m, ground.south_m), (ground.east_m, ground.north_m)]
    whole = _around(near) or Bounds(0.0, 0.0, 0.0, 0.0)
    margin_m = _MARGIN * max(whole.width_m, whole.height_m, _LEAST_M)
    wide_m = max(0.0, _LEAST_M - whole.width_m) / 2 + margin_m
    high_m = max(0.0, _LEAST_M - whole.height_m) / 2 + margin_m
    return Bounds(
        whole.west_m - wide_m, whole.south_m - high_m, whole.east_m + wide_m, whole.north_m + high_m
    )


def ink_on(colour: str) -> str:
    """Black or white: the ink with the higher contrast on the colour (WCAG 2)."""
    linear = [
        each / 12.92 if each <= 0.04045 else ((each + 0.055) / 1.055) ** 2.4 for each in components(colour)
    ]
    light = sum(share * each for share, each in zip((0.2126, 0.7152, 0.0722), linear, strict=True))
    return "#000000" if (light + 0.05) / 0.05 > 1.05 / (light + 0.05) else "#ffffff"


def _around(places: Sequence[tuple[float, float]]) -> Bounds | None:
    if not places:
        return None
    east, north = zip(*places, strict=True)
    return Bounds(min(east), min(north), max(east), max(north))


def _ring(point: _Point, words: Words) -> Markup:
    """How far from there the object may lie."""
    if point.radius is None:
        return Markup()
    colour = words.of(point.object.found.finding.what).colour
    ring = {"cx": point.x, "cy": point.y, "r": point.radius}
    return joined(
        element("circle", **ring, class_="halo"), element("circle", **ring, stroke=colour, class_="radius")
    )


def _numbered(
    point: _Point,
    label: Spot | None,
    size: float,
    wide_high: tuple[float, float],
    words: Words,
    *,
    linked: bool,
) -> tuple[Sequence[Markup], Markup]:
    """The line from the object's place to its number, and both of them."""
    word = words.of(point.object.found.finding.what)
    spot = element("circle", cx=point.x, cy=point.y, r=4.5, fill=word.colour, class_="point")
    if label is None:
        return (), spot
    x, y = label
    ends = {"x1": point.x, "y1": point.y, "x2": x, "y2": y}
    line = [
        element("line", **ends, class_="halo"),
        element("line", **ends, stroke=word.colour, class_="leader"),
    ]
    wide, high = wide_high
    box = element(
        "rect", x=x - wide / 2, y=y - high / 2, width=wide, height=high, rx=high / 2, fill=word.colour,
        class_="number",
    )  # fmt: skip
    number = element(
        "text", point.object.name, x=x, y=y + 0.35 * size, font_size=size, fill=ink_on(word.colour),
        text_anchor="middle",
    )  # fmt: skip
    if not linked:
        return line, joined(spot, box, number)
    name = f"Object {point.object.name}: {word.name}"
    return line, joined(spot, element("a", box, number, href=f"#object-{point.object.name}", aria_label=name))


def _scale(scale: float, height: float) -> Markup:
    """A bar of a round number of metres."""
    most_m = _BAR * _WIDE / scale
    step_m = 10.0 ** math.floor(math.log10(most_m))
    length_m = max(factor * step_m for factor in (1, 2, 5) if factor * step_m <= most_m)
    words = f"{length_m / 1000:g} km" if length_m >= 1000 else f"{length_m:g} m"
    y, end = height + 20.0, scale * length_m
    return joined(
        element("path", d=f"M1 {y - 6:.1f} v6 h{end:.1f} v-6", class_="scale"),
        element("text", words, x=end + 8, y=y + 1, font_size=18, class_="said"),
    )


def _north(width: float, height: float) -> Markup:
    x, y = width - 12, height + 8
    return joined(
        element("path", d=f"M{x:.1f} {y:.1f} l7 20 l-7 -5 l-7 5 z", class_="north"),
        element("text", "N", x=x - 14, y=y + 17, font_size=18, text_anchor="end", class_="said"),
    )
