"""Problems of a configuration that its types do not exclude: a key, and what is wrong with it and what to do."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator

from upwash.config.values import is_address, is_listening_address
from upwash.core.operation import ON_DRONE

Problem = tuple[str, str]  # the key, and what is wrong with it

_MOST_NESTED = 12
_ENDLESS = re.compile(r"server\b.*\.turn_s")  # keys whose values may be infinite
_HOST_NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?")


def impossible_values(value: object, key: str, depth: int = 0) -> Iterator[Problem]:
    """Values that no key may have: infinite (but turns), longer than 64 bits, or nested without end."""
    match value:
        case math.inf if _ENDLESS.fullmatch(key):
            pass
        case dict() | list() if depth >= _MOST_NESTED:
            yield key, "nested too deeply: no value lies that deep"
        case dict():
            for name, inner in value.items():
                yield from impossible_values(inner, f"{key}.{name}" if key else name, depth + 1)
        case list():
            for index, inner in enumerate(value):
                yield from impossible_values(inner, f"{key}[{index}]", depth + 1)
        case float() if not math.isfinite(value):
            yield key, f"expected a finite number, found {value}"
        case int() if value.bit_length() > 63:
            yield key, "expected a number that fits 64 bits"


def listed(names: Iterable[str]) -> str:
    """Names as an error message lists them."""
    return ", ".join(names) or "none"


def unknown(what: str, name: str, allowed: Iterable[str]) -> str:
    """The message that a name is not allowed, with the allowed names and the nearest of them."""
    import difflib  # only needed for errors

    choices = list(allowed)
    near = difflib.get_close_matches(name, choices, n=1)
    hint = f'did you mean "{near[0]}"? ' if near else ""
    return f'unknown {what} "{name}"; {hint}allowed: {listed(choices)}'


def below(prefix: str, problems: Iterable[Problem]) -> Iterator[Problem]:
    """The problems of a table that stands at `prefix`."""
    for key, problem in problems:
        yield f"{prefix}.{key}" if key else prefix, problem


def name_problems(key: str, names: list[str]) -> Iterator[Problem]:
    """Names of the tables [[key]] that are given twice, or that stand for the drone in results."""
    for index, name in enumerate(names):
        if name == ON_DRONE and key in ("server", "drone"):
            what = f'"{ON_DRONE}" stands for the drone itself in results: rename the {key}'
            yield f"{key}[{index}].name", what
    for index, name in repeated(names):
        yield f"{key}[{index}].name", f'a second {key} named "{name}": give each its own name'


def repeated(names: list[str]) -> list[tuple[int, str]]:
    """The names that stand earlier in the list too, each with its index."""
    first: dict[str, int] = {}
    return [(index, name) for index, name in enumerate(names) if first.setdefault(name, index) < index]


def address_problems(key: str, address: str) -> Iterator[Problem]:
    """What is wrong with the address of a daemon."""
    if not is_address(address):
        yield key, f'expected "host:port" or "unix:path", found "{address}"'


def metrics_problems(metrics: str | None, hosts: Collection[str]) -> Iterator[Problem]:
    """What is wrong with the address of the metrics, and with the names of `metrics_hosts`."""
    if metrics is not None and (metrics.startswith("unix:") or not is_listening_address(metrics)):
        yield "metrics", f'expected "host:port" such as "127.0.0.1:9100", found "{metrics}"'
    if hosts and metrics is None:
        yield "metrics_hosts", 'needs metrics, such as "0.0.0.0:9100"'
    for index, host in enumerate(hosts):
        if not _HOST_NAME.fullmatch(host):
            problem = f'expected a name such as "host.docker.internal", without a port, found "{host}"'
            yield f"metrics_hosts[{index}]", problem
