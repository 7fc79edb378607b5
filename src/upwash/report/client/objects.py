"""The objects of the client's document: by label, in a table, and each with its pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from upwash.report.client.album import DocumentPictures
from upwash.report.client.sitemap import ink_on
from upwash.report.client.survey import Inspected, ShownSighting, Survey
from upwash.report.client.words import Word, Words
from upwash.report.gallery import coordinates, outlined
from upwash.report.markup import Markup, element, joined
from upwash.report.numbering import PlacedFinding
from upwash.report.tables import framed
from upwash.support.text import counted, printable

_LONGEST_LABEL = 80  # characters
_MOST_ROWS = 2000  # objects
_MOST_LABELS = 100  # rows
_MOST_LISTED = 40  # numbers in a row
_STYLES = {"No.": "no", "Label": "words", "Severity": "words", "Numbers": "numbers"}  # of columns


def draw_objects(survey: Survey, album: DocumentPictures, words: Words) -> Iterator[Markup]:
    """The sections about what was found."""
    if not survey.objects:
        yield _section("Objects", element("p", "Nothing was found on the photos."))
        return
    yield _section("What was found", _by_label(survey, words))
    pictured = [each for each in survey.objects if album.shows(each)]
    yield _section("Objects", _table(survey, album, words))
    if not pictured:
        yield element("p", "The photos are not part of this document.", class_="soft")
        return
    cards = element("div", *map(_Cards(survey, album, words).card, pictured), class_="objects")
    lacking = len(survey.objects) - len(pictured)
    note = f"{counted(lacking, 'object')} without a picture: see the table." if lacking else ""
    yield _section("Each object", element("p", note, class_="soft") if note else Markup(), cards)


def listed(names: Sequence[str]) -> Markup:
    """The names of the first objects, and how many more there are; no line ends within a name."""
    more = [f" and {len(names) - _MOST_LISTED} more"] if len(names) > _MOST_LISTED else []
    shown = [element("span", name, class_="name") for name in names[:_MOST_LISTED]]
    return joined(Markup(", ".join(shown)), *more)


def _section(heading: str, *content: Markup) -> Markup:
    return element("section", element("h2", heading), *content)


# --- tables -------------------------------------------------------------------------------------------------


def _by_label(survey: Survey, words: Words) -> Markup:
    """How many objects of each label there are, the worst first; labels that the client calls the same are one."""
    names: dict[Word, list[str]] = {}
    for each in survey.objects:
        names.setdefault(words.of(each.found.finding.what), []).append(each.name)
    rank = {severity: number for number, severity in enumerate(words.severities)}
    ordered = sorted(names, key=lambda word: (rank.get(word.severity, len(rank)), -len(names[word])))
    rows = [
        element(
            "tr",
            element("th", _worded(word.name), scope="row", class_="words"),
            *([element("td", _worded(word.severity))] if rank else []),
            element("td", str(len(names[word])), class_="figures"),
            element("td", listed(names[word]), class_="numbers"),
        )
        for word in ordered[:_MOST_LABELS]
    ]
    more = len(ordered) - len(rows)
    note = element("p", f"{counted(more, 'label')} more: see the next table.", class_="soft")
    heads = ["Label", *(["Severity"] if rank else []), "Objects", "Numbers"]
    return joined(_whole("Objects by label", heads, rows), *([note] if more else []))


def _table(survey: Survey, album: DocumentPictures, words: Words) -> Markup:
    severity = ["Severity"] if words.severities else []
    ground = ["Ground"] if survey.knows_the_ground else []
    shown = survey.objects[:_MOST_ROWS]
    rows = [_row(each, words, ground=bool(ground), linked=album.shows(each)) for each in shown]
    figures = ["Score", "Latitude", "Longitude", "East", "North", "Radius", "Sightings", "Altitude"]
    heads = ["No.", "Label", *severity, *figures, *ground]
    said = [
        "East and north are metres from the flight's take-off.",
        "With a probability of 95 % the object lies within the radius around its place.",
        "Altitude is that of the camera above the take-off.",
    ]
    if not survey.are_one_list:
        said.append("The number before the dash is the flight's.")
    if ground:
        said.append("Ground is the altitude of the object's place above the take-off.")
    if len(survey.objects) > _MOST_ROWS:
        said.append(f"{len(survey.objects) - _MOST_ROWS} more objects are left out.")
    return joined(_whole("Objects", heads, rows), element("p", " ".join(said), class_="soft"))


def _row(each: Inspected, words: Words, *, ground: bool, linked: bool) -> Markup:
    found, finding = each.found, each.found.finding
    word = words.of(finding.what)
    latitude, longitude = (f"{degrees:.6f}°" for degrees in found.earth) if found.earth else ("", "")
    camera = finding.photo.shot.position if finding.photo else None
    figures = [
        _percent(finding.score),
        latitude,
        longitude,
        _metres(finding.place.east_m),
        _metres(finding.place.north_m),
        "not known" if finding.error_m is None else _metres(finding.error_m),
        str(found.sightings),
        "" if camera is None else _metres(camera.altitude_m),
    ]
    if ground:
        figures.append(_metres(finding.own.position.altitude_m) if finding.own else "")
    name = element("a", each.name, href=f"#object-{each.name}") if linked else each.name
    return element(
        "tr",
        element("th", name, scope="row"),
        element("td", _worded(word.name), *_note(found), class_="words"),
        *([element("td", _worded(word.severity), class_="words")] if words.severities else []),
        *(element("td", figure, class_="figures") for figure in figures),
    )


def _whole(caption: str, heads: Sequence[str], rows: Sequence[Markup]) -> Markup:
    head = [element("th", name, scope="col", class_=_STYLES.get(name, "figures")) for name in heads]
    return framed(caption, head, rows)


# --- each object --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Cards:
    """Draws objects with their pictures; a photo that several objects are on is in the document once."""

    survey: Survey
    album: DocumentPictures
    words: Words
    drawn: set[str] = field(default_factory=set)

    def card(self, each: Inspected) -> Markup:
        """An object: its surest sighting, the best other one beside it, and the whole photo."""
        word = self.words.of(each.found.finding.what)
        severity = [element("span", _worded(word.severity), class_="severity")] if word.severity else []
        figures = [self._crop(each, index, look) for index, look in enumerate(each.looks)]
        return element(
            "article",
            element(
                "header",
                element("h3", _badge(each.name, word.colour), _worded(word.name), *severity),
                element("p", "; ".join(_facts(each)), *_note(each.found), class_="soft"),
            ),
            element("div", *figures, *self._photo(each.looks[0]), class_="looks"),
            class_="object",
            id=f"object-{each.name}",
        )

    def _crop(self, each: Inspected, index: int, look: ShownSighting) -> Markup:
        crop, box = self.album.crops.get((each.name, index)), look.finding.box
        if crop is None or box is None:
            return Markup()
        score = f", {_percent(look.finding.score)}" if look.finding.score is not None else ""
        drawn = outlined(box, crop, f"crop-{each.name}-{index}")
        return _figure(drawn, f"{look.title}: {self.survey.taken(look.photo)}{score}")

    def _photo(self, look: ShownSighting) -> Iterator[Markup]:
        photo, box = self.album.photos.get(look.photo), look.finding.box
        if photo is not None and box is not None:
            name = "photo-{}-{}".format(*look.photo)
            drawn = outlined(box, photo, name, again=name in self.drawn)
            self.drawn.add(name)
            yield _figure(drawn, f"The whole of {self.survey.named(look.photo)}")


def _facts(each: Inspected) -> Iterator[str]:
    found, finding = each.found, each.found.finding
    if finding.score is not None:
        yield f"Score {_percent(finding.score)}"
    yield coordinates(found, home="the take-off")
    yield finding.place_is if finding.error_m is None else f"within {_metres(finding.error_m)}"
    if finding.own is not None and finding.own.assumes:
        yield f"assuming {finding.own.assumes}"
    yield counted(found.sightings, "sighting")


def _note(found: PlacedFinding) -> Sequence[Markup]:
    """What the person who reviewed the object wrote, on a line of its own."""
    return [element("br"), element("bdi", printable(found.note))] if found.note else []


def _figure(picture: Markup, caption: str) -> Markup:
    return element("figure", picture, element("figcaption", caption))


def _badge(name: str, colour: str) -> Markup:
    width = 13.0 + 10.0 * len(name)
    return element(
        "svg",
        element("title", f"Object {name}"),
        element("rect", width=width, height=24.0, rx=12.0, fill=colour),
        element("text", name, x=width / 2, y=17.5, font_size=16.0, text_anchor="middle", fill=ink_on(colour)),
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {width:g} 24",
        class_="badge",
        role="img",
    )


def _worded(words: str) -> Markup:
    """Words of others, which may be written from right to left."""
    return element("bdi", printable(words, _LONGEST_LABEL))


def _percent(score: float | None) -> str:
    return "" if score is None else f"{100 * score:.0f}\N{NO-BREAK SPACE}%"


def _metres(length_m: float) -> str:
    return f"{length_m:z.1f}\N{NO-BREAK SPACE}m"
