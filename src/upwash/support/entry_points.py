"""Plug-ins: what installed distributions bring to the program, by the entry points of their metadata.

A plug-in is code that a person installed here. The program loads it when a command line or a configuration names it,
and by that name alone: nothing of a log or of the network leads to code. Callers look for upwash's own parts first:
no plug-in replaces one, and none that is broken stops one.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from upwash.errors import UpwashError, UsageError
from upwash.support.text import worded

if TYPE_CHECKING:  # some 20 modules, for a program that asks for no plug-in
    from importlib.metadata import Distribution, EntryPoint

COMMANDS = "upwash.commands"
INSTANCES = "upwash.instances"
CAMERAS = "upwash.cameras"
SERVICES = "upwash.services"
EXPORTS = "upwash.exports"
_NOUNS = {
    COMMANDS: "command",
    INSTANCES: "container engine",
    CAMERAS: "camera",
    SERVICES: "service",
    EXPORTS: "export",
}


def find(point: str, name: str) -> EntryPoint | None:
    """The entry point of that name; None without one. Raises UsageError where two plug-ins claim it."""
    claims = [each for each in plug_ins(point) if each.name == name]
    if len(claims) > 1:
        claimed = " and by ".join(map(origin, claims))
        raise UsageError(f"the {_NOUNS[point]} {name!r} is claimed by {claimed}: uninstall one of them")
    return claims[0] if claims else None


def plug_ins(point: str) -> list[EntryPoint]:
    """What is installed for that point, in the order of the names; nothing of it is loaded."""
    found: dict[tuple[str, str], EntryPoint] = {}
    for each in _distributions():
        for entry in _entry_points(each, point):
            found.setdefault((entry.name, each.name), entry)  # an installation that stands later is hidden
    return [entry for _, entry in sorted(found.items(), key=lambda claim: claim[0])]


def names(point: str) -> list[str]:
    """What `find` knows at that point."""
    return list(dict.fromkeys(entry.name for entry in plug_ins(point)))


def plug_in(point: str, name: str) -> Any:
    """What the plug-in of that name brings, loaded; raises UsageError, with the names that there are."""
    entry = find(point, name)
    if entry is None:
        raise UsageError(
            f"no plug-in that is installed here brings the {_NOUNS[point]} {name!r}: install one, or name one of: "
            f"{', '.join(names(point)) or 'none'}"
        )
    return load(entry)


def made(point: str, name: str, settings: Mapping[str, object]) -> Any:
    """What the plug-in's class makes of these settings; raises UsageError."""
    cls = plug_in(point, name)
    with failing(point, name, "cannot be made", UsageError):
        return cls(**settings)


def load(entry: EntryPoint) -> Any:
    """What the entry point names; raises UsageError with its name, its distribution and the cause."""
    try:
        return entry.load()
    except UpwashError:
        raise
    except (Exception, SystemExit) as error:
        raise UsageError(
            f"the {_NOUNS[entry.group]} {entry.name!r} of {origin(entry)} cannot be loaded from {entry.value}: "
            f"{worded(error)}"
        ) from error


@contextlib.contextmanager
def failing(point: str, name: str, how: str, kind: Callable[[str], UpwashError]) -> Iterator[None]:
    """Has what a plug-in's code raises end in an error of that kind, which names the plug-in."""
    try:
        yield
    except UpwashError:
        raise
    except Exception as error:
        raise kind(f"the {_NOUNS[point]} {name!r} {how}: {worded(error)}") from error


def origin(entry: EntryPoint) -> str:
    """The distribution that brings it, with its version."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an unknown distribution"


def summary(entry: EntryPoint) -> str:
    """What the metadata of its distribution says, in one line."""
    return (entry.dist and entry.dist.metadata["Summary"]) or ""


def _entry_points(distribution: Distribution, point: str) -> list[EntryPoint]:
    """The entry points of one distribution at that point; an empty list where its metadata cannot be read."""
    with contextlib.suppress(ValueError, OSError):
        if point in (distribution.read_text("entry_points.txt") or ""):
            return list(distribution.entry_points.select(group=point))
    return []


def _distributions() -> Iterator[Distribution]:
    """What is installed; what lies in the folder where the program was started is not."""
    from importlib.metadata import distributions

    here = os.path.realpath(os.curdir)
    places = [place for place in sys.path if place and os.path.realpath(place) != here]
    return iter(distributions(path=places))
