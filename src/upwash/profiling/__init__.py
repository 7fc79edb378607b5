"""PROGRAM: measures what the calls of a service cost."""
