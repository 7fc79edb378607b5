"""The event log of a flight, and everything that is read from it."""
