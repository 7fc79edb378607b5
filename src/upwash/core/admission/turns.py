"""The turns of drones at one server: how long each has had a slot, which wait, and which must yield.

Laws:
- only what the server measures counts: no message of a drone changes the order;
- a drone that arrives starts with the least slot time of those present: absence saves nothing up;
- a free slot goes to the waiting drone with the least slot time, then to the longest waiting, then by name;
- after a turn a holder yields to a drone that has had less by more than half a turn;
- the drone that has had most yields first;
- holders yield until the asking drone and the drones before it in the queue have slots, and no further;
- a drone that yields counts as present until its lease would have ended, as it may not know yet;
- a holder yields only to a drone that has asked twice, as a drone that asks once may be gone;
- a drone that misses three questions leaves the queue;
- while there are slots for all drones, no drone waits and no turn ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from upwash.core.admission.clients import AccountStatus

ASK_AGAIN_S = 2.0
_PATIENCE_S = 3 * ASK_AGAIN_S
_MOST_ABSENT = 1000  # drones that are remembered while others are there


@dataclass(slots=True)
class Account:
    """One drone's slot time in all, in seconds, and since when it holds a slot or waits for one."""

    drone: str
    had_s: float = 0.0  # without the turn that it is at
    holds_since_s: float | None = None
    waits_since_s: float | None = None
    asked_s: float = -math.inf  # while it waits
    asks: int = 0
    expected_until_s: float = -math.inf  # since it yielded

    def had_until_s(self, now_s: float) -> float:
        """The slot time (s) that the drone has had in all, until `now_s`."""
        return self.had_s + (0.0 if self.holds_since_s is None else now_s - self.holds_since_s)

    @property
    def is_present(self) -> bool:
        """Whether the drone holds a slot or waits for one."""
        return self.holds_since_s is not None or self.waits_since_s is not None


class Turns:
    """The accounts of the drones at one server, and the order of turns that follows."""

    def __init__(self, turn_s: float) -> None:
        self.turn_s = turn_s
        self._accounts: dict[str, Account] = {}

    def took(self, drone: str, *, now_s: float) -> None:
        """Note that the drone has got a slot."""
        account = self._arrived(drone, now_s)
        account.holds_since_s, account.waits_since_s = now_s, None

    def gave_back(self, drone: str, *, now_s: float) -> None:
        """Note that the drone has given its slot back."""
        account = self._accounts[drone]
        account.had_s, account.holds_since_s = account.had_until_s(now_s), None
        self._forget()

    def yields(self, drone: str, *, expected_until_s: float) -> None:
        """End the drone's turn; it counts as present until `expected_until_s`, when its lease would have ended."""
        self._accounts[drone].expected_until_s = expected_until_s

    def asked(self, drone: str, *, now_s: float) -> bool:
        """Note that a drone without a slot asks for one, and waits; return whether this is its first question."""
        self._dismiss(now_s)
        account = self._arrived(drone, now_s)
        if account.waits_since_s is None:
            account.waits_since_s, account.asks = now_s, 0
        account.asked_s = now_s
        account.asks += 1
        return account.asks == 1

    def gave_up(self, drone: str) -> None:
        """Remove the drone from the queue."""
        account = self._accounts.get(drone)
        if account is not None:
            account.waits_since_s, account.expected_until_s = None, -math.inf
            self._forget()

    def waiting(self, *, now_s: float) -> list[Account]:
        """The waiting drones, in the order in which they get free slots."""
        self._dismiss(now_s)
        waiting = [account for account in self._accounts.values() if account.waits_since_s is not None]
        return sorted(waiting, key=lambda account: (account.had_s, account.waits_since_s, account.drone))

    def rank(self, drone: str, *, now_s: float) -> int:
        """How many drones are before the waiting drone in the queue."""
        return [account.drone for account in self.waiting(now_s=now_s)].index(drone)

    def over(self, to: str, *, now_s: float) -> list[str]:
        """The names of the holders that must yield to the waiting drone `to`, the longest slot time in all first."""
        waiting = self._accounts[to]
        if waiting.asks < 2:
            return []
        over = [
            (-account.had_until_s(now_s), account.drone)
            for account in self._accounts.values()
            if account.holds_since_s is not None
            and now_s - account.holds_since_s >= self.turn_s
            and account.had_until_s(now_s) - waiting.had_s > self.turn_s / 2
        ]
        return [drone for _, drone in sorted(over)]

    def status(self, *, now_s: float) -> list[AccountStatus]:
        """The accounts of present drones by name, for the status page."""
        self._dismiss(now_s)
        return [
            AccountStatus(
                account.drone,
                account.had_until_s(now_s),
                None if account.holds_since_s is None else now_s - account.holds_since_s,
                None if account.waits_since_s is None else now_s - account.waits_since_s,
            )
            for _, account in sorted(self._accounts.items())
            if account.is_present
        ]

    def _arrived(self, drone: str, now_s: float) -> Account:
        account = self._accounts.get(drone)
        if account is None:
            account = self._accounts[drone] = Account(drone)
        if not account.is_present and now_s > account.expected_until_s:
            present = [
                account.had_until_s(now_s) for account in self._accounts.values() if account.is_present
            ]
            account.had_s = max(account.had_s, min(present, default=0.0))
        return account

    def _dismiss(self, now_s: float) -> None:
        """Remove drones from the queue that missed three questions."""
        for account in self._accounts.values():
            if account.waits_since_s is not None and now_s - account.asked_s > _PATIENCE_S:
                account.waits_since_s = None
        self._forget()

    def _forget(self) -> None:
        """Forget all accounts if no drone is present, else those of the longest absent drones beyond 1,000."""
        absent = [name for name, account in self._accounts.items() if not account.is_present]
        if len(absent) == len(self._accounts):
            self._accounts.clear()
        for name in absent[: max(0, len(absent) - _MOST_ABSENT)]:
            self._accounts.pop(name, None)
