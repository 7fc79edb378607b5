"""Where a call is attempted: at a server, or on the drone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from upwash.core.geo import Position
from upwash.core.operation import Operation
from upwash.core.policies.policy import Inputs, Lightened

if TYPE_CHECKING:
    from upwash.core.call.call import Call

_LEAST_S, _FACTOR = 30.0, 10.0
End: TypeAlias = Literal["answered", "raised", "queued", "failed"]


def hangs_after_s(expected_s: float | None) -> float:
    """The seconds after which the drone's own service hangs in a call: ten times its estimate, 30 s at least."""
    return max(_LEAST_S, _FACTOR * (expected_s or 0.0))


@dataclass(slots=True, eq=False)
class Computing:
    """The drone's own computation of a call, which begins when earlier ones of its service are over."""

    call: Call
    operation: Operation
    lightened: Lightened | None
    asked_s: float
    began_s: float | None = None
    took_s: float = 0.0
    raised: str = ""
    state: Literal["open", "answered", "failed"] = "open"

    @property
    def is_open(self) -> bool:
        """Whether an answer may still come."""
        return self.state == "open"


@dataclass(slots=True, eq=False)
class Attempt:
    """One attempt at a call at a server, READY since `check`, from `position`.

    Its delay counts from `counts_from_s`, as a part before sending that fails is no fault of the server.
    """

    call: Call
    server: str
    check: int
    operation: Operation
    lightened: Lightened | None
    position: Position
    inputs: Inputs  # of the decision
    deadline_s: float
    begun_s: float
    counts_from_s: float
    size_bytes: int  # of the whole request
    sends_less: bool  # after a part that makes the request smaller
    part_s: float = 0.0  # that the part took
    sent_bytes: int = 0
    state: Literal["open"] | End = "open"
    raised: str = ""  # the exception of the service that the server reports
    delay_s: float = 0.0  # until that report
    verdict: Literal["", "confirmed", "denied"] = ""  # of the drone's own service, on the report

    @property
    def is_open(self) -> bool:
        """Whether an answer may still come."""
        return self.state == "open"

    @property
    def facts_of_sending(self) -> dict[str, Any]:
        """What a part before sending made of the request, as a call's log record has it."""
        if not self.sends_less:
            return {}
        return {"whole_bytes": self.size_bytes, "sent_bytes": self.sent_bytes, "part_s": self.part_s}

    @property
    def told_of_sending(self) -> str:
        """What was sent, and why, after a semicolon; "" where no part may run before sending."""
        inputs = self.inputs
        if inputs.whole_s is None or inputs.less_s is None:
            return ""
        if inputs.sends_less and not self.sends_less:
            return "; sent whole, as it was not made smaller"
        how = "made smaller before sending" if self.sends_less else "sent whole"
        return f"; {how}: {inputs.less_s:.2f} s expected with less to send, {inputs.whole_s:.2f} s whole"
