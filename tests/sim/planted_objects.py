"""Defects planted in acts on objects: `planted.py` lists them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from typing import Any
from unittest.mock import patch

from tests.sim.planting import Planting, plant, planted, planting

from upwash.core.geo import Position
from upwash.drone.answered_photos import AnsweredPhotos, NumberedPhoto
from upwash.drone.answers import AnswerAction
from upwash.drone.mission import MissionThread
from upwash.drone.object_acts import ObjectAct
from upwash.drone.objects import FlightObjects
from upwash.drone.settling import Settling
from upwash.drone.several import Several
from upwash.drone.stops import Stops

plant("each finding of an object has an act", FlightObjects, "_is_claimed", lambda *_, **__: False)


@planted("an act on an object is done at the waypoint of its photo", ObjectAct, "_locate")
def acts_at_the_waypoint(locate: Any, self: ObjectAct) -> None:
    locate(self)
    self.place = self._objects._findings[self._claim.key].taken_at


@planting("findings are placed by the last photo")
def placed_by_the_last_photo() -> Planting:
    take, take_photo, last = FlightObjects.take, AnsweredPhotos.take, dict[str, NumberedPhoto]()

    def note(self: AnsweredPhotos, *about: Any) -> None:
        take_photo(self, *about)
        assert self._last is not None
        last["photo"] = self._last

    def misplaced(self: FlightObjects, answer: object, _: NumberedPhoto | None, taken_at: Position) -> Any:
        return take(self, answer, last["photo"], taken_at)

    planted = contextlib.ExitStack()
    planted.enter_context(patch.object(AnsweredPhotos, "take", note))
    planted.enter_context(patch.object(FlightObjects, "take", misplaced))
    return planted


@planting("the user gets all answers at the end of the way")
def told_late() -> Planting:
    have_told = AnswerAction._have_told
    untold: list[tuple[MissionThread, Callable[[], None]]] = []

    def kept(self: AnswerAction[Any], do: Callable[[], object]) -> None:
        if self.only_tells:
            untold.append((self.call.thread, partial(have_told, self, do)))
        else:
            have_told(self, do)

    def telling_all(settle: Any) -> Any:
        def all_told(self: Settling, **how: Any) -> None:
            settle(self, **how)
            own = [told for told in untold if told[0] is self.thread]
            untold[:] = [told for told in untold if told not in own]
            for _, do in own:
                do()

        return all_told

    planted = contextlib.ExitStack()
    planted.enter_context(patch.object(AnswerAction, "_have_told", kept))
    for kind in (Stops, Several):
        planted.enter_context(patch.object(kind, "settle", telling_all(kind.settle)))
    return planted
