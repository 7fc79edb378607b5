"""A policy of the user's own: a class in a file or module, loaded before take-off.

The rest of the drone relies on a policy's answers, and runs on the same thread. So each question has a limit of time,
and each answer is checked. A policy that raises, is silent, or answers what cannot be is a defect. Offloading
ends with its reason, and the mission goes on with every call on the drone. Where the class has no method for a
question, the built-in policy answers.
"""

from __future__ import annotations

import contextlib
import ctypes
import inspect
import math
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from typing import Any, TypeVar, cast

from upwash.config.drone import PolicyConfig
from upwash.core.planning.acts import LateAct
from upwash.core.planning.backlog import Stay
from upwash.core.planning.earliest import Line, Take
from upwash.core.policies.names import is_own, make_policy
from upwash.core.policies.policy import (
    CallInputs,
    Choice,
    Coming,
    Decision,
    Local,
    Policy,
    Remote,
    Situation,
    Wait,
)
from upwash.errors import UsageError
from upwash.support.background import only_logged, thread
from upwash.support.loading import load
from upwash.support.text import counted, worded

T = TypeVar("T")
ANSWERS_WITHIN_S = 5.0
_FARTHEST_HORIZON = 1000  # calls
_LONGEST_WHY = 500  # characters
_LONGEST_S = 3600.0


class PolicyDefect(Exception):
    """Raised for an own policy that raises, does not answer, or answers what cannot be."""


def policy_of(settings: PolicyConfig) -> Policy:
    """The configured policy; raises UsageError if an own one cannot be loaded."""
    built_in = make_policy(
        "location-aware" if is_own(settings.name) else settings.name,
        gain_switch=settings.gain_switch,
        gain_wait=settings.gain_wait,
        patient_first_call=settings.patient_first_call,
    )
    return _own_policy(settings, otherwise=built_in) if is_own(settings.name) else built_in


def _own_policy(settings: PolicyConfig, *, otherwise: Policy) -> Policy:
    made, name = load(settings.name), settings.name
    if not callable(made):
        raise UsageError(f"policy {name}: expected a class, and this is {made!r}: name the class")
    try:
        policy = made(**settings.settings)
    except Exception as error:
        known = inspect.signature(made) if inspect.isclass(made) else "()"
        raise UsageError(
            f"policy {name} cannot be made: {worded(error)}; it takes {known}, and "
            f"policy.settings has {', '.join(settings.settings) or 'nothing'}"
        ) from error
    if not callable(getattr(policy, "choose", None)):
        raise UsageError(
            f"policy {name} has no method choose(situation): add it; it returns the server to use"
        )
    horizon = getattr(policy, "horizon", 0)
    if not isinstance(horizon, int) or not 0 <= horizon <= _FARTHEST_HORIZON:
        raise UsageError(
            f"policy {name}: its horizon is {horizon!r}: give a number of calls up to {_FARTHEST_HORIZON}"
        )
    return OwnPolicy(policy, settings.label, horizon, otherwise)


class OwnPolicy:
    """The user's policy, kept in bounds; `otherwise` answers where it has no method for a question."""

    def __init__(self, policy: Any, name: str, horizon: int, otherwise: Policy) -> None:
        self._policy = policy
        self._otherwise = otherwise
        self.name = name
        self.horizon = horizon

    def choose(self, situation: Situation) -> Choice:
        """The server to select now, if any."""
        choice = self._answer("choose", situation)
        servers = [option.server for option in situation.options]
        if isinstance(choice, str) or choice is None:
            choice = Choice(choice, "its choice")
        if not isinstance(choice, Choice):
            raise self._defect(
                "choose", f"returned {choice!r:.200}, and a server's name, None or a Choice is expected"
            )
        if choice.server is not None and choice.server not in servers:
            raise self._defect(
                "choose", f"named {choice.server!r:.100}, which is not among the servers {servers}"
            )
        if not isinstance(choice.coming, Coming | None):
            raise self._defect("choose", f"has coming = {choice.coming!r:.200}: None or a Coming is expected")
        return Choice(choice.server, str(choice.why)[:_LONGEST_WHY], choice.coming)

    def decide(self, call: CallInputs) -> Decision:
        """Where the call runs: Wait, Remote or Local."""
        decision = self._answer("decide", call)
        match decision:
            case Local():
                return Local(str(decision.why)[:_LONGEST_WHY])
            case Remote(server=call.server, deadline_s=int() | float() as within_s) if (
                0 < within_s <= _LONGEST_S
            ):
                return Remote(call.server, within_s, str(decision.why)[:_LONGEST_WHY], bool(decision.raced))
            case Wait(server=call.server, at_most_s=int() | float() as within_s) if (
                0 < within_s <= _LONGEST_S
            ):
                return Wait(call.server, within_s, str(decision.why)[:_LONGEST_WHY])
        raise self._defect(
            "decide",
            f"returned {decision!r:.200}: expected Local, or Remote or Wait at {call.server} for up to "
            f"{_LONGEST_S:g} s",
        )

    def place_in_line(self, line: Line) -> Take | None:
        """The call in line that a free lane takes now, if any."""
        take = self._answer("place_in_line", line)
        match take:
            case None:
                return None
            case Take(call=int() as number, lane="drone" | "server" as lane) if 0 <= number < len(line.calls):
                is_server = lane == "server"
                held, call = line.server if is_server else line.drone, line.calls[number]
                if held is None or not held.is_free:
                    raise self._defect(
                        "place_in_line", f"took call {number}, and the {lane}'s lane is not free"
                    )
                if math.isinf(call.remote_s if is_server else call.local_s):
                    raise self._defect(
                        "place_in_line", f"took call {number}, and the {lane} cannot compute it now"
                    )
                return take
        raise self._defect(
            "place_in_line",
            f"returned {take!r:.200}, and None or the Take of one of {counted(len(line.calls), 'call')} is expected",
        )

    def where_to_wait(self, stay: Stay) -> str | None:
        """The server of the range where a resting drone waits for answers; None for where it is."""
        server = self._answer("where_to_wait", stay)
        places = [place.server for place in stay.places]
        if server not in places:
            raise self._defect(
                "where_to_wait", f"named {server!r:.100}, which is not among the places {places}"
            )
        return cast("str | None", server)

    def when_to_act(self, act: LateAct) -> int | None:
        """The number of a gap of the act, where the drone acts then; None for at once."""
        match self._answer("when_to_act", act):
            case None:
                return None
            case int() as gap if 0 <= gap < len(act.gaps):
                return gap
            case other:
                gaps = counted(len(act.gaps), "gap")
                raise self._defect(
                    "when_to_act",
                    f"returned {other!r:.200}, and None or the number of one of {gaps} is expected",
                )

    def _answer(self, method: str, about: object) -> Any:
        """The answer of the user's method, or the built-in one where there is no such method."""
        question = getattr(self._policy, method, None)
        if question is None:
            return getattr(self._otherwise, method)(about)
        try:
            return _ANSWERING.ask(lambda: question(about))
        except _NoAnswer:
            raise self._defect(method, f"did not answer within {ANSWERS_WITHIN_S:g} s") from None
        except Exception as error:
            raise self._defect(method, f"raised {worded(error)}") from error

    def _defect(self, method: str, what: str) -> PolicyDefect:
        return PolicyDefect(f"policy {self.name}: {method} {what}")


class _Answering:
    """The thread that own policies answer on. A thread that does not answer is given up, and replaced."""

    def __init__(self) -> None:
        self._questions: SimpleQueue[tuple[Callable[[], Any], Future[Any]]] | None = None
        self._thread_id = 0

    def ask(self, question: Callable[[], T]) -> T:
        """The answer; raises what the question raises, and _NoAnswer."""
        if self._questions is None:
            self._questions = SimpleQueue()
            answering = thread(partial(_answer, self._questions), name="own policy", failed=only_logged)
            answering.start()
            self._thread_id = answering.ident or 0
        answer: Future[T] = Future()
        self._questions.put((question, answer))
        try:
            answer.exception(timeout=ANSWERS_WITHIN_S)
        except TimeoutError:
            self._questions = None
            _interrupt(self._thread_id)
            raise _NoAnswer from None
        return answer.result()


def _answer(questions: SimpleQueue[tuple[Callable[[], Any], Future[Any]]]) -> None:
    with contextlib.suppress(_GivenUp):  # which may be raised at any moment
        while True:
            question, answer = questions.get()
            try:
                answer.set_result(question())
            except _GivenUp:
                raise
            except BaseException as error:  # noqa: BLE001 - it is raised where the answer is awaited
                answer.set_exception(error if isinstance(error, Exception) else RuntimeError(worded(error)))


class _NoAnswer(Exception):
    """Raised for a question whose answer is not there in time."""


class _GivenUp(BaseException):
    """Raised in the thread of a policy that does not answer, so that it stops computing."""


def _interrupt(thread_id: int) -> None:
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread_id), ctypes.py_object(_GivenUp))


_ANSWERING = _Answering()
