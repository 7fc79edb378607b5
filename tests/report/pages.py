"""What a flight's page says in words and tables, for tests: of logs that are written here, as a tree."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree

from tests.events import line

from upwash.report.photos import PhotoShelf
from upwash.report.record import read_records
from upwash.report.sheet import draw_sheet

Told = tuple[float, str, Mapping[str, object]]  # an event: when, its kind and its facts
SVG = "{http://www.w3.org/2000/svg}"


def log_of(file: Path, *events: Told, home: object = None) -> Path:
    """A log of these events, after the plan and the start of a mission of four waypoints at second 1."""
    began: list[Told] = [
        (0.0, "planned", {"home": home, "waypoints_m": [(0, 0), (20, 0), (40, 0), (60, 0)]}),
        (1.0, "mission_started", {"policy": "location-aware", "waypoints": 4}),
    ]
    file.write_bytes(b"".join(line(kind, t, **facts) for t, kind, facts in (*began, *events)))
    return file


def arrivals(*waypoints: int) -> Iterator[Told]:
    """At each of these waypoints, ten seconds apart."""
    for number, waypoint in enumerate(waypoints):
        yield 2.0 + 10 * number, "arrived", {"waypoint": waypoint, "east_m": 20.0 * waypoint, "north_m": 0.0}


def parsed(*logs: Path, photos: Path | None = None) -> ElementTree.Element:
    """What is said of these logs."""
    return ElementTree.fromstring(draw_sheet(read_records(logs), PhotoShelf(photos)))


def text(element: ElementTree.Element) -> str:
    """All that it says."""
    return "".join(element.itertext())


def of_class(page: ElementTree.Element, style: str) -> list[ElementTree.Element]:
    """The elements that have that class."""
    return [each for each in page.iter() if style in each.get("class", "").split()]


def table_named(page: ElementTree.Element, caption: str) -> list[list[str]]:
    """The rows of the only table with that caption."""
    (table,) = [each for each in page.iter("table") if each[0].text == caption]
    return [[text(cell) for cell in row] for row in table.iter("tr")]


def heads(page: ElementTree.Element) -> list[str]:
    """The headings of the page's parts."""
    return [text(each) for each in page.iter("h2")]
