"""Missions by name: the bundled one, and the user's own by their path."""

from __future__ import annotations

import functools
import inspect
from typing import cast

from upwash.drone.api import Mission
from upwash.errors import UsageError
from upwash.support.loading import load

_MISSIONS = {"survey": "upwash.missions.survey:survey"}


def is_bundled(program: str) -> bool:
    """Whether the mission of that name is bundled; the bundled missions look at no photo themselves."""
    return program in _MISSIONS


def load_mission(program: str, *, mode: str) -> Mission:
    """The mission of that name or path; one with a parameter `mode` gets it."""
    if ":" not in program and program not in _MISSIONS:
        raise UsageError(
            f"there is no mission {program!r}: the bundled ones are {', '.join(_MISSIONS)}; "
            "a mission of your own is path/to/file.py:function"
        )
    mission = load(_MISSIONS.get(program, program))
    if not callable(mission):
        raise UsageError(f"mission {program!r} is not a function")
    if inspect.iscoroutinefunction(mission):
        raise UsageError(f"mission {program!r} is async: write it as a plain blocking function")
    try:
        signature = inspect.signature(mission)
        if "mode" in signature.parameters:
            mission = functools.partial(mission, mode=mode)
        inspect.signature(mission).bind(None)
    except (TypeError, ValueError) as error:
        raise UsageError(f"mission {program!r} cannot be called with a drone alone: {error}") from error
    return cast(Mission, mission)
