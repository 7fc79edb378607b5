"""The policy that knows where the drone will be: it picks the server that serves the calls to come best."""

from __future__ import annotations

from dataclasses import dataclass, field

from upwash.core.outlook import Outlook
from upwash.core.policy import Call, Choice, Decision, LocationAware, Remote, Situation
from upwash.core.schedule import Schedule, quickest

HORIZON = 20  # calls: what is further away changes nothing about the next server


@dataclass(frozen=True, slots=True)
class LookAhead:
    """The server with which the calls to come are over soonest; as location-aware where none are foreseen.

    The selected server is left only where that saves more than the fraction `gain_leave` of a local call over all
    those calls, as estimates are never exact.
    """

    gain_leave: float = 0.1
    reactive: LocationAware = field(default_factory=LocationAware)
    horizon: int = HORIZON
    name: str = "look-ahead"

    def choose(self, situation: Situation) -> Choice:
        """The server of the next call in the quickest schedule, once it is in range; until then the current one."""
        outlook = situation.outlook
        if outlook is None or not outlook.calls:
            return self.reactive.choose(situation)
        local_s = situation.local_mean_call_s
        in_range = [option.server for option in situation.options if option.mean_call_s < local_s]
        current = situation.current if situation.current in in_range else None
        if current is not None and self._holds(situation.under_way, outlook):
            return Choice(current, "a call is under way")
        best = self._quickest(outlook, current)
        following = best.servers[0]
        gains = f"serves the next {len(outlook.calls)} calls in {best.total_s:.1f} s"
        if current is None:
            if following in in_range:
                return Choice(following, gains)
            return Choice(None, f"{following} is not in range yet" if following else "no server pays off")
        if following in (None, current):
            return Choice(current, "no other is better")
        saved_s = self._quickest(outlook, current, stays=True).total_s - best.total_s
        if saved_s <= self.gain_leave * local_s:
            return Choice(current, f"{following} saves no more than {saved_s:.1f} s")
        if following not in in_range:
            return Choice(current, f"{following} is not in range yet")
        return Choice(following, f"{gains}, {saved_s:.1f} s less than with {current} kept")

    def _holds(self, under_way: Decision | None, outlook: Outlook) -> bool:
        """Whether a call goes on there, or the check, which is of use later, while a call goes on elsewhere."""
        return isinstance(under_way, Remote) or (under_way is not None and outlook.ready_in_s > 0)

    def _quickest(self, outlook: Outlook, current: str | None, *, stays: bool = False) -> Schedule:
        return quickest(
            outlook.calls,
            outlook.checks,
            server=current,
            ready_in_s=outlook.ready_in_s,
            gain_wait=self.reactive.wait.gain_wait,
            stays=stays,
        )

    def decide(self, call: Call) -> Decision:
        """As location-aware: a wait that does not make this call shorter makes none shorter that follows.

        While a call runs on the drone the check goes on.
        """
        return self.reactive.decide(call)
