"""Bounds on others: connections of which the oldest gives way, turns, and what is known of who came lately."""

from __future__ import annotations

import asyncio
from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

from upwash.core.admission.limits import Allowance

M = TypeVar("M")
K = TypeVar("K")


class Crowd(Generic[M]):
    """At most `most` members, and `most_of_group` of each group: one address, or one certificate.

    Newcomers are let in: who is honest needs a moment only, or comes again because the old connection is dead.
    """

    def __init__(self, most: int, *, most_of_group: int) -> None:
        self._most = most
        self._most_of_group = most_of_group
        self._groups: dict[M, str] = {}  # of each member, the oldest first
        self._sizes: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._groups)

    def enter(self, member: M, group: str) -> M | None:
        """Takes in the member; returns the one that has to go for it, which has left by then."""
        self._groups[member] = group
        self._sizes[group] += 1
        if self._sizes[group] > self._most_of_group:
            return self._oldest_of(group)
        if len(self._groups) > self._most:
            return self._oldest_of(self._sizes.most_common(1)[0][0])
        return None

    def leave(self, member: M) -> None:
        """Forgets the member, if it is still there."""
        group = self._groups.pop(member, None)
        if group is not None:
            self._sizes[group] -= 1
            if not self._sizes[group]:
                del self._sizes[group]

    def _oldest_of(self, group: str) -> M:
        oldest = next(member for member, its in self._groups.items() if its == group)
        self.leave(oldest)
        return oldest


class Recent(Generic[K]):
    """Something for each name that came lately, made where it is new; the longest unseen are forgotten."""

    def __init__(self, make: Callable[[], K], *, most: int) -> None:
        self._make = make
        self._most = most
        self._known: OrderedDict[str, K] = OrderedDict()

    def of(self, name: str) -> K:
        """What is known of that name."""
        if name not in self._known:
            self._known[name] = self._make()
        self._known.move_to_end(name)
        if len(self._known) > self._most:
            self._known.popitem(last=False)
        return self._known[name]


class Turns:
    """So many turns a second, and twice as many after a rest, in the order in which they are asked for.

    Without an order those who ask again at once could keep one out who waits.
    """

    def __init__(self, per_s: float) -> None:
        self._allowance = Allowance(per_s, at_once=2 * per_s)
        self._order = asyncio.Lock()

    async def turn(self) -> None:
        """Returns when it is the caller's turn."""
        now_s = asyncio.get_running_loop().time
        async with self._order:
            await asyncio.sleep(self._allowance.take_anyway_s(1, now_s=now_s()))
