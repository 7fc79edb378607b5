"""A simulated mission in steps: questions to its policy are answered from outside.

The mission runs in a thread of its own. At a question the thread hands it over, and waits for the answer.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, NamedTuple, cast

from upwash.config.drone import DroneConfig
from upwash.core.policies.policy import Policy
from upwash.drone.own_policy import policy_of
from upwash.lab.run import Run, simulate
from upwash.sim.loop import end_run
from upwash.support.background import now_s, only_logged, thread


class PolicyQuestion(NamedTuple):
    """A question, the answer of the scenario's policy, and the virtual time."""

    about: Any
    built_in: Any
    at_s: float


class SteppedMission:
    """The scenario's mission, whose policy has one method that is answered from outside; `end` it."""

    def __init__(self, config: DroneConfig, method: str) -> None:
        self._handed: SimpleQueue[PolicyQuestion | Run | BaseException] = SimpleQueue()
        self._answers: SimpleQueue[Any] = SimpleQueue()
        self._is_over = False
        policy = _Asking(policy_of(config.policy), method, self._ask)
        self._thread = thread(lambda: self._fly(config, policy), name="mission in steps", failed=only_logged)
        self._thread.start()

    def next(self) -> PolicyQuestion | Run:
        """The next question, or the flown mission, after the answer to the question before; raises its error.

        The thread is over where no question is left.
        """
        handed = self._handed.get()
        if not isinstance(handed, PolicyQuestion):
            self._thread.join()
        if isinstance(handed, BaseException):
            raise handed
        return handed

    def answer(self, answer: Any) -> None:
        """Answer the last question."""
        self._answers.put(answer)

    def end(self) -> None:
        """End the mission; return when its thread is over."""
        self._is_over = True
        self._answers.put(None)
        self._thread.join()

    def _fly(self, config: DroneConfig, policy: _Asking) -> None:
        try:
            self._handed.put(simulate(config, policy=cast("Policy", policy)))
        except BaseException as error:  # noqa: BLE001 - raised where the next question is awaited
            self._handed.put(error)

    def _ask(self, about: Any, built_in: Any) -> Any:
        answer = None
        if not self._is_over:
            self._handed.put(PolicyQuestion(about, built_in, now_s()))
            answer = self._answers.get()
        if self._is_over:
            end_run(RuntimeError("the mission is not wanted any more"))
            raise asyncio.CancelledError
        return answer


class _Asking:
    """The scenario's policy with one other method: `ask` answers it, except in forecasts."""

    def __init__(self, policy: Policy, method: str, ask: Callable[[Any, Any], Any]) -> None:
        def answer(about: Any) -> Any:
            built_in = getattr(policy, method)(about)
            return built_in if getattr(about, "is_foreseen", False) else ask(about, built_in)

        self._policy = policy
        setattr(self, method, answer)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._policy, name)
