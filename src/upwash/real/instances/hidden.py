"""Why a service did not start in a sandbox that starts outside: a file or module that the sandbox hides from it."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from importlib.machinery import PathFinder
from itertools import islice
from pathlib import Path

_PATHS = re.compile(r"'(/[^'\n]+)'|\"(/[^\"\n]+)\"|(?<![\w/.:'\"])(/[^\s'\"(),:;]+)")
_RELATIVE = re.compile(r"No such file or directory: '([^/'\n][^'\n]*)'")
_MODULES = re.compile(r"No module named '(\w+)")
_MOST_NAMES = 3


def sandbox_remedy(said: str, *, folder: Path, is_shown: Callable[[Path], bool]) -> str:
    """What to add to the words of a start that failed in a sandbox; empty where nothing that they name is hidden.

    `folder` has the service's program, and is searched first for modules.

    It does not say whether a file is there: a service might ask for what it must not know.
    """
    if relative := _RELATIVE.search(said):
        return (
            f"; in a sandbox relative paths begin at its own /tmp: have the service use the whole path of "
            f"{relative[1]}, and name that in runtime.readable"
        )
    hidden = list(
        islice(dict.fromkeys(each for each in _named(said, folder) if not is_shown(Path(each))), _MOST_NAMES)
    )
    if not hidden:
        return ""
    return f"; the sandbox hides {', '.join(hidden)}: name what the service needs in runtime.readable"


def _named(said: str, folder: Path) -> Iterator[str]:
    """The absolute paths in a text, and those of the modules that it says are missing."""
    for found in _PATHS.finditer(said):
        yield found[found.lastindex or 0]
    for found in _MODULES.finditer(said):
        spec = PathFinder.find_spec(found[1], [str(folder), *sys.path])
        if spec is not None:
            places = spec.submodule_search_locations or [spec.origin or ""]
            yield from (place for place in places if place.startswith("/"))
