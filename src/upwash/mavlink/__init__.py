"""MAVLink as the driver and the stand-in both speak it."""
