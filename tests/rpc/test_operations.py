"""Which methods of a class can be called from afar, and what is refused rather than left out."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, Literal

import pytest

from upwash.errors import DeclarationError
from upwash.rpc.service import once, service, spec_of

Mode = Literal["light", "heavy"]


def look(self: Any, photo: bytes = b"", mode: int = 1) -> int:
    """What the attributes below are made of."""
    return len(photo) * mode


def logged(method: Callable[..., Any], *, names: bool = True, keeps: bool = True) -> Callable[..., Any]:
    def by_name(self: object, *args: Any, **kwargs: Any) -> Any:
        return method(self, *args, **kwargs)

    def by_place(self: object, *args: Any) -> Any:
        return method(self, *args)

    wrapper = by_name if names else by_place
    return functools.wraps(method)(wrapper) if keeps else wrapper


async def looks_later(self: object) -> None:
    """Nothing."""


def yields(self: object) -> list[int]:  # type: ignore[misc]
    yield 1


async def yields_later(self: object) -> list[int]:  # type: ignore[misc]
    yield 1


def without_self() -> int:
    return 1


def with_any_self(*photos: bytes) -> int:
    return len(photos)


def good(self: object) -> None:
    """Keeps the class from having no method at all."""


class Callable1:
    def __call__(self, photo: bytes) -> int:
        return 1


def camera_with(**attributes: object) -> type:
    return type("Camera", (), {"good": good, **attributes})


@pytest.mark.parametrize(
    ("attributes", "said"),
    [
        (
            {"look": staticmethod(look)},
            "method look: declare it as a plain method, with self, not as a staticmethod",
        ),
        ({"look": classmethod(look)}, "method look: declare it .*, not as a classmethod"),
        ({"look": property(look)}, "method look: declare it .*, not as a property, or begin its name with _"),
        ({"look": functools.cached_property(look)}, "method look: declare it .*, not as a cached_property"),
        (
            {"look": functools.partialmethod(look, mode=2)},
            "method look: declare it .*, not as a partialmethod",
        ),
        ({"look": functools.lru_cache(look)}, "method look: declare it .*, not as a _lru_cache_wrapper"),
        ({"look": functools.singledispatchmethod(look)}, "method look: .*, not as a singledispatchmethod"),
        ({"look": len}, "method look: declare it .*, not as a builtin_function"),
        ({"look": Callable1()}, "method look: declare it .*, not as a Callable1"),
        ({"look": lambda self, photo: 1}, "method look: it is the function <lambda>: write it as `def look"),
        ({"look": logged(look, keeps=False)}, "method look: it is the function by_name: .* functools.wraps"),
        ({"view": look}, "method view: it is the function look: write it as `def view"),
        (
            {"look": logged(look, names=False)},
            "method look: its decorator does not take its parameters by their names",
        ),
        ({"looks_later": looks_later}, "method looks_later: declare it as a plain blocking method"),
        ({"yields": yields}, "method yields: it yields: return a list instead"),
        ({"yields_later": yields_later}, "method yields_later: it yields: return a list instead"),
        ({"without_self": without_self}, "method without_self: its first parameter must be self"),
        ({"with_any_self": with_any_self}, "method with_any_self: its first parameter must be self"),
        ({"__call__": look}, "give __call__ a name"),
    ],
)
def test_what_callers_would_miss_is_refused_also_where_it_is_inherited(
    attributes: dict[str, object], said: str
) -> None:
    camera = camera_with(**attributes)
    for declared in (camera, type("Camera", (camera,), {})):
        with pytest.raises(DeclarationError, match=said):
            service(declared)


def test_constants_classes_and_slots_are_no_operations() -> None:
    class Camera:
        __slots__ = ("opened",)
        LABELS = ("person",)
        model: str | None = None
        mode = Mode
        numbers = math

        def look(self) -> int:
            return 1

    assert spec_of(service(Camera)).methods.keys() == {"look"}


def test_a_method_whose_decorator_uses_wraps_is_called_through_it() -> None:
    declared = camera_with(look=logged(look))
    method = spec_of(service(declared)).methods["look"]
    assert (
        method.result(method.decode(method.perform(declared(), method.encode((b"12",), {"mode": 2})[1])[1]))
        == 4
    )


@pytest.mark.parametrize(
    ("hint", "default"),
    [
        (int, None),
        (int, "1"),
        (bytes, len),
        (list[int], ("a",)),
        (Mode, "light!"),
        (str, b"text"),
        (float, 1j),
    ],
    ids=str,
)
def test_a_default_that_cannot_be_sent_is_refused(hint: object, default: object) -> None:
    def look(self: object, value: object = default) -> None:
        """Nothing."""

    look.__annotations__["value"] = hint
    with pytest.raises(
        DeclarationError, match=r"Camera, method look: parameter 'value': its default .* cannot be"
    ):
        service(camera_with(look=look))


@pytest.mark.parametrize(
    ("hint", "default"), [(float, 1), (list[int], (1, 2)), (Mode, "light"), (int | None, None)], ids=str
)
def test_a_default_that_arrives_as_its_type_hint_says_is_taken(hint: object, default: object) -> None:
    def look(self: object, value: object = default) -> None:
        """Nothing."""

    look.__annotations__["value"] = hint
    assert service(camera_with(look=look))


def test_a_method_that_overrides_one_of_once_runs_once_too() -> None:
    class Winch:
        @once
        def drop(self) -> None:
            """Nothing."""

    class Better(Winch):
        def drop(self) -> None:
            """Nothing."""

    assert spec_of(service(Better)).methods["drop"].once


@pytest.mark.parametrize("kind", [property, staticmethod, classmethod, functools.lru_cache])
def test_once_above_another_decorator_is_refused(kind: Callable[..., Any]) -> None:
    with pytest.raises(DeclarationError, match="@once: write it directly above the method"):
        once(kind(look))
