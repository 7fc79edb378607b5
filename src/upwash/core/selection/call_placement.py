"""Where a call runs: on the drone, on the server in use, or first a wait for that server.

With probing, a server that failed is in doubt until it answers a call in time. Until then calls to it are trials: the
drone's own service computes them too. A call that runs on the drone is also sent to a server that becomes READY.

A lane that a call of the drone holds is not free (lanes.py): nothing is raced, overtaken or sent a second time there.
Which call in line a free lane takes is up to the policy: by default by earliest completion (planning/earliest.py).
Calls of other drones that a server has in its queue count as time before a call there, and in the call's deadline.

An operation that only servers run has its place at the server in use, once that is READY, or none yet.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, TypeAlias

from msgspec import structs

from upwash.core.knowledge.servers import CHECKING, Server, State
from upwash.core.operation import ON_DRONE, Operation
from upwash.core.planning.earliest import Lane, Line, WaitingCall
from upwash.core.planning.forecast import rest_of_check_s
from upwash.core.policies.policy import CallInputs, Decision, Inputs, Local, Remote, Wait
from upwash.core.selection.lanes import InLine
from upwash.core.selection.moment import Moment, Part
from upwash.core.selection.radios import Radios
from upwash.core.selection.settings import TwoAnswers

Place: TypeAlias = Literal["either", "drone"]
_TRIAL_S = 10.0  # for the server's answer to a call on trial


class CallPlacement(Part):
    """Decides where each call runs, by the policy and by what is known of the server in use."""

    def __init__(self, moment: Moment, radios: Radios) -> None:
        super().__init__(moment)
        self._radios = radios
        self._two_answers = moment.settings.two_answers

    def next_in_line(self) -> tuple[InLine, Place] | None:
        """The call to be decided now, of those in line, and where; None while all wait for a place.

        It is "either" place, or only the drone, which the policy has take the call.
        """
        line, server = self._line(), self._radios.in_use
        if line is None or (take := self._policy.place_in_line(line)) is None:
            return None
        call, is_open = self._lanes.line[take.call], line.calls[take.call].remote_s == math.inf
        if take.lane == "server" or (is_open and not call.on_drone):
            return call, "either"
        is_twice = call.operation in self._two_answers
        is_for_both = is_twice and server is not None and self._lanes.is_free(server.name)
        return call, "either" if is_for_both else "drone"

    def _line(self) -> Line | None:
        """The calls in line, and their lanes; None without a call or a free lane."""
        calls, server = self._lanes.line, self._radios.in_use
        drone, at_server = self._lane(ON_DRONE), self._lane(server.name) if server else None
        if not calls or not (drone.is_free or (at_server is not None and at_server.is_free)):
            return None
        known = {operation: self._both_s(operation) for operation in {call.operation for call in calls}}
        waiting = [
            WaitingCall(
                call.operation,
                self._now_s - call.since_s,
                known[call.operation][0],
                math.inf if call.on_drone else known[call.operation][1],
                call.urgent,
                call.operation in self._two_answers,
            )
            for call in calls
        ]
        return Line(waiting, drone, at_server)

    def _lane(self, place: str) -> Lane:
        lanes, now_s = self._lanes, self._now_s
        return Lane(
            lanes.is_free(place),
            lanes.rest_s(place, now_s),
            lanes.queue_s(place, now_s),
            lanes.usual_wait_s(place),
        )

    @property
    def _ready(self) -> Server | None:
        """The server in use; None unless that server is READY and in range."""
        server = self._radios.in_use
        is_ready = server is not None and server.in_range and server.state is State.READY
        return server if is_ready else None

    def _both_s(self, operation: Operation) -> tuple[float, float]:
        """The seconds of a call in line on the drone, and at the server; infinite where it does not run."""
        server = self._ready
        remote_s = self._estimates.remote_s(server.name, operation) if server is not None else None
        if self._estimates.needs_server(operation):
            is_there = isinstance(self._at_server(operation), Remote)
            return math.inf, remote_s if is_there and remote_s is not None else math.inf
        local_s = self._estimates.local_s(operation)
        if local_s is None:
            return 0.0, math.inf
        two = self._two_answers.get(operation)
        computed_s = local_s if two is None else self._first_s(two, local_s)
        if server is None or remote_s is None or self._recovery.in_doubt(server.name, operation):
            return computed_s, math.inf
        if two is not None and remote_s > two.within_s:
            return computed_s, math.inf
        decision = self._policy.decide(self._call(server, operation, local_s, remote_s))
        return computed_s, remote_s if isinstance(decision, Remote) else math.inf

    def _first_s(self, two: TwoAnswers, local_s: float) -> float:
        first_s = self._estimates.local_s(two.first)
        return local_s if first_s is None else first_s

    def decide(  # noqa: PLR0912
        self, operation: Operation, *, on_drone: bool = False, drone_is_busy: bool = False
    ) -> Decision:
        """Decide where a call made now runs; leave the server in use if it is out of range.

        With `on_drone` the drone takes the call out of the line. A call with two answers runs at both places where
        the drone, if not busy, has the first one before the server, and on the drone where the server is too late.
        """
        if self._estimates.needs_server(operation):
            return self._at_server(operation)
        inputs, server = self._inputs(operation), self._radios.in_use
        if server is None:
            return Local("no server selected", inputs)
        if not server.in_range:
            self._radios.leave(server, "out of range")
            return Local(f"{server.name} is out of range", inputs)
        if on_drone:
            is_busy = not self._lanes.is_free(server.name)
            why = f"{server.name} is busy with earlier calls" if is_busy else "the drone takes it first"
            return Local(why, inputs)
        local_s, remote_s = inputs.local_s, inputs.remote_s
        if local_s is None or remote_s is None:
            return Local(f"no estimate of {operation} on {server.name}", inputs)
        if server.state in CHECKING and server.is_full(self._now_s):
            return Local(f"{server.name} has no free slot", inputs)
        two = self._two_answers.get(operation)
        if two is not None and remote_s > two.within_s:
            return Local(f"{server.name} answers too late for the better answer", inputs)
        decision = self._on_trial(server, operation, local_s)
        if decision is not None:  # how a server in doubt answers whole calls is seen from whole calls
            inputs = structs.replace(inputs, whole_s=None, less_s=None)
        else:
            decision = self._policy.decide(self._call(server, operation, local_s, remote_s))
        if isinstance(decision, Remote):
            if two is not None and not drone_is_busy and self._first_s(two, local_s) < remote_s:
                decision = replace(decision, raced=True)
            deadline_s, queue_s = decision.deadline_s, self._lanes.queue_s(server.name, self._now_s)
            if self._lanes.has_line:  # it has counted the queue: here nothing else may be sooner
                decision = replace(decision, deadline_s=deadline_s + self._wait_s(server.name))
            elif queue_s > self.may_queue_s(server.name, operation, deadline_s):
                return Local(f"{server.name} has {queue_s:.1f} s of calls in its queue", inputs)
        return replace(decision, inputs=inputs)

    def may_queue_s(self, server: str, operation: Operation, deadline_s: float) -> float:
        """The seconds within which the server has to begin a call that is sent now, to answer it by its deadline."""
        remote_s = self._estimates.remote_s(server, operation) or 0.0
        if not self._lanes.has_line:
            return max(0.0, deadline_s - remote_s + self._lanes.usual_wait_s(server))
        return max(0.0, (deadline_s + self._wait_s(server) - remote_s) / 2)

    def _wait_s(self, server: str) -> float:
        """The seconds that a call sent now may have to wait for other drones' calls: what is known, or as usual."""
        return max(self._lanes.queue_s(server, self._now_s), self._lanes.usual_wait_s(server))

    def _at_server(self, operation: Operation) -> Decision:
        """Remote for a call that only servers compute, or why no server takes it now."""
        inputs, server = self._inputs(operation), self._radios.in_use
        alone_s, remote_s = self._estimates.alone_s(operation), inputs.remote_s
        if server is None:
            return Local("no server selected", inputs)
        if alone_s is None or remote_s is None:
            return Local(f"{server.name} does not offer {operation}", inputs)
        if not server.in_range or server.state is not State.READY:
            return Local(f"{server.name} is not ready", inputs)
        decision = self._policy.decide(self._call(server, operation, alone_s, remote_s))
        if isinstance(decision, Remote):
            deadline_s = decision.deadline_s + self._wait_s(server.name)
            decision = replace(decision, raced=False, deadline_s=deadline_s)
        return replace(decision, inputs=inputs)

    def second(self, operation: Operation, beside: str, *, begins: bool) -> Server | None:
        """The other READY server in range that offers the operation; a server in doubt when its next trial is due.

        If the call `begins` there, it is that trial.
        """
        for server in self._radios.selected:
            if server.name == beside or not server.in_range or server.state is not State.READY:
                continue
            if begins and not self._lanes.is_free(server.name):
                continue
            if self._estimates.remote_s(server.name, operation) is None:
                continue
            if self._recovery.in_doubt(server.name, operation):
                if self._recovery.trial_due_s(server.name, operation) > self._now_s:
                    continue
                if begins:
                    self._recovery.trials.add(server.name)
            return server
        return None

    def may_send(self, server: str, check: int) -> bool:
        """Whether a call that was decided for the server, READY since that check, may still go there."""
        selected = self._radios.ready(server, check)
        return selected is not None and selected.in_range

    def _call(self, server: Server, operation: Operation, local_s: float, remote_s: float) -> CallInputs:
        return CallInputs(
            server=server.name,
            state=server.state,
            local_s=local_s,
            remote_s=remote_s,
            check_expected_s=self._check_s(server),
            check_elapsed_s=self._now_s - server.checked_since_s,
            is_first=self._estimates.is_first_call(server.name, operation),
        )

    def _check_s(self, server: Server) -> float:
        return self._estimates.check_s(server.name, running=server.state is State.CHECK_R)

    def _inputs(self, operation: Operation) -> Inputs:
        server, local_s = self._radios.in_use, self._estimates.local_s(operation)
        if server is None:
            return Inputs(local_s)
        remote_s = self._estimates.remote_s(server.name, operation)
        if remote_s is not None:  # behind what the server still computes
            remote_s += self._lanes.rest_s(server.name, self._now_s)
        whole_s, less_s = self._estimates.both_ways_s(server.name, operation) or (None, None)
        return Inputs(
            local_s,
            server.name,
            server.state,
            server.check,
            remote_s=remote_s,
            check_s=self._check_s(server),
            check_elapsed_s=self._now_s - server.checked_since_s,
            whole_s=whole_s,
            less_s=less_s,
            queue_s=self._wait_s(server.name) or None if self._lanes.has_line else None,
        )

    def decide_after_wait(self, operation: Operation, check: int) -> Decision:
        """Decide where a call runs after its wait for that check; never another Wait."""
        server = self._radios.in_use
        if server is None or server.check != check:
            return Local("the check failed or was given up", self._inputs(operation))
        decision = self.decide(operation)
        if isinstance(decision, Remote):
            return replace(decision, why="server became ready")
        return Local("not ready in time", decision.inputs) if isinstance(decision, Wait) else decision

    def overtake(self, operation: Operation, began_s: float) -> tuple[Remote | None, float]:
        """The server expected to answer before the drone, which computes the call since `began_s`; None without one.

        The second value is the time to ask again if no event comes before.
        """
        server, now_s = self._ready, self._now_s
        if self._recovery.probing is None or server is None:
            return None, math.inf
        if not self._lanes.is_free(server.name):
            return None, math.inf
        line = self._line()
        take = None if line is None else self._policy.place_in_line(line)
        if take is not None and take.lane == "server":  # for a call in line
            return None, math.inf
        if (queue_s := self._lanes.queue_s(server.name, now_s)) > 0:
            return None, now_s + queue_s
        local_s = self._estimates.local_s(operation)
        usual_s = self._estimates.remote_s(server.name, operation, slow=False)
        if local_s is None or usual_s is None or usual_s >= began_s + local_s - now_s:
            return None, math.inf
        due_s = self._recovery.trial_due_s(server.name, operation)
        if due_s > now_s:
            return None, due_s
        decision = self.decide(operation)
        if not isinstance(decision, Remote):
            return None, math.inf
        return replace(decision, why=f"{server.name} is ready, and sooner", raced=True), math.inf

    def better(self, operation: Operation, by_s: float, *, is_next: bool) -> tuple[Remote | None, bool]:
        """The server in use, READY to answer by then a call whose first answer the drone computes; None without one.

        The second value tells whether the server may become of use in time, as where the call `is_next` there.
        """
        server, now_s = self._radios.in_use, self._now_s
        if server is None or not server.in_range:
            return None, False
        remote_s = self._estimates.remote_s(server.name, operation)
        if remote_s is None or server.is_full(now_s):
            return None, False
        begins_s = now_s + rest_of_check_s(server, self._estimates, now_s)
        if server.state is State.READY:
            begins_s = max(now_s, self._recovery.trial_due_s(server.name, operation))
        begins_s += self._lanes.queue_s(server.name, now_s)
        if begins_s + remote_s > by_s:
            return None, False
        if server.state is not State.READY or begins_s > now_s or not is_next:
            return None, True
        decision = self.decide(operation)
        if not isinstance(decision, Remote):
            return None, False
        deadline_s = min(decision.deadline_s, by_s - now_s)
        return replace(decision, deadline_s=deadline_s, why="for the better answer", raced=True), True

    def _on_trial(self, server: Server, operation: Operation, local_s: float) -> Decision | None:
        """Where a call runs if the operation is in doubt on its server; None otherwise."""
        name, usual_s = server.name, self._estimates.remote_s(server.name, operation, slow=False)
        if not self._recovery.in_doubt(name, operation):
            return None
        if usual_s is None or usual_s >= local_s:
            return Local(f"{name} failed or was slow, and is not faster")
        if server.state is not State.READY:
            return Local(f"{name} failed or was slow: it is not waited for")
        if self._recovery.trial_due_s(name, operation) > self._now_s:
            return Local(f"{name} failed or was slow: it is tried again soon")
        if not self._lanes.is_free(name):
            return Local(f"{name} failed or was slow, and still has an earlier call")
        self._recovery.trials.add(name)
        return Remote(name, max(_TRIAL_S, local_s), "on trial", raced=True)
