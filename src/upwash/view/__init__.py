"""Flights as a page that moves, live or afterwards: event logs, served to a browser on this machine."""
