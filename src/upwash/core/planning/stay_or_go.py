"""Whether a drone waits at a waypoint for an answer, or flies on and comes back if the answer demands it.

A drone that goes saves the part of the call's delay that the leg and the next photo hide, if the answer has no
demand. A demand costs it braking and the way back. Going pays if on average it saves more than it costs:

    (1 - p) * saved_s > p * lost_s, p: the chance that an answer has a demand

On a row (drone/rows.py) the drone goes, without a stop at the next spots, by the same law.

Laws:
- the drone stays at the last waypoint, and at every waypoint without a known successor;
- the chance is learnt from the last answers alone: (demands + 1) / (answers + 4), a quarter before the first; with a
  map of demands (demand_map.py) it is the chance at the place of the photo;
- a call that would lose its server on the way is expected to end on the drone.
"""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import Literal, TypeAlias

from msgspec import Struct

from upwash.core.geo import Position
from upwash.core.planning.demand_map import DemandMap
from upwash.core.planning.legs import Leg

Manner: TypeAlias = Literal["stay", "go", "learn"]
_WINDOW = 40  # answers
_DEMANDS, _ANSWERS = 1, 4  # that are taken to have been, before there are any


class Outlook(Struct, frozen=True):
    """The leg to the next waypoint, the time of the photo there, and the rest of the open call.

    The call takes another `stay_s` if the drone stays, and `go_s` if it goes and perhaps loses the server.
    """

    leg: Leg
    photo_s: float
    stay_s: float
    go_s: float

    @property
    def saved_s(self) -> float:
        """The seconds that going saves if the answer has no demand."""
        return self.stay_s - max(0.0, self.go_s - self.leg.duration_s - self.photo_s)

    @property
    def lost_s(self) -> float:
        """The seconds that going costs if the answer has a demand; the next photo is taken once, now or later."""
        if self.go_s <= self.leg.duration_s:
            return self.go_s + self.leg.back_s(self.go_s) - self.stay_s
        photographed_s = self.leg.duration_s + self.photo_s
        return max(self.go_s, photographed_s) + self.leg.duration_s - self.photo_s - self.stay_s


class RowOutlook(Struct, frozen=True):
    """The next spot of a row: the answer to its photo takes `answer_s`, and a photo `photo_s`.

    A drone that rests there loses its speed, unless it `rests_anyway`, as at a row's end.
    """

    ground_speed_m_s: float
    acceleration_m_s2: float
    answer_s: float
    photo_s: float
    rests_anyway: bool = False

    @property
    def saved_s(self) -> float:
        """The seconds that flying on saves if the answer has no demand."""
        return self.photo_s + self.answer_s + (0.0 if self.rests_anyway else self._ramp_s)

    @property
    def lost_s(self) -> float:
        """The seconds that flying on costs if the answer has a demand: the drone brakes and flies back."""
        answered_s = self.photo_s + self.answer_s
        way_m = self.ground_speed_m_s * (answered_s + self._ramp_s / 2)
        back_s = Leg(way_m, self.ground_speed_m_s, self.acceleration_m_s2).duration_s
        return answered_s + 1.5 * self._ramp_s + back_s - self.saved_s

    @property
    def _ramp_s(self) -> float:
        return self.ground_speed_m_s / self.acceleration_m_s2


class StayVerdict(Struct, frozen=True):
    """Whether the drone goes, why, and the chance of a demand; `saved_s` and `lost_s` are None if not computed."""

    goes: bool
    why: str
    chance: float
    saved_s: float | None = None
    lost_s: float | None = None


class StayRule:
    """Decides at each waypoint, and learns from each answer; with a map of demands by the place of the photo."""

    def __init__(self, manner: Manner, demand_map: DemandMap | None = None) -> None:
        self.manner = manner
        self.demand_map = demand_map
        self._demands: deque[bool] = deque(maxlen=_WINDOW)
        self._took_s: deque[float] = deque(maxlen=_WINDOW)

    @property
    def chance(self) -> float:
        """The chance of a demand, from 0 to 1, by the last 40 answers."""
        before = self.demand_map.before if self.demand_map is not None else _DEMANDS / _ANSWERS
        return (sum(self._demands) + _ANSWERS * before) / (len(self._demands) + _ANSWERS)

    @property
    def answer_s(self) -> float | None:
        """The median of the last 40 delays of answers; None before the first."""
        return median(self._took_s) if self._took_s else None

    def answered(self, took_s: float, *, demanded: bool, place: Position | None = None) -> None:
        """Add an answer, its delay, whether it had a demand, and where its photo was taken."""
        if self.demand_map is not None and place is not None:
            self.demand_map.note(place, demanded=demanded)
        self._demands.append(demanded)
        self._took_s.append(took_s)

    def decide(self, outlook: Outlook | RowOutlook | None, place: Position | None = None) -> StayVerdict:
        """Decide whether the drone goes; `outlook` is None if no next waypoint is known.

        `place` is where the photo of the open call was taken.
        """
        chance = self.chance
        if self.demand_map is not None and place is not None:
            chance = self.demand_map.chance(place, chance)
        if self.manner == "stay":
            return StayVerdict(False, "it always stays", chance)
        if outlook is None:
            return StayVerdict(False, "no waypoint is known to follow", chance)
        saved_s, lost_s = outlook.saved_s, outlook.lost_s
        if self.manner == "go":
            return StayVerdict(True, "it always goes", chance, saved_s, lost_s)
        gain_s = (1 - chance) * saved_s - chance * lost_s
        goes = gain_s > 0
        why = f"going {'gains' if goes else 'costs'} {abs(gain_s):.2f} s on average"
        return StayVerdict(goes, why, chance, saved_s, lost_s)
