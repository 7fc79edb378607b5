"""What is wrong with a configuration: keys, each with what is wrong there and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from upwash.config.values import is_address
from upwash.errors import ConfigError

Document = dict[str, Any]
Problem = tuple[str, str]  # the key, and what is wrong with it


def refuse_first(file: Path, problems: Iterable[Problem]) -> None:
    """Raises ConfigError for the first of the problems, if there is one."""
    for key, problem in problems:
        raise ConfigError(str(file), key, problem)


def listed(names: Iterable[str]) -> str:
    """Names as an error message lists them."""
    return ", ".join(names) or "none"


def unknown(what: str, name: str, allowed: Iterable[str]) -> str:
    """Says that a name is not one of those allowed, and which it may have been meant to be."""
    import difflib  # only needed once something is wrong

    choices = list(allowed)
    near = difflib.get_close_matches(name, choices, n=1)
    hint = f'did you mean "{near[0]}"? ' if near else ""
    return f'unknown {what} "{name}"; {hint}allowed: {listed(choices)}'


def metrics_problems(metrics: str | None) -> Iterator[Problem]:
    """What is wrong with the address that metrics are to be offered at."""
    if metrics is not None and (metrics.startswith("unix:") or not is_address(metrics)):
        yield "metrics", f'expected "host:port" such as "127.0.0.1:9100", found "{metrics}"'
