"""Starts the programs on real things: the flight, the edge daemon, the surveys before a flight.

The laws: if the configuration names a thing that this machine lacks, a UsageError is raised before the start.
What was opened is closed in reverse order, however the program ends. Optional libraries are imported where a
configuration needs them.

`flight` starts a drone's flight from `drone` (vehicle, networks, servers, own services) and `cameras`. `readiness`
and `survey` find beforehand what would prevent it. `handover` gives its findings to `recipients`. `daemon`
starts the edge daemon from `daemon_keys`, `daemon_services`, `confinement` and `containers`. `daemon_reload` takes
its operator's orders, `in_force` keeps what came of them, `daemon_check` says what would. `daemon_changes` hands it
over.

What is ugly: `daemon.serve` is one long function. Its subject is the order of all starts and ends.
"""
