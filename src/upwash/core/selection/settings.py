"""How the drone's machine is set, by the configuration."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from upwash.core.operation import Operation
from upwash.core.selection.recovery import Probing


class LighterSettings(Struct, frozen=True):
    """The time by which the mission must end, and the lighter operation of each operation."""

    finish_by_s: float
    operations: Mapping[Operation, Operation]


class TwoAnswers(Struct, frozen=True):
    """What the drone computes at once of a call, and how long after the call a server's answer counts."""

    first: Operation
    within_s: float


class SelectionSettings(Struct, frozen=True):
    """How long `Selection` remembers, and how many servers it may select at a time.

    With `probing`, `blacklist_s` has no effect. A server that others wait for is used only if it saves more than
    the fraction `gain_slot` of a local call. The mission takes off to `takeoff_m`, and `lands` at its last waypoint
    or else returns home. Calls of the operations in `two_answers` have a first answer of the drone. Where radios are
    free, `with_second` keeps another server READY for calls that the one in use answers late.
    """

    blacklist_s: float = 60.0
    idle_s: float = 180.0
    retry_s: float = 300.0
    radios: int = 1
    probing: Probing | None = None
    gain_slot: float = 0.25
    lighter: LighterSettings | None = None
    two_answers: Mapping[Operation, TwoAnswers] = {}
    with_second: bool = False
    takeoff_m: float = 0.0
    lands: bool = False
