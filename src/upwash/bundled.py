"""Missions and services by name: the bundled ones, and the user's own by their path."""

from __future__ import annotations

import functools
import inspect
from typing import cast

from upwash.config import DroneConfig
from upwash.drone import Mission
from upwash.errors import UsageError
from upwash.loading import load
from upwash.service import load_service, spec_of

_MISSIONS = {"survey": "upwash.missions.survey:survey"}
_SERVICES = {"detector": "upwash.services.hotspots:HotSpotDetector"}


def load_mission(program: str, *, mode: str) -> Mission:
    """The mission of that name or path; one with a parameter `mode` gets it."""
    if ":" not in program and program not in _MISSIONS:
        raise UsageError(
            f"there is no mission {program!r}: the bundled ones are {', '.join(_MISSIONS)}; "
            "a mission of your own is path/to/file.py:function"
        )
    mission = load(_MISSIONS.get(program, program))
    if not callable(mission):
        raise UsageError(f"mission {program!r} is not a function")
    if inspect.iscoroutinefunction(mission):
        raise UsageError(f"mission {program!r} is async: write it as a plain blocking function")
    try:
        signature = inspect.signature(mission)
        if "mode" in signature.parameters:
            mission = functools.partial(mission, mode=mode)
        inspect.signature(mission).bind(None)
    except (TypeError, ValueError) as error:
        raise UsageError(f"mission {program!r} cannot be called with a drone alone: {error}") from error
    return cast(Mission, mission)


def load_configured_services(config: DroneConfig) -> dict[str, type]:
    """The class of each service of the configuration, by name; raises UsageError."""
    services = {
        service.name: load_service(service_program(config, service.name)) for service in config.services
    }
    for name, cls in services.items():
        own = spec_of(cls).name
        if own != name:
            raise UsageError(
                f"service {name!r} runs {cls.__name__}, which is declared as {own!r}: use that name"
            )
    return services


def service_program(config: DroneConfig, service: str) -> str:
    """The path of a configured service's class."""
    program = next(each.program for each in config.services if each.name == service)
    return program or bundled_service(service)


def bundled_service(name: str) -> str:
    """The path of a bundled service's class; raises UsageError naming those that there are."""
    if name not in _SERVICES:
        raise UsageError(
            f"service {name!r} needs a program, package.module:Class; without one only "
            f"{', '.join(_SERVICES)} are known"
        )
    return _SERVICES[name]
