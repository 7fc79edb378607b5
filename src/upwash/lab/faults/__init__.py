"""Drawn worlds with faults, and the promises that every flight in them keeps (docs/promises.md)."""
