"""The computers that the emulated programs run on: a drone's own, and each server's."""

from __future__ import annotations

from typing import Protocol

from upwash.config import DaemonConfig, RuntimeConfig
from upwash.emulation.namespaces import inside, make_namespace


class Computers(Protocol):
    """Makes computers, each with a network namespace of its name."""

    def make(self, name: str) -> None:
        """Makes a computer whose network namespace has nothing but its loopback."""

    def inside(self, name: str) -> tuple[str, ...]:
        """The words that run a command on the computer."""

    def equip(self, name: str, daemon: DaemonConfig, *, subnet: str) -> RuntimeConfig:
        """Has the computer able to run the daemon's services; returns in what.

        Services that have addresses of their own get them from the subnet.
        """


class NamespaceComputers:
    """Computers that are network namespaces and nothing more: they share this machine's files and processes."""

    def make(self, name: str) -> None:
        """Makes a namespace."""
        make_namespace(name)

    def inside(self, name: str) -> tuple[str, ...]:
        """The words that run a command in the namespace."""
        return inside(name)

    def equip(self, name: str, daemon: DaemonConfig, *, subnet: str) -> RuntimeConfig:
        """Services are processes of their daemon."""
        return RuntimeConfig(sandbox_as_root=True)  # who else may make networks
