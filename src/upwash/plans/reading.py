"""From a plan's file to a plan, or to a ConfigError that names the file and the item."""

from __future__ import annotations

from pathlib import Path

from upwash.errors import ConfigError
from upwash.plans.foreign import WANTED, kind_of_bytes, kind_of_text
from upwash.plans.items import Refusal
from upwash.plans.plan import Plan
from upwash.plans.waypoint_list import HEADER, parse_waypoint_list
from upwash.support.input_files import read_file, text_of, why_unreadable

_MOST_BYTES = 10_000_000


def read_plan(file: Path) -> Plan:
    """The plan in the file; raises ConfigError with the item's number for anything that is not understood."""
    try:
        return _parsed(_content(file))
    except Refusal as refusal:
        raise ConfigError(str(file), refusal.where, refusal.problem) from None


def _parsed(content: bytes) -> Plan:
    if kind := kind_of_bytes(content):
        raise Refusal("", f"no plan, it is {kind}; {WANTED}")
    try:
        text = text_of(content)
    except UnicodeDecodeError as error:
        raise Refusal("", f"not UTF-8 text (byte {error.start}); {WANTED}") from None
    if text.startswith(HEADER):
        return parse_waypoint_list(text)
    if text.lstrip().startswith(("{", "[")):
        from upwash.plans.qgroundcontrol import parse_plan  # its parser is only needed here

        return parse_plan(text)
    kind = kind_of_text(text)
    raise Refusal("", f"no plan{f', it is {kind}' if kind else ''}; {WANTED}")


def _content(file: Path) -> bytes:
    try:
        return read_file(file, most_bytes=_MOST_BYTES)
    except FileNotFoundError:
        raise ConfigError(str(file), "", "no such file: check the path") from None
    except (OSError, ValueError) as error:
        raise ConfigError(
            str(file), "", f"cannot be read ({why_unreadable(error)}): name a readable file"
        ) from None
