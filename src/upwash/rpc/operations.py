"""Which methods of a class are the operations of its service; attributes that only look like methods are refused."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, get_origin

from upwash.errors import DeclarationError

_HIDE = "or begin its name with _ where only the service itself uses it"


def operations_of(cls: type) -> dict[str, Callable[..., Any]]:
    """The public methods of a class, inherited ones too, by name.

    Raises DeclarationError if there is none, and for public attributes that a stub would lack: a property, a static
    method, another callable object, `__call__`.
    """
    if any("__call__" in vars(base) for base in cls.__mro__):
        raise DeclarationError(f"service {cls.__name__}: give __call__ a name without underscores")
    found = {name: inspect.getattr_static(cls, name) for name in dir(cls) if not name.startswith("_")}
    methods = {name: attribute for name, attribute in found.items() if not _is_data(attribute)}
    for name, method in methods.items():
        if why := _why_not(name, method):
            raise DeclarationError(f"service {cls.__name__}, method {name}: {why}")
    if not methods:
        raise DeclarationError(f"service {cls.__name__} has no public method to call")
    return methods


def _is_data(attribute: object) -> bool:
    """Whether the attribute is data: a constant, a class or type hint, or a member of `__slots__`."""
    if isinstance(attribute, type) or get_origin(attribute) or inspect.ismemberdescriptor(attribute):
        return True
    return not callable(attribute) and not hasattr(type(attribute), "__get__")


def _why_not(name: str, attribute: Any) -> str:
    """Why an attribute cannot be an operation, with the remedy; "" if it can."""
    if not inspect.isfunction(attribute):
        return f"declare it as a plain method, with self, not as a {type(attribute).__name__}, {_HIDE}"
    if inspect.iscoroutinefunction(attribute):
        return "declare it as a plain blocking method, not async"
    if inspect.isgeneratorfunction(attribute) or inspect.isasyncgenfunction(attribute):
        return "it yields: return a list instead"
    if attribute.__name__ != name:
        return (
            f"it is the function {attribute.__name__}: write it as `def {name}(self, ...)`, with functools.wraps in "
            f"each of its decorators, {_HIDE}"
        )
    parameters = inspect.signature(attribute).parameters.values()
    first = next(iter(parameters), None)
    if first is None or first.kind not in (first.POSITIONAL_ONLY, first.POSITIONAL_OR_KEYWORD):
        return "its first parameter must be self"
    if hasattr(attribute, "__wrapped__"):
        given = dict.fromkeys([parameter.name for parameter in parameters if parameter is not first])
        try:
            inspect.signature(attribute, follow_wrapped=False).bind(None, **given)
        except TypeError as error:
            return f"its decorator does not take its parameters by their names ({error}): have it pass on **kwargs"
    return ""
