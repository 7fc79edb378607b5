"""Vehicles over MAVLink: ArduCopter and PX4.

The laws:

1. No command is sent unless the vehicle is the program's (`core.vehicle.control`). Each command first waits for a
   fresh heartbeat, so that a pilot who has just taken the vehicle keeps it. Questions are always sent.
2. A verb returns when the vehicle's reports show that it is done, never because a command was accepted.
3. Silences of the link count against no verb; a long silence ends the verb in progress (AutopilotLost).
4. A message is believed only from the followed vehicle, in order, with possible numbers, and signed where there is a
   key. A defect in the handling of a message costs that message.

From the bytes up: `link` opens connections, `receiver` decides which bytes are believed, `identity` whose they are,
`numbering` which are new, and `gate` which numbers are possible. `news` limits the messages to a person. `telemetry`
keeps the last reports, `streams` has them sent often enough, `tracker` makes a position of them. `observed` ties
these together as a vehicle that answers questions, and `vehicle` adds commands. `parameters`, `ftp`, `mission_list`,
`fence`, `rally`, `needs`, `way_home` and `dead_man` each read or set one thing in it. `reports` answers a mission's
questions, and `autopilot` adds its verbs. The firmwares differ in `arducopter` and `px4` (with `px4_firmware` and
`setpoints`).

What is ugly: MAVLink answers belong to no request, so an answer may be that of an earlier attempt, and most verbs
rely on reports instead. An absent parameter and a lost question look alike. PX4 tells its fail-safes by events whose
texts stand in a table made from its source. Only their clocks distinguish vehicles with one system id.
"""

from upwash.real.mavlink.autopilot import MavlinkAutopilot
from upwash.real.mavlink.connect import connect_autopilot
from upwash.real.mavlink.link import MavlinkLink
from upwash.real.mavlink.settings import DriverPatience, FlightSettings

__all__ = ["DriverPatience", "FlightSettings", "MavlinkAutopilot", "MavlinkLink", "connect_autopilot"]
