"""The client's document as one HTML file, which needs no scripts and refers to no other file."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.resources import files

from upwash.report.client.album import DocumentPictures, album_of
from upwash.report.client.mosaic import Mosaic
from upwash.report.client.objects import draw_objects, listed
from upwash.report.client.sitemap import DrawnMap, SiteMap, sites_of
from upwash.report.client.survey import Survey, SurveyFlight, survey_of
from upwash.report.client.words import NO_WORDS, Words
from upwash.report.markup import Markup, element, head, in_document, joined, source_of
from upwash.report.palette import DARK, LIGHT, Theme
from upwash.report.photos import PhotoShelf
from upwash.report.record import Record
from upwash.support.text import counted, printable

_LONGEST_LABEL = 80  # characters
_MOST_FLIGHTS = 20  # with a line each
_SECURITY = "default-src 'none'; base-uri 'none'; form-action 'none'; img-src data:; style-src"
_COLOURS = ("paper", "ink", "soft", "line", "band", "alarm")


@dataclass(frozen=True, slots=True)
class Wording:
    """What the user says in the document: its title, "" for the date's, a note, and the client's words."""

    title: str = ""
    note: str = ""
    words: Words = NO_WORDS


@dataclass(frozen=True, slots=True)
class ClientDocument:
    """The document, how many photos the flights have, and of how many there are pictures.

    `is_full` says that there are fewer pictures than usual, as all have a bound.
    """

    html: bytes
    photos: int
    shown: int
    is_full: bool


def client_document(
    records: Sequence[Record], shelves: Sequence[PhotoShelf], wording: Wording
) -> ClientDocument:
    """The document about these flights, the photos of each on its shelf."""
    survey = survey_of(records)
    maps = [SiteMap(survey, site) for site in sites_of(survey)]
    mosaics = [Mosaic(each.bounds) for each in maps]
    by_flight = {
        flight: (each.site.first, mosaic)
        for each, mosaic in zip(maps, mosaics, strict=True)
        for flight in each.site.flights
    }
    album = album_of(survey, shelves, by_flight)
    drawn = [each.draw(mosaic.jpeg, album, wording.words) for each, mosaic in zip(maps, mosaics, strict=True)]
    days = _days(survey)
    title = wording.title or (f"Inspection of {days}" if days else "Inspection")
    body = element(
        "main",
        element("h1", title, dir="auto"),
        _facts(survey, maps),
        _note(wording.note),
        *(
            _map(each, svg, album, number=number, of=len(maps))
            for number, (each, svg) in enumerate(zip(maps, drawn, strict=True), start=1)
        ),
        *draw_objects(survey, album, wording.words),
        *_without_findings(survey, album),
        *_how(survey),
        element("footer", "Places are in degrees of WGS 84; times are UTC. Made with upwash."),
    )
    shown = len(album.photos.keys() | album.thumbnails.keys() | album.laid)
    style = _style()
    opened = head(title, style, policy=f"{_SECURITY} {source_of(style)}")
    html = f"<!DOCTYPE html>\n{element('html', opened, element('body', body), lang='en')}\n".encode()
    return ClientDocument(html, len(survey.photographs), shown, album.full)


@functools.cache
def _style() -> str:
    own = (files("upwash.report.client") / "document.css").read_text(encoding="utf-8")
    dark = f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {_colours(DARK)} }} }}"
    return f":root {{ color-scheme: light dark; {_colours(LIGHT)} }}\n{dark}\n{own}"


def _colours(theme: Theme) -> str:
    return " ".join(f"--{name}: {getattr(theme, name)};" for name in _COLOURS)


# --- who, when and where ------------------------------------------------------------------------------------


def _facts(survey: Survey, maps: Sequence[SiteMap]) -> Markup:
    facts = [("Date", _dates(survey))]
    for number, each in enumerate(maps, start=1):
        facts.append(("Site" if len(maps) == 1 else f"Site {number}", _where(survey, each)))
    drones = dict.fromkeys(filter(None, map(_flown_by, survey.flights)))
    facts += [("Flown by", ", ".join(drones))] if drones else []
    photos = counted(len(survey.photographs), "photo")
    facts.append(("Flights", f"{counted(len(survey.flights), 'flight')}, {photos}"))
    if 1 < len(survey.flights) <= _MOST_FLIGHTS:
        facts += [(f"Flight {number}", _flight(each)) for number, each in enumerate(survey.flights, start=1)]
    facts.append(("Found", counted(len(survey.objects), "object") if survey.objects else "nothing"))
    facts += [("Reviewed", survey.tally.words)] if survey.tally.words else []
    return element(
        "dl",
        *(joined(element("dt", name), element("dd", element("bdi", value))) for name, value in facts),
        class_="facts",
    )


def _days(survey: Survey) -> str:
    opened = [time for flight in survey.flights if (time := _began(flight)) is not None]
    days = list(dict.fromkeys(f"{time.day} {time:%B %Y}" for time in sorted(opened)))
    return days[0] if len(days) == 1 else f"{days[0]} to {days[-1]}" if days else ""


def _flight(flight: SurveyFlight) -> str:
    began, drone = _began(flight), _flown_by(flight)
    day = [] if began is None else [f"{began.day} {began:%B %Y}, {began:%H:%M} UTC"]
    photos = counted(len(flight.photographs), "photo")
    return "; ".join(
        [*day, *([drone] if drone else []), photos, counted(len(flight.record.findings), "sighting")]
    )


def _dates(survey: Survey) -> str:
    if all(flight.record.simulated is not None for flight in survey.flights):
        return "none: simulated"
    began = [time for flight in survey.flights if (time := _began(flight)) is not None]
    ended = [time for flight in survey.flights if (time := _ended(flight)) is not None]
    if not began or not ended:
        return "not known"
    first, last = min(began), max(ended)
    if first.date() == last.date():
        return f"{_days(survey)}, {first:%H:%M} to {last:%H:%M} UTC"
    return _days(survey)


def _began(flight: SurveyFlight) -> datetime | None:
    return flight.record.flight.time_of_day(flight.record.began_s)


def _ended(flight: SurveyFlight) -> datetime | None:
    return flight.record.flight.time_of_day(flight.record.began_s + flight.record.result.mission_time_s)


def _where(survey: Survey, site: SiteMap) -> str:
    home = survey.flights[site.site.first].record.plan.home
    ground = site.photographed
    known = [] if home is None else [f"{home.latitude_deg:.6f}°, {home.longitude_deg:.6f}° (take-off)"]
    if ground is not None:
        known.append(f"{ground.width_m:.0f} m (east-west) by {ground.height_m:.0f} m photographed")
    return "; ".join(known) or "not known"


def _flown_by(flight: SurveyFlight) -> str:
    drone = printable(flight.record.drone or "", _LONGEST_LABEL)
    return f"{drone} ({flight.vehicle})" if drone and flight.vehicle else drone or flight.vehicle


def _note(note: str) -> Markup:
    lines = [printable(line) for line in note.splitlines() if line.strip()]
    if not lines:
        return Markup()
    return element("div", *(element("p", line, dir="auto") for line in lines), class_="client-note")


# --- the map ------------------------------------------------------------------------------------------------


def _map(site: SiteMap, drawn: DrawnMap, album: DocumentPictures, *, number: int, of: int) -> Markup:
    said: list[str] = ["North is up."]
    if site.objects:
        said.append("The numbers are those of the table, and a ring is the radius there.")
    placed = [photo.key for photo in site.photographs if photo.corners_m is not None]
    laid = len(album.laid.intersection(placed))
    if 0 < laid < len(placed):
        said.append(f"{laid} of {counted(len(placed), 'photo')} are laid over the ground.")
    if drawn.beyond:
        said.append(joined("Beyond the map: ", listed(drawn.beyond), "."))
    if drawn.unnumbered:
        objects = counted(drawn.unnumbered, "object")
        said.append(f"{objects} had no room for a number here; the table has all places.")
    caption = element("figcaption", *(part for sentence in said for part in (sentence, " ")))
    heading = element("h2", "Map" if of == 1 else f"Map of site {number}")
    return element("section", heading, element("figure", drawn.svg, caption), class_="map")


# --- what else there is -------------------------------------------------------------------------------------


def _without_findings(survey: Survey, album: DocumentPictures) -> Iterator[Markup]:
    told = survey.with_findings
    empty = [photo for photo in survey.photographs if photo.key not in told]
    shown = [photo for photo in empty if photo.key in album.thumbnails]
    if not shown:
        return
    items = []
    for photo in shown:
        picture, name = album.thumbnails[photo.key], survey.named(photo.key)
        size = {"width": picture.width_px, "height": picture.height_px}
        image = element("img", src=in_document(picture.jpeg), alt=f"{name}: nothing found", **size)
        items.append(element("li", element("figure", image, element("figcaption", name))))
    number = counted(len(empty), "photo")
    note = number if len(shown) == len(empty) else f"{len(shown)} of {number}"
    yield element(
        "section",
        element("h2", "Photos without findings"),
        element("p", f"{note}.", class_="soft"),
        element("ul", *items, class_="thumbnails"),
    )


def _how(survey: Survey) -> Iterator[Markup]:
    if not survey.objects:
        return
    ground = "a terrain model" if survey.knows_the_ground else "taken to be level with the take-off"
    computed = (
        "Each place was computed from the object's box on the photo, the camera's position and direction at the "
        f"shutter, its lens, and the ground ({ground}).",
        "An object on several photos has one number, and its place is the mean of its sightings, of which the surer "
        "ones count more.",
        "The radius adds up the errors of all these; an object without a radius is shown where the drone took its "
        "photo.",
    )
    taken = (
        "The camera's lens or direction is not known.",
        "So each place is that of the drone when it took the photo.",
        "How far from there the object lies is not known, and an object on several photos has several numbers.",
    )
    sentences = computed if any(each.found.finding.own for each in survey.objects) else taken
    yield element("section", element("h2", "How the places were made"), element("p", " ".join(sentences)))
