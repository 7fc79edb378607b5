"""Settings of a service: the parameters of its constructor, which a configuration may give.

    class Detector:
        def __init__(self, *, threads: int = 2, labels: Path | None = None) -> None: ...

Settings are checked by the type hints, and travel as the plain values of JSON. A relative path counts from the
configuration's file, and is sent as an absolute path.

A parameter whose type is a service stands for another service in the same instance, made from a table of its own
settings, so its calls never leave that computer:

    class Inspection:
        def __init__(self, detector: Detector) -> None: ...               # [service.settings.detector]
"""

from __future__ import annotations

import inspect
import sys
import traceback
import typing
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

import msgspec
from msgspec import UNSET, UnsetType

from upwash.errors import DeclarationError, UsageError
from upwash.rpc.wire import require_plain
from upwash.support.loading import import_remedy
from upwash.support.text import worded

T = TypeVar("T")
PlainSettings = Mapping[str, object]
Used = Callable[[Any], type[msgspec.Struct] | None]  # the settings of a type hint that is a service
_MAKES = "__upwash_makes__"  # on settings: the class that is made of them


def describe_settings(cls: type, used: Used = lambda _: None) -> type[msgspec.Struct]:
    """A struct class with a field for each setting of `cls`; raises DeclarationError if one cannot be configured."""
    fields: list[Any] = []
    for parameter, hint in _parameters(cls):
        where = f"service {cls.__name__}: __init__'s parameter {parameter.name!r}"
        if hint is None:
            raise DeclarationError(f"{where} has no type hint, so a configuration cannot give it")
        if parameter.kind is parameter.POSITIONAL_ONLY:
            raise DeclarationError(f"{where} must be passable by its name")
        if (settings := used(hint)) is not None:
            hint = settings  # noqa: PLW2901 - what a configuration gives for it
        else:
            require_plain(hint, where, is_meant=lambda cls: cls is Path)
        if settings is not None and parameter.default is parameter.empty and not required_settings(settings):
            fields.append((parameter.name, hint, msgspec.field(default_factory=settings)))
        elif parameter.default is parameter.empty:
            fields.append((parameter.name, hint))
        else:
            fields.append((parameter.name, hint | UnsetType, UNSET))
    return msgspec.defstruct(
        f"{cls.__name__}_settings",
        fields,
        kw_only=True,
        forbid_unknown_fields=True,
        namespace={_MAKES: cls},
    )


def required_settings(kind: type[msgspec.Struct]) -> list[str]:
    """The names of the settings that have no default."""
    return [field.name for field in msgspec.structs.fields(kind) if field.required]


def plain(settings: msgspec.Struct) -> dict[str, object]:
    """The settings as the plain values that are sent."""
    return cast(dict[str, object], msgspec.to_builtins(settings, enc_hook=str, str_keys=True))


def with_files(
    kind: type[msgspec.Struct], settings: PlainSettings, carried: Callable[[Path], Path]
) -> dict[str, object]:
    """The settings with each path replaced by `carried(path)`."""
    checked = msgspec.convert(settings, kind, dec_hook=_path, str_keys=True)
    found = msgspec.to_builtins(checked, enc_hook=lambda path: str(carried(path)), str_keys=True)
    return cast(dict[str, object], found)


def construct(cls: type[T], kind: type[msgspec.Struct], settings: PlainSettings) -> T:
    """An object of the class with these settings; raises UsageError if they do not fit, or the constructor fails."""
    try:
        checked = msgspec.convert(settings, kind, dec_hook=_path, str_keys=True)
    except msgspec.ValidationError as error:
        raise UsageError(f"{cls.__name__} cannot be made with its settings: {error}") from error
    return _made(cls, checked)


def _made(cls: type[T], settings: msgspec.Struct) -> T:
    given = {}
    for name in settings.__struct_fields__:
        value = getattr(settings, name)
        used = vars(type(value)).get(_MAKES)
        if value is not UNSET:
            given[name] = value if used is None else _made(used, value)
    try:
        return cls(**given)
    except Exception as error:
        raise UsageError(
            f"{cls.__name__} cannot be made: {worded(error)} ({_place(error, cls)})"
            f"{import_remedy(error, _file_of(cls))}"
        ) from error


def _place(error: Exception, cls: type) -> str:
    """The innermost line of the error's trace in the class's own file, or in any file."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename == _file_of(cls)]
    last = (own or frames)[-1]
    return f"{last.filename}, line {last.lineno}"


def _file_of(cls: type) -> str:
    return getattr(sys.modules.get(cls.__module__), "__file__", None) or ""


def _parameters(cls: type) -> Iterator[tuple[inspect.Parameter, Any]]:
    """The parameters of the constructor that have a name, each with its type hint or None."""
    constructor = inspect.getattr_static(cls, "__init__")
    if constructor is object.__init__:
        return
    try:
        hints = typing.get_type_hints(constructor, include_extras=True)
    except NameError as error:
        raise DeclarationError(
            f"service {cls.__name__}: a type hint of __init__ cannot be resolved: {error}"
        ) from error
    for parameter in inspect.signature(cls).parameters.values():
        if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            yield parameter, hints.get(parameter.name)


def _path(kind: type, value: object) -> Path:
    if kind is not Path or not isinstance(value, str):
        raise ValueError(f"expected a path, found {value!r}")
    return Path(value)
