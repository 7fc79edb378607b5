"""Trains the default detector; not part of the installed package."""
