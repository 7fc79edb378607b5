"""Policies: which server to select, and where a call runs (thesis sections 3.3 and 3.4).

A policy decides both from its arguments alone. A built-in policy has no memory. Users extend
these classes (docs/own-policy.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from msgspec import Struct
from msgspec.structs import asdict

from upwash.core.geo import Measured, Position, Reach
from upwash.core.knowledge.servers import CHECKING, State
from upwash.core.operation import Operation
from upwash.core.planning.acts import LateAct, cheapest
from upwash.core.planning.backlog import Stay, soonest
from upwash.core.planning.earliest import Line, Take, earliest
from upwash.core.planning.forecast import Forecast


class PolicyDefect(Exception):
    """Raised for an own policy that raises, does not answer, or answers what cannot be; offloading ends with it."""


class Option(Struct, frozen=True):
    """A server in range that may be used, the mean delay of calls with it ready, and whether it has no free slot.

    `in_range_since_s` is a time like `Situation.now_s`. `area` is where the server is believed to be in range.
    """

    server: str
    mean_call_s: float
    in_range_since_s: float
    full: bool = False
    state: State = State.AVL
    area: Reach = Measured()


class Situation(Struct, frozen=True):
    """The inputs of a selection.

    `options` are in the order of the server table, without blacklisted servers and those that gain too little for a
    slot that others wait for. `current` is the selected server; it is among the options unless the drone has left
    its range or should leave it to others. `local_mean_call_s` is the mean delay on the drone, `under_way` the
    decision on the open call. A policy with a horizon gets a `forecast`; None while no call is foreseen. `position`
    is the drone's, at the time `now_s`; None and 0 where a coming call is placed in a forecast.
    """

    options: Sequence[Option]
    current: str | None
    local_mean_call_s: float
    under_way: Decision | None = None
    forecast: Forecast | None = None
    now_s: float = 0.0
    position: Position | None = None

    @property
    def is_foreseen(self) -> bool:
        """Whether a coming call is placed in a forecast."""
        return self.position is None


class Coming(Struct, frozen=True):
    """The server that the drone uses next, and in how many seconds at the earliest."""

    server: str
    in_s: float


class Choice(Struct, frozen=True):
    """The server to select, if any, and why; and the server after it, if foreseen."""

    server: str | None
    why: str
    coming: Coming | None = None


class CallInputs(Struct, frozen=True):
    """The inputs of a call's decision, while a server is selected and in range.

    `local_s` and `remote_s` are the operation's estimates. `check_expected_s` is the estimate of the check under way,
    and `check_elapsed_s` how long it has run (`Check_cur` or `CheckR_cur`, and now - t_check). `is_first` if the
    service is not known to have computed a call there since its start. `is_foreseen` for a coming call in a forecast.
    """

    server: str
    state: State
    local_s: float
    remote_s: float
    check_expected_s: float
    check_elapsed_s: float
    is_first: bool = False
    is_foreseen: bool = False


class Lightened(Struct, frozen=True):
    """A call that runs as a lighter operation than `asked`, because the mission would end too late."""

    operation: Operation
    asked: Operation
    forecast_s: float
    finish_by_s: float

    @property
    def facts(self) -> dict[str, Any]:
        """Why the call runs as another operation, by name, as a call's log record has it."""
        return {"asked": str(self.asked), "forecast_s": self.forecast_s, "finish_by_s": self.finish_by_s}


class Inputs(Struct, frozen=True):
    """The facts behind a call's decision. With them the decision can be repeated.

    `selected` is the server in use. Without one, `selected`, its `state`, the number of its `check` and its estimates
    are None. `check_s` is the expected time of its check, and `check_elapsed_s` the part that is over. If the call is
    `lightened`, the estimates are the lighter operation's. Where a part may run before sending, `remote_s` is the
    shorter of `whole_s`, with the request sent whole, and `less_s`, with less to send. Before `remote_s` a call may
    have to wait `queue_s` for calls of other drones, as far as that is counted apart.
    """

    local_s: float | None = None
    selected: str | None = None
    state: State | None = None
    check: int | None = None
    remote_s: float | None = None
    check_s: float | None = None
    check_elapsed_s: float | None = None
    lightened: Lightened | None = None
    whole_s: float | None = None
    less_s: float | None = None
    queue_s: float | None = None

    @property
    def sends_less(self) -> bool:
        """Whether the request is made smaller before it is sent."""
        return self.whole_s is not None and self.less_s is not None and self.less_s < self.whole_s

    @property
    def facts(self) -> dict[str, Any]:
        """The inputs by name, as a decision's log record has them; without `lightened`."""
        facts = asdict(self)
        del facts["lightened"]
        return facts


NO_INPUTS = Inputs()  # of a decision by itself, as policies make them


@dataclass(frozen=True, slots=True)
class Local:
    """Run the call on the drone."""

    why: str
    inputs: Inputs = field(default=NO_INPUTS, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Remote:
    """Run the call on the server, for at most `deadline_s`; then on the drone.

    If `raced`, the drone's own service computes the call too, and the first answer counts.
    """

    server: str
    deadline_s: float
    why: str
    raced: bool = False
    inputs: Inputs = field(default=NO_INPUTS, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Wait:
    """Wait for the server to become READY, for at most `at_most_s`; then run the call on the drone."""

    server: str
    at_most_s: float
    why: str
    inputs: Inputs = field(default=NO_INPUTS, compare=False, repr=False)


Decision = Local | Remote | Wait


class Policy(Protocol):
    """What every policy provides: the choice of a server, the place of a call, and where a drone waits."""

    @property
    def name(self) -> str:
        """The policy's name in configurations and results."""

    @property
    def horizon(self) -> int:
        """How many coming calls the policy needs in `Situation.forecast`; 0 for none."""

    def choose(self, situation: Situation) -> Choice:
        """The server to select now, if any."""

    def decide(self, call: CallInputs) -> Decision:
        """Where the call runs: Wait, Remote or Local."""

    def place_in_line(self, line: Line) -> Take | None:
        """The call in line that a free lane takes now; None if none does yet."""

    def where_to_wait(self, stay: Stay) -> str | None:
        """The server of the range where a resting drone waits for answers; None for where it is."""

    def when_to_act(self, act: LateAct) -> int | None:
        """The number of a gap of the act, where the drone acts then; None for at once."""


class BuiltInRules:
    """The built-in rules for calls in line, and for acts of answers that come later."""

    def place_in_line(self, line: Line) -> Take | None:
        """By earliest completion."""
        return earliest(line)

    def where_to_wait(self, stay: Stay) -> str | None:
        """Where the line ends soonest, with the way there and on."""
        return soonest(stay)

    def when_to_act(self, act: LateAct) -> int | None:
        """Where it makes the way least longer."""
        return cheapest(act)


class Deadline(Struct, frozen=True):
    """The longest time of a remote call: `factor` times its estimate, but no longer than a local call takes.

    A call given up after the time of a local call costs at most twice that time: the ski-rental bound. If
    `patient_first`, a service's first call may take that whole time, as its estimate is uncertain.
    """

    least_s: float = 1.0
    factor: float = 4.0
    patient_first: bool = False

    def seconds(self, *, local_s: float, remote_s: float, is_first: bool = False) -> float:
        """The deadline in seconds of a call with these estimates, at least `least_s`."""
        if is_first and self.patient_first:
            return max(self.least_s, local_s)
        return max(self.least_s, min(self.factor * remote_s, local_s))


class WaitRule(Struct, frozen=True):
    """Waits for a server under check if that should save the fraction `gain_wait` of a local call (eq. 3.5)."""

    gain_wait: float = 0.25
    deadline: Deadline = Deadline()

    def longest_s(self, *, local_s: float, remote_s: float) -> float:
        """The longest wait (s) that pays off for a call with these estimates; 0 or less if none does."""
        return local_s * (1 - self.gain_wait) - remote_s

    def decide(self, call: CallInputs) -> Decision:
        """Remote if the server is READY; a bounded Wait or Local while it is checked; Local in any other state."""
        if call.state is State.READY:
            deadline_s = self.deadline.seconds(
                local_s=call.local_s, remote_s=call.remote_s, is_first=call.is_first
            )
            return Remote(call.server, deadline_s, "server ready")
        if call.state not in CHECKING:
            return Local(f"{call.server} is {call.state}")
        longest_s = self.longest_s(local_s=call.local_s, remote_s=call.remote_s)
        wait_s = call.check_expected_s - call.check_elapsed_s
        if longest_s <= 0:
            return Local("waiting cannot pay off")
        if wait_s <= 0:
            return Wait(call.server, longest_s, "the check takes longer than expected")
        if (call.local_s - (call.remote_s + wait_s)) / call.local_s > self.gain_wait:
            return Wait(call.server, longest_s, f"expected to be ready in {wait_s:.2f} s")
        return Local(f"expected to be ready in {wait_s:.2f} s, too late to pay off")


_WAIT_RULE = WaitRule()


def with_slots(options: Sequence[Option]) -> Sequence[Option]:
    """The options that may have a free slot, or all options if none has."""
    return [option for option in options if not option.full] or options


@dataclass(frozen=True)
class LocalOnly(BuiltInRules):
    """Never offloads: the thesis's no-offload reference."""

    name: str = "local-only"
    horizon: int = 0

    def choose(self, situation: Situation) -> Choice:
        """Select no server, ever."""
        return Choice(None, "local-only policy")

    def decide(self, call: CallInputs) -> Decision:
        """Run every call on the drone."""
        return Local("local-only policy")


@dataclass(frozen=True)
class Opportunistic(BuiltInRules):
    """Uses the server whose range was entered first, and never compares: the thesis's naive reference."""

    wait: WaitRule = _WAIT_RULE
    name: str = "opportunistic"
    horizon: int = 0

    def choose(self, situation: Situation) -> Choice:
        """The current server while it is in range, else the server whose range was entered first."""
        options = with_slots(situation.options)
        if any(option.server == situation.current for option in options):
            return Choice(situation.current, "in range")
        if not options:
            return Choice(None, "no server in range")
        return Choice(min(options, key=lambda option: option.in_range_since_s).server, "first come")

    def decide(self, call: CallInputs) -> Decision:
        """Decide by the wait rule, without a comparison with the drone."""
        return self.wait.decide(call)


@dataclass(frozen=True)
class LocationAware(BuiltInRules):
    """The thesis's policy: the fastest server in range, unless the drone is faster (eqs. 3.2 to 3.4)."""

    gain_switch: float = 0.25
    wait: WaitRule = _WAIT_RULE
    name: str = "location-aware"
    horizon: int = 0

    def choose(self, situation: Situation) -> Choice:
        """The best candidate; the current server unless another gains more than `gain_switch` over it."""
        local_s = situation.local_mean_call_s
        candidates = with_slots([option for option in situation.options if option.mean_call_s < local_s])
        current = next((option for option in candidates if option.server == situation.current), None)
        if not candidates:
            return Choice(None, "not faster than local" if situation.options else "no server in range")
        best = min(candidates, key=lambda option: option.mean_call_s)
        if current is None:
            return Choice(best.server, "fastest in range")
        if (current.mean_call_s - best.mean_call_s) / local_s > self.gain_switch:
            return Choice(best.server, f"gains enough over {current.server}")
        return Choice(current.server, "no other gains enough")

    def decide(self, call: CallInputs) -> Decision:
        """Local if the operation is no faster on the server, else as the wait rule decides."""
        if call.remote_s >= call.local_s:
            return Local(f"{call.server} is not faster for this operation")
        return self.wait.decide(call)
