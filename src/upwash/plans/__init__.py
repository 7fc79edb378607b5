"""Plans made with a ground station, as values: QGroundControl's `.plan` and `QGC WPL 110` text.

A plan is never flown otherwise than it says without a word. Each item of a file is flown, left out or changed with a
notice, or refused: ConfigError names the file, the item, and what to do.

    qgroundcontrol, waypoint_list    a file's text becomes items, home and fences.
    items                            The commands: which are flown, left out, refused.
    course                           The items, one after the other, become a plan.
    foreign                          Names the kind of a file that is no plan.

Ugly is that autopilots understand items differently. `course` takes them as ArduCopter flies them, and for a waypoint
list, which mostly comes from Mission Planner, fills gaps as ArduCopter does (`as_arducopter`).
"""

from __future__ import annotations

from pathlib import Path

from upwash.errors import ConfigError
from upwash.plans.foreign import BEGINNING, WANTED, kind_of_beginning, kind_of_bytes, kind_of_text
from upwash.plans.items import PlanRefusal
from upwash.plans.plan import (
    Ending,
    FlightPlan,
    PhotoTrigger,
    PlannedCircle,
    PlannedPolygon,
    PlannedWaypoint,
)
from upwash.plans.waypoint_list import HEADER, parse_waypoint_list
from upwash.support.input_files import read_named_file, text_of

__all__ = [
    "Ending",
    "FlightPlan",
    "PhotoTrigger",
    "PlannedCircle",
    "PlannedPolygon",
    "PlannedWaypoint",
    "read_plan",
]

_MOST_BYTES = 10_000_000


def read_plan(file: Path) -> FlightPlan:
    """The plan in the file; raises ConfigError with the number of the item that is not understood."""
    try:
        return _parsed(_content(file))
    except PlanRefusal as refusal:
        raise ConfigError(str(file), refusal.where, refusal.problem) from None


def _content(file: Path) -> bytes:
    try:
        return read_named_file(file, most_bytes=_MOST_BYTES)
    except ConfigError:
        if kind := _kind_of_large(file):
            raise PlanRefusal("", f"no plan, it is {kind}; {WANTED}") from None
        raise


def _kind_of_large(file: Path) -> str:
    """What a file is that is too large for a plan, as logs are; "" for what is not known."""
    try:
        if not file.is_file():
            return ""
        with file.open("rb") as opened:
            beginning = opened.read(BEGINNING)
    except (OSError, ValueError):
        return ""
    return kind_of_beginning(beginning) or kind_of_text(beginning.decode("latin-1"))


def _parsed(content: bytes) -> FlightPlan:
    if kind := kind_of_bytes(content):
        raise PlanRefusal("", f"no plan, it is {kind}; {WANTED}")
    try:
        text = text_of(content)
    except UnicodeDecodeError as error:
        raise PlanRefusal("", f"not UTF-8 text (byte {error.start}); {WANTED}") from None
    if text.startswith(HEADER):
        return parse_waypoint_list(text)
    kind = kind_of_text(text)
    if not kind and text.lstrip().startswith(("{", "[")):
        from upwash.plans.qgroundcontrol import parse_plan  # its parser is only needed here

        return parse_plan(text)
    raise PlanRefusal("", f"no plan{f', it is {kind}' if kind else ''}; {WANTED}")
