"""PROGRAM: a policy of the user's own, asked by `own_policy` over a line, in a process of its own.

All code of the user runs here, the text of what it returns or raises too. Answers are plain values of the few types
that a policy may return.
"""

from __future__ import annotations

import inspect
import sys
import traceback
from collections.abc import Mapping, Sequence
from types import NoneType
from typing import Any

import msgspec
from msgspec import Struct
from msgspec.structs import asdict

from upwash.core.geo import Circle, Measured
from upwash.core.planning.acts import LateAct
from upwash.core.planning.backlog import Stay
from upwash.core.planning.earliest import Line, Take
from upwash.core.policies.policy import CallInputs, Choice, Decision, Local, Option, Remote, Situation, Wait
from upwash.errors import UsageError
from upwash.support.apart import serve
from upwash.support.loading import load
from upwash.support.text import message_of, worded

_FARTHEST_HORIZON = 1000  # calls
_LONGEST_WHY = 500  # characters
_LONGEST_TEXT = 10_000
_Facts = dict[str, Any]


class Make(Struct, frozen=True, tag=True):
    """Make the policy of the class; modules are looked for in the folders of `path` too."""

    program: str
    settings: Mapping[str, str | int | float | bool]
    path: Sequence[str]


class Ask(Struct, frozen=True, tag=True):
    """Call the method of the policy with the encoded value."""

    method: str
    about: msgspec.Raw


class PolicyMade(Struct, frozen=True, tag=True):
    """The methods that the policy has, of those that it may have, and its horizon."""

    methods: Sequence[str]
    horizon: int


class Returned(Struct, frozen=True, tag=True):
    """The value that a method returned: its text, its type if that is one of KINDS, or "", and its encoding."""

    shown: str
    kind: str = ""
    value: msgspec.Raw = msgspec.Raw()


class PolicyFailed(Struct, frozen=True, tag=True):
    """What the user's code raised, or why there is no policy; `trace` is for the log."""

    why: str
    trace: str = ""


Question = Make | Ask
Answer = PolicyMade | Returned | PolicyFailed


KINDS: Mapping[str, type] = {
    kind.__name__: kind for kind in (NoneType, str, int, Choice, Local, Remote, Wait, Take)
}


class _SentOption(Option, frozen=True):
    area: _Facts = msgspec.field(default_factory=dict)  # type: ignore[assignment]


class _SentSituation(Situation, frozen=True):
    options: list[_SentOption]
    under_way: _Facts | None = None  # type: ignore[assignment]


_ABOUT: Mapping[str, msgspec.msgpack.Decoder[Any]] = {
    method: msgspec.msgpack.Decoder(kind)
    for method, kind in {
        "choose": _SentSituation,
        "decide": CallInputs,
        "place_in_line": Line,
        "where_to_wait": Stay,
        "when_to_act": LateAct,
    }.items()
}
_QUESTIONS = msgspec.msgpack.Decoder(Question)


def _situation(sent: _SentSituation) -> Situation:
    facts = {name: getattr(sent, name) for name in Situation.__struct_fields__}
    facts["options"] = [
        Option(**asdict(each) | {"area": msgspec.convert(each.area, Circle) if each.area else Measured()})
        for each in sent.options
    ]
    facts["under_way"] = None if sent.under_way is None else _decision(sent.under_way)
    return Situation(**facts)


def _decision(facts: _Facts) -> Decision:
    if "deadline_s" in facts:
        return msgspec.convert(facts, Remote)
    if "at_most_s" in facts:
        return msgspec.convert(facts, Wait)
    return msgspec.convert(facts, Local)


def _made(make: Make) -> tuple[Any, int]:
    sys.path.extend(folder for folder in make.path if folder not in sys.path)
    made, name = load(make.program), make.program
    if not callable(made):
        raise UsageError(f"policy {name}: expected a class, and this is {made!r}: name the class")
    try:
        policy = made(**make.settings)
    except Exception as error:
        known = inspect.signature(made) if inspect.isclass(made) else "()"
        raise UsageError(
            f"policy {name} cannot be made: {worded(error)}; it takes {known}, and "
            f"policy.settings has {', '.join(make.settings) or 'nothing'}"
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
    return policy, int(horizon)


class _Program:
    def __init__(self) -> None:
        self._policy: Any = None

    def answer(self, question: bytes) -> bytes:
        try:
            return _encoded(self._told(_QUESTIONS.decode(question)))
        except BaseException as error:  # noqa: BLE001 - whatever the code of the user raises
            why = message_of(error) if isinstance(error, UsageError) else worded(error)
            trace = "".join(traceback.format_exception(error))
            return _encoded(PolicyFailed(why[:_LONGEST_TEXT], trace[-_LONGEST_TEXT:]))

    def _told(self, question: Question) -> Answer:
        if isinstance(question, Make):
            self._policy = None
            self._policy, horizon = _made(question)
            return PolicyMade(
                [name for name in _ABOUT if getattr(self._policy, name, None) is not None], horizon
            )
        about = _ABOUT[question.method].decode(question.about)
        if isinstance(about, _SentSituation):
            about = _situation(about)
        return _returned(getattr(self._policy, question.method)(about))


def _returned(value: Any) -> Returned:
    shown = f"{value!r:.200}"
    kind = next((name for name, kind in KINDS.items() if isinstance(value, kind)), "")
    match value:
        case Choice():
            value = Choice(value.server, _why(value), value.coming)
        case Local():
            value = Local(_why(value))
        case Remote():
            value = Remote(value.server, value.deadline_s, _why(value), bool(value.raced))
        case Wait():
            value = Wait(value.server, value.at_most_s, _why(value))
    try:
        return Returned(shown, kind, msgspec.Raw(_encoded(value if kind else None)))
    except (TypeError, ValueError, OverflowError):
        return Returned(shown)


def _why(value: Choice | Decision) -> str:
    return str(value.why)[:_LONGEST_WHY]


def _plain(value: Any) -> Any:
    """The number or text that a value of another type is, such as one of numpy."""
    for kind in (int, float, str):
        if isinstance(value, kind):
            return kind(value)
    raise NotImplementedError


_encoded = msgspec.msgpack.Encoder(enc_hook=_plain).encode


if __name__ == "__main__":
    serve(_Program().answer)
