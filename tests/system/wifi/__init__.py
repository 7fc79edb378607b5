"""Flights over a real WiFi stack, in a virtual machine: `python -m tests.system.wifi`."""
