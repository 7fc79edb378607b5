"""Defects planted in what flies rows, and in the line of its calls: `planted.py` lists them."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Sequence
from typing import Any
from unittest.mock import patch

from msgspec import structs
from msgspec.structs import replace
from tests.sim.planting import Planting, plant, planted, planting

from upwash.config.drone import DroneConfig
from upwash.core.call.call import Call
from upwash.core.call.calls import Calls
from upwash.core.geo import Position
from upwash.core.planning import acts, earliest
from upwash.core.planning.acts import Acts
from upwash.core.planning.demand_map import DemandMap
from upwash.core.selection.call_placement import CallPlacement
from upwash.core.selection.lanes import Lanes
from upwash.drone import legs
from upwash.drone.answers import AnswerAction
from upwash.drone.late_acts import LateActs
from upwash.drone.legs import Legs
from upwash.drone.places import ahead_m
from upwash.drone.seeking import Seeking
from upwash.drone.several import Several
from upwash.eventlog import schema
from upwash.eventlog.schema import Event
from upwash.lab.faults import call_promises
from upwash.sim.autopilot import ModelAutopilot


@planted("on a row an action is done where the drone is", Several, "come_back")
def acts_on_the_row(come_back: Any, self: Several, answer: AnswerAction[Any], waited_s: float = 0.0) -> None:
    if self.rests:
        come_back(self, answer, waited_s)
    else:
        answer.finish(waited_s)


@planted("the map of demands does not count answers that demand nothing", DemandMap, "note")
def counts_demands_only(note: Any, self: DemandMap, position: Position, *, demanded: bool) -> None:
    if demanded:
        note(self, position, demanded=demanded)


@planted("of several demands on a row one is met", Several, "meet")
def meets_one(meet: Any, self: Several, demanding: list[AnswerAction[Any]], *about: Any) -> Any:
    for answer in demanding[1:]:
        self._open.remove(answer)
    return meet(self, demanding[:1], *about)


@planted("an answer is taken twice on a row", Several, "_taken")
def takes_twice(taken: Any, self: Several, waited_s: float = 0.0, **about: Any) -> Any:
    before = [answer for answer in self._open if answer.call.is_over]
    demanding = taken(self, waited_s, **about)
    for answer in before:
        answer._holds = None
        answer.holds()
    return demanding


plant("a spot that was passed during a call is not flown back to", Legs, "_misses", lambda *_, **__: False)


@planted("on a row a spot counts however far beside it the drone passes", legs, "is_missed")
def counts_beside(_: Any, spot: Position, here: Position, *, speed_m_s: float, **leg: Position) -> bool:
    return -ahead_m(spot, here, **leg) > max(1.0, 0.5 * speed_m_s)


@planting("on a row a spot counts in doubt of the position")
def counts_in_doubt() -> Planting:
    planted = contextlib.ExitStack()
    planted.enter_context(patch.object(ModelAutopilot, "position_is_sure", True))
    planted.enter_context(counts_beside())  # the place in the report is that of the doubt
    return planted


plant(
    "the number of open photos has no bound",
    Several,
    "leave_open",
    lambda self, answer: self._open.append(answer),
)
plant("the line knows no busy place", Lanes, "hold", lambda *_: None)


@planted("a server with a call of the drone overtakes another", CallPlacement, "overtake")
def overtakes_where_busy(overtake: Any, self: CallPlacement, *about: Any) -> Any:
    with patch.object(self._lanes, "is_free", lambda _: True):
        return overtake(self, *about)


@planted("the line is left from its other end", Calls, "__init__")
def other_end(init: Any, self: Calls, *about: Any, **how: Any) -> None:
    init(self, *about, **how)
    self.lanes.newest_first = not self.lanes.newest_first


@planted("a free place takes the last call of the line", earliest, "first_taken")
def takes_the_last(first_taken: Any, line: Sequence[tuple[float, float]], **about: Any) -> Any:
    taken = first_taken(line, **about)
    return None if taken is None else len(line) - 1


@planted("a resting drone flies from range to range", Seeking, "sooner")
async def never_rests(sooner: Any, self: Seeking, *about: Any, but: set[str], **how: Any) -> Any:
    with patch("upwash.core.planning.backlog.LEAST_GAIN_S", -1e9):
        return await sooner(self, *about, but=set(), **how)


@planted("a call that the mission waits for joins the line", Calls, "_make")
def nothing_is_urgent(make: Any, self: Calls, call: Call) -> None:
    call.asked = structs.replace(call.asked, urgent=False)
    make(self, call)


@planted("the drone sets off for home with open answers", Several, "settle")
def leaves_answers_open(settle: Any, self: Several, *, comes_back: bool = True) -> None:
    if comes_back:
        settle(self)
    else:
        self.stop()


@planted("an act that was put off is forgotten", Acts, "all")
def forgets(all_acts: Any, self: Acts[Any]) -> list[Any]:
    all_acts(self)
    return []


@planted("an act is put off for longer than its limit", LateActs, "_left_s")
def has_no_limit(_left_s: Any, self: LateActs, *_: Any) -> float:
    return math.inf


plant("an act is put off to where it costs more", acts, "_LEAST_GAIN_S", -1e9)


@planted("a photo whose demand was met is taken again", call_promises, "waypoints_done")
def taken_again(done: Any, events: Iterable[Event], config: DroneConfig) -> Any:
    forgetful = (
        replace(event, back=False) if isinstance(event, schema.SetOff) else event for event in events
    )
    return done(forgetful, config)
