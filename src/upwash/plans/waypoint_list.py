"""`QGC WPL 110`: one item a line, twelve numbers each; item 0 is home."""

from __future__ import annotations

from upwash.plans.items import ABOVE_SEA_LEVEL, MOST_ITEMS, Command, Home, Item, Refusal, home_at, make_plan
from upwash.plans.plan import Plan

HEADER = "QGC WPL"
_VERSION = "110"
_COLUMNS = 12


def parse_waypoint_list(text: str) -> Plan:
    """The plan in the text of a waypoint list; raises Refusal."""
    header, *lines = text.splitlines()
    if header.split() != [*HEADER.split(), _VERSION]:
        raise Refusal("line 1", f'expected "{HEADER} {_VERSION}", found "{header.strip()[:40]}"')
    rows = [(number, line.split()) for number, line in enumerate(lines, start=2) if line.strip()]
    if len(rows) > MOST_ITEMS + 1:
        raise Refusal("", f"{len(rows)} items: at most {MOST_ITEMS} can be flown")
    if not rows:
        raise Refusal("", "no item in it: item 0 is home, and waypoints follow it")
    first, *others = (_item(line, fields, index) for index, (line, fields) in enumerate(rows))
    return make_plan(_home(first), others)


def _item(line: int, fields: list[str], expected: int) -> Item:
    if len(fields) != _COLUMNS:
        raise Refusal(f"line {line}", f"expected {_COLUMNS} numbers, found {len(fields)}")
    number, current, frame, command = (_whole(line, field) for field in fields[:4])
    if number != expected:
        raise Refusal(f"line {line}", f"expected item {expected}, found item {number}")
    if current not in (0, 1) or (current == 1 and number > 1):
        raise Refusal(f"item {number}", "is marked as current: a flight begins with the first item")
    goes_on = _whole(line, fields[11])
    if goes_on not in (0, 1):
        raise Refusal(f"item {number}", f"expected 0 or 1 as its autocontinue, found {goes_on}")
    parameters = tuple(_real(line, field) for field in fields[4:11])
    return Item(number, command, frame, parameters, goes_on == 1)


def _home(item: Item) -> Home | None:
    if item.command != Command.WAYPOINT or item.frame not in ABOVE_SEA_LEVEL:
        item.refuse(
            "cannot be item 0, which is home: a waypoint (16) with its altitude above sea level (frame 0)"
        )
    place = (
        item.number_of(index, what) for index, what in ((5, "latitude"), (6, "longitude"), (7, "altitude"))
    )
    return home_at("item 0", *place)


def _whole(line: int, field: str) -> int:
    if not (field.isascii() and field.isdecimal() and len(field) <= 9):
        raise Refusal(f"line {line}", f'expected a whole number, found "{field[:40]}"')
    return int(field)


def _real(line: int, field: str) -> float:
    try:
        return float(field)
    except ValueError:
        raise Refusal(f"line {line}", f'expected a number, found "{field[:40]}"') from None
