"""What is wrong with a configuration: keys, each with what is wrong there and what to do about it."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

from upwash.config.values import is_listening_address
from upwash.errors import ConfigError

_HOST_NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?")

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


def metrics_problems(metrics: str | None, hosts: Collection[str]) -> Iterator[Problem]:
    """What is wrong with the address of the metrics, and with the names of `metrics_hosts`."""
    if metrics is not None and (metrics.startswith("unix:") or not is_listening_address(metrics)):
        yield "metrics", f'expected "host:port" such as "127.0.0.1:9100", found "{metrics}"'
    if hosts and metrics is None:
        yield "metrics_hosts", 'needs metrics, such as "0.0.0.0:9100"'
    for index, host in enumerate(hosts):
        if not _HOST_NAME.fullmatch(host):
            yield (
                f"metrics_hosts[{index}]",
                f'expected a name such as "host.docker.internal", without a port, found "{host}"',
            )
