"""Writes docs/api.md from the docstrings and signatures of all that is public: `python site/api.py`.

A signature that names a class of upwash's that is not public itself is an error.
"""

from __future__ import annotations

import enum
import inspect
import sys
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import upwash
import upwash.plug_ins
import upwash.policies
import upwash.services

PAGE = Path(__file__).parents[1] / "docs" / "api.md"
PACKAGES = (upwash, upwash.services, upwash.policies, upwash.plug_ins)  # whose `__all__` is what is public

_HEAD = """\
# The Python interface

<!-- written by site/api.py from the docstrings: change those, then run `make docs` -->

Missions, services, policies, plug-ins and notebooks import these names of the packages `upwash`, `upwash.services`,
`upwash.policies` and `upwash.plug_ins`, and [`upwash.environment.UpwashEnv`](own-policy.md#training-a-policy). All
other modules are private and may change at any time. A configuration names the bundled mission `survey` and service
`detector`.

A number's name ends in its unit: `_s` for seconds, `_m` for metres. Positions count from the mission's home. Every
error is an `UpwashError`.
"""
_SECTIONS = {
    "In a mission": (
        *("Drone", "Pending", "Demand", "Vehicle", "Photographer", "Payload", "User"),
        *("Waypoint", "Via", "Position"),
        *("Telemetry", "EarthPosition", "GeoPosition", "Velocity", "Attitude", "GpsFix"),
        *("PhotoPose", "FoundObject", "SecondLook", "Place", "Unplaced"),
    ),
    "In a service": ("service", "once"),
    "In a notebook": (
        *("simulate", "Simulation", "simulate_fleet", "FleetSimulation", "compare", "ComparedPolicy"),
        "draw_world",
        *("read_log", "read_result", "Event", "Events", "RunResult", "CallResult", "Totals", "EnergyTotals"),
        *("Bound", "FleetBound"),
    ),
}
_GIVEN = (
    "Drone",
    "Pending",
    "Demand",
    "Vehicle",
    "Photographer",
    "PhotoPose",
    "FoundObject",
    "SecondLook",
    "Place",
    "Unplaced",
    "Payload",
    "User",
    "Event",
    "Events",
)  # users get these, and make none
_LONGEST_LINE = 100
_ALL_OTHERS = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}


def page() -> str:
    """The page as it should be."""
    public = {name: getattr(upwash, name) for name in upwash.__all__}
    errors = {name: value for name, value in public.items() if _is_class(value, Exception)}
    listed = [*errors, *(name for names in _SECTIONS.values() for name in names)]
    if sorted(listed) != sorted(public):
        raise SystemExit(f"public, and in no section of site/api.py or in two: {set(public) ^ set(listed)}")
    parts = [_HEAD]
    for title, names in _SECTIONS.items():
        parts.append(f"## {title}\n")
        parts += [_described(name, public[name]) for name in names]
    parts += ["## Errors\n", "\n".join(_tree(errors, upwash.UpwashError)) + "\n"]
    parts += ["## upwash.services\n", f"{inspect.getdoc(upwash.services)}\n"]
    parts += [_described(name, getattr(upwash.services, name)) for name in upwash.services.__all__]
    parts += ["## upwash.policies\n", f"{inspect.getdoc(upwash.policies)}\n"]
    own = [name for name in upwash.policies.__all__ if name not in upwash.__all__]
    parts += [_described(name, getattr(upwash.policies, name)) for name in own]
    parts += ["## upwash.plug_ins\n", f"{inspect.getdoc(upwash.plug_ins)}\n"]
    parts += [_described(name, getattr(upwash.plug_ins, name)) for name in upwash.plug_ins.__all__]
    return "\n".join(parts)


def _described(name: str, value: object) -> str:
    if inspect.isclass(value):
        code, prose = _class_head(name, value), inspect.getdoc(value)
        members = "".join(f"\n{_member(value, member)}\n" for member in _members(value))
    elif inspect.isfunction(value):
        variants = typing.get_overloads(value) or [value]
        code, prose, members = (
            "\n".join(_function(name, variant) for variant in variants),
            inspect.getdoc(value),
            "",
        )
    else:
        code, prose, members = f"{name} = {_written(value)}", "", ""
    text = f"### {name}\n\n```python\n{code}\n```\n"
    return text + (f"\n{prose}\n" if prose else "") + members


def _class_head(name: str, cls: type) -> str:
    """The class with what is stored in it, and its constructor where that says more."""
    bases = [_written(base) for base in cls.__bases__ if base.__module__.startswith("upwash")]
    bases += [base.__name__ for base in cls.__bases__ if issubclass(base, Exception) and not bases]
    head = f"class {name}({', '.join(bases)}):" if bases else f"class {name}:"
    hints = typing.get_type_hints(cls)
    own = [each for each in vars(cls).get("__annotations__", {}) if not each.startswith("_")]
    defaults = inspect.signature(cls).parameters if own and name not in _GIVEN else {}
    lines = [f"    {each}: {_written(hints[each])}{_default(defaults.get(each))}" for each in own]
    if name not in _GIVEN and not own and "__init__" in vars(cls) and typing.Protocol not in cls.__bases__:
        lines.append("    " + _function("__init__", vars(cls)["__init__"]).replace("\n", "\n    "))
    return "\n".join([head, *lines]) if lines else f"{head} ..."


def _members(cls: type) -> Iterator[str]:
    """The public methods and properties that the class itself defines."""
    for name, member in vars(cls).items():
        if not name.startswith("_") and (inspect.isfunction(member) or isinstance(member, property)):
            yield name


def _member(cls: type, name: str) -> str:
    member = vars(cls)[name]
    if isinstance(member, property):
        assert member.fget is not None  # noqa: S101 - it can be read
        returns = _written(typing.get_type_hints(member.fget)["return"])
        text = f"`{name}: {returns}`"
    else:
        text = f"`{_signature(name, member, longest=sys.maxsize)}`"
    first, *others = (inspect.getdoc(member) or "").split("\n\n")
    return "\n\n".join([f"- {text}: {first}".replace("\n", "\n  "), *others]).replace("\n\n", "\n\n  ")


def _function(name: str, function: Callable[..., object]) -> str:
    return f"def {_signature(name, function)}: ..."


def _signature(name: str, function: Callable[..., object], longest: int = _LONGEST_LINE) -> str:
    """On one line, or where that is too long on one for each parameter."""
    hints = typing.get_type_hints(function)
    parts = ["self"] if name == "__init__" else []
    kind = None
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name == "self":
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and kind is not parameter.KEYWORD_ONLY:
            parts.append("*")
        if kind is parameter.POSITIONAL_ONLY and parameter.kind is not kind:
            parts.append("/")
        kind = parameter.kind
        if kind in _ALL_OTHERS:  # of another function
            parts.append(f"{_ALL_OTHERS[kind]}{parameter.name}")
            continue
        parts.append(f"{parameter.name}: {_written(hints[parameter.name])}{_default(parameter)}")
    parts += ["/"] if kind is inspect.Parameter.POSITIONAL_ONLY else []
    returns = "" if name == "__init__" else f" -> {_written(hints['return'])}"
    line = f"{name}({', '.join(parts)}){returns}"
    if len(line) <= longest:
        return line
    return f"{name}(\n" + "".join(f"    {part},\n" for part in parts) + f"){returns}"


def _default(parameter: inspect.Parameter | None) -> str:
    if parameter is None or parameter.default is parameter.empty:
        return ""
    value = parameter.default
    plain = value is None or (
        isinstance(value, (str, int, float, tuple)) and not isinstance(value, enum.Enum)
    )
    return f" = {parameter.default!r}".replace("'", '"') if plain else " = ..."


def _written(hint: object) -> str:
    """A type as source text, the same on all Pythons; raises SystemExit for a class that is not public."""
    arguments = typing.get_args(hint)
    match typing.get_origin(hint):
        case None:
            return _name(hint)
        case typing.Literal:
            return f"Literal[{', '.join(_quoted(argument) for argument in arguments)}]"
        case typing.Union | types.UnionType:
            return " | ".join(_written(argument) for argument in arguments)
        case origin:
            return f"{_name(origin)}[{', '.join(_argument(argument) for argument in arguments)}]"


def _argument(hint: object) -> str:
    return f"[{', '.join(_written(each) for each in hint)}]" if isinstance(hint, list) else _written(hint)


def _quoted(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _name(hint: object) -> str:
    if hint is type(None):
        return "None"
    if hint is ...:
        return "..."
    name = str(getattr(hint, "__name__", hint))
    is_ours = isinstance(hint, type) and hint.__module__.startswith("upwash")
    if is_ours and not any(name in package.__all__ for package in PACKAGES):
        raise SystemExit(f"a public signature names {name}, which is private")
    return name


def _tree(errors: Mapping[str, type], root: type, depth: int = 0) -> Iterator[str]:
    arguments = ""
    if "__init__" in vars(root):
        arguments = f"({', '.join(list(inspect.signature(root).parameters))})"
    text = (inspect.getdoc(root) or "").replace("\n\n", " ").replace("\n", " ")
    yield f"{'    ' * depth}- `{root.__name__}{arguments}`: {text}"
    for error in errors.values():
        if error.__base__ is root:
            yield from _tree(errors, error, depth + 1)


def _is_class(value: object, base: type) -> bool:
    return inspect.isclass(value) and issubclass(value, base)


if __name__ == "__main__":
    PAGE.write_text(page())
