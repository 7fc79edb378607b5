"""The drone-side machine: events in, commands out (thesis sections 3.2 to 3.4)."""
