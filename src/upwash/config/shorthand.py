"""Write out the short forms of a drone's configuration.

This runs before the types are checked: a value that is not recognised here stays as it is, and is refused there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from upwash.config.reading import Document
from upwash.config.world import RADIOS

_LOCAL = ("local_call_s", "local_pace_s", "local_joining_slowdown")
_REMOTE = ("processing_s", "remote_call_s")


def written_out(document: Document, folder: Path) -> Document:
    """The document without shorthands, its times by service and profile key, its paths from the folder.

    A service with a program of its own and without a delay on the drone gets an infinite delay: only servers run it.
    """
    services: list[dict[str, Any]] = []
    if isinstance(found := document.get("service"), list):
        found = each_table(found, lambda table: _with_local_keys(table, document))
        document = document | {"service": found}
        services = [table for table in found if isinstance(table, dict)]
    changes: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
        "camera": lambda table: _with_film_from(table, folder),
        "mission": lambda table: _with_program_from(table, folder),
        "policy": lambda table: _with_path_from(table, "name", folder),
        "service": lambda table: (
            _with_program_from(table, folder) | _by_key(table, *_LOCAL) | _before_sending(table)
        ),
        "server": lambda table: _server(table, services, folder),
        "user": lambda table: _with_program_from(table, folder),
        "drone": lambda table: (
            _with_path_from(table, "policy", folder) | _by_service(table, services, "local_call_s")
        ),
    }
    tables = {name: each_table(document[name], changes[name]) for name in changes if name in document}
    return document | tables


def _with_local_keys(service: dict[str, Any], document: Document) -> dict[str, Any]:
    """The service; without a delay on the drone, an infinite one for each profile key of its times at servers."""
    if "program" not in service or not service.keys().isdisjoint(_LOCAL):
        return service
    servers = document.get("server")
    tables = [table for table in servers if isinstance(table, dict)] if isinstance(servers, list) else []
    times = [times for table in tables for name in _REMOTE if isinstance(times := table.get(name), dict)]
    by_key = [its for its_times in times if isinstance(its := its_times.get(service.get("name")), dict)]
    keys = dict.fromkeys(key for its in by_key for key in its) or [""]
    return service | {"local_call_s": dict.fromkeys(keys, math.inf)}


def each_table(value: Any, write_out: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """The table written out, or each table of an array; other values stay as they are."""
    if isinstance(value, list):
        return [each_table(item, write_out) if isinstance(item, dict) else item for item in value]
    return write_out(value) if isinstance(value, dict) else value


def _with_program_from(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table with its program's file, and the files that its command names, as paths from the folder."""
    table, command = _with_path_from(table, "program", folder), table.get("command")
    if not isinstance(command, list):
        return table
    words = [
        str(folder / word) if isinstance(word, str) and word and (folder / word).is_file() else word
        for word in command
    ]
    return table | {"command": words}


def _with_path_from(table: dict[str, Any], key: str, folder: Path) -> dict[str, Any]:
    name = table.get(key)
    return table | {key: str(folder / name)} if isinstance(name, str) and ".py:" in name else table


def _with_film_from(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    device = table.get("device")
    if isinstance(device, str) and is_file(folder / device):
        return table | {"device": str(folder / device)}
    return table


def is_file(path: Path) -> bool:
    """Whether a file has that path; False for a path that no file can have, such as a pipeline."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def image_written_out(image: dict[str, Any], folder: Path) -> dict[str, Any]:
    """A daemon's service with its times by profile key and its program's file as a path from the folder."""
    return _with_program_from(image, folder) | _by_key(image, "pace_s")


def _by_key(table: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: {"": table[name]} for name in names if _is_number(table.get(name))}


def _before_sending(service: dict[str, Any]) -> dict[str, Any]:
    table = service.get("before_sending")
    return {"before_sending": table | _by_key(table, "loss")} if isinstance(table, dict) else {}


def _server(server: dict[str, Any], services: list[dict[str, Any]], folder: Path) -> dict[str, Any]:
    table = server | _by_service(server, services, *_REMOTE)
    if isinstance(server.get("truth"), dict):
        truth = server["truth"]
        table["truth"] = truth | _by_service(truth, services, *_REMOTE)
        if isinstance(truth.get("radio"), str) and truth["radio"] not in ("", *RADIOS):
            table["truth"]["radio"] = str(folder / truth["radio"])
    if server.get("name"):
        table.setdefault("network", server["name"])
    return table


def _by_service(table: dict[str, Any], services: list[dict[str, Any]], *names: str) -> dict[str, Any]:
    """The times of a table by service and key: a number is that of all beneath, a key's that of all that have it."""
    named = {service["name"]: service for service in services if isinstance(service.get("name"), str)}
    if not named:
        return {}
    return {name: _nested(table[name], named) for name in names if name in table}


def _nested(times: object, services: dict[str, dict[str, Any]]) -> object:
    if _is_number(times):
        return {name: dict.fromkeys(_keys(service), times) for name, service in services.items()}
    if not isinstance(times, dict):
        return times
    nested: dict[str, Any] = {}
    for name, value in times.items():
        if name not in services and _is_number(value):
            having = [owner for owner, service in services.items() if name in _keys(service)]
            for owner in having or [next(iter(services))]:  # which is then said not to have it
                nested.setdefault(owner, {})[name] = value
    for name, value in times.items():  # what names its service says more than a key does
        if name in services:
            by_key = dict.fromkeys(_keys(services[name]), value) if _is_number(value) else value
            nested[name] = nested.get(name, {}) | by_key if isinstance(by_key, dict) else by_key
        elif not _is_number(value):
            nested[name] = value
    return nested


def _keys(service: dict[str, Any]) -> list[str]:
    local_call_s = service.get("local_call_s")
    return list(local_call_s) if isinstance(local_call_s, dict) else [""]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
