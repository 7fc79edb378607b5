"""The pictures of the client's document: scaled, and within a bound on all together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

from upwash.report.client.mosaic import Mosaic
from upwash.report.client.survey import Inspected, PhotoKey, ShownSighting, Survey
from upwash.report.crops import Crop, crop_around, pixels_of, smaller
from upwash.report.photos import PhotoShelf
from upwash.support.progress import work

if TYPE_CHECKING:
    from cv2.typing import MatLike

MOST_BYTES = 16_000_000  # of all pictures as JPEG; a document is a third larger
_MOST_PICTURED = 400  # objects
_MOST_THUMBNAILS = 120
_MOST_LAID = 600  # photos of the mosaics
_THUMBNAIL_PX = 240
_FEW, _MANY = 60, 200  # objects
Key = TypeVar("Key")


@dataclass(frozen=True, slots=True)
class Size:
    """How wide photos are at most, and how many times larger crops are than on a page with many."""

    width_px: int
    enlarged: float


_FINE, _MEDIUM, _COARSE = Size(1000, 2.5), Size(720, 2.0), Size(480, 1.5)


@dataclass(slots=True)
class DocumentPictures:
    """The pictures that there are: photos and thumbnails by photo, crops by object and look.

    `laid` are the photos of the mosaics; `missing` photos were not kept, or cannot be read. `full` says that the
    bound leaves some pictures out.
    """

    photos: dict[PhotoKey, Crop] = field(default_factory=dict)
    thumbnails: dict[PhotoKey, Crop] = field(default_factory=dict)
    crops: dict[tuple[str, int], Crop] = field(default_factory=dict)
    laid: set[PhotoKey] = field(default_factory=set)
    missing: set[PhotoKey] = field(default_factory=set)
    bytes: int = 0
    full: bool = False

    def shows(self, each: Inspected) -> bool:
        """Whether there is a picture of the object."""
        crops = any((each.name, index) in self.crops for index in range(len(each.looks)))
        return crops or bool(each.looks and each.looks[0].photo in self.photos)

    def add(self, pictures: dict[Key, Crop], key: Key, picture: Crop | None) -> None:
        """Add a picture, unless it is missing or exceeds the bound on all pictures."""
        if picture is None:
            return
        if self.bytes + len(picture.jpeg) > MOST_BYTES:
            self.full = True
            return
        self.bytes += len(picture.jpeg)
        pictures[key] = picture

    def add_look(self, each: Inspected, index: int, look: ShownSighting, pixels: MatLike, size: Size) -> None:
        """Add what a look at an object shows, and of the surest look the whole photo."""
        if look.finding.box is not None:
            crop = crop_around(look.finding.box, pixels, enlarged=size.enlarged)
            self.add(self.crops, (each.name, index), crop)
        if index == 0 and look.photo not in self.photos:
            self.add(self.photos, look.photo, _whole(pixels, size.width_px))


def album_of(
    survey: Survey, shelves: Sequence[PhotoShelf], mosaics: Mapping[int, tuple[int, Mosaic]]
) -> DocumentPictures:
    """The pictures of the survey: each photo is read once, and laid on the mosaic of its flight.

    Photos of a flight are on its shelf. A mosaic is in metres from the home of the flight named beside it.
    """
    album = DocumentPictures()
    looks: dict[PhotoKey, list[tuple[Inspected, int, ShownSighting]]] = defaultdict(list)
    for each in survey.objects[:_MOST_PICTURED]:
        for index, look in enumerate(each.looks):
            looks[look.photo].append((each, index, look))
    photographs = {photo.key: photo for photo in survey.photographs}
    told = survey.with_findings
    thumbnails = _every(_MOST_THUMBNAILS, [key for key in photographs if key not in told])
    laid = _every(_MOST_LAID, [key for key, photo in photographs.items() if photo.corners_m is not None])
    wanted = [*looks, *(key for key in photographs if key not in looks and key in thumbnails | laid)]
    objects = len(survey.objects)
    size = _FINE if objects <= _FEW else _MEDIUM if objects <= _MANY else _COARSE
    with work("photos read", len(wanted)) as done:
        for key in wanted:
            jpeg = shelves[key[0]].find(photographs[key].taken.shot)
            pixels = None if jpeg is None else pixels_of(jpeg)
            done()
            if pixels is None:
                album.missing.add(key)
                continue
            if key in laid:
                first, mosaic = mosaics[key[0]]
                mosaic.lay(pixels, survey.corners_m(photographs[key], first))
                album.laid.add(key)
            for each, index, look in looks.get(key, ()):
                album.add_look(each, index, look, pixels, size)
            if key in thumbnails:
                album.add(album.thumbnails, key, _whole(pixels, _THUMBNAIL_PX))
    return album


def _every(most: int, keys: Sequence[PhotoKey]) -> set[PhotoKey]:
    """All of them, or every second, third and so on, so that at most that many are left."""
    return set(keys[:: max(1, -(-len(keys) // most))])


def _whole(pixels: MatLike, width_px: int) -> Crop:
    height, width = pixels.shape[:2]
    return Crop(smaller(pixels, min(1.0, width_px / width)), 0, 0, width, height)
