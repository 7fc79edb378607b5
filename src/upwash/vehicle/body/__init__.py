"""The parts of a stand-in that both autopilots share.

- `copter`: the base of all vehicles: settings, faults, the battery, and the questions that reports ask.
- `parameters`: named values with types; each autopilot's names and defaults are in its `parameters.csv`.
- `kinematics`: motions made of parts under a constant jerk; the simulation flies by them too.
- `fence`: areas, and the mission protocol that uploads them. `ftp`: files over MAVLink FTP.
- `telemetry`: the reports. `firmware`: what a connection needs of an autopilot, and how commands are read.
- `connection`: peers, their streams of reports and their requests, on a clock that may run faster.

An autopilot adds to `Multicopter`, `StandInTelemetry` and `StandInFirmware` by subclasses, and gives `FenceTransfer`
its rules.

Ugly: `ftp` serves ArduPilot only, as the stand-in PX4 runs no scripts; but it knows nothing of ArduPilot.
"""
