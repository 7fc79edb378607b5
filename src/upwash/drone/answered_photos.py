"""Which photo a message to the user is about: that of the call whose answer it tells.

An object of an answer is known by its identity, as a mission may tell it after later photos. A message without one is
about the photo of the answer that the mission has in hand, or about the last photo if that is newer.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import TypeVar

from upwash.core.camera.georeference import PhotoGeometry

T = TypeVar("T")

_MOST_PHOTOS = 1000  # whose bytes are known
_MOST_OBJECTS = 4096  # of answers
_MOST_LOOKED_AT = 1000  # of one answer or message


@dataclass(frozen=True, slots=True)
class NumberedPhoto:
    """A photo, by its number since the program began, counted from 0; `geometry` is None if the lens is unknown."""

    number: int
    geometry: PhotoGeometry | None


class AnsweredPhotos:
    """Follows photos, calls and answers, from the mission's thread or while that waits."""

    def __init__(self) -> None:
        self._last: NumberedPhoto | None = None
        self._in_hand: NumberedPhoto | None = None
        self._by_hash: dict[int, NumberedPhoto] = {}
        # By id. The objects are held, so that the id stays theirs.
        self._of_objects: dict[int, tuple[object, NumberedPhoto]] = {}

    def take(self, jpeg: bytes, geometry: PhotoGeometry | None) -> None:
        """Note that a photo was taken."""
        number = 0 if self._last is None else self._last.number + 1
        self._last = self._in_hand = NumberedPhoto(number, geometry)
        self._by_hash.pop(hash(jpeg), None)
        self._by_hash[hash(jpeg)] = self._last
        _forget_first(self._by_hash, _MOST_PHOTOS)

    def of_call(self, arguments: Iterable[object]) -> NumberedPhoto | None:
        """The photo among a call's arguments, else the last photo."""
        known = (
            self._by_hash.get(hash(each if isinstance(each, bytes) else bytes(each)))
            for each in arguments
            if isinstance(each, bytes | bytearray | memoryview)
        )
        return next((photo for photo in known if photo is not None), self._last)

    def answered(self, answer: object, photo: NumberedPhoto | None) -> None:
        """Note the answer of a call that was made with the photo."""
        if photo is not None:
            for each in _objects(answer):
                self._of_objects.pop(id(each), None)
                self._of_objects[id(each)] = each, photo
            _forget_first(self._of_objects, _MOST_OBJECTS)

    def hand_over(self, photo: NumberedPhoto | None) -> None:
        """Note that the mission gets the answer of a call that was made with the photo."""
        self._in_hand = photo

    @contextlib.contextmanager
    def looking_at(self, photo: NumberedPhoto | None) -> Iterator[None]:
        """The same during the block."""
        before, self._in_hand = self._in_hand, photo
        try:
            yield
        finally:
            self._in_hand = before

    def of_objects(self, message: object) -> NumberedPhoto | None:
        """The photo of the first object in the message that is one of an answer; None if there is none."""
        known = (self._of_objects.get(id(each)) for each in _objects(message))
        return next((photo for each in known if each is not None for photo in each[1:]), None)

    def number_of(self, message: object) -> int | None:
        """The number of the photo that the message is about; None for the last photo."""
        photo = self.of_objects(message) or self._in_hand
        return None if photo is None or photo is self._last else photo.number


def _objects(value: object) -> Iterator[object]:
    """Lists, mappings, structs and dataclasses of the value, itself included, the outer ones first."""
    line = deque([value])
    for _ in range(_MOST_LOOKED_AT):
        if not line:
            return
        each = line.popleft()
        inside = _inside(each)
        if inside is not None:
            yield each
            line.extend(islice(inside, _MOST_LOOKED_AT))


def _inside(value: object) -> Iterable[object] | None:
    """What the value consists of; None for a plain one."""
    if isinstance(value, dict):
        return value.values()
    if isinstance(value, list | tuple):
        return value
    names = getattr(value, "__struct_fields__", None) or getattr(value, "__dataclass_fields__", None)
    return None if names is None else [getattr(value, name, None) for name in names]


def _forget_first(known: dict[int, T], most: int) -> None:
    for key in list(islice(known, max(0, len(known) - most))):
        del known[key]
