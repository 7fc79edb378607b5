"""A MAVLink-speaking stand-in multicopter, for machines without an autopilot."""
