"""Tests that are coroutines, each in a world that a function makes with arguments of the test."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable
from typing import Any, TypeAlias

Scenario: TypeAlias = Callable[..., Awaitable[None]]
Test: TypeAlias = Callable[..., None]


def played(world: Callable[..., object] | str, *arguments: Any, **named: Any) -> Callable[[Scenario], Test]:
    """Make a coroutine function a test, which `world(scenario, *arguments, **named)` plays.

    A world that is a text is the fixture of that name. The world passes as many positional arguments as the coroutine
    function takes. Keyword-only arguments are pytest's: fixtures and parameters.
    """

    def made(scenario: Scenario) -> Test:
        parameters = inspect.signature(scenario).parameters.values()
        of_pytest = [parameter for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY]
        count = len(parameters) - len(of_pytest)

        if isinstance(world, str):
            of_pytest.append(inspect.Parameter(world, inspect.Parameter.KEYWORD_ONLY))

        def test(**given: Any) -> None:
            play = given.pop(world) if isinstance(world, str) else world
            play(lambda *things: scenario(*things[:count], **given), *arguments, **named)

        test.__name__, test.__qualname__, test.__module__ = (
            scenario.__name__,
            scenario.__name__,
            scenario.__module__,
        )
        test.__doc__ = scenario.__doc__
        test.__signature__ = inspect.Signature(of_pytest)  # type: ignore[attr-defined]  # where pytest looks
        return test

    return made
