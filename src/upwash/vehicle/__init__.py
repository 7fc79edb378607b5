"""A stand-in multicopter that speaks MAVLink, as ArduCopter or PX4 does, for machines without an autopilot.

`server` puts a stand-in on a socket. A stand-in is one body with the dialect of one autopilot:

- `body/`: what both autopilots share: settings, faults, parameters, battery, fence, files, reports, connections.
- `ardupilot/` and `px4/`: how an autopilot flies, its modes, checks, fail-safes, answers and texts.

Both dialects import the body, and never each other. A chain of classes makes a vehicle: `Multicopter` (body), then
how it flies, then what it obeys. The firmware beside it translates messages.
A vehicle collects its texts or events; after each message, and by itself, its firmware sends them to all peers.

Laws: time is an argument everywhere below `body/connection.py`, so a stand-in lives on virtual time as on real time.
Figures and texts are those of recorded flights (tests/vehicle), which judge every change. No message may raise.

Ugly: the two fly by different mathematics. ArduCopter's motion is drawn in advance and read off by the time; PX4's is
computed in steps. Each was fitted to its own recordings, and neither fits the other's.
"""
