"""What of a plan is flown otherwise than it says, or is left out: collected while a plan is read."""

from __future__ import annotations

from dataclasses import dataclass

_MOST_STRETCHES = 6  # that a person reads


@dataclass(frozen=True, slots=True)
class Notice:
    """The items, by the numbers that the ground station shows, and what is done about them and why.

    Without items it is of the plan as a whole.
    """

    items: tuple[int, ...]
    what: str

    def __str__(self) -> str:
        if not self.items:
            return self.what
        from upwash.eventlog.narration import spans  # only needed for notices

        which = spans(self.items)
        if which.count(",") >= _MOST_STRETCHES:
            which = f"{self.items[0]} to {self.items[-1]} ({len(self.items)} of them)"
        return f"{'item' if len(self.items) == 1 else 'items'} {which}: {self.what}"


class Notices:
    """Notices in the order of their first items; one notice for the same words about several items."""

    def __init__(self) -> None:
        self._items: dict[str, list[int]] = {}

    def add(self, what: str, *items: int) -> None:
        """Takes in the words about the items."""
        self._items.setdefault(what, []).extend(items)

    def all(self) -> tuple[Notice, ...]:
        """Those so far."""
        return tuple(Notice(tuple(items), what) for what, items in self._items.items())
