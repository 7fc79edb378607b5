"""How defects are planted in the programs for a while; `DEFECTS` has all that were declared, in their order."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, wraps
from typing import Any
from unittest.mock import patch

Planting = contextlib.AbstractContextManager[object]


@dataclass(frozen=True, slots=True)
class Defect:
    """What is wrong, and how it is put into the programs for a while."""

    what: str
    plant: Callable[[], Planting]


DEFECTS: list[Defect] = []


def plant(what: str, target: object, name: str, stand_in: object) -> None:
    """A defect: the stand-in takes the place of the target's attribute."""
    DEFECTS.append(Defect(what, partial(patch.object, target, name, stand_in)))


def planted(what: str, target: object, name: str) -> Callable[[Callable[..., Any]], Callable[[], Planting]]:
    """A defect: the decorated function takes the place of the target's, and gets that one first."""

    def put(stand_in: Callable[..., Any]) -> Callable[[], Planting]:
        original = getattr(target, name)

        @wraps(stand_in)
        def called(*arguments: Any, **more: Any) -> Any:
            return stand_in(original, *arguments, **more)

        plant(what, target, name, called)
        return DEFECTS[-1].plant

    return put


def planting(what: str) -> Callable[[Callable[[], Planting]], None]:
    """A defect: the decorated function plants it."""
    return lambda plants: DEFECTS.append(Defect(what, plants))
