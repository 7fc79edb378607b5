"""Starts the programs on real things, one module a program: the flight, the edge daemon, the surveys before a flight.

The laws: what a configuration asks for and this machine lacks is a UsageError with the remedy, before anything
starts. What was opened is closed in reverse order, however the program ends. Optional libraries are imported where
a configuration needs them.

`flight` starts a drone's flight from `drone` (vehicle, servers, own services), `cameras` and `networks`;
`readiness`, `survey` and `server_survey` find beforehand what would prevent it. `daemon` starts the edge daemon
from `daemon_keys`, `daemon_services`, `confinement` and `containers`; `daemon_changes` reloads it and hands it
over.

What is ugly: `daemon.serve` is one long function, since the order in which its parts start and end is its subject.
"""
