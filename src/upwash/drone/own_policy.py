"""A policy of the user's own: a class in a file or module, made before take-off in a process of its own.

The rest of the drone relies on a policy's answers, and waits for them. So each question has a limit of time,
and each answer is checked. A policy that raises, is silent, or answers what cannot be is a defect. Offloading
ends with its reason, and the mission goes on with every call on the drone. Where the class has no method for a
question, the built-in policy answers. See docs/decisions/own-policies-apart.md.
"""

from __future__ import annotations

import atexit
import math
import sys
import time
import weakref
from pathlib import Path
from typing import Any, cast

import msgspec

from upwash.config.drone import PolicyConfig
from upwash.core.planning.acts import LateAct
from upwash.core.planning.backlog import Stay
from upwash.core.planning.earliest import Line, Take
from upwash.core.policies.names import is_own, make_policy
from upwash.core.policies.policy import (
    CallInputs,
    Choice,
    Decision,
    Local,
    Policy,
    PolicyDefect,
    Remote,
    Situation,
    Wait,
)
from upwash.drone.policy_program import KINDS, Answer, Ask, Make, PolicyFailed, PolicyMade, Returned
from upwash.errors import UsageError
from upwash.support.apart import Apart, Crashed, TookTooLong
from upwash.support.background import now_s
from upwash.support.text import counted

ANSWERS_WITHIN_S = 2.0
_SHARE = 0.1  # of the time, that answers may take in the long run
_MADE_WITHIN_S = 60.0
_LONGEST_S = 3600.0
_PROGRAM = "upwash.drone.policy_program"
_ANSWERS: msgspec.msgpack.Decoder[Answer] = msgspec.msgpack.Decoder(Answer)
_encoded = msgspec.msgpack.Encoder().encode


class _Raised(Exception):
    """What the code of the user raised, as its process tells it."""


def policy_of(settings: PolicyConfig) -> Policy:
    """The configured policy; raises UsageError if an own one cannot be loaded."""
    built_in = make_policy(
        "location-aware" if is_own(settings.name) else settings.name,
        gain_switch=settings.gain_switch,
        gain_wait=settings.gain_wait,
        patient_first_call=settings.patient_first_call,
    )
    return OwnPolicy(settings, otherwise=built_in) if is_own(settings.name) else built_in


class OwnPolicy:
    """The user's policy, kept in bounds; `otherwise` answers where it has no method for a question."""

    def __init__(self, settings: PolicyConfig, *, otherwise: Policy) -> None:
        self.name = settings.label
        self._otherwise = otherwise
        self._process = _IDLE.pop() if _IDLE else Apart(_PROGRAM)
        self._put_back = weakref.finalize(self, _put_back, self._process)
        made = self._made(Make(_anywhere(settings.name), settings.settings, sys.path))
        self._methods, self.horizon = frozenset(made.methods), made.horizon
        self._left_s, self._asked_s = ANSWERS_WITHIN_S, -math.inf
        self._ended: PolicyDefect | None = None  # with its process

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
        if choice.server not in (None, *servers):
            raise self._defect(
                "choose", f"named {choice.server!r:.100}, which is not among the servers {servers}"
            )
        return choice

    def decide(self, call: CallInputs) -> Decision:
        """Where the call runs: Wait, Remote or Local."""
        match decision := self._answer("decide", call):
            case Local():
                return decision
            case Remote(server=call.server, deadline_s=within_s) if 0 < within_s <= _LONGEST_S:
                return decision
            case Wait(server=call.server, at_most_s=within_s) if 0 < within_s <= _LONGEST_S:
                return decision
        expected = f"expected Local, or Remote or Wait at {call.server} for up to {_LONGEST_S:g} s"
        raise self._defect("decide", f"returned {decision!r:.200}: {expected}")

    def place_in_line(self, line: Line) -> Take | None:
        """The call in line that a free lane takes now, if any."""
        take = self._answer("place_in_line", line)
        calls = counted(len(line.calls), "call")
        why = f"returned {take!r:.200}, and None or the Take of one of {calls} is expected"
        match take:
            case None:
                return None
            case Take(call=int() as number, lane="drone" | "server" as lane) if 0 <= number < len(line.calls):
                is_server = lane == "server"
                held, call = line.server if is_server else line.drone, line.calls[number]
                if held is None or not held.is_free:
                    why = f"took call {number}, and the {lane}'s lane is not free"
                elif math.isinf(call.remote_s if is_server else call.local_s):
                    why = f"took call {number}, and the {lane} cannot compute it now"
                else:
                    return take
        raise self._defect("place_in_line", why)

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
        match answer := self._answer("when_to_act", act):
            case None:
                return None
            case int() as gap if 0 <= gap < len(act.gaps):
                return gap
        expected = f"None or the number of one of {counted(len(act.gaps), 'gap')} is expected"
        raise self._defect("when_to_act", f"returned {answer!r:.200}, and {expected}")

    def end(self) -> None:
        """Give up the process of the policy, which is not asked any more."""
        self._ended = self._ended or PolicyDefect(f"policy {self.name} was asked after its end")
        self._put_back()

    def _made(self, make: Make) -> PolicyMade:
        why = f"policy {self.name} cannot be made"
        try:
            made = self._told(make, within_s=_MADE_WITHIN_S)
        except TookTooLong:
            raise UsageError(f"policy {self.name} was not made within {_MADE_WITHIN_S:g} s") from None
        except Crashed as error:
            raise UsageError(f"{why}: it {error}") from error
        except _Raised as error:
            raise UsageError(str(error)) from error.__cause__
        if not isinstance(made, PolicyMade):
            raise UsageError(why)
        return made

    def _answer(self, method: str, about: object) -> Any:
        if method not in self._methods:
            return getattr(self._otherwise, method)(about)
        if self._ended is not None:
            raise self._ended
        self._left_s = self._left_now_s()
        began_s = time.monotonic()
        try:
            question = Ask(method, msgspec.Raw(_encoded(about)))
            return _value(self._told(question, within_s=self._left_s))
        except (TookTooLong, Crashed) as error:
            what = str(error)
            if isinstance(error, TookTooLong):
                slow = self._left_s < ANSWERS_WITHIN_S
                share = f", as answers may take {_SHARE:.0%} of the time" if slow else ""
                what = f"did not answer within {self._left_s:.2g} s{share}"
            self._ended = self._defect(method, what)
            raise self._ended from None
        except _Raised as error:
            raise self._defect(method, f"raised {error}") from error.__cause__
        finally:
            self._left_s -= time.monotonic() - began_s

    def _left_now_s(self) -> float:
        """The seconds that an answer may take now: the drone waits for it, and does nothing else meanwhile."""
        try:
            asked_s = now_s()
        except RuntimeError:  # no drone flies by the answer
            return ANSWERS_WITHIN_S
        earned_s = _SHARE * (asked_s - self._asked_s)
        self._asked_s = asked_s
        return max(0.0, min(ANSWERS_WITHIN_S, self._left_s + earned_s))

    def _told(self, question: Make | Ask, *, within_s: float) -> Answer:
        told = _ANSWERS.decode(self._process.ask(_encoded(question), within_s=within_s))
        if isinstance(told, PolicyFailed):
            raise _Raised(told.why) from _Raised(f"in the process of the policy:\n{told.trace}")
        return told

    def _defect(self, method: str, what: str) -> PolicyDefect:
        return PolicyDefect(f"policy {self.name}: {method} {what}")


def _value(told: Answer) -> object:
    """What the policy returned; of other types, or with other fields, the text of it alone."""
    assert isinstance(told, Returned)  # noqa: S101 - a policy that was made is only asked
    try:
        return msgspec.msgpack.decode(told.value, type=KINDS[told.kind])
    except (KeyError, msgspec.DecodeError):
        return _Other(told.shown)


class _Other:
    def __init__(self, shown: str) -> None:
        self._shown = shown

    def __repr__(self) -> str:
        return self._shown


def _anywhere(program: str) -> str:
    place, colon, name = program.rpartition(":")
    return f"{Path(place).absolute()}{colon}{name}" if place.endswith(".py") else program


_IDLE: list[Apart] = []  # for the next policies, which need not wait for the start of a process


def _put_back(process: Apart) -> None:
    if process.runs:
        _IDLE.append(process)


@atexit.register
def _end_idle() -> None:
    while _IDLE:
        _IDLE.pop().end()
