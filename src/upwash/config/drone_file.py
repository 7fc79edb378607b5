"""Reads a drone's configuration or a scenario."""

from __future__ import annotations

from pathlib import Path

from upwash.config.checks import problems
from upwash.config.drone import DroneConfig
from upwash.config.problems import Document, refuse_first
from upwash.config.reading import convert, read_document
from upwash.config.shorthand import written_out


def read_drone_config(path: Path) -> DroneConfig:
    """The configuration in the file; raises ConfigError for anything that could not be flown or simulated."""
    return drone_config(read_document(path), path)


def drone_config(document: Document, file: Path) -> DroneConfig:
    """The configuration that the document of that file says; raises ConfigError."""
    tables = written_out(document, file.absolute().parent)
    config = convert(tables, DroneConfig, file=file, as_written=document)
    refuse_first(file, problems(config))
    return config
