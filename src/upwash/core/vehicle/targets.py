"""Where a vehicle may say that it steers to: the places that the program sent it to, and no others."""

from __future__ import annotations

from upwash.core.geo import Position, distance_m

_SAME_PLACE_M = 1.0  # a vehicle keeps a target in metres from its own origin, and rounds it


class Targets:
    """The targets of one flight: a report must agree with the last command that was obeyed, or with the one after it.

    Altitudes of commands and of reports count from the same place. Before the first command, the first report is what
    another program left behind, and no difference.
    """

    def __init__(self) -> None:
        self._obeyed: Position | None = None  # None: a take-off, which reports no target
        self._pending: Position | None = None
        self._is_pending = False
        self._is_known = False  # what it steers to

    def send(self, place: Position | None) -> None:
        """A command is about to be sent; None for a take-off, which has no target."""
        self._pending, self._is_pending = place, True

    def settle(self, *, obeyed: bool) -> None:
        """The last command was obeyed, or refused."""
        if obeyed and self._is_pending:
            self._obeyed, self._is_known = self._pending, True
        self._is_pending = False

    def difference(self, reported: Position | None) -> str:
        """How a reported target differs from what was commanded; empty where it does not. None: it has a velocity."""
        if not self._is_known:
            self._learn(reported)
            return ""
        expected = [self._obeyed, *([self._pending] if self._is_pending else [])]
        if reported is None:
            return "" if self._is_pending else "it follows a velocity that the program did not command"
        if any(place is not None and distance_m(place, reported) <= _SAME_PLACE_M for place in expected):
            return ""
        there = f"{reported.east_m:.0f} m east, {reported.north_m:.0f} m north"
        if self._obeyed is None:
            return f"it was sent to {there}, which the program did not command"
        apart_m = distance_m(self._obeyed, reported)
        return f"it was sent to {there}, {apart_m:.0f} m from where the program sent it"

    def _learn(self, reported: Position | None) -> None:
        if reported is not None and not self._is_pending:
            self._obeyed, self._is_known = reported, True
