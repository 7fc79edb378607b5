"""Servers' networks: joined by NetworkManager, and servers found in them by multicast DNS.

Laws. A network is a connection profile that is on the drone before take-off: nothing here makes or changes one. Only
the configured interfaces are used. `leave` ends all that a join began, and the next join ends what an earlier flight
left. An address found by multicast DNS is not trusted: the server must show its certificate.

- networkmanager.py   NetworkManager's calls and signals on D-Bus; decides nothing
- profiles.py         which profile and interface a network needs, and what keeps them from being used
- network.py          the Network of a drone: join, lost, leave
- discovery.py        announces servers, and finds them

Ugly: NetworkManager names a connection's path only in the reply to the activation, and may signal about it before.
So early signals are kept and read again. Its reasons are numbers without texts, and its "no secrets" often means
that the access point went away.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SurveyFinding:
    """One thing that a flight needs, its present state, and its trouble with the remedy; "" without trouble."""

    subject: str
    found: str
    trouble: str = ""
