"""`QGC WPL 110`: one item a line, twelve numbers each; item 0 is home. A line that begins with # is a comment."""

from __future__ import annotations

import io
import itertools
import math

from upwash.plans.course import make_plan
from upwash.plans.foreign import WANTED
from upwash.plans.items import (
    ABOVE_SEA_LEVEL,
    MOST_ITEMS,
    SET_HOME,
    Command,
    Item,
    PlanHome,
    PlanRefusal,
    home_at,
)
from upwash.plans.plan import FlightPlan, PlanNotices
from upwash.support.text import number_of

HEADER = "QGC WPL"
_VERSION = "110"
_COLUMNS = 12
_COMMENT = "#"
_SAVED_ANEW = "save the list again with a ground station"
_OF_A_FENCE = range(5000, 5005)
_OF_RALLY_POINTS = range(5100, 5101)
_NO_COMMAND = 0  # as some ground stations write home


def parse_waypoint_list(text: str) -> FlightPlan:
    """The plan in the text of a waypoint list; raises PlanRefusal."""
    lines = io.StringIO(text, newline=None)  # read one by one: a file may hold millions
    header = next(lines)
    if header.split() != [*HEADER.split(), _VERSION]:
        raise PlanRefusal("line 1", f'expected "{HEADER} {_VERSION}", found "{header.strip()[:40]}"')
    found = ((number, line.split()) for number, line in enumerate(lines, start=2) if _is_item(line))
    rows = list(itertools.islice(found, MOST_ITEMS + 2))  # home, the items, and one too many
    if len(rows) > MOST_ITEMS + 1:
        raise PlanRefusal("", f"more than {MOST_ITEMS} items: at most {MOST_ITEMS} can be flown, so fly less")
    if not rows:
        raise PlanRefusal("", "no item in it: item 0 is home, and waypoints follow it")
    notices = PlanNotices()
    numbers = _numbers(rows, notices)
    waits = all(fields[-1] == "0" for _, fields in rows)
    if waits:
        notices.add("none of its items continues by itself (autocontinue 0): flown on, as ArduCopter does")
    items = [_item(line, fields, number, waits) for number, (line, fields) in zip(numbers, rows, strict=True)]
    for commands, what in ((_OF_A_FENCE, "a geofence"), (_OF_RALLY_POINTS, "rally points")):
        if any(item.command in commands for item in items[:2]):
            raise PlanRefusal("", f"no plan, it is a list of {what}; {WANTED}")
    home, others = _home(items, notices)
    return make_plan(home, others, notices, as_arducopter=True)


def _is_item(line: str) -> bool:
    return bool(line.strip()) and not line.startswith(_COMMENT)


def _numbers(rows: list[tuple[int, list[str]]], notices: PlanNotices) -> list[int]:
    """The items' numbers, with a notice of a gap; refuses numbers that do not ascend, as the list may be mixed up."""
    numbers = [_whole(line, fields[0]) for line, fields in rows]
    wrong = next((expected for expected, number in enumerate(numbers) if number != expected), None)
    if wrong is not None:
        if any(after <= before for before, after in itertools.pairwise(numbers)):
            raise PlanRefusal(
                f"line {rows[wrong][0]}",
                f"expected item {wrong}, found item {numbers[wrong]}: number the lines in the order of the flight, "
                f"or {_SAVED_ANEW}",
            )
        notices.add(f"its numbers leave item {wrong} out: the items in the file are flown in their order")
    return numbers


def _item(line: int, fields: list[str], number: int, waits: bool) -> Item:
    if len(fields) != _COLUMNS:
        raise PlanRefusal(f"line {line}", f"expected {_COLUMNS} numbers, found {len(fields)}: {_SAVED_ANEW}")
    current, frame, command = (_whole(line, field) for field in fields[1:4])
    if current not in (0, 1) or (current == 1 and number > 1):
        raise PlanRefusal(f"item {number}", "is marked as current: a flight begins with the first item")
    goes_on = _whole(line, fields[11])
    if goes_on not in (0, 1):
        raise PlanRefusal(f"item {number}", f"expected 0 or 1 as its autocontinue, found {goes_on}")
    parameters = tuple(_real(line, field) for field in fields[4:11])
    return Item(number, command, frame, parameters, goes_on == 1 or waits)


def _home(items: list[Item], notices: PlanNotices) -> tuple[PlanHome | None, list[Item]]:
    """The plan's home, and the items that are flown: all of them where the first one cannot be home."""
    first, *others = items
    is_a_place = first.command in (Command.WAYPOINT, SET_HOME, _NO_COMMAND)
    is_above_sea = first.frame in ABOVE_SEA_LEVEL
    if (
        first.number == 0
        and is_a_place
        and (is_above_sea or first.command == SET_HOME or first.value(7) == 0)
    ):
        latitude_deg, longitude_deg, altitude_m = (
            first.number_of(index, what)
            for index, what in ((5, "latitude"), (6, "longitude"), (7, "altitude"))
        )
        return home_at("item 0", latitude_deg, longitude_deg, altitude_m if is_above_sea else None), others
    if first.number == 0 and any(item.command == Command.TAKEOFF for item in others):
        first.refuse(
            "cannot be item 0, which is home: a waypoint (16) with its altitude above sea level (frame 0)"
        )
    notices.add("it has no item for home: every item is flown")
    return None, items


def _whole(line: int, field: str) -> int:
    """A whole number, which some programs write with decimals."""
    digits = field.removesuffix("." + "0" * (len(field) - field.find(".") - 1)) if "." in field else field
    if not (digits.isascii() and digits.isdecimal() and len(digits) <= 9):
        raise PlanRefusal(f"line {line}", f'expected a whole number, found "{field[:40]}": {_SAVED_ANEW}')
    return int(digits)


def _real(line: int, field: str) -> float:
    try:
        return math.nan if field.lower() == "nan" else number_of(field)
    except ValueError:
        raise PlanRefusal(f"line {line}", f'expected a number, found "{field[:40]}": {_SAVED_ANEW}') from None
