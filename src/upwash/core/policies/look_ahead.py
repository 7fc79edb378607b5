"""The policy that looks ahead: it picks the server with which the coming calls are over soonest."""

from __future__ import annotations

from dataclasses import dataclass

from upwash.core.planning.forecast import Forecast
from upwash.core.planning.schedule import Schedule, quickest
from upwash.core.policies.policy import (
    BuiltInRules,
    CallInputs,
    Choice,
    Coming,
    Decision,
    LocationAware,
    Remote,
    Situation,
)

HORIZON = 20  # calls: what is further away changes nothing about the next server
_REACTIVE = LocationAware()
MOST_LABELS = 64  # that a schedule is chosen from: twice what flights among 50 servers have had


@dataclass(frozen=True)  # without slots, so that users can extend it
class LookAhead(BuiltInRules):
    """Selects the server that ends the coming calls soonest; as location-aware if no calls are foreseen.

    The selected server is left only if that saves more than the fraction `gain_leave` of a local call over all those
    calls, as estimates are never exact.
    """

    gain_leave: float = 0.1
    reactive: LocationAware = _REACTIVE
    horizon: int = HORIZON
    name: str = "look-ahead"

    def choose(self, situation: Situation) -> Choice:
        """The server of the next call in the quickest schedule, once in range; until then the current server."""
        forecast = situation.forecast
        if forecast is None or not forecast.calls:
            return self.reactive.choose(situation)
        local_s = situation.local_mean_call_s
        in_range = [option.server for option in situation.options if option.mean_call_s < local_s]
        current, under_way = situation.current if situation.current in in_range else None, situation.under_way
        is_checked = under_way is not None and forecast.ready_in_s > 0  # during a local call
        if current is not None and (isinstance(under_way, Remote) or is_checked):
            return Choice(current, "a call is under way")
        best = self._quickest(forecast, current)
        following = best.servers[0]
        count = len(forecast.calls)
        gains = f"serves the next {'call' if count == 1 else f'{count} calls'} in {best.total_s:.1f} s"
        if current is None:
            if following in in_range:
                return Choice(following, gains)
            return Choice(None, f"{following} is not in range yet" if following else "no server pays off")
        if following in (None, current):
            return Choice(current, "no other is better", _coming(best, forecast, current))
        staying = self._quickest(forecast, current, stays=True)
        saved_s = staying.total_s - best.total_s
        if saved_s <= self.gain_leave * local_s:
            why = f"{following} saves no more than {saved_s:.1f} s"
            return Choice(current, why, _coming(staying, forecast, current))
        if following not in in_range:
            return Choice(current, f"{following} is not in range yet", _coming(best, forecast, current))
        return Choice(following, f"{gains}, {saved_s:.1f} s less than with {current} kept")

    def _quickest(self, forecast: Forecast, current: str | None, *, stays: bool = False) -> Schedule:
        return quickest(
            forecast.calls,
            forecast.checks,
            server=current,
            ready_in_s=forecast.ready_in_s,
            gain_wait=self.reactive.wait.gain_wait,
            peers=forecast.peers,
            stays=stays,
            most_labels=MOST_LABELS,
        )

    def decide(self, call: CallInputs) -> Decision:
        """Decide as location-aware does.

        The check goes on while a call runs on the drone, so a wait that makes this call no shorter helps no later
        call.
        """
        return self.reactive.decide(call)


def _coming(schedule: Schedule, forecast: Forecast, current: str) -> Coming | None:
    at_s = 0.0
    for call, server in zip(forecast.calls, schedule.servers, strict=True):
        at_s += call.gap_s
        offer = next((offer for offer in call.offers if offer.server == server), None)
        if offer is not None and server != current:
            return Coming(offer.server, max(0.0, at_s - offer.head_start_s))
        at_s += call.local_s if offer is None else min(call.local_s, offer.call_s)
    return None
