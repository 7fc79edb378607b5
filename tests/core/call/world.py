"""All around random calls: a selection that decides as drawn, and what is known of each call."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from tests.core.call.field import CHECK, LIGHT, LOCAL, RACED, REMOTE, Field

from upwash.core.call import steps
from upwash.core.operation import ON_DRONE, Operation
from upwash.core.policies.policy import Remote
from upwash.core.selection.deadlines import AnswerDeadline, Deadlines
from upwash.core.selection.lanes import InLine
from upwash.core.selection.settings import TwoAnswers

BY_A_DEADLINE = Operation("gripper", "aim")
TWICE = Operation("gripper", "show")
ON_SERVERS = Operation("gripper", "seek")
TWO = TwoAnswers(LIGHT, 20.0)
KNOWN_S = [0.5] * 200


@dataclass(eq=False)
class Story:
    """What a call is known to have done."""

    asked: steps.Asked
    made_s: float
    end: steps.Answer | steps.LeftUnanswered | None = None
    is_abandoned: bool = False
    is_enough: bool = False
    place: str = ""  # whose lane it holds
    is_decided: bool = False
    is_waiting: bool = False  # for a check
    has_raised: bool = False  # a server, and the drone tests that
    own: str = ""  # how the drone's own computation has ended
    has_heard: bool = False  # the mission, a first answer
    is_seconded: bool = False  # its first attempt
    is_hedged: bool = False
    waits: bool = False  # the mission, at rest
    is_hopeless: bool = False  # no server could give a better answer, once it waited

    @property
    def is_over(self) -> bool:
        return self.end is not None or self.is_abandoned

    @property
    def is_twice(self) -> bool:
        return self.asked.operation == TWICE and not self.asked.once

    @property
    def is_one(self) -> bool:
        """Whether the drone may compute it, and its first answer ends it."""
        return not self.is_twice and not self.asked.on_servers


class World(Field):
    """All around calls: the selection decides as drawn, and keeps to the lanes that are free."""

    def __init__(self, first: str | None) -> None:
        known = {(server, BY_A_DEADLINE): KNOWN_S for server in ("s1", "s2")}
        deadlines = Deadlines({BY_A_DEADLINE: AnswerDeadline(2.05, 0.999, 1.0)}, known)
        super().__init__(first=first, deadlines=deadlines, waiting_bytes=250)
        self.two_answers = {TWICE: TWO}
        self.decision: Any = LOCAL
        self.is_checked = False  # the check under way has ended
        self.is_of_use = False  # s1, beside the drone
        self.has_better = False
        self.may_come = True
        self.has_second = True

    def next_in_line(self) -> tuple[InLine, str] | None:
        drone, server = self.lanes.is_free(ON_DRONE), self.lanes.is_free("s1")
        for call in self.lanes.line:
            if call.on_drone or call.needs_server:
                if drone if call.on_drone else server:
                    return call, "drone" if call.on_drone else "either"
            elif drone or server:
                return call, "either" if server else "drone"
        return None

    def decide(self, operation: Operation, *, on_drone: bool = False, **_: Any) -> tuple[Any, list[Any]]:
        return self._possible(self.decision, operation, on_drone=on_drone), []

    def decide_after_wait(self, operation: Operation, check: int, **_: Any) -> tuple[Any, list[Any]]:
        return self._possible(REMOTE if self.is_checked else LOCAL, operation), []

    def _possible(self, decision: Any, operation: Operation, *, on_drone: bool = False) -> Any:
        if on_drone or (self.lanes.has_line and not self.lanes.is_free("s1")):
            return LOCAL
        if self.lanes.has_line and not self.lanes.is_free(ON_DRONE) and operation != ON_SERVERS:
            return REMOTE
        return REMOTE if operation == ON_SERVERS and getattr(decision, "raced", False) else decision

    def is_awaited(self, check: int) -> bool:
        assert check == CHECK
        return not self.is_checked

    def overtake(self, operation: Operation, **_: Any) -> tuple[Remote | None, float]:
        if self.is_of_use and self.lanes.is_free("s1"):
            self.is_of_use = False
            return RACED, math.inf
        return None, self.now_s + 3.0

    def better(self, operation: Operation, by_s: float, *_: Any, is_next: bool) -> tuple[Remote | None, bool]:
        return (RACED if self.has_better and is_next else None), self.may_come

    def second(self, operation: Operation, beside: str, *, begins: bool) -> Any:
        is_free = self.lanes.is_free("s2") or not begins
        return self.servers["s2"] if self.has_second and is_free and beside == "s1" else None

    def needs_server(self, operation: Operation) -> bool:
        return operation == ON_SERVERS
